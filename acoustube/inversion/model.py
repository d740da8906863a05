"""Forward model: the complex baseband of a cycle with given presses, and its Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acoustube.base.checks import Optional, check_fields, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.base.units import KHZ, MM
from acoustube.inversion.baseband import Baseband
from acoustube.inversion.clutter import Clutter, unknown_clutter
from acoustube.inversion.coupled_network import coupled_echo
from acoustube.inversion.joints import Joined
from acoustube.inversion.network import Echo, Waves, echo
from acoustube.inversion.tables import MOST_MODES, FrontCoefficients, Matrices, table_of
from acoustube.inversion.tools import Library, Tool
from acoustube.inversion.wrap import WrappedPath
from acoustube.waves.modes import bessel_zero
from acoustube.waves.modes.grid_modes import mode_numbers
from acoustube.waves.scattering import Complex

NUISANCES = "temperature", "gain", "phase", "resonance", "quality_factor", "stretch", "bore"
"""Names of the nuisance parameters, in their order in parameter vectors after places and depths."""
DRIFTING = "temperature", "gain", "phase"
"""Those of them that drift. The others are constants of the sensor and the tube, and the stretch,
which stands for errors of the solver, changes little with the press."""
SAME_BORE = 0.005
"""Largest allowed relative difference of the bores of library and baseband."""
LEAST = 1e-9
"""Standard deviation of a nuisance parameter that is stated as 0."""
BAND_MARGIN = 0.01
"""Fraction of a frequency by which a library's band must exceed the baseband's at each end."""


@dataclass(frozen=True, kw_only=True)
class Priors:
    """Standard deviations of the uncertain quantities, whose prior means are zero.

    Attributes
    ----------
    temperature : float
        Deviation of the air's temperature from the reported one, in K. Default 0.3.
    gain : float
        Logarithm of the gain. Default 0.05.
    phase : float
        Phase of the gain in rad. Default 0.05.
    resonance, quality_factor : float
        Relative deviations of the transducer's parameters. Defaults 0.003 and 0.03.
    stretch : float
        Relative change of the frequency at which the presses' scattering is evaluated, for errors
        of the solver. Default 0.002.
    losses : float
        Relative imaginary part of that frequency, for errors of the losses, which make trapped
        sound decay faster or slower. The value is the rms of a complex error, whose distribution is
        circular. It is not a parameter, but a part of the covariance. Default 0.0004, an eighth of
        the losses of trapped sound; 0 for no such error.
    thermometer : float
        Error in K that the thermometer has in all recordings, including those of the untouched
        tube. Not a parameter, but a part of the error of places. Default 0.1; 0 for none.
    place, depth : float
        Offsets in m between a press and the library's press with the same echo, due to errors of
        mesh and solver that no recording shows. Not parameters either. Defaults 0.03 mm and
        0.018 mm, those between two meshes and solvers; 0 for none.
    bore : float
        Relative deviation of the bore's diameter from that of the library. A press of a wider bore
        has, at higher frequencies, the echo of a press that is shallower in proportion, and modes
        other than the plane wave propagate faster along the tube. Default 0.005; 0 for a bore that
        is known.
    length : float
        Deviation of the tube's length in m, used with a rangefinder at each end. Default 2 mm.
    modulus : float
        Relative deviation of the wall's Young's modulus from that of the library or of a twin, to
        which forces are proportional. It adds to the deviation stated in the file of a twin.
        Default 0; 0.1 for 2 Shore A.

    Raises
    ------
    ConfigError
        If a value is outside its range.
    """

    temperature: float = 0.3
    gain: float = 0.05
    phase: float = 0.05
    resonance: float = 3e-3
    quality_factor: float = 0.03
    stretch: float = 2e-3
    losses: float = 4e-4
    thermometer: float = 0.1
    place: float = 0.03e-3
    depth: float = 0.018e-3
    bore: float = 0.005
    length: float = 2e-3
    modulus: float = 0.0

    def __post_init__(self) -> None:
        """Check that all deviations are within their ranges."""
        rules = dict.fromkeys(NUISANCES[:-1], Number(1e-9, 100.0))
        offset, share = Number(0, 0.01, "m"), Number(0, 0.1)
        check_fields(
            self, **rules, thermometer=Number(0, 100.0, "K"), place=offset, depth=offset,
            losses=share, bore=share, modulus=Number(0, 1), length=Number(0, 1, "m"),
        )  # fmt: skip

    @property
    def deviations(self) -> Array:
        """Standard deviations of the nuisance parameters, in the order of :data:`NUISANCES`."""
        return np.array([max(getattr(self, name), LEAST) for name in NUISANCES])

    def offsets(self, n_presses: int) -> Array:
        """Return the standard deviations in m of each press's place and depth, (2 n_presses,).

        They are those relative to the library's presses with the same echo.
        """
        return np.tile([self.place, self.depth], n_presses)

    def force_deviation(self, tool: Tool, depths: Array) -> Array:
        """Return the standard deviation in N of a tool's force at depths in m, (n,)."""
        return np.hypot(tool.force_deviation(depths), self.modulus * tool.force_at(depths))


