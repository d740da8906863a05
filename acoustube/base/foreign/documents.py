"""TOML and JSON documents within limits."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

from acoustube.base.errors import ConfigError
from acoustube.base.foreign import limits

DOTTED = re.compile(rf"(?<![\w-])(?:[\w-]++\s*+\.\s*+){{{limits.NESTING}}}")
"""Pattern of too deep a dotted key: TOML's parser takes time in proportion to the depth squared."""
PARSERS = {".toml": ("TOML", tomllib.loads), ".json": ("JSON", json.loads)}


def read_document(path: str | Path, kind: str = ".toml") -> dict[str, Any]:
    """Read a table from a TOML or JSON file.

    Parameters
    ----------
    path : str or Path
    kind : {".toml", ".json"}
        Format of the file, whatever its name.

    Raises
    ------
    ConfigError
        If the file cannot be read, is not valid, does not hold a table, or exceeds a limit of
        :mod:`acoustube.base.foreign.limits`.
    """
    limits.check_file(path, "settings")
    name, _ = PARSERS[kind]
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path} is not a text file in UTF-8; give a {name} file") from error
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be read ({error.strerror}); check the name of the file"
        ) from error
    found = parsed(text, path, kind)
    if not isinstance(found, dict):
        raise ConfigError(
            f"{path} is not a table of names and values in {name}; give settings as such a table"
        )
    return found


def parsed(text: str, source: str | Path, kind: str = ".json") -> Any:
    """Return the content of a TOML or JSON text.

    Parameters
    ----------
    text : str
    source : str or Path
        Origin of the text, for messages.
    kind : {".toml", ".json"}

    Raises
    ------
    ConfigError
        If the text is not valid, or exceeds a limit.
    """
    name, parse = PARSERS[kind]
    if kind == ".toml" and DOTTED.search(text):
        raise _too_deep(source)
    try:
        found = parse(text)
    except (tomllib.TOMLDecodeError, json.JSONDecodeError) as error:
        raise ConfigError(f"{source} is not valid {name}: {error}; correct it") from error
    except (ValueError, RecursionError) as error:  # thousands of digits, or of brackets
        raise ConfigError(
            f"{source} cannot be read ({limits.reason(error)}); correct it"
        ) from error
    _check(found, source, "", 0)
    return found


def _check(value: Any, source: str | Path, name: str, depth: int) -> None:
    """Raise if a document is nested too deeply, or has a name or a whole number too long."""
    if depth > limits.NESTING:
        raise _too_deep(source)
    if isinstance(value, dict):
        for key, inner in value.items():
            limits.check_name(source, key)
            _check(inner, source, key, depth + 1)
    elif isinstance(value, list):
        for inner in value:
            _check(inner, source, name, depth + 1)
    elif isinstance(value, int) and value.bit_length() > 64:
        raise ConfigError(
            f"{source}: {name} is an integer of more than 64 bits, the limit; correct it"
        )


def _too_deep(source: str | Path) -> ConfigError:
    return ConfigError(f"{source} is nested over {limits.NESTING} levels, the limit; flatten it")
