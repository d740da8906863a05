"""Sound in a tube of any length with any number of presses, from their scattering matrices.

Between the presses each mode travels by its own wavenumber, exact in its dispersion and its losses;
each press couples the modes as its scattering matrix says; both ends reflect all modes alike. At
each frequency the reflection of all that lies beyond a plane is built up from the far end to the
source, press by press (Redheffer's star product), and the waves then from the source to the far
end: all echoes between presses and ends are in it. A mode is dropped from a press where it does
not propagate, so that the near fields of two presses do not meet.

References
----------
Redheffer, R. (1962). On the relation of transmission-line theory to scattering and transfer.
Journal of Mathematics and Physics 41, 1-41. doi:10.1002/sapm19624111
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import log, pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import next_fast_len
from scipy.signal import CZT

from acoustube.air import Air
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.modes import axial_wavenumber, cut_on_frequency
from acoustube.waves.modes.grid_modes import mode_numbers
from acoustube.waves.scattering import Complex, ModalScattering, Scattering
from acoustube.waves.scheme.pulse import check_duration

Signal = Callable[[Array], ArrayLike]
Reflection = complex | NDArray[Any]

LEFT_OUT = 1e-4
"""Share of a pulse's energy that may lie outside the band of the scattering matrices."""
COARSEST_STEP = 300.0
"""Largest step in Hz of a scattering matrix that can be told between its frequencies.

With 200 or 300 Hz the echo of a pinched tube at 42 kHz, beside the cut-on of (2,1), was right to
0.4 %, with 500 Hz to 2 %, or 22 % where a mode was trapped.
"""
SAME_BORE = 0.04
"""Largest relative error of a cut-on that counts as that of the grid."""
CYCLE = 4
"""Computed time, which is cyclic, in wanted durations."""
FADED = 1e4
"""By how much what lasts longer than the cycle is damped before it comes in again."""


@dataclass(frozen=True)
class Placed:
    """A press, or a bend, and where it is.

    Attributes
    ----------
    scattering : ModalScattering
        With both reference planes at one place; that of a file is z = 0 of its surface.
    position : float
        Distance of that place from the source end in m.
    """

    scattering: ModalScattering
    position: float


def heard(
    presses: Sequence[Placed],
    air: Air,
    pulse: Signal,
    *,
    radius: float,
    length: float,
    duration: float,
    time_step: float = 1e-6,
    probes: Sequence[float] = (0.02,),
    source_reflection: Reflection = -1.0,
    far_reflection: Reflection = 0.0,
    lossy: bool = True,
) -> tuple[Array, Array]:
    """Return what probes along a tube hear of a pulse.

    Parameters
    ----------
    presses : sequence of Placed
        In any order; none for an untouched tube.
    air : Air
        Gas in the lumen.
    pulse : callable
        Pressure over time in s that the source launches into the tube, as a `Pulse`.
    radius, length : float
        Of the bore, in m.
    duration : float
        In s.
    time_step : float
        In s.
    probes, source_reflection, far_reflection, lossy
        See :func:`transfer`. With -1 at the source the pressure there is the pulse, afterwards 0.

    Returns
    -------
    time : ndarray
        (n,) in s, from 0.
    pressure : ndarray
        Plane-averaged, (n_probes, n), in units of the pulse.

    Raises
    ------
    ValueError
        As :func:`transfer`; or if the pulse holds sound outside the band of the presses, or lasts
        longer than the run.

    Notes
    -----
    The spectra are those of the pressure times a decaying exponential, taken out again at the end:
    a tube without losses rings for longer than any time that one would compute.
    """
    if not time_step > 0:
        raise ValueError(f"time_step = {time_step} s must be positive")
    check_duration(pulse, duration)
    n = int(np.ceil(duration / time_step)) + 1
    n_cycle = next_fast_len(CYCLE * n, real=True)
    time = np.arange(n_cycle) * time_step
    damping = log(FADED) / time[-1]
    spectrum = np.fft.rfft(np.asarray(pulse(time), float) * np.exp(-damping * time))
    frequency = np.fft.rfftfreq(n_cycle, time_step)
    inside = in_band(presses, frequency, spectrum, what="the pulse")
    answer = np.zeros((len(probes), len(frequency)), complex)
    answer[:, inside] = spectrum[inside] * transfer(
        presses, air, frequency[inside] - 1j * damping / (2 * pi), radius=radius, length=length,
        probes=probes, source_reflection=source_reflection, far_reflection=far_reflection,
        lossy=lossy,
    )  # fmt: skip
    pressure = np.fft.irfft(answer, n_cycle) * np.exp(damping * time)
    return time[:n], pressure[:, :n]


