"""Duct modes and the excitation against tabulated and closed-form values."""

from dataclasses import replace

import numpy as np
import pytest
from wave_lumens import BORE, straight_tube

from acoustube.air import Air, air_at, sound_speed
from acoustube.runs.sound import band_of
from acoustube.waves import cut_cells, section_cut_ons
from acoustube.waves.modes import (
    attenuation,
    axial_wavenumber,
    bessel_zero,
    cut_on_frequency,
    cut_ons_in_band,
    modes_below,
)
from acoustube.waves.network_checks import OUT_OF_BAND_ENERGY
from acoustube.waves.scheme.pulse import Pulse, SampledPulse

RADIUS = 3.95e-3


def test_air_at_20_degrees_has_tabulated_properties():
    """ISO 9613-1 rounds the speed to 343.2 m/s; 1.204 kg/m3 is the standard's density."""
    air = air_at(20.0)
    assert air.sound_speed == pytest.approx(343.2, abs=0.05)
    assert air.density == pytest.approx(1.204, abs=5e-4)
    assert sound_speed(20.0) == air.sound_speed


def test_impossible_temperatures_and_gases_are_refused():
    with pytest.raises(ValueError, match="absolute zero"):
        sound_speed(-300.0)
    with pytest.raises(ValueError, match="density"):
        Air(sound_speed=343.0, density=0.0)


@pytest.mark.parametrize(
    ("mode", "zero"),
    [((0, 0), 0.0), ((1, 1), 1.8412), ((2, 1), 3.0542), ((0, 1), 3.8317), ((3, 1), 4.2012)],
)
def test_zeros_match_abramowitz_and_stegun(mode, zero):
    """Table 9.5, four decimals."""
    assert bessel_zero(*mode) == pytest.approx(zero, abs=5e-5)


def test_modes_are_complete_and_sorted():
    """All zeros j'mn below 10 (Abramowitz and Stegun): 0 and fourteen more."""
    modes = modes_below(cut_on_frequency(0, 0, RADIUS, 343.2) + 10 * 343.2 / (2 * np.pi * RADIUS),
                        RADIUS, 343.2)  # fmt: skip
    expected = {(0, 0), (1, 1), (2, 1), (0, 1), (3, 1), (4, 1), (1, 2), (5, 1), (2, 2), (0, 2),
                (6, 1), (3, 2), (1, 3), (7, 1), (4, 2), (8, 1), (2, 3)}  # fmt: skip
    expected = {mode for mode in expected if bessel_zero(*mode) < 10.0}
    assert {(mode.m, mode.n) for mode in modes} == expected
    cut_ons = [mode.cut_on for mode in modes]
    assert cut_ons == sorted(cut_ons)


def test_cut_on_of_21_lies_in_the_carrier_band():
    """(2,1) cuts on 0.6 % above 42 kHz in this bore: commands must warn of this case."""
    critical = cut_ons_in_band(Pulse(frequency=42e3).band(), RADIUS, 343.2)
    broad = cut_ons_in_band((0.0, 48e3), RADIUS, 343.2)  # that of a pulse of one or two cycles
    assert broad == modes_below(48e3, RADIUS, 343.2)[1:]
    assert [(mode.m, mode.n) for mode in critical] == [(2, 1)]
    assert critical[0].cut_on == pytest.approx(42.24e3, rel=1e-3)


TABLE_AIR = Air(sound_speed=343.2, density=1.204, viscosity=1.8133e-5, prandtl=0.70520337)


def test_wavenumber_of_the_plane_mode_is_zwikker_and_kostens():
    """Attenuation in Np/m and phase speed in m/s, from values computed with 40 digits."""
    frequency = np.array([1e3, 10e3, 28e3])
    found = axial_wavenumber(0, 0, frequency, RADIUS, TABLE_AIR)
    assert -found.imag == pytest.approx([0.239945, 0.752134, 1.25651], rel=1e-4)
    assert 2 * np.pi * frequency / found.real == pytest.approx(
        [338.8165, 341.8015, 342.3628], rel=1e-6
    )


def test_wall_and_air_attenuate_a_mode():
    """The wall attenuates (1,1) by 2.266 Np/m to first order; the air adds its absorption."""
    assert attenuation(1, 1, 42e3, RADIUS, TABLE_AIR) == pytest.approx(2.266, abs=3e-3)
    moist = air_at(20.0)
    dry = replace(moist, classical_absorption=0.0, relaxations=())
    added = attenuation(0, 0, 42e3, RADIUS, moist) - attenuation(0, 0, 42e3, RADIUS, dry)
    assert added == pytest.approx(moist.absorption(42e3), rel=5e-3)
    assert axial_wavenumber(0, 0, 42e3, RADIUS, moist, lossy=False) == pytest.approx(
        2 * np.pi * 42e3 / moist.sound_speed
    )


