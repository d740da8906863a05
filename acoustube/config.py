"""User settings: what a person may ask for, in human units, checked before anything is computed.

Each section is a frozen dataclass whose fields carry their own rule (range or choice), so that one
check serves them all; :class:`Config` adds the checks that need more than one section. This module
imports nothing heavy: wrong settings are refused at once.
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from acoustube.air import sound_speed
from acoustube.errors import ConfigError
from acoustube.limits import CLEARANCE, SHALLOWEST_MM, pressed_reach
from acoustube.rules import Choice, File, Number, Section, filled, nearest, setting, short

if TYPE_CHECKING:  # the command line imports this module before it writes anything
    from tomlkit.items import Table

CELLS_PER_WAVELENGTH = 8
"""Coarsest grid of the wave stage."""

BAND_WIDTH = 3.83
"""Half the pulse's band down to -70 dB, in carriers times cycles."""
MOST_CELLS = 50_000_000
"""Largest grid of the wave stage, which then takes some 15 GB of memory."""


@dataclass(frozen=True, kw_only=True)
class TubeSettings(Section):
    """The tube. The defaults are the paper's silicone tube.

    The material is given by its hardness or by its shear modulus, not both; with neither, the
    hardness is 35 Shore A.
    """

    inner_diameter_mm: float = setting(7.9, Number(1, 50, "mm", "diameter of the bore"))
    wall_mm: float = setting(1.6, Number(0.2, 20, "mm", "wall thickness"))
    length_cm: float = setting(40.0, Number(5, 1000, "cm", "length of the tube"))
    shore_a: float | None = setting(None, Number(10, 90, "Shore A", "hardness of the wall"))
    shear_modulus_mpa: float | None = setting(
        None, Number(0.01, 20, "MPa", "shear modulus of the wall, in place of shore_a")
    )
    poisson_ratio: float = setting(0.49, Number(0.2, 0.499, "", "Poisson's ratio of the wall"))
    surface: str | None = setting(
        None,
        File("closed surface of a wall in mm along z (STL, PLY, OBJ), in place of the round tube"),
    )

    def __post_init__(self) -> None:
        if self.shore_a is None and self.shear_modulus_mpa is None:
            object.__setattr__(self, "shore_a", 35.0)
        super().__post_init__()
        if self.shore_a is not None and self.shear_modulus_mpa is not None:
            raise ConfigError(
                f"shore_a = {self.shore_a:g} and shear_modulus_mpa = {self.shear_modulus_mpa:g} "
                "both describe the wall's stiffness; give one of the two"
            )

    @property
    def outer_diameter_mm(self) -> float:
        """Outer diameter in mm."""
        return self.inner_diameter_mm + 2 * self.wall_mm


class _Depth(Number):
    """A depth of press; zero is the untouched tube."""

    @property
    def allowed(self) -> str:
        """The range in words."""
        return f"{SHALLOWEST_MM:g} to {self.high:g} {self.unit}, or 0 in a sweep"


@dataclass(frozen=True, kw_only=True)
class IndentationSettings(Section):
    """The press: a rigid tool that comes down on the tube, and what the tube rests on."""

    shape: Literal["rod", "punch", "sphere"] = setting(
        "rod",
        Choice(
            ("rod", "punch", "sphere"),
            "a cylinder lying across the tube, an upright one with a flat end, or a sphere",
        ),
    )
    indenter_mm: float = setting(25.0, Number(2, 100, "mm", "diameter of the pressing tool"))
    depth_mm: float = setting(4.0, _Depth(0, 50, "mm", "how far it is pressed in"))
    steps: int = setting(
        16,
        Number(1, 1000, "", "equally spaced depths that acoustube indent reports", whole=True),
    )
    position_cm: float | None = setting(
        None,
        Number(0.1, 1000, "cm", "distance of the press from the source end (the middle)"),
    )
    offset_mm: float = setting(
        0.0, Number(-50, 50, "mm", "how far beside the tube's axis a punch or sphere comes down")
    )
    yaw_deg: float = setting(
        0.0, Number(-60, 60, "deg", "by how much a rod is turned from across the tube")
    )
    support: Literal["held", "free"] = setting(
        "held",
        Choice(
            ("held", "free"),
            "bottom line held down along its length, or resting on a floor with free ends",
        ),
    )
    layer_mm: float | None = setting(
        None, Number(0.1, 100, "mm", "thickness of an elastic layer under a free tube")
    )
    layer_mpa: float | None = setting(
        None, Number(0.001, 1000, "MPa", "Young's modulus of that layer")
    )
    mesh: Literal["coarse", "usual", "fine"] = setting(
        "usual",
        Choice(
            ("coarse", "usual", "fine"),
            "finite elements of a round tube, to see what they change",
        ),
    )