def transfer(
    presses: Sequence[Placed],
    air: Air,
    frequency: NDArray[Any],
    *,
    radius: float,
    length: float,
    probes: Sequence[float] = (0.02,),
    source_reflection: Reflection = -1.0,
    far_reflection: Reflection = 0.0,
    lossy: bool = True,
) -> Complex:
    """Return the plane-averaged pressure at probes over that which the source launches.

    Parameters
    ----------
    presses : sequence of Placed
        In any order.
    air : Air
        Gas in the lumen.
    frequency : ndarray
        In Hz, (n,), within the band of all presses; with a negative imaginary part it is that of
        sound that decays.
    radius, length : float
        Of the bore, in m.
    probes : sequence of float
        Distances from the source end in m, (n_probes,).
    source_reflection, far_reflection : complex or ndarray
        Pressure that an end sends back, over that which arrives, the same for all modes; one
        number or (n,): -1 for a prescribed pressure, 0 for an endless tube, 1 for a rigid wall, or
        what was measured of a transducer.
    lossy : bool
        With the losses in the straight parts.

    Returns
    -------
    ndarray
        Time as exp(+j omega t), (n_probes, n).

    Raises
    ------
    ValueError
        If presses overlap each other, an end or a probe, are of another air or bore, have different
        modes, or the frequencies leave their band.
    """
    frequency = np.atleast_1d(frequency)
    _check_tube(presses, air, radius)
    presses = sorted(presses, key=lambda press: press.position)
    _check_places(presses, length, probes)
    modes = _common_modes(presses)
    matrices = [continued(press.scattering, frequency) for press in presses]
    waves = np.stack(
        [
            axial_wavenumber(*mode_numbers(name), frequency, radius, air, lossy=lossy)
            for name in modes
        ],
        axis=-1,
    )
    places = np.array([press.position for press in presses])
    lengths = np.diff([0.0, *places, length])
    beyond = _reflections(matrices, waves, lengths, far_reflection)
    plane = modes.index("00")
    forward = _forward(matrices, waves, lengths, beyond, source_reflection, plane)
    pressure = np.zeros((len(probes), len(frequency)), complex)
    for i, probe in enumerate(probes):
        k = int(np.searchsorted(places, probe))
        ahead = probe - lengths[:k].sum()
        there = _at(ahead, lengths[k] - ahead, waves, forward[k], beyond[k].at_end)
        pressure[i] = there[:, plane]
    return pressure


class _Beyond(NamedTuple):
    """What all beyond sends back at the start and at the end of a straight part, (n, m, m)."""

    at_start: Complex
    at_end: Complex


def _reflections(
    matrices: list[Complex], waves: Complex, lengths: Array, far: Reflection
) -> list[_Beyond]:
    """Return what is reflected in each straight part, built up from the far end."""
    m = waves.shape[1]
    at_end: Complex = np.asarray(
        np.reshape(far, (-1, 1, 1)) * np.eye(m) * np.ones((len(waves), 1, 1)), complex
    )
    found = []
    for k in range(len(matrices), -1, -1):
        way = _decayed(waves, lengths[k])
        at_start = np.asarray(way * at_end * way.swapaxes(1, 2))
        found.append(_Beyond(at_start, at_end))
        if k > 0:
            s = matrices[k - 1]
            loop = np.eye(m) - at_start @ s[:, 1, :, 1]
            passed = np.linalg.solve(loop, at_start @ s[:, 1, :, 0])
            at_end = np.asarray(s[:, 0, :, 0] + s[:, 0, :, 1] @ passed)
    return found[::-1]


def _forward(
    matrices: list[Complex],
    waves: Complex,
    lengths: Array,
    beyond: list[_Beyond],
    source: Reflection,
    plane: int,
) -> list[Complex]:
    """Return the waves (n, m, 1) that set out at the start of each straight part."""
    m = waves.shape[1]
    launched = np.zeros((len(waves), m, 1), complex)
    launched[:, plane] = 1.0
    loop = np.eye(m) - np.reshape(source, (-1, 1, 1)) * beyond[0].at_start
    found = [np.asarray(np.linalg.solve(loop, launched))]
    for s, before, length in zip(matrices, beyond[1:], lengths, strict=False):
        arriving = _decayed(waves, length) * found[-1]
        loop = np.eye(m) - s[:, 1, :, 1] @ before.at_start
        found.append(np.asarray(np.linalg.solve(loop, s[:, 1, :, 0] @ arriving)))
    return found


