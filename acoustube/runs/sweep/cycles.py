"""Labelled cycles of a rangefinder for each case of a sweep."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from acoustube import ranging
from acoustube.base.checks import SEED, Instance, Optional, Reals, check_fields
from acoustube.base.errors import ConfigError
from acoustube.base.netcdf import variable
from acoustube.base.rules import Choice, Number
from acoustube.base.types import Array
from acoustube.base.version import __version__
from acoustube.ranging import Burst, Rangefinder
from acoustube.ranging.analogue import MEASURED_SPACING, within
from acoustube.runs.config import configured
from acoustube.runs.config.si import SISettings, settings_in_si
from acoustube.runs.scattering_file import StoredScattering, from_dataset
from acoustube.runs.sweep import store
from acoustube.runs.sweep.case_results import placed
from acoustube.runs.sweep.plan import digest, tube_name

PLAIN = ("offset",)
"""Parameters whose values are normally distributed over sessions; of others the logarithms are."""
SPREAD = ("resonance", "quality_factor", "gain", "send", "noise", *PLAIN)
"""Parameters of the rangefinder that may vary from session to session."""
LONGEST_SESSION = 72_000
"""Number of cycles of a session of one hour; its cases begin at random cycles of this hour."""
SIGNAL_CHUNK = 64
"""Number of cycles in a chunk of the signal in the file."""
CARRIED = {
    "true_distance": "m", "depth": "m", "force": "N", "diameter": "m", "shape": "1",
    "lumen_area": "m2", "lumen_height": "m", "inner_diameter": "m", "wall_thickness": "m",
    "shear_modulus": "Pa", "tube_length": "m", "carrier_frequency": "Hz",
}  # fmt: skip
"""Labels that a cycle takes from its case, with their units."""
SINCE = "time; the drive starts at zero, or at the trigger of a twin"
"""Description of the time axis of cycles."""


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Settings of the recording of cycles.

    Attributes
    ----------
    n_cycles : int
        Number of cycles of each case in each session.
    n_tubes : int
        Number of specimens of each tube, each with its own irregularities.
    n_sessions : int
        Number of sessions of each specimen, each with its own drift and error of the temperature.
    seed : int
        Random seed.
    rangefinder : Rangefinder or None
        None for the default rangefinder at the carrier frequency of the case.
    offset_deviation : float or None
        Standard deviation in K, over the sessions, of the thermometer's error about the
        ``temperature_bias`` of the rangefinder. With None the error is uniform between minus and
        plus this bias.
    reflectors : tuple of float
        Reflection coefficients of the irregularities of the first specimen, as the argument of
        :func:`acoustube.ranging.clutter`; random if empty.
    spread : tuple of (str, float)
        Parameters of the rangefinder, and their standard deviations over the sessions: of the value
        for those in :data:`PLAIN`, of the logarithm for the others.
    clutter_spread : float
        Variance per metre of the changes of `reflectors` from session to session, in 1/m.
    young_modulus : float or None
        Young's modulus of the wall in Pa, to which forces and moduli of the labels are scaled; None
        for that of the sweep.
    trigger : float
        Time in s at which the drive starts; cycles begin earlier by the rangefinder's ``lead``.
    """

    n_cycles: int = 50
    n_tubes: int = 1
    n_sessions: int = 1
    seed: int = 0
    rangefinder: Rangefinder | None = None
    offset_deviation: float | None = None
    reflectors: tuple[float, ...] = ()
    spread: tuple[tuple[str, float], ...] = ()
    clutter_spread: float = 0.0
    young_modulus: float | None = None
    trigger: float = 0.0

    def __post_init__(self) -> None:
        """Validate counts, seed and rangefinder."""
        count = Number(1, 1e6, whole=True)
        check_fields(
            self, n_cycles=count, n_tubes=count, n_sessions=count, seed=SEED,
            rangefinder=Optional(Instance((Rangefinder,))),
            offset_deviation=Optional(Number(0, 100, "K")),
            reflectors=Reals(-1, 1, ndim=1, empty=True),
            clutter_spread=Number(0, 1, "1/m"),
            young_modulus=Optional(Number(1e-3, 1e15, "Pa")), trigger=Number(-1, 1, "s"),
        )  # fmt: skip
        object.__setattr__(self, "reflectors", tuple(map(float, self.reflectors)))
        for name, deviation in self.spread:
            Choice(SPREAD).check("spread", name)
            Number(0, 10).check(f"spread of {name}", deviation)

    @property
    def per_case(self) -> int:
        """Number of cycles of a case over all tubes and sessions."""
        return self.n_cycles * self.n_tubes * self.n_sessions

    @property
    def name(self) -> str:
        """Hash of all settings and of the version of acoustube."""
        own = None if self.rangefinder is None else self.rangefinder.to_json()
        words: list[Any] = [
            self.n_cycles,
            self.n_tubes,
            self.n_sessions,
            self.seed,
            own,
            __version__,
        ]
        if self.offset_deviation is not None or self.reflectors:
            words += [self.offset_deviation, *self.reflectors]
        if self.spread or self.clutter_spread or self.young_modulus is not None:
            words += [self.spread, self.clutter_spread, self.young_modulus]
        # In earlier versions cycles with a lead began at time zero: present ones need another name.
        if self.trigger != 0 or (self.rangefinder is not None and self.rangefinder.lead > 0):
            words += ["trigger", self.trigger]
        return digest(words)

    def rangefinder_for(self, settings: SISettings) -> Rangefinder:
        """Return the rangefinder that records a case with these settings."""
        carrier = settings.pulse.frequency
        usual = Rangefinder(drive=Burst(frequency=carrier), resonance=carrier)
        return self.rangefinder or usual