@dataclass(frozen=True, kw_only=True)
class WaveSettings(Section):
    """The sound in the lumen, and the grid on which it is computed."""

    frequency_khz: float = setting(42.0, Number(5, 100, "kHz", "carrier of the pulse"))
    cycles: int = setting(11, Number(1, 100, "", "carrier cycles in the pulse", whole=True))
    temperature_c: float = setting(20.0, Number(-20, 60, "degC", "temperature of the air"))
    humidity_percent: float = setting(
        50.0, Number(0, 100, "%", "relative humidity of the air, which absorbs sound")
    )
    pressure_kpa: float = setting(101.325, Number(10, 200, "kPa", "pressure of the air at rest"))
    losses: Literal["off", "on"] = setting(
        "off", Choice(("off", "on"), "losses at the wall and in the air")
    )
    method: Literal["full", "scattering"] = setting(
        "full",
        Choice(
            ("full", "scattering"),
            "march the whole tube, or the press alone and join it to straight tube",
        ),
    )
    resolution: int = setting(32, Number(8, 256, "", "grid cells across the bore", whole=True))
    source_end: Literal["release", "absorbing"] = setting(
        "release",
        Choice(("release", "absorbing"), "what the source end does once the pulse has left"),
    )
    probe_cm: float = setting(
        2.0, Number(0.1, 100, "cm", "distance of the listening plane from the source end")
    )


@dataclass(frozen=True, kw_only=True)
class SignalSettings(Section):
    """The processing from pressure to distance."""

    lowpass_khz: float | None = setting(
        None,
        Number(
            0.5,
            50,
            "kHz",
            "cut-off of the envelope's low-pass (half of frequency_khz, at most 10)",
        ),
    )
    prominence: float = setting(
        0.001, Number(0.0001, 1, "", "least prominence of an echo, as a share of the send pulse")
    )


@dataclass(frozen=True, kw_only=True)
class Mechanics:
    """The settings of a press alone, which may close the lumen.

    Parameters
    ----------
    tube, indentation : section
        The sections; each is checked on its own before they are checked together.

    Raises
    ------
    ConfigError
        If the press is deeper than the solver follows.
    """

    tube: TubeSettings = TubeSettings()
    indentation: IndentationSettings = IndentationSettings()

    def __post_init__(self) -> None:
        _check_sections(self)
        _check_press(self.indentation)
        check_touched(self)
        if self.tube.surface is None:
            _check_depth(self.tube, self.indentation)
        elif self.indentation.mesh != "usual":  # its sizes are known when the surface is read
            raise ConfigError(
                f"mesh = {self.indentation.mesh} is of a round tube, and surface = "
                f"{self.tube.surface} is meshed by its own size; use mesh usual"
            )