class ForwardModel:
    """Forward model: the baseband of cycles with presses by the tools of a library.

    Parameters
    ----------
    library : Library
    base : Baseband
    clutter : Clutter, optional
        Clutter of the tube; by default only its power density is known.
    priors : Priors, optional

    Attributes
    ----------
    transverse : ndarray
        Transverse wavenumbers of the modes in 1/m, (m,).
    path : Path
        Propagation along the tube.
    span : (float, float)
        Nearest and farthest place in m of a press.
    tables : list of ToolTable
        Interpolated scattering of each tool.
    stretch, stretch_by_temperature : float
        Relative change of the frequency at which the presses' scattering is evaluated, at the
        temperature of `base`: the ratio of the library's speed of sound to that of the air, less 1;
        and its derivative by temperature in 1/K.
    stretches : (float, float)
        Least and largest sum of the nuisance parameters `stretch` and `bore` that the tables cover
        at that temperature.

    Raises
    ------
    ConfigError
        If the bore, the modes or the band of the library are not those of the baseband, or the tube
        has no place for a press.
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
        _check_library(library, base)
        self.tool_library, self.base, self.priors = library, base, priors or Priors()
        self.clutter = clutter or unknown_clutter(base)
        modes = min(len(library.modes), MOST_MODES)
        # Sound in warmer air has the wavelength of a lower frequency in the air of the library.
        speed = library.sound_speed / base.speed
        self.stretch = speed - 1
        self.stretch_by_temperature = -speed * base.speed_by_temperature / base.speed
        self.tables = [table_of(tool, base.frequency.tobytes(), modes) for tool in library.tools]
        covered = np.array([one.stretches for one in self.tables]) - self.stretch
        self.stretches = float(covered[:, 0].max()), float(covered[:, 1].min())
        self.modes = modes
        self.transverse = np.array(
            [bessel_zero(*mode_numbers(name)) / library.radius for name in library.modes[:modes]]
        )
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
            In m, (n, n_presses); the places of each set are in rising order.
        nuisances : ndarray
            Nuisance parameters in the order of :data:`NUISANCES`, (n, 7).

        Returns
        -------
        value : ndarray
            Baseband in counts, (n, n_time).
        jacobian : ndarray
            Derivatives by place and depth of each press in turn, then by the nuisance parameters,
            in single precision, (n, 2 n_presses + 7, n_time).
        """
        base, clutter = self.base, self.clutter
        if places.shape[1]:
            value, slopes = self._recorded(tools, places, depths, nuisances)
        else:
            n, n_f = len(places), len(base.frequency)
            value = np.zeros((n, n_f), complex)
            slopes = np.zeros((n, len(NUISANCES), n_f), np.complex64)
            if clutter.behind is not None:
                untouched, _, warm = clutter.beyond(np.zeros(n), nuisances[:, 0])
                value, slopes[:, 0] = base.gain * untouched, base.gain * warm
        return base.transformed(value) + clutter.ring, base.transformed(slopes)

    def _recorded(
        self, tools: tuple[int, ...], places: Array, depths: Array, nuisances: Array
    ) -> tuple[Complex, Complex]:
        """Return recorded spectra in counts s, and derivatives, of presses and clutter.

        Their shapes are (n, n_f) and, in single precision, (n, 2 n_presses + 7, n_f).
        """
        from acoustube.inversion.recorded_sums import add_clutter, recorded  # imports Numba

        (n, m), base = places.shape, self.base
        nuisances = np.ascontiguousarray(nuisances)  # views would be compiled for anew
        warming = self.stretch_by_temperature
        stretch = self.stretches_of(nuisances)
        found, matrices = self._echo(tools, places, depths, nuisances, stretch)
        transducer = base.rangefinder.resonance, base.rangefinder.quality_factor
        value, slopes = recorded(*found, nuisances, base.frequency, base.sent, transducer, warming)
        if self.clutter.behind is not None:
            passed = np.array([one.transmission() for one in matrices])
            at = np.concatenate([np.zeros((n, 1)), places], axis=1).ravel()
            beyond = self.clutter.beyond(at, np.repeat(nuisances[:, 0], m + 1))
            beyond = beyond.reshape(3, n, m + 1, -1)
            add_clutter(value, slopes, beyond, passed, base.gain, warming)
        return value, slopes

    def by_losses(
        self, tools: tuple[int, ...], places: Array, depths: Array, nuisances: Array
    ) -> Complex:
        """Return the derivative of the baseband by the losses in the presses.

        The losses are a relative imaginary part of the frequency of the presses' scattering.

        Parameters
        ----------
        tools, places, depths, nuisances
            See :meth:`baseband`.

        Returns
        -------
        ndarray
            Derivative in counts, (n, n_time). Since scattering is analytic in frequency, it is the
            derivative by `stretch` with the spectrum multiplied by the imaginary unit.
        """
        stretch = self.stretches_of(nuisances)
        found, _ = self._echo(tools, places, depths, nuisances, stretch)
        factor = self.base.press_gain(nuisances[:, 3:5])
        turn = np.exp(nuisances[:, 1] + 1j * nuisances[:, 2])[:, None]
        return self.base.transformed(1j * factor * turn * found.by_stretch)

    def stretches_of(self, nuisances: Array) -> Array:
        """Return the changes of the frequency of the presses' scattering, (n,), for nuisances."""
        by_warmth = self.stretch_by_temperature * nuisances[:, 0]
        return np.asarray(self.stretch + by_warmth + nuisances[:, 5] + nuisances[:, 6])

    def _echo(
        self, tools: tuple[int, ...], places: Array, depths: Array, nuisances: Array,
        stretch: Array,
    ) -> tuple[Echo, Sequence[Matrices | FrontCoefficients | Joined]]:  # fmt: skip
        """Return the echo at the face, and the scattering of the presses in the path's modes."""
        base, path = self.base, self.path
        temperature, widening = np.ascontiguousarray(nuisances[:, [0, 6]].T)  # views: see above
        face = base.rangefinder.face_reflection
        whole = tools if path.converts else tools[:-1]
        given = [self.tables[tool](depths[:, i], stretch) for i, tool in enumerate(whole)]
        if not path.converts:
            m = self.modes
            waves = Waves(base.k[:, :m], base.k_by_temperature[:, :m], self.transverse)
            last = self.tables[tools[-1]].front(depths[:, -1], stretch)
            found = echo(given, last, places, temperature, widening, waves, face)
            return found, [*given, last]
        assert isinstance(path, WrappedPath)
        presses = [path.joined(one, places[:, i], temperature) for i, one in enumerate(given)]
        sections, entry = path.sections(places, temperature), path.entry(temperature)
        return coupled_echo(presses, sections, face, entry), presses

    def without_presses(self, nuisances: Array) -> Complex:
        """Return the untouched tube's baseband in counts, (n, n_time), for nuisances (n, 7)."""
        empty = np.zeros((len(nuisances), 0))
        return self.baseband((), empty, empty, nuisances)[0]

    def scale_error(self, place: float) -> float:
        """Return the standard deviation in m of a place in m due to the thermometer's error.

        It is zero where the clutter is not measured.
        """
        if self.clutter.behind is None:  # the estimated temperature contains that error
            return 0.0
        return place * self.base.speed_by_temperature / self.base.speed * self.priors.thermometer


