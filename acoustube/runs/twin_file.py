"""TOML files of twins: parameters with standard deviations, and the sensor for other commands."""

from __future__ import annotations

from collections.abc import Iterator
from math import exp, isfinite, log
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit

from acoustube.base.files import toml_array
from acoustube.base.units import CM, KHZ, MM, MPA, MS, PERCENT, US
from acoustube.base.version import __version__
from acoustube.inversion.twin.background import Measured
from acoustube.inversion.twin.estimate import PRIORS, SPEED, radius
from acoustube.inversion.twin.material import PRIOR_COMPLIANCE, PRIOR_MODULUS, PRIOR_ZERO, Material
from acoustube.inversion.twin.model import NOMINAL_FREQUENCY, NOMINAL_RADIUS, SHARED
from acoustube.ranging import Burst, Rangefinder
from acoustube.runs.sensor_file import KIND, add_rangefinder
from acoustube.runs.twin import FittedSensor
from acoustube.tube import shore_from_shear_modulus

MOST_REFLECTED = 0.98
"""Largest magnitude of the reflection coefficient of a rangefinder's face; the posterior's mean may
be larger where repetitions of echoes hardly determine it."""
AT_ZERO = 4e-5
"""Time in s by which the drive must miss time zero, or precede the first sample, for a note."""
DETERMINED = 0.5
"""Ratio of posterior to prior standard deviation below which a parameter is determined."""


class Parameter(NamedTuple):
    """A parameter of a twin, in the unit that its name states.

    Attributes
    ----------
    name : str
    value, deviation : float
        Value and its standard deviation, which may be infinite.
    prior : float or None
        Standard deviation of the prior; None where it is flat.
    meaning : str
    """

    name: str
    value: float
    deviation: float
    prior: float | None
    meaning: str

    @property
    def determined(self) -> bool:
        """True if the deviation is finite and below :data:`DETERMINED` times that of the prior."""
        if not isfinite(self.deviation):
            return False
        return self.prior is None or self.deviation < DETERMINED * self.prior


def parameters(found: FittedSensor) -> list[Parameter]:
    """Return all parameters of a twin with their standard deviations."""
    return [
        *_echo_parameters(found), *_background_parameters(found), *_material_parameters(found)
    ]  # fmt: skip


def _echo_parameters(found: FittedSensor) -> Iterator[Parameter]:
    """Yield the parameters that are estimated from the echoes of closures."""
    twin = found.twin
    r, r_sd = radius(twin)
    yield Parameter(
        "inner_diameter_mm", 2 * MM * r, 2 * MM * r_sd,
        2 * MM * NOMINAL_RADIUS * PRIORS["log_radius"][1], "diameter of the bore",
    )  # fmt: skip
    logs = (
        ("log_resonance", "resonance_khz", KHZ * NOMINAL_FREQUENCY, "resonance of the transducer"),
        ("log_quality", "quality_factor", 1.0, "quality factor of the transducer"),
        ("log_drive_frequency", "drive_frequency_khz", KHZ * NOMINAL_FREQUENCY,
         "frequency of the drive"),
        ("log_gain", "gain_v", 1 / found.per_volt, "received level of a complete reflection"),
        ("log_loss", "loss_factor", 1.0, "losses at the wall over those at a smooth one"),
    )  # fmt: skip
    for own, name, unit, meaning in logs:
        value = unit * exp(twin.value(own))
        prior = value * PRIORS[own][1]
        yield Parameter(name, value, value * twin.deviation(own), prior, meaning)
    plain = (
        ("temperature_offset", "temperature_offset_c", 1.0, "added to the reported temperature"),
        ("temperature_gradient", "temperature_gradient_c_per_m", 1.0, "gradient along the tube"),
        ("drive_cycles", "drive_cycles", 1.0, "periods of the drive"),
        ("trigger", "trigger_us", US, "start of the drive after time zero"),
        ("face_real", "face_reflection_real", 1.0, "reflection of the face, real part"),
        ("face_imag", "face_reflection_imag", 1.0, "reflection of the face, imaginary part"),
        *((name, f"send_{name}", 1.0, "coefficient of the send pulse's correction")
          for name in SHARED if name[-1] in "123"),
    )  # fmt: skip
    for own, name, unit, meaning in plain:
        prior = unit * PRIORS[own][1]
        yield Parameter(name, unit * twin.value(own), unit * twin.deviation(own), prior, meaning)