@dataclass(frozen=True, kw_only=True)
class Config:
    """All settings of one simulation.

    Parameters
    ----------
    tube, indentation, waves, signals : section
        The sections; each is checked on its own before the checks across sections are made here.

    Raises
    ------
    ConfigError
        If the sections contradict each other: a press deeper than the solver follows, too near an
        end, or a grid that is too coarse for the sound or too large.

    Notes
    -----
    A depth of zero is the untouched tube, which a sweep may include.
    """

    tube: TubeSettings = TubeSettings()
    indentation: IndentationSettings = IndentationSettings()
    waves: WaveSettings = WaveSettings()
    signals: SignalSettings = SignalSettings()

    def __post_init__(self) -> None:
        _check_sections(self)
        _check_press(self.indentation)
        _check_audible(self)
        self._fill("indentation", "position_cm", self.tube.length_cm / 2)
        self._fill("signals", "lowpass_khz", min(10.0, self.waves.frequency_khz / 2))
        _check_depth(self.tube, self.indentation)
        _check_position(self)
        _check_resolution(self)
        _check_probe(self.tube, self.waves)
        _check_pulse(self.tube, self.waves)
        _check_lowpass(self)

    def _fill(self, section: str, name: str, value: float) -> None:
        """Give a setting that was left open the value that follows from the others."""
        settings = getattr(self, section)
        if getattr(settings, name) is None:
            object.__setattr__(self, section, dataclasses.replace(settings, **{name: value}))


def _check_sections(config: Any) -> None:
    """Refuse what is not a section where one belongs."""
    for field in dataclasses.fields(config):
        value, section = getattr(config, field.name), _SECTIONS[field.name]
        if not isinstance(value, section):
            raise ConfigError(f"{field.name} = {value!r} must be a {section.__name__}")


def check_touched(config: Config | Mechanics) -> None:
    """Refuse a press that does not touch the tube, where one is needed.

    Raises
    ------
    ConfigError
    """
    if config.indentation.depth_mm == 0:
        raise ConfigError(
            f"depth_mm = 0 presses nothing; use {SHALLOWEST_MM:g} or more (only a sweep may "
            "include the untouched tube)"
        )


def _check_press(press: IndentationSettings) -> None:
    """Refuse settings of the press that have no effect or contradict each other."""
    if 0 < press.depth_mm < SHALLOWEST_MM:
        raise ConfigError(
            f"depth_mm = {short(press.depth_mm)} is hardly a touch; use {SHALLOWEST_MM:g} or more"
        )
    if press.yaw_deg != 0 and press.shape != "rod":
        raise ConfigError(
            f"yaw_deg = {short(press.yaw_deg)} turns a {press.shape}, which is round; use 0"
        )
    if press.offset_mm != 0 and press.shape == "rod":
        raise ConfigError(
            f"offset_mm = {short(press.offset_mm)} moves a rod along itself, which changes "
            "nothing; use 0"
        )
    if (press.layer_mm is None) != (press.layer_mpa is None):
        raise ConfigError("layer_mm and layer_mpa describe one layer; give both or neither")
    if press.layer_mm is not None and press.support == "held":
        raise ConfigError(
            f"layer_mm = {short(press.layer_mm)} cannot hold a tube down; use support free"
        )


def _check_audible(config: Config) -> None:
    """Refuse what only the mechanics can follow so far."""
    if config.tube.surface is not None:
        raise ConfigError(
            f"surface = {config.tube.surface} cannot be simulated with sound; "
            "use acoustube indent for the press alone"
        )


def _check_depth(tube: TubeSettings, indentation: IndentationSettings) -> None:
    """Refuse a press past the floor, or far beyond a closed lumen."""
    depth, outer, bore = indentation.depth_mm, tube.outer_diameter_mm, tube.inner_diameter_mm
    gives = indentation.layer_mm or 0.0
    deepest = _round_down(bore + tube.wall_mm / 2 + gives)
    if depth > outer + gives:
        reason = f"is past the floor (outer diameter {outer:g} mm)"
    elif depth > deepest:
        reason = f"is beyond a closed lumen by more than half a wall (bore {bore:g} mm)"
    else:
        return
    raise ConfigError(f"depth_mm = {short(depth)} {reason}; use at most {deepest:g}")


