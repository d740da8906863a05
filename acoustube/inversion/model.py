"""Forward model: the baseband of a cycle of presses, and its Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acoustube.base.checks import Optional, check_fields, checked
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.inversion.baseband import Baseband
from acoustube.inversion.clutter import Clutter, unknown_clutter
from acoustube.inversion.coupled_network import coupled_echo
from acoustube.inversion.joints import Joined
from acoustube.inversion.network import Echo, Waves, echo
from acoustube.inversion.tables import MOST_MODES, FrontCoefficients, Matrices, table_of
from acoustube.inversion.tools import Library, Tool
from acoustube.inversion.wrap import WrappedPath
from acoustube.waves.scattering import Complex

NUISANCES = "temperature", "gain", "phase", "resonance", "quality_factor", "stretch"
"""Parameters besides places and depths, in their order."""


@dataclass(frozen=True, kw_only=True)
class Priors:
    """Standard deviations of what is not known exactly; their means are zero.

    Attributes
    ----------
    temperature : float
        Of the air, from the reported one, in K. Default 0.3.
    gain : float
        Of the logarithm of the gain. Default 0.05.
    phase : float
        In rad. Default 0.05.
    resonance, quality_factor : float
        Of the transducer, relative. Defaults 0.001 and 0.03.
    stretch : float
        Of frequency in the presses, relative: errors of the bore and of the solver. Default 0.002.
    losses : float
        Of the imaginary part of frequency in the presses, relative to frequency: errors of the
        losses, by which trapped sound decays faster or slower. The rms of a complex error, as its
        covariance is that of a circular distribution. No parameter, but a part of the model's
        error. Default 0.0004, an eighth of the losses of trapped sound; 0 if there is none.
    thermometer : float
        Of the error in K that the thermometer has in all recordings, also in those of the untouched
        tube: no parameter, but part of the error of places. Default 0.1; 0 if there is none.
    place, depth : float
        Of the offsets in m between a press and the library's press of the same echo: errors
        of mesh and solver that no recording shows; no parameters either. Defaults 0.03 mm and
        0.018 mm, those of two meshes and solvers; 0 if there are none.
    bore : float
        Of the bore's diameter, relative, from the library's. A press of a wider bore sounds like
        one that is shallower in proportion, which no recording shows either. Default 0; 0.01 of an
        extruded tube, say.
    length : float
        Of the tube's length in m, where there is a rangefinder at each end. Default 2 mm.
    modulus : float
        Of the wall's Young's modulus, relative to its value, the library's or a twin's; forces are
        proportional to it. It adds to the deviation that a twin's file states. Default 0; 0.1 for
        2 Shore A.
    """

    temperature: float = 0.3
    gain: float = 0.05
    phase: float = 0.05
    resonance: float = 1e-3
    quality_factor: float = 0.03
    stretch: float = 2e-3
    losses: float = 4e-4
    thermometer: float = 0.1
    place: float = 0.03e-3
    depth: float = 0.018e-3
    bore: float = 0.0
    length: float = 2e-3
    modulus: float = 0.0

    def __post_init__(self) -> None:
        """Check that all are positive."""
        rules = dict.fromkeys(NUISANCES, Number(1e-9, 100.0))
        offset, share = Number(0, 0.01, "m"), Number(0, 0.1)
        check_fields(
            self, **rules, thermometer=Number(0, 100.0, "K"), place=offset, depth=offset,
            losses=share, bore=share, modulus=Number(0, 1), length=Number(0, 1, "m"),
        )  # fmt: skip

    @property
    def deviations(self) -> Array:
        """All, in the order of :data:`NUISANCES`."""
        return np.array([getattr(self, name) for name in NUISANCES])

    def offsets(self, depths: Array) -> Array:
        """Return the standard deviations of the offsets of place and depth in turn of each press.

        Parameters
        ----------
        depths : ndarray
            In m, (n, n_presses).

        Returns
        -------
        ndarray
            In m, (n, 2 n_presses).
        """
        found = np.empty((len(depths), 2 * depths.shape[1]))
        found[:, ::2], found[:, 1::2] = self.place, np.hypot(self.depth, self.bore * depths)
        return found

    def force_deviation(self, tool: Tool, depths: Array) -> Array:
        """Return the standard deviation in N of a tool's force at depths in m, (n,)."""
        return np.hypot(tool.force_deviation(depths), self.modulus * tool.force_at(depths))