def _decayed(waves: Complex, distance: float) -> Complex:
    """Return what remains of each mode after a distance, (n, m, 1)."""
    return np.exp(-1j * waves * distance)[:, :, None]


def _at(ahead: float, left: float, waves: Complex, forward: Complex, beyond: Complex) -> Complex:
    """Return the pressures (n, m) at a place in a straight part, of both directions."""
    here = _decayed(waves, ahead) * forward
    rest = _decayed(waves, left)
    return np.asarray((here + rest * (beyond @ (rest * here)))[:, :, 0])


def continued(scattering: ModalScattering, frequency: NDArray[Any]) -> Complex:
    """Return a scattering matrix at other frequencies, real or complex.

    Parameters
    ----------
    scattering : ModalScattering
        At evenly spaced frequencies.
    frequency : ndarray
        In Hz, (n,), their real parts within its band.

    Returns
    -------
    ndarray
        (n, port_out, mode_out, port_in, mode_in); zero where a mode does not propagate.

    Raises
    ------
    ValueError
        If the frequencies leave the band, or the given ones are not evenly spaced, or too far apart
        for a cut-on among them.

    Notes
    -----
    By the impulse response of the band: its spectrum at a frequency with a negative imaginary part
    is that of the response times a decaying exponential.
    """
    given = scattering.frequency
    low, high = given[[0, -1]]
    least, most = np.min(np.real(frequency)), np.max(np.real(frequency))
    if not low * (1 - 1e-9) <= least <= most <= high * (1 + 1e-9):
        raise ValueError(
            f"frequency = {least:g} to {most:g} Hz is outside the band of a press, {low:g} to "
            f"{high:g} Hz; compute its scattering over a wider band"
        )
    step = np.diff(given)
    if np.ptp(step) > 1e-6 * step[0]:
        raise ValueError("the frequencies of a press must be evenly spaced; compute them so")
    within = np.any((scattering.cut_ons > low) & (scattering.cut_ons < high))
    if within and step[0] > COARSEST_STEP:
        raise ValueError(
            f"steps of {step[0]:g} Hz are too coarse for what happens beside a cut-on; compute the "
            f"press in steps of {COARSEST_STEP:g} Hz at most"
        )
    n, s = len(given), scattering.s
    # The response begins before zero, since the press begins before its reference plane.
    early = n // 10
    time = (np.arange(n) - early) / (n * step[0])
    inverse = np.roll(np.fft.ifft(s.reshape(n, -1), axis=0), early, axis=0)
    response = np.exp(2j * pi * given[0] * time)[:, None] * inverse
    return _spectrum(response, time, np.asarray(frequency)).reshape(len(frequency), *s.shape[1:])


def _spectrum(response: Complex, time: Array, frequency: NDArray[Any]) -> Complex:
    """Return the spectra of columns over an even time, at any frequencies, real or complex.

    By the chirp-z transform where the frequencies are even: ten times as fast as sums.
    """
    n = len(frequency)
    steps = np.diff(frequency)
    if n < 2 or np.ptp(steps.real) > 1e-9 * steps[0].real or np.any(steps.imag != 0):
        return np.asarray(np.exp(-2j * pi * np.outer(frequency, time)) @ response, complex)
    rate = time[1] - time[0]
    transform = CZT(
        len(time), n, w=np.exp(-2j * pi * steps[0].real * rate),
        a=np.exp(2j * pi * frequency[0] * rate),
    )  # fmt: skip
    return np.asarray(
        transform(response, axis=0) * np.exp(-2j * pi * frequency * time[0])[:, None], complex
    )


def rescaled(scattering: Scattering, sound_speed: float) -> Scattering:
    """Return the scattering of the same lumen in air of another speed of sound.

    Parameters
    ----------
    scattering : Scattering
    sound_speed : float
        In m/s.

    Returns
    -------
    Scattering
        At other frequencies: those of the same wavelengths.

    Notes
    -----
    Without losses this is exact, on the grid too. The thickness of the boundary layers in
    wavelengths goes as the root of viscosity over speed times bore: 15 K change the losses within
    a press, some 0.5 dB, by 4 %.
    """
    ratio = sound_speed / scattering.sound_speed
    return replace(
        scattering,
        frequency=scattering.frequency * ratio,
        cut_ons=scattering.cut_ons * ratio,
        sound_speed=sound_speed,
        time_step=scattering.time_step / ratio,
    )