def _check_position(config: Config) -> None:
    """Refuse a press whose bent part reaches the listening plane or the far end."""
    tube, position = config.tube, filled(config.indentation.position_cm)
    reach = pressed_reach(tube.outer_diameter_mm, config.indentation.indenter_mm) / 10
    reach += CLEARANCE * tube.outer_diameter_mm / 10
    nearest = _round_up(config.waves.probe_cm + reach)
    farthest = _round_down(tube.length_cm - reach)
    bends = f"the press bends the tube for {reach:.4g} cm to each side"
    if nearest > farthest:
        shortest = _round_up(nearest + reach)
        raise ConfigError(
            f"length_cm = {short(tube.length_cm)} is too short: {bends} and the listening plane "
            f"is at {config.waves.probe_cm:g} cm; use at least {shortest:g}"
        )
    if not nearest <= position <= farthest:
        end = "source" if position < nearest else "far"
        raise ConfigError(
            f"position_cm = {short(position)} is too near the {end} end: {bends}; "
            f"use {nearest:g} to {farthest:g}"
        )


def grid_cells(config: Config) -> float:
    """Return the number of grid cells in the box around the bore that is marched."""
    tube, waves = config.tube, config.waves
    length = 10 * tube.length_cm
    if waves.method == "scattering":
        reach = pressed_reach(tube.outer_diameter_mm, config.indentation.indenter_mm)
        length = 2 * (reach + 4 * tube.outer_diameter_mm)
    return waves.resolution**3 * length / tube.inner_diameter_mm


def _check_resolution(config: Config) -> None:
    """Refuse a grid that cannot carry the sound, or that no computer will hold."""
    tube, waves = config.tube, config.waves
    bore, highest = tube.inner_diameter_mm, waves.frequency_khz
    if waves.method == "scattering":  # it follows the pulse's whole band
        highest *= 1 + BAND_WIDTH / waves.cycles
    wavelength_mm = sound_speed(waves.temperature_c) / highest
    coarsest = math.ceil(CELLS_PER_WAVELENGTH * bore / wavelength_mm)
    if waves.resolution < coarsest:
        raise ConfigError(
            f"resolution = {waves.resolution} is too coarse for {highest:.4g} kHz in a "
            f"{bore:g} mm bore ({CELLS_PER_WAVELENGTH} cells per wavelength are needed); "
            f"use at least {coarsest}"
        )
    cells = grid_cells(config)
    if cells > MOST_CELLS:
        finest = math.floor(waves.resolution * (MOST_CELLS / cells) ** (1 / 3))
        raise ConfigError(
            f"resolution = {waves.resolution} makes {cells:.1e} grid cells in "
            f"{tube.length_cm:g} cm of tube, more than {MOST_CELLS:.0e}; "
            f"use at most {finest} or a shorter tube"
        )


def _check_probe(tube: TubeSettings, waves: WaveSettings) -> None:
    """Refuse a listening plane within the first layer of cells, where the pulse is set."""
    nearest = _round_up(tube.inner_diameter_mm / waves.resolution / 10)
    if waves.probe_cm < nearest:
        raise ConfigError(
            f"probe_cm = {short(waves.probe_cm)} lies in the first layer of cells; use at least "
            f"{nearest:g} or a higher resolution"
        )


def _check_pulse(tube: TubeSettings, waves: WaveSettings) -> None:
    """Refuse a pulse that has not left when the echo of the far end is back."""
    pulse_ms = waves.cycles / waves.frequency_khz
    record_ms = 20 * tube.length_cm / sound_speed(waves.temperature_c)
    if pulse_ms > record_ms:
        raise ConfigError(
            f"cycles = {waves.cycles} make a pulse of {pulse_ms:.3g} ms, longer than the "
            f"{record_ms:.3g} ms that a {tube.length_cm:g} cm tube takes to answer; use at most "
            f"{math.floor(record_ms * waves.frequency_khz)}"
        )


