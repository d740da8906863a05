"""Files of sensors: those written by hand, and twins."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from acoustube.base.errors import ConfigError

KIND = "twin"
"""Name of the table that only files of twins have."""
OF_OTHERS = ("length_cm", "priors")
"""What such a file states besides the rangefinder."""


def sensor_document(document: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the content of a sensor's file, of a twin's what other commands use of it.

    Parameters
    ----------
    document : mapping
        Content of the file.
    path : Path
        For messages.

    Raises
    ------
    ConfigError
        If it is a twin's file without its rangefinder.
    """
    if KIND not in document:
        return dict(document)
    own = document.get("rangefinder")
    if not isinstance(own, dict):
        raise ConfigError(f"{path} is a twin's file without [rangefinder]; make it again")
    found = dict(own)
    for name in OF_OTHERS:
        if name in document:
            found[name] = document[name]
    return found
