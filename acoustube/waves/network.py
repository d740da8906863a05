"""Sound in a tube of any length with any number of presses, from their scattering matrices.

Between the presses each mode propagates with its own axial wavenumber, exact in dispersion and
losses. Each press couples the modes by its scattering matrix, and both ends reflect all modes
alike. At each frequency the input reflection of everything beyond a plane is built up from the far
end to the source, press by press (Redheffer's star product [1]_). The waves are then followed from
the source to the far end. All multiple echoes between presses and ends are included. Evanescent
modes are neglected between presses, so that the near fields of two presses do not interact, except
for a mode just below its cut-on, which extends over centimetres
(:mod:`acoustube.waves.cut_on_steps`).

References
----------
.. [1] Redheffer, R. (1962). On the relation of transmission-line theory to scattering and transfer.
   Journal of Mathematics and Physics 41, 1-41. doi:10.1002/sapm19624111
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import log, pi
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import next_fast_len

from acoustube.air import Air
from acoustube.base.checks import (
    DISTANCE,
    LENGTH,
    ONE_REFLECTION,
    PLACE,
    REFLECTION,
    WAVE_SERIES,
    Several,
    checked,
)
from acoustube.base.rules import Number
from acoustube.waves import network_checks as checks
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.interpolation import interpolate_scattering
from acoustube.waves.modes.grid_modes import change_by_losses, wavenumbers
from acoustube.waves.port_waves import Complex
from acoustube.waves.scattering import ModalScattering, PlacedScatterer, Scattering
from acoustube.waves.scheme.pulse import check_pulse

Signal = Callable[[Array], ArrayLike]
Reflection = complex | NDArray[Any]
AnyScattering = TypeVar("AnyScattering", bound=ModalScattering)

CYCLE = 4
"""Period of the discrete Fourier transform, in durations of the recording."""
WRAPAROUND_ATTENUATION = 1e4
"""Factor by which the exponential window attenuates wrap-around in the time domain."""


@checked(
    presses=Several(PlacedScatterer),
    air=Air,
    radius=PLACE,
    length=LENGTH,
    duration=Number(1e-9, 1e4, "s"),
    time_step=Number(-1, 1, "s"),
    probes=Several(DISTANCE, 1),
    source_reflection=ONE_REFLECTION,
    far_reflection=ONE_REFLECTION,
)
def probe_pressure(
    presses: Sequence[PlacedScatterer],
    air: Air,
    pulse: Signal,
    *,
    radius: float,
    length: float,
    duration: float,
    time_step: float = 1e-6,
    probes: Sequence[float] = (0.02,),
    source_reflection: complex = -1.0,
    far_reflection: complex = 0.0,
    lossy: bool = True,
) -> tuple[Array, Array]:
    """Return the pressure at probes along a tube, for a pulse launched at the source end.

    Parameters
    ----------
    presses : sequence of PlacedScatterer
        In any order; empty for an untouched tube.
    air : Air
        Gas in the lumen.
    pulse : callable
        Pressure that the source launches into the tube as a function of time in s, such as a
        `Pulse`.
    radius, length : float
        Radius of the bore and length of the tube in m.
    duration : float
        Duration of the recording in s.
    time_step : float
        Sampling interval in s.
    probes, lossy
        See :func:`transfer`.
    source_reflection, far_reflection : complex
        As in :func:`transfer`, one number for all frequencies. With -1 at the source the pressure
        there is the pulse, afterwards 0.

    Returns
    -------
    time : ndarray
        (n,) in s, from 0.
    pressure : ndarray
        Plane-averaged, (n_probes, n), in units of the pulse.

    Raises
    ------
    ValueError
        As :func:`transfer`; or if too much of the pulse's energy lies outside the band of the
        presses, the pulse lasts longer than the recording, the time step is not positive, or the
        recording has too many samples.

    Notes
    -----
    The spectra are those of the pressure times a decaying exponential, which is divided out again
    in the time domain, because a tube without losses rings for longer than any period of the
    transform. Their frequencies are complex, so that the part at frequency zero propagates too.
    """
    if not time_step > 0:
        raise ValueError(f"time_step = {time_step} s must be positive")
    check_pulse(pulse, duration)
    checks.check_samples(duration, time_step)
    n = int(np.ceil(duration / time_step)) + 1
    n_cycle = next_fast_len(CYCLE * n, real=True)
    time = np.arange(n_cycle) * time_step
    damping = log(WRAPAROUND_ATTENUATION) / time[-1]
    spectrum = np.fft.rfft(np.asarray(pulse(time), float) * np.exp(-damping * time))
    frequency = np.fft.rfftfreq(n_cycle, time_step)
    inside = checks.in_band(presses, frequency, spectrum, what="the pulse")
    answer = np.zeros((len(probes), len(frequency)), complex)
    answer[:, inside] = spectrum[inside] * transfer(
        presses, air, frequency[inside] - 1j * damping / (2 * pi), radius=radius, length=length,
        probes=probes, source_reflection=source_reflection, far_reflection=far_reflection,
        lossy=lossy,
    )  # fmt: skip
    pressure = np.fft.irfft(answer, n_cycle) * np.exp(damping * time)
    return time[:n], pressure[:, :n]


@checked(
    presses=Several(PlacedScatterer),
    air=Air,
    frequency=WAVE_SERIES,
    radius=PLACE,
    length=LENGTH,
    probes=Several(DISTANCE, 1),
    source_reflection=REFLECTION,
    far_reflection=REFLECTION,
)
def transfer(
    presses: Sequence[PlacedScatterer],
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
    """Return the transfer functions from the launched to the plane-averaged pressure at probes.

    Parameters
    ----------
    presses : sequence of PlacedScatterer
        In any order.
    air : Air
        Gas in the lumen.
    frequency : ndarray
        In Hz, (n,), within the band of all presses. With a negative imaginary part, spectra are
        those of signals times a decaying exponential.
    radius, length : float
        Radius of the bore and length of the tube in m.
    probes : sequence of float
        Distances from the source end in m, (n_probes,).
    source_reflection, far_reflection : complex or ndarray
        Pressure reflection coefficients of the ends, the same for all modes, a number or (n,): -1
        for a prescribed pressure, 0 for an endless tube, 1 for a rigid wall, or the measured
        coefficient of a transducer.
    lossy : bool
        With viscothermal losses and absorption in the straight parts.

    Returns
    -------
    ndarray
        For time dependence exp(+j omega t), (n_probes, n).

    Raises
    ------
    ValueError
        If presses overlap each other, an end or a probe, were computed for another air or bore, or
        have different modes; if a frequency lies outside their band; or if a reflection coefficient
        has another shape than () and (n,).
    """
    frequency = np.atleast_1d(frequency)
    checks.check_reflection("source_reflection", source_reflection, len(frequency))
    checks.check_reflection("far_reflection", far_reflection, len(frequency))
    checks.check_tube(presses, air, radius)
    presses = sorted(presses, key=lambda press: press.position)
    checks.check_places(presses, length, probes)
    modes = checks.common_modes(presses)
    losses = partial(change_by_losses, radius, air) if lossy else None
    matrices = [interpolate_scattering(press.scattering, frequency, losses) for press in presses]
    waves = wavenumbers(modes, frequency, radius, air, lossy=lossy)
    places = np.array([press.position for press in presses])
    ends = [press.position + press.scattering.extent[1] for press in presses]
    planes = np.array([press.scattering.planes for press in presses]).reshape(-1, 2)
    edges = np.hstack([0.0, (places[:, None] + planes).ravel(), length]).reshape(-1, 2)
    lengths = edges[:, 1] - edges[:, 0]
    loads = _load_reflections(matrices, waves, lengths, far_reflection)
    plane = modes.index("00")
    forward = _forward_waves(matrices, waves, lengths, loads, source_reflection, plane)
    pressure = np.zeros((len(probes), len(frequency)), complex)
    for i, probe in enumerate(probes):
        k = int(np.searchsorted(ends, probe, side="right"))
        ahead = probe - edges[k, 0]
        there = _pressure_at(ahead, lengths[k] - ahead, waves, forward[k], loads[k].at_end)
        pressure[i] = there[:, plane]
    return pressure


class _LoadReflection(NamedTuple):
    """Reflection matrices of all that lies ahead of a section's start and of its end.

    Each is (n, m, m), for n frequencies and m modes; "ahead" is towards the far end of the tube.
    """

    at_start: Complex
    at_end: Complex


def _load_reflections(
    matrices: list[Complex], waves: Complex, lengths: Array, far: Reflection
) -> list[_LoadReflection]:
    """Return the input reflection of each straight section, built up from the far end."""
    m = waves.shape[1]
    at_end: Complex = np.asarray(
        np.reshape(far, (-1, 1, 1)) * np.eye(m) * np.ones((len(waves), 1, 1)), complex
    )
    found = []
    for k in range(len(matrices), -1, -1):
        path = _propagator(waves, lengths[k])
        at_start = np.asarray(path * at_end * path.swapaxes(1, 2))
        found.append(_LoadReflection(at_start, at_end))
        if k > 0:
            s = matrices[k - 1]
            loop = np.eye(m) - at_start @ s[:, 1, :, 1]
            passed = np.linalg.solve(loop, at_start @ s[:, 1, :, 0])
            at_end = np.asarray(s[:, 0, :, 0] + s[:, 0, :, 1] @ passed)
    return found[::-1]


def _forward_waves(
    matrices: list[Complex],
    waves: Complex,
    lengths: Array,
    loads: list[_LoadReflection],
    source: Reflection,
    plane: int,
) -> list[Complex]:
    """Return the amplitudes (n, m, 1) of the forward waves at the start of each section.

    The source launches the plane mode, of index `plane`, with an amplitude of 1.
    """
    m = waves.shape[1]
    launched = np.zeros((len(waves), m, 1), complex)
    launched[:, plane] = 1.0
    loop = np.eye(m) - np.reshape(source, (-1, 1, 1)) * loads[0].at_start
    found = [np.asarray(np.linalg.solve(loop, launched))]
    for s, load, length in zip(matrices, loads[1:], lengths, strict=False):
        arriving = _propagator(waves, length) * found[-1]
        loop = np.eye(m) - s[:, 1, :, 1] @ load.at_start
        found.append(np.asarray(np.linalg.solve(loop, s[:, 1, :, 0] @ arriving)))
    return found


def _propagator(waves: Complex, distance: float) -> Complex:
    """Return the propagation factors exp(-j kz d) of the modes, (n, m, 1)."""
    return np.exp(-1j * waves * distance)[:, :, None]


def _pressure_at(
    ahead: float, left: float, waves: Complex, forward: Complex, load: Complex
) -> Complex:
    """Return the total modal pressures (n, m), of both directions, at a point of straight tube.

    The point is `ahead` m from the start of its section and `left` m from the end, where the load
    reflects; `forward` are the amplitudes at the start.
    """
    here = _propagator(waves, ahead) * forward
    rest = _propagator(waves, left)
    return np.asarray((here + rest * (load @ (rest * here)))[:, :, 0])


def at_sound_speed(scattering: AnyScattering, sound_speed: float) -> AnyScattering:
    """Return the scattering matrix of the same lumen in air with another speed of sound.

    Parameters
    ----------
    scattering : ModalScattering
    sound_speed : float
        In m/s.

    Returns
    -------
    ModalScattering
        Of the same type, at the frequencies that have the same wavelengths.

    Notes
    -----
    Without losses this is exact, also on a grid. The thickness of the boundary layers in
    wavelengths scales as sqrt(nu / (c R)), with the kinematic viscosity nu, the speed of sound c
    and the radius R: a change by 15 K changes the losses within a press, about 0.5 dB, by 4 %.
    """
    ratio = sound_speed / scattering.sound_speed
    grid: dict[str, Any] = {}
    if isinstance(scattering, Scattering):
        grid["time_step"] = scattering.time_step / ratio
    return replace(
        scattering,
        frequency=scattering.frequency * ratio,
        cut_ons=scattering.cut_ons * ratio,
        sound_speed=sound_speed,
        **grid,
    )