class ForwardModel:
    """Baseband of cycles with presses of a library's tools.

    Parameters
    ----------
    library : Library
    base : Baseband
    clutter : Clutter, optional
        Of the tube; by default only its statistics are known.
    priors : Priors, optional

    Attributes
    ----------
    path : Path
        Propagation along the tube.
    span : (float, float)
        Nearest and farthest place in m of a press.
    """

    @checked(
        library=Library, base=Baseband, clutter=Optional(Clutter), priors=Optional(Priors)
    )  # fmt: skip
    def __init__(
        self,
        library: Library,
        base: Baseband,
        clutter: Clutter | None = None,
        priors: Priors | None = None,
    ) -> None:
        self.tool_library, self.base, self.priors = library, base, priors or Priors()
        self.clutter = clutter or unknown_clutter(base)
        modes = min(len(library.modes), MOST_MODES)
        # Where the air is warmer, sound of a frequency has the wavelength of a lower one.
        speed = library.sound_speed / base.speed
        self.stretch = speed - 1
        self.stretch_by_temperature = -speed * base.speed_by_temperature / base.speed
        self.tables = [table_of(tool, base.frequency.tobytes(), modes) for tool in library.tools]
        self.modes = modes
        self.path = base.path
        self.span = self.path.span(base.nearest, base.length)

    def baseband(
        self, tools: tuple[int, ...], places: Array, depths: Array, nuisances: Array
    ) -> tuple[Complex, Complex]:
        """Return the baseband of cycles and its Jacobian, for many sets of parameters at once.

        Parameters
        ----------
        tools : tuple of int
            Number of the tool of each press in the library, (n_presses,).
        places, depths : ndarray
            In m, (n, n_presses); the places of each set rise.
        nuisances : ndarray
            In the order of :data:`NUISANCES`, (n, 6).

        Returns
        -------
        value : ndarray
            (n, n_time), in counts.
        jacobian : ndarray
            By place and depth in turn of each press, then by the nuisances, in single precision,
            (n, 2 n_presses + 6, n_time).
        """
        n, m = places.shape
        base = self.base
        temperature, gain, phase = nuisances[:, 0], nuisances[:, 1], nuisances[:, 2]
        spectrum = np.zeros((n, 2 * m + len(NUISANCES) + 1, len(base.frequency)), complex)
        if m:
            stretch = self.stretch + self.stretch_by_temperature * temperature + nuisances[:, 5]
            found, matrices = self._echo(tools, places, depths, temperature, stretch)
            factor, by_resonance, by_quality = base.press_gain(nuisances[:, 3:5])
            turn = np.exp(gain + 1j * phase)[:, None]
            factor = factor * turn
            echo_spectrum: Complex = factor * found.value
            spectrum[:, 0] = echo_spectrum
            spectrum[:, 1 : 2 * m + 1 : 2] = factor[:, None] * found.by_place
            spectrum[:, 2 : 2 * m + 1 : 2] = factor[:, None] * found.by_depth
            rest = spectrum[:, 2 * m + 1 :]
            warm = found.by_temperature + self.stretch_by_temperature * found.by_stretch
            rest[:, 0], rest[:, 1], rest[:, 2] = factor * warm, echo_spectrum, 1j * echo_spectrum
            rest[:, 3] = turn * by_resonance * found.value
            rest[:, 4] = turn * by_quality * found.value
            rest[:, 5] = factor * found.by_stretch
            self._add_clutter(spectrum, places, temperature, matrices)
        elif self.clutter.behind is not None:
            value, _, warm = self.clutter.beyond(np.zeros(n), temperature)
            spectrum[:, 0], spectrum[:, 1] = base.gain * value, base.gain * warm
        value = base.transformed(spectrum[:, 0]) + self.clutter.ring
        return value, base.transformed(spectrum[:, 1:].astype(np.complex64))

    def by_losses(
        self, tools: tuple[int, ...], places: Array, depths: Array, nuisances: Array
    ) -> Complex:
        """Return the derivative of the baseband by the imaginary part of frequency in the presses.

        Parameters
        ----------
        tools, places, depths, nuisances
            See :meth:`baseband`.

        Returns
        -------
        ndarray
            Relative to frequency, (n, n_time): the derivative of the spectrum by `stretch`, as an
            analytic function of frequency, times the imaginary unit.
        """
        temperature = nuisances[:, 0]
        stretch = self.stretch + self.stretch_by_temperature * temperature + nuisances[:, 5]
        found, _ = self._echo(tools, places, depths, temperature, stretch)
        factor, *_ = self.base.press_gain(nuisances[:, 3:5])
        turn = np.exp(nuisances[:, 1] + 1j * nuisances[:, 2])[:, None]
        return self.base.transformed(1j * factor * turn * found.by_stretch)

    def _echo(
        self, tools: tuple[int, ...], places: Array, depths: Array, temperature: Array,
        stretch: Array,
    ) -> tuple[Echo, Sequence[Matrices | FrontCoefficients | Joined]]:  # fmt: skip
        """Return the echo at the face, and the matrices of the presses along the path."""
        base, path = self.base, self.path
        face = base.rangefinder.face_reflection
        whole = tools if path.converts else tools[:-1]
        given = [self.tables[tool](depths[:, i], stretch) for i, tool in enumerate(whole)]
        if not path.converts:
            heat = base.k_by_temperature[:, : self.modes]
            waves = Waves(base.k[:, : self.modes] + temperature[:, None, None] * heat, heat)
            last = self.tables[tools[-1]].front(depths[:, -1], stretch)
            return echo(given, last, places, waves, face), [*given, last]
        assert isinstance(path, WrappedPath)
        presses = [path.joined(one, places[:, i], temperature) for i, one in enumerate(given)]
        sections, entry = path.sections(places, temperature), path.entry(temperature)
        return coupled_echo(presses, sections, face, entry), presses

    def _add_clutter(
        self,
        spectrum: Complex,
        places: Array,
        temperature: Array,
        matrices: Sequence[Matrices | FrontCoefficients | Joined],
    ) -> None:
        """Add the clutter, dimmed by the presses before it, and its derivatives.

        With C(z) that of all beyond z and the transmissions t_i both ways of each press, it is
        C(0) - C(z_1) + t_1 (C(z_1) - C(z_2)) + t_1 t_2 (C(z_2) - ...) + ...
        """
        if self.clutter.behind is None:
            return
        gain, m = self.base.gain, len(matrices)
        passed = [one.transmission() for one in matrices]
        through = [value for value, *_ in passed]
        value, _, warm = self.clutter.beyond(np.zeros(len(places)), temperature)
        spectrum[:, 0] += gain * value
        spectrum[:, 2 * m + 1] += gain * warm
        beyond = [self.clutter.beyond(places[:, i], temperature) for i in range(m)]
        dimmed: list[Complex] = [np.ones_like(through[0])]
        for one in through:
            dimmed.append(dimmed[-1] * one)
        # The sum is C(0) + sum_i (passed_i+1 - passed_i) C(z_i).
        for i, (value, by_place, warm) in enumerate(beyond):
            share = gain * (dimmed[i + 1] - dimmed[i])
            spectrum[:, 0] += share * value
            spectrum[:, 1 + 2 * i] += share * by_place
            spectrum[:, 2 * m + 1] += share * warm
        for i, (_, *changes) in enumerate(passed):
            onwards = dimmed[i] * beyond[i][0]
            product: Complex = dimmed[i]
            for j in range(i + 1, m):
                onwards = onwards + product * (through[j] - 1) * beyond[j][0]
                product = product * through[j]
            deepened, stretched = (gain * change * onwards for change in changes)
            spectrum[:, 2 + 2 * i] += deepened
            spectrum[:, -1] += stretched
            spectrum[:, 2 * m + 1] += self.stretch_by_temperature * stretched

    def without_presses(self, nuisances: Array) -> Complex:
        """Return the baseband of the untouched tube, (n, n_time)."""
        empty = np.zeros((len(nuisances), 0))
        return self.baseband((), empty, empty, nuisances)[0]

    def scale_error(self, place: float) -> float:
        """Return the standard deviation in m of a place in m by the error of the thermometer."""
        if self.clutter.behind is None:  # the temperature is estimated with that error
            return 0.0
        return place * self.base.speed_by_temperature / self.base.speed * self.priors.thermometer