def seed_of(*what: Any) -> int:
    """Return a seed derived from the arguments by hashing."""
    return int(digest(what)[:15], 16)


def record_cases(cases: Sequence[tuple[str, Path]], out: Path, recipe: Recipe) -> int:
    """Simulate labelled cycles of some cases, and write them to one file.

    Parameters
    ----------
    cases : sequence of (str, Path)
        Name of each case, and the file of the sweep that contains the case.
    out : Path
        File to write.
    recipe : Recipe

    Returns
    -------
    int
        Number of cycles.

    Raises
    ------
    ValueError
        As :func:`record_one`.
    SimulationError
        If the file cannot be written.
    """
    parts = [part for name, path in cases for part in _recorded(name, path, recipe)]
    data = xr.concat(parts, dim="cycle", data_vars="minimal", coords="minimal", compat="override",
                     combine_attrs="drop_conflicts", join="exact")  # fmt: skip
    data = data.assign_attrs(
        title="Cycles of a rangefinder on a soft acoustic waveguide",
        source="simulation", acoustube_version=__version__, seed=recipe.seed, warnings="",
    )  # fmt: skip
    store.write_file(out, data, chunks={"signal": SIGNAL_CHUNK})
    return int(data.sizes["cycle"])


def record_one(name: str, path: Path, recipe: Recipe) -> xr.Dataset:
    """Return one cycle of a case, as :func:`record_cases` would simulate it.

    Raises
    ------
    ValueError
        If the rangefinder's band exceeds that of the press's scattering matrix.
    ConfigError
        If `young_modulus` is given for a tube on an elastic layer.
    """
    return next(_recorded(name, path, dataclasses.replace(recipe, n_cycles=1)))


@lru_cache(maxsize=64)
def _opened(path: Path) -> tuple[xr.Dataset, StoredScattering | None]:
    """Return cases and scattering of a sweep's file, in memory: cases are taken one by one."""
    data, matrix = store.read(path)
    return data.drop_vars("pressure"), None if matrix is None else from_dataset(matrix)


def _recorded(name: str, path: Path, recipe: Recipe) -> Iterator[xr.Dataset]:
    """Yield the labelled cycles of a case for each specimen and session."""
    data, scattering = _opened(path)
    case = data.sel(press=name)
    config = configured(json.loads(str(case["configuration"].values)))
    settings = settings_in_si(config)
    presses = placed(settings, scattering if settings.depth > 0 else None)
    rangefinder = recipe.rangefinder_for(settings)
    for specimen in range(recipe.n_tubes):
        tube = f"{tube_name(config)}-{specimen}"
        measured = specimen == 0 and len(recipe.reflectors) > 0
        for number in range(recipe.n_sessions):
            session = seed_of(tube, number, recipe.seed)
            cycles = ranging.record(
                presses,
                in_session(rangefinder, session, recipe),
                radius=settings.radius,
                length=settings.tube.length,
                temperature=settings.temperature,
                n_cycles=recipe.n_cycles,
                first_cycle=seed_of(name) % LONGEST_SESSION,
                seed=seed_of(name, tube, number, recipe.seed),
                session_seed=session,
                tube_seed=seed_of(tube, recipe.seed),
                reflectors=(
                    _reflectors(recipe, session, settings.tube.length) if measured else None
                ),
            )
            names = {"press": name, "tube": tube, "session": f"{tube}-{number}"}
            start = recipe.trigger - rangefinder.lead
            labelled = _labelled(cycles, case, settings, names, start)
            labelled.attrs["rangefinder"] = _of_all_sessions(rangefinder, recipe).to_json()
            yield _with_modulus(labelled, settings, recipe.young_modulus)