def _check_lowpass(config: Config) -> None:
    """Refuse an envelope filter that lets the carrier through, or is slower than the record."""
    waves, lowpass = config.waves, filled(config.signals.lowpass_khz)
    # Rectifying doubles the carrier; two octaves above the cut-off it is down by 48 dB.
    highest = waves.frequency_khz / 2
    record_ms = 20 * config.tube.length_cm / sound_speed(waves.temperature_c)
    # The filter continues the record at both ends by three periods of the cut-off.
    lowest = _round_up(3 / record_ms)
    if lowpass < lowest:
        raise ConfigError(
            f"lowpass_khz = {short(lowpass)} is too slow for the {record_ms:.2f} ms that a "
            f"{config.tube.length_cm:g} cm tube takes to answer; use at least {lowest:g}"
        )
    if lowpass > highest:
        raise ConfigError(
            f"lowpass_khz = {short(lowpass)} lets the rectified "
            f"{waves.frequency_khz:g} kHz carrier through; use at most {_round_down(highest):g}, "
            "under [signals] in a --config file"
        )


def _round_up(value: float) -> float:
    """Return the value rounded up to two decimals, so that the advice itself is allowed."""
    return math.ceil(round(value * 100, 6)) / 100


def _round_down(value: float) -> float:
    """Return the value rounded down to two decimals, so that the advice itself is allowed."""
    return math.floor(round(value * 100, 6)) / 100


_SECTIONS: dict[str, type[Any]] = {
    "tube": TubeSettings,
    "indentation": IndentationSettings,
    "waves": WaveSettings,
    "signals": SignalSettings,
}
_SECTION_OF = {
    field.name: name for name, section in _SECTIONS.items() for field in dataclasses.fields(section)
}


Settings = TypeVar("Settings", Config, Mechanics)
Given = dict[str, dict[str, Any]]


def load_config(
    path: str | Path | None = None,
    kind: type[Settings] = Config,  # type: ignore[assignment]
    **overrides: Any,
) -> Settings:
    """Build the settings from the defaults, then a file, then single values.

    Parameters
    ----------
    path : str or path, optional
        A TOML file with any of the sections ``[tube]``, ``[indentation]``, ``[waves]`` and
        ``[signals]``; what it does not mention keeps its default.
    kind : {Config, Mechanics}
        Which settings are wanted; sections that it lacks are left alone.
    **overrides
        Settings by name, such as ``depth_mm=3``; they win over the file. None means not given.

    Returns
    -------
    Config
        The checked settings.

    Raises
    ------
    ConfigError
        If the file cannot be read, or a section, a name or a value is wrong.

    Examples
    --------
    >>> load_config(indenter_mm=10).indentation.indenter_mm
    10.0
    """
    given: Given = {}
    if path is not None:
        given = given_in(Path(path), read_document(Path(path)))
    return configured(given, kind, **overrides)


def configured(
    given: Mapping[str, Mapping[str, Any]],
    kind: type[Settings] = Config,  # type: ignore[assignment]
    **overrides: Any,
) -> Settings:
    """Build the settings from values by section, then from single ones, as :func:`load_config`.

    Raises
    ------
    ConfigError
        If a name or a value is wrong.
    """
    values = {name: dict(given.get(name, {})) for name in _SECTIONS}
    for name, value in overrides.items():
        if value is not None:
            values[section_of(name)][name] = value
    # From the folder that the caller is in; those of the file are already absolute.
    _make_absolute(values, Path.cwd())
    wanted = [field.name for field in dataclasses.fields(kind)]
    return kind(**{name: _SECTIONS[name](**values[name]) for name in wanted})


def is_whole(name: str) -> bool:
    """Tell whether a setting is a whole number."""
    fields = dataclasses.fields(_SECTIONS[section_of(name)])
    (rule,) = (field.metadata["rule"] for field in fields if field.name == name)
    return isinstance(rule, Number) and rule.whole