def test_attenuation_below_cut_on_is_evanescent_decay():
    """(0,1) at 42 kHz decays over 1 / sqrt((j'/R)^2 - k^2) = 1.7 mm."""
    assert 1e3 / attenuation(0, 1, 42e3, RADIUS, air_at(20.0)) == pytest.approx(1.7, abs=0.1)
    evanescent = axial_wavenumber(0, 1, 42e3, RADIUS, TABLE_AIR, lossy=False)
    assert evanescent.real == 0.0
    assert evanescent.imag < 0.0


def test_mode_without_nodal_circle_count_is_refused():
    with pytest.raises(ValueError, match="does not exist"):
        bessel_zero(1, 0)


def test_pulse_band_is_that_of_its_spectrum():
    """The Gaussian's band is compared with the spectrum of samples; the cut at 3 sigma adds 2 %."""
    pulse = Pulse(frequency=42e3)
    time = np.arange(0.0, 20 * pulse.duration, 1e-7)
    spectrum = np.abs(np.fft.rfft(pulse(time)))
    frequency = np.fft.rfftfreq(len(time), 1e-7)
    above = frequency[spectrum > spectrum.max() * 0.5]
    lowest, highest = pulse.band(-20 * np.log10(2))
    assert above[0] == pytest.approx(lowest, abs=0.02 * (highest - lowest) + 100)
    assert above[-1] == pytest.approx(highest, abs=0.02 * (highest - lowest) + 100)


def test_pulse_starts_and_ends_in_silence():
    """Zero outside its window, continuous at its ends, unit peak envelope inside."""
    pulse = Pulse(frequency=42e3)
    assert np.all(pulse([-1e-6, pulse.duration + 1e-6]) == 0.0)
    assert np.abs(pulse([1e-12, pulse.duration - 1e-12])).max() < 1e-6
    assert np.abs(pulse(np.linspace(0, pulse.duration, 10001))).max() == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize("half", [False, True])
def test_section_of_a_round_bore_cuts_on_at_bessel_zeros(half):
    """Cut-ons at 32 cells per bore: 0.2 %, the cut cells' error.

    The half has one mode of each pair.
    """
    h = 2 * BORE / 32
    cells = cut_cells(straight_tube(4 * h, sections=512), h, half=half)
    found = section_cut_ons(cells, 2, 343.2, n_modes=3 if half else 5)
    pairs = [(0, 0), (1, 1), (2, 1)] if half else [(0, 0), (1, 1), (1, 1), (2, 1), (2, 1)]
    exact = [cut_on_frequency(m, n, BORE, 343.2) for m, n in pairs]
    assert found[0] < 1.0
    assert found[1:] == pytest.approx(exact[1:], rel=2e-3)


def test_sampled_pulse_is_the_pulse_that_was_sampled():
    """24 samples per period at 1 MHz: a cubic spline within 5e-4 of the peak, zero outside."""
    pulse = Pulse(frequency=42e3)
    n = int(pulse.duration * 1e6) + 1
    sampled = SampledPulse(pressure=pulse(np.arange(n) / 1e6), rate=1e6)
    time = np.linspace(0, sampled.duration, 5001)
    assert sampled(time) == pytest.approx(pulse(time), abs=5e-4)
    assert np.all(sampled([-1e-6, sampled.duration + 1e-6]) == 0.0)


@pytest.mark.parametrize(
    ("words", "part"),
    [
        ({"pressure": [1.0, 2.0]}, "shape"),
        ({"pressure": [0.0, 1.0, np.nan, 0.0]}, "finite"),
        ({"rate": 0.0}, "rate = 0 is out of range"),
    ],
)
def test_samples_that_are_no_pulse_are_refused(words, part):
    with pytest.raises(ValueError, match=part):
        SampledPulse(**{"pressure": np.zeros(10), "rate": 1e6} | words)


@pytest.mark.parametrize("cycles", [1, 2, 3, 5, 11, 100])
def test_computed_band_of_a_pulse_holds_the_energy_that_joining_presses_requires(cycles):
    pulse = Pulse(frequency=10e3, cycles=cycles)
    frequency = np.fft.rfftfreq(2**17, 1e-6)
    energy = np.abs(np.fft.rfft(pulse(1e-6 * np.arange(2**17)))) ** 2
    low, high = band_of(pulse)
    inside = (frequency >= low) & (frequency <= high)
    assert energy[~inside].sum() < 0.8 * OUT_OF_BAND_ENERGY * energy.sum()