def _background_parameters(found: FittedSensor) -> Iterator[Parameter]:
    """Yield the parameters estimated from untouched cycles, and from the scatter of all cycles."""
    rest, volt = found.rest, 1 / found.per_volt
    rows: list[tuple[str, Measured, float, float | None, str]] = [
        ("send_v", rest.send, volt, None, "received level of the direct drive"),
        ("far_reflection", rest.far_reflection, 1.0, 1.0, "reflection coefficient of the far end"),
        ("clutter_per_m", rest.clutter, 1.0, None, "power that irregularities reflect per metre"),
        ("noise_v", rest.noise, volt, None, "rms of the noise"),
        ("offset_v", rest.offset, volt, None, "mean voltage"),
        ("drift_v", rest.drift, volt, None, "rms of the offset's drift"),
        ("jitter_us", rest.jitter, US, None, "rms variation of the trigger from cycle to cycle"),
        ("gain_wander_percent", rest.wander, PERCENT, None, "rms variation of gain among cycles"),
    ]
    if rest.length is not None:
        rows.append(("far_end_cm", rest.length, CM, None, "distance of the far end"))
    for name, one, unit, prior, meaning in rows:
        yield Parameter(name, unit * one.value, unit * one.deviation, prior, meaning)
    n = len(found.twin.used)
    for name, value, meaning in (
        ("placement_mm", MM * found.twin.posterior.placement, "rms error of the stated distances"),
        ("closure_level_percent", PERCENT * found.twin.posterior.level,
         "rms scatter of the closures' levels"),
    ):  # fmt: skip
        yield Parameter(name, value, value / np.sqrt(max(2 * (n - 2), 1)), None, meaning)


def _material_parameters(found: FittedSensor) -> Iterator[Parameter]:
    """Yield the parameters of wall and ground, estimated from presses."""
    material = found.material
    if material is None:
        return
    modulus, compliance, zero = material.young_modulus, material.compliance, material.zero
    shear = modulus.value / (2 * (1 + material.poisson_ratio))
    decade = 0.0235 * log(10)
    yield Parameter("young_modulus_mpa", MPA * modulus.value, MPA * modulus.deviation,
                    PRIOR_MODULUS * MPA * modulus.value, "Young's modulus of the wall")  # fmt: skip
    yield Parameter(
        "hardness_shore_a", shore_from_shear_modulus(shear),
        modulus.deviation / modulus.value / decade, PRIOR_MODULUS / decade,
        "Shore A hardness that corresponds to this modulus",
    )  # fmt: skip
    yield Parameter(
        "ground_compliance_mm_per_n", MM * compliance.value, MM * compliance.deviation,
        MM * PRIOR_COMPLIANCE, "settlement of the ground per force",
    )  # fmt: skip
    yield Parameter("depth_zero_mm", MM * zero.value, MM * zero.deviation, MM * PRIOR_ZERO,
                    "stated depth at first contact")  # fmt: skip


def rangefinder_of(found: FittedSensor) -> Rangefinder:
    """Return the simulated rangefinder with the parameters of a twin."""
    twin, rest, volt = found.twin, found.rest, 1 / found.per_volt
    band = twin.band
    face = complex(twin.value("face_real"), twin.value("face_imag"))
    face *= min(1.0, MOST_REFLECTED / max(abs(face), MOST_REFLECTED))
    tuned = {
        name: NOMINAL_FREQUENCY * exp(twin.value(f"log_{name}"))
        for name in ("resonance", "drive_frequency")
    }
    return Rangefinder(
        drive=Burst(frequency=tuned["drive_frequency"], cycles=twin.value("drive_cycles")),
        resonance=tuned["resonance"], quality_factor=exp(twin.value("log_quality")),
        send=volt * rest.send.value, gain=volt * exp(twin.value("log_gain")),
        face_reflection=face, far_reflection=rest.far_reflection.value,
        clutter=min(rest.clutter.value, 0.1), noise=volt * rest.noise.value,
        offset=volt * rest.offset.value, drift=volt * rest.drift.value,
        sampling_rate=band.rate, n_samples=band.n_samples, bits=found.bits,
        full_scale=found.full_scale, quantised=found.quantised,
        jitter=rest.jitter.value, gain_wander=min(rest.wander.value, 1.0),
        lead=max(twin.value("trigger") - band.start, 0.0),
        temperature_bias=-found.dry_offset,
        temperature_noise=found.temperature_noise, temperature_resolution=0.0,
    )  # fmt: skip


def in_toml(found: FittedSensor) -> str:
    """Return the content of the file of a twin."""
    document = tomlkit.document()
    document.add(tomlkit.comment("A sensor that acoustube was fitted to; NAME_sd is the standard"))
    document.add(tomlkit.comment("deviation of NAME. [rangefinder] and [priors] are for other"))
    document.add(tomlkit.comment("commands: --sensor takes this file."))
    known = parameters(found)
    for one in known:
        document.add(one.name, tomlkit.item(_short(one.value)).comment(one.meaning))
        document.add(f"{one.name}_sd", tomlkit.item(_short(one.deviation)))
    humidity = found.twin.model.humidity
    if humidity is not None:
        document.add("humidity_percent", tomlkit.item(_short(humidity)).comment("stated"))
    document.add("length_cm", tomlkit.item(_short(CM * tube_length(found))).comment("of the tube"))
    document.add("determined", _words(one.name for one in known if one.determined))
    document.add("undetermined", _words(one.name for one in known if not one.determined))
    document.add(KIND, _origin(found))
    table = tomlkit.table()
    add_rangefinder(table, rangefinder_of(found))
    document.add("rangefinder", table)
    document.add(
        "priors", tomlkit.item({name: _short(one) for name, one in deviations_of(found).items()})
    )
    document.add("closures", _closures(found))
    if found.material is not None:
        document.add("presses", _presses(found, found.material))
    document.add("clutter", _clutter(found))
    document.add("correlation", _correlation(found))
    return tomlkit.dumps(document)


