"""Settings in TOML documents, overridden by options."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from acoustube.base.checks import Optional, checked
from acoustube.base.errors import ConfigError, short
from acoustube.base.foreign.documents import read_document
from acoustube.base.names import PATH
from acoustube.base.rules import Number, nearest

if TYPE_CHECKING:  # tomlkit is imported only where TOML is written
    from tomlkit.items import Table

from acoustube.runs.config.config import SECTIONS, Config, Settings

_SECTION_OF = {
    field.name: name for name, section in SECTIONS.items() for field in dataclasses.fields(section)
}
# Values of settings, by section and name.
Given = dict[str, dict[str, Any]]


@checked(path=Optional(PATH))
def load_config(
    path: str | Path | None = None,
    kind: type[Settings] = Config,  # type: ignore[assignment]
    **overrides: Any,
) -> Settings:
    """Build settings from the defaults, overridden by a file and then by single values.

    Parameters
    ----------
    path : str or path, optional
        A TOML file with any of the sections ``[tube]``, ``[indentation]``, ``[waves]`` and
        ``[signals]``; settings that it omits keep their defaults. A relative `surface` is relative
        to the folder of the file.
    kind : {Config, Mechanics}
        Class of the settings; sections that it lacks are ignored.
    **overrides
        Settings by name, such as ``depth_mm=3``, which override the file. None means not given.

    Returns
    -------
    Config or Mechanics
        The checked settings, of the class `kind`.

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
    """Build settings from values by section and from overrides, as :func:`load_config` does.

    A relative `surface` is relative to the working directory.

    Raises
    ------
    ConfigError
        If a name or a value is wrong.
    """
    values = {name: dict(given.get(name, {})) for name in SECTIONS}
    for name, value in overrides.items():
        if value is not None:
            values[section_of(name)][name] = value
    # Relative to the working directory; paths from the file are already absolute.
    _make_absolute(values, Path.cwd())
    wanted = [field.name for field in dataclasses.fields(kind)]
    return kind(**{name: SECTIONS[name](**values[name]) for name in wanted})


def is_whole(name: str) -> bool:
    """Return whether a setting is a whole number.

    Raises
    ------
    ConfigError
        If there is no such setting.
    """
    fields = dataclasses.fields(SECTIONS[section_of(name)])
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


def given_in(path: Path, document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the values of settings that a TOML file gives, by section and name.

    Parameters
    ----------
    path : Path
        The file.
    document : dict
        Content of the file.

    Raises
    ------
    ConfigError
        If a section or a name is not known, or a setting stands outside its section.
    """
    for section, values in document.items():
        _check_names(path, section, values)
    given = {name: dict(document.get(name, {})) for name in SECTIONS}
    _make_absolute(given, path.resolve().parent)
    return given


def _make_absolute(given: dict[str, dict[str, Any]], folder: Path) -> None:
    """Make a relative path of a surface absolute, in place; it is relative to `folder`."""
    surface = given["tube"].get("surface")
    if isinstance(surface, str | Path) and str(surface):
        given["tube"]["surface"] = str(folder / Path(surface).expanduser())


def _check_names(path: Path, section: str, values: Any) -> None:
    """Raise unless `section` is a known section and `values` holds known settings of it."""
    if section in SECTIONS and not isinstance(values, dict):
        raise ConfigError(
            f"{path}: {section} must be a section, written [{section}] above its settings"
        )
    if not isinstance(values, dict):
        home = f" under [{_SECTION_OF[section]}]" if section in _SECTION_OF else ""
        advice = f"; put it{home}" if home else nearest(section, _SECTION_OF)
        raise ConfigError(f"{path}: {section} stands outside a section{advice}")
    if section not in SECTIONS:
        raise ConfigError(f"{path}: [{section}] is not a section{nearest(section, SECTIONS)}")
    known = [field.name for field in dataclasses.fields(SECTIONS[section])]
    for name in values:
        if name not in known:
            advice = nearest(name, known)
            if name in _SECTION_OF:
                advice = f"; it belongs under [{_SECTION_OF[name]}]"
            raise ConfigError(f"{path}: [{section}] {name} is not a setting{advice}")


def describe(name: str, default: Any = None) -> str:
    """Return the help text of a setting: meaning, allowed range and default, as far as it has them.

    Parameters
    ----------
    name : str
    default : optional
        Value to show in place of the setting's own default.
    """
    section = _SECTION_OF[name]
    (field,) = (f for f in dataclasses.fields(SECTIONS[section]) if f.name == name)
    rule = field.metadata["rule"]
    default = getattr(getattr(Config(), section), name) if default is None else default
    meaning = rule.meaning[0].upper() + rule.meaning[1:]
    if default is None:
        return f"{meaning}."
    if isinstance(default, str):  # the help lists the choices anyway
        return f"{meaning}; default {default}."
    return f"{meaning}: {rule.allowed}; default {short(default)}."


def to_toml(config: Any) -> str:
    """Return settings as a TOML document from which they are read back unchanged.

    Parameters
    ----------
    config : Config, Mechanics or DesignGoal
        The settings, a dataclass of sections.

    Returns
    -------
    str
        Every section and every setting, each with its meaning and its range as a comment. A setting
        without a value is itself a comment.
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