def section_of(name: str) -> str:
    """Return the section that a setting belongs to.

    Raises
    ------
    ConfigError
        If there is no such setting.
    """
    if name not in _SECTION_OF:
        raise ConfigError(f"{name} is not a setting{nearest(name, _SECTION_OF)}")
    return _SECTION_OF[name]


def read_document(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises
    ------
    ConfigError
        If there is none, or it is not TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path} is not a text file in UTF-8; give a TOML file") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path} is not valid TOML: {error}") from error
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(
            f"{path} cannot be read ({reason}); check the name of the file"
        ) from error


def given_in(path: Path, document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the values that a TOML file gives, by section.

    Parameters
    ----------
    path : Path
        The file.
    document : dict
        Its content.

    Raises
    ------
    ConfigError
        If a section or a name is not known.
    """
    for section, values in document.items():
        _check_names(path, section, values)
    given = {name: dict(document.get(name, {})) for name in _SECTIONS}
    _make_absolute(given, path.resolve().parent)
    return given


def _make_absolute(given: dict[str, dict[str, Any]], folder: Path) -> None:
    """Let the name of a surface, which a file gives from its own folder, be read from anywhere."""
    surface = given["tube"].get("surface")
    if isinstance(surface, str | Path) and str(surface):
        given["tube"]["surface"] = str(folder / Path(surface).expanduser())


def _check_names(path: Path, section: str, values: Any) -> None:
    """Refuse what is not a known section with known settings in it."""
    if section in _SECTIONS and not isinstance(values, dict):
        raise ConfigError(
            f"{path}: {section} must be a section, written [{section}] above its settings"
        )
    if not isinstance(values, dict):
        home = f" under [{_SECTION_OF[section]}]" if section in _SECTION_OF else ""
        advice = f"; put it{home}" if home else nearest(section, _SECTION_OF)
        raise ConfigError(f"{path}: {section} stands outside a section{advice}")
    if section not in _SECTIONS:
        raise ConfigError(f"{path}: [{section}] is not a section{nearest(section, _SECTIONS)}")
    known = [field.name for field in dataclasses.fields(_SECTIONS[section])]
    for name in values:
        if name not in known:
            advice = nearest(name, known)
            if name in _SECTION_OF:
                advice = f"; it belongs under [{_SECTION_OF[name]}]"
            raise ConfigError(f"{path}: [{section}] {name} is not a setting{advice}")


def describe(name: str, default: Any = None) -> str:
    """Return what a setting means, its default (or another) and what it may be, in words."""
    section = _SECTION_OF[name]
    (field,) = (f for f in dataclasses.fields(_SECTIONS[section]) if f.name == name)
    rule = field.metadata["rule"]
    default = getattr(getattr(Config(), section), name) if default is None else default
    meaning = rule.meaning[0].upper() + rule.meaning[1:]
    if default is None:
        return f"{meaning}."
    if isinstance(default, str):  # the choices are listed anyway
        return f"{meaning}; default {default}."
    return f"{meaning}: {rule.allowed}; default {short(default)}."


def to_toml(config: Config | Mechanics) -> str:
    """Return the settings as a TOML document that :func:`load_config` reads back as they are.

    Parameters
    ----------
    config : Config or Mechanics
        The settings.

    Returns
    -------
    str
        Every section and every setting that has a value, each with its meaning and its range as a
        comment.
    """
    import tomlkit

    document = tomlkit.document()
    for field in dataclasses.fields(config):
        if document:
            document.add(tomlkit.nl())
        document.add(field.name, _table(getattr(config, field.name)))
    return tomlkit.dumps(document)


def _table(section: Any) -> Table:
    """Return one section as a table of TOML."""
    import tomlkit

    table = tomlkit.table()
    for field in dataclasses.fields(section):
        value = getattr(section, field.name)
        rule = field.metadata["rule"]
        meaning = f"{rule.meaning}; {rule.allowed}"
        if value is None:
            table.add(tomlkit.comment(f"{field.name} = # {meaning}"))
        else:
            table.add(field.name, tomlkit.item(value).comment(meaning))
    return table