def tube_length(found: FittedSensor) -> float:
    """Return the tube's length in m: stated, from its end's echo, or 5 cm beyond all closures."""
    if found.length is not None:
        return found.length
    if found.rest.length is not None:
        return found.rest.length.value
    return float(found.twin.model.places.max()) + 0.05


def _short(value: float) -> float:
    """Return a number rounded to seven significant digits; 1e9 if it is not finite."""
    return float(f"{value:.7g}") if isfinite(value) else 1e9


def _words(names: Any) -> Any:
    array = tomlkit.array()
    array.extend(names)
    return array.multiline(True)


def _origin(found: FittedSensor) -> Any:
    table = tomlkit.table()
    table.add("acoustube_version", __version__)
    files = dict.fromkeys([group.source for group in found.closed] + [found.untouched.source])
    table.add("recordings", _words(Path(name).name for name in files))
    table.add("explained", tomlkit.item(_short(float(found.twin.explained.mean()))).comment(
        "fraction of the closures' energy that the model explains"
    ))  # fmt: skip
    return table


def deviations_of(found: FittedSensor) -> dict[str, float]:
    """Return standard deviations for the priors, by name.

    That of the gain is not below the scatter of echo levels and of the gain from cycle to cycle.
    """
    twin = found.twin
    return {
        "temperature": max(twin.deviation("temperature_offset"), 0.1),
        "gain": max(twin.posterior.level, found.rest.wander.value, 0.005),
        "resonance": max(twin.deviation("log_resonance"), 1e-4),
        "quality_factor": max(twin.deviation("log_quality"), 1e-3),
        "thermometer": twin.deviation("temperature_offset"),
    }


def _closures(found: FittedSensor) -> Any:
    """Return the closures with the errors of their stated distances."""
    twin = found.twin
    rows = tomlkit.aot()
    error = twin.posterior.displacement
    for i, group in enumerate(found.closed):
        row = tomlkit.table()
        row.add("recording", Path(group.source).name)
        row.add("distance_cm", _short(CM * group.place))
        if i in twin.left_out:
            row.add("left_out", twin.left_out[i])
        else:
            k = twin.used.index(i)
            row.add("placement_error_mm", round(MM * float(error[k]), 4))
            deviation = MM * float(twin.posterior.displacement_deviation[k])
            row.add("placement_error_mm_sd", round(deviation, 4))
        rows.append(row)
    return rows


def _presses(found: FittedSensor, material: Material) -> Any:
    """Return the presses with depths from their echoes, and the forces expected at these depths."""
    rows = tomlkit.aot()
    for i, state in enumerate(found.pressed):
        row, press = tomlkit.table(), state.press
        row.add("recording", Path(state.source).name)
        for name, value in (
            ("distance_cm", CM * state.place), ("stated_depth_mm", MM * press.stated_depth),
            ("depth_mm", MM * press.depth), ("depth_mm_sd", MM * press.depth_deviation),
            ("stated_force_n", press.force), ("force_n", float(material.expected[i])),
        ):  # fmt: skip
            if isfinite(value):
                row.add(name, _short(value))
        for name, words in (("no_depth", state.reason), ("left_out", material.left_out.get(i))):
            if words:
                row.add(name, words)
        rows.append(row)
    return rows


def _clutter(found: FittedSensor) -> Any:
    """Return positions and reflection coefficients of the measured clutter."""
    places = MM * found.rest.places
    spacing = float(places[1] - places[0]) if len(places) > 1 else 1.0
    reflection = toml_array(float(f"{value:.3g}") for value in found.rest.reflectivity)
    return tomlkit.item(
        {
            "first_mm": _short(float(places[0])),
            "spacing_mm": _short(spacing),
            "reflection": reflection,
        }
    )


def _correlation(found: FittedSensor) -> Any:
    """Return the posterior correlations of the parameters that all closures share, row by row."""
    covariance = found.twin.posterior.covariance
    root = np.sqrt(np.diag(covariance))
    names = [name.removeprefix("log_") for name in SHARED]
    rows = zip(names, covariance / np.outer(root, root), strict=True)
    rounded = {name: toml_array(round(float(value), 3) for value in row) for name, row in rows}
    return tomlkit.item({"names": _words(names)} | rounded)


def time_zero_note(found: FittedSensor) -> str:
    """Return a note if the drive starts before the record or not at time zero; empty otherwise."""
    late = found.twin.value("trigger")
    early = found.twin.band.start - late
    if early >= AT_ZERO:
        return (
            f"the drive starts {MS * early:.3f} ms before the first sample, which invert and "
            f"dataset take for its start, or the stated positions are {CM * SPEED * early / 2:.1f} "
            "cm too large; record from the start of the drive, and measure from the face"
        )
    if abs(late) < AT_ZERO:
        return ""
    return (
        f"the drive starts {MS * late:.3f} ms after time zero of the recordings; if they begin "
        "before it, give --pulse-at"
    )