def _check_tube(presses: Sequence[Placed], air: Air, radius: float) -> None:
    """Refuse presses that were computed for another air or bore."""
    if not 0 < radius < np.inf:
        raise ValueError(f"radius = {radius} m must be positive")
    for press in presses:
        scattering = press.scattering
        if abs(scattering.sound_speed / air.sound_speed - 1) > 1e-3:
            raise ValueError(
                f"the press at {press.position:.4g} m was computed for sound at "
                f"{scattering.sound_speed:.2f} m/s and the tube's air carries it at "
                f"{air.sound_speed:.2f} m/s; compute it at the same temperature"
            )
        if "11c" in scattering.modes:
            found = scattering.cut_ons[scattering.modes.index("11c")]
            wanted = cut_on_frequency(1, 1, radius, air.sound_speed)
            if abs(found / wanted - 1) > SAME_BORE:
                raise ValueError(
                    f"radius = {radius:.4g} m is not that of the press at {press.position:.4g} m, "
                    f"whose mode (1,1) cuts on at {1e-3 * found:.4g} kHz: its bore has a radius of "
                    f"{radius * wanted / found:.4g} m"
                )


def in_band(
    presses: Sequence[Placed], frequency: Array, spectrum: Complex, *, what: str
) -> NDArray[np.bool_]:
    """Return which frequencies all presses know.

    Parameters
    ----------
    presses : sequence of Placed
    frequency : ndarray
        In Hz, (n,).
    spectrum : ndarray
        Of what is to be heard of them, (n,).
    what : str
        What an error calls it.

    Raises
    ------
    ValueError
        If it is silent, or too much of its energy lies at other frequencies.
    """
    inside = frequency > 0
    for press in presses:
        low, high = press.scattering.frequency[[0, -1]]
        inside &= (frequency >= low) & (frequency <= high)
    energy = np.abs(spectrum) ** 2
    if not 0 < energy.sum() < np.inf:
        raise ValueError(f"{what} is silent, or holds values that are not finite")
    left_out = energy[~inside].sum() / energy.sum()
    if left_out > LEFT_OUT:
        low, high = frequency[inside][[0, -1]] if inside.any() else (0.0, 0.0)
        raise ValueError(
            f"{100 * left_out:.2g} % of the energy of {what} lies outside {1e-3 * low:.4g} to "
            f"{1e-3 * high:.4g} kHz, in which the presses' scattering is known, and "
            f"{100 * LEFT_OUT:g} % are allowed; compute it over a wider band"
        )
    return inside


def _common_modes(presses: Sequence[Placed]) -> tuple[str, ...]:
    """Return the modes of all presses."""
    if not presses:
        return ("00",)
    modes = presses[0].scattering.modes
    for press in presses:
        if press.scattering.modes != modes:
            raise ValueError(
                f"the presses have different modes, {', '.join(modes)} and "
                f"{', '.join(press.scattering.modes)}; compute their scattering over one band, on "
                "one grid, and with the same symmetry"
            )
    return modes


def _check_places(presses: Sequence[Placed], length: float, probes: Sequence[float]) -> None:
    """Refuse presses that overlap, and probes within them or outside the tube."""
    parts = [
        (press.position + press.scattering.extent[0], press.position + press.scattering.extent[1])
        for press in presses
    ]
    free = 0.0
    for press, (start, end) in zip(presses, parts, strict=True):
        if start < free:
            raise ValueError(
                f"the press at {press.position:.4g} m, which bends the tube from {start:.4g} m to "
                f"{end:.4g} m, meets the one before it or the source end; place it at "
                f"{press.position + free - start:.4g} m or farther"
            )
        free = end
    if free > length:
        raise ValueError(
            f"the last press bends the tube up to {free:.4g} m, beyond its end at {length:.4g} m"
        )
    for probe in probes:
        if not 0 <= probe <= length or any(start < probe < end for start, end in parts):
            raise ValueError(
                f"probe = {probe:.4g} m lies outside the tube or within a press; move it"
            )