def _reflectors(recipe: Recipe, seed: int, length: float) -> Array:
    """Return the reflection coefficients of the first specimen's irregularities in a session.

    Those beyond the tube's end, of `length` in m, are left out.
    """
    mean = within(recipe.reflectors, length)
    if recipe.clutter_spread == 0:
        return mean
    deviation = np.sqrt(recipe.clutter_spread * MEASURED_SPACING)
    moved = mean + np.random.default_rng([seed, 1]).normal(0, deviation, len(mean))
    return np.clip(moved, -1, 1)


def in_session(rangefinder: Rangefinder, seed: int, recipe: Recipe) -> Rangefinder:
    """Return a rangefinder with the parameters and the thermometer's error of a random session."""
    random, drawn = np.random.default_rng([seed, 2]), {}
    for name, deviation in recipe.spread:
        value, off = getattr(rangefinder, name), deviation * random.normal()
        drawn[name] = value + off if name in PLAIN else value * float(np.exp(off))
    rangefinder = dataclasses.replace(rangefinder, **drawn)
    most = rangefinder.temperature_bias
    if recipe.offset_deviation is not None:
        bias = np.random.default_rng(seed).normal(most, recipe.offset_deviation)
        return dataclasses.replace(rangefinder, temperature_bias=float(bias))
    bias = np.random.default_rng(seed).uniform(-abs(most), abs(most)) if most else 0.0
    return dataclasses.replace(rangefinder, temperature_bias=float(bias))


def _of_all_sessions(rangefinder: Rangefinder, recipe: Recipe) -> Rangefinder:
    """Return a rangefinder with the mean error of the thermometer over random sessions.

    Unlike the parameters of a session, it is the same in all files and sessions of a dataset.
    """
    if recipe.offset_deviation is not None:
        return rangefinder
    return dataclasses.replace(rangefinder, temperature_bias=0.0)


def _with_modulus(cycles: xr.Dataset, settings: SISettings, modulus: float | None) -> xr.Dataset:
    """Return cycles with labels force and shear_modulus scaled to a Young's modulus in Pa."""
    if modulus is None:
        return cycles
    if settings.layer is not None:
        raise ConfigError(
            "on an elastic layer the force is not proportional to the twin's modulus of the wall; "
            "sweep with the twin's hardness, and remove young_modulus_mpa from `determined` in the "
            "twin's file"
        )
    factor = modulus / settings.tube.young_modulus
    scaled = {
        name: cycles[name].copy(data=factor * cycles[name].values)
        for name in ("force", "shear_modulus")
    }
    return cycles.assign(scaled)


def _labelled(
    cycles: xr.Dataset, case: xr.Dataset, settings: SISettings, names: dict[str, str], start: float
) -> xr.Dataset:
    """Return cycles with the labels of their case, and the names of case, tube and session.

    They begin at the time `start` in s. Without a press, true_distance and diameter are nan.
    """
    n = cycles.sizes["cycle"]
    labels = {
        label: variable("cycle", np.full(n, case[label].values), units, str(text))
        for label, units in CARRIED.items()
        for text in [case[label].attrs["long_name"]]
    }
    if settings.depth == 0:
        labels |= {
            label: variable("cycle", np.full(n, np.nan), "m", "nan, as nothing presses")
            for label in ("true_distance", "diameter")
        }
    labels["air_temperature"] = variable(
        "cycle", np.full(n, settings.temperature), "degC", "temperature of the air"
    )
    texts = {
        "press": "name of the case", "tube": "specimen of a tube", "session": "recording session",
    }  # fmt: skip
    coordinates = {
        name: variable("cycle", np.full(n, value), "1", texts[name])
        for name, value in names.items()
    }
    coordinates["time"] = variable("time", cycles["time"].values + start, "s", SINCE)
    found = cycles.assign(labels).assign_coords(coordinates)
    found.attrs = {name: cycles.attrs[name] for name in ("sampling_rate", "full_scale")}
    return found