def needed_band(library: Library, base: Baseband) -> tuple[float, float]:
    """Return the lowest and highest frequency in Hz that a library must cover for a baseband.

    They include :data:`BAND_MARGIN`, and are converted to the speed of sound of the library.
    """
    ratio = library.sound_speed / base.speed
    low, high = base.frequency[[0, -1]] * ratio
    return float(low) * (1 - BAND_MARGIN), float(high) * (1 + BAND_MARGIN)


def check_band(
    library: Library,
    base: Baseband,
    advice: str = "make the baseband with the recordings' rangefinder, or a library of that band",
) -> None:
    """Raise :class:`ConfigError` if a library's band does not contain that of a baseband.

    The frequencies of the baseband are converted to the speed of sound of the library.
    """
    (low, high), (least, most) = library.band, needed_band(library, base)
    if least < low or most > high:
        raise ConfigError(
            f"the library covers {KHZ * low:.4g} to {KHZ * high:.4g} kHz, and the rangefinder at "
            f"{base.temperature:.3g} degC needs {KHZ * least:.4g} to {KHZ * most:.4g} kHz; {advice}"
        )


def _check_library(library: Library, base: Baseband) -> None:
    """Raise ConfigError unless the bore, modes and band of a library suit a baseband."""
    if abs(library.radius / base.radius - 1) > SAME_BORE:
        raise ConfigError(
            f"the library is of a bore of {2 * MM * library.radius:.4g} mm and the baseband of "
            f"{2 * MM * base.radius:.4g} mm; make the baseband with library.radius"
        )
    own, given = (tuple(one[:MOST_MODES]) for one in (library.modes, base.modes))
    if own != given:
        raise ConfigError(
            f"the first modes of the library are {', '.join(own)}, and those of the baseband "
            f"{', '.join(given)}; make the baseband with library.modes"
        )
    check_band(library, base)
