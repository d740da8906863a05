"""Origin of a result: version, settings, device and warnings, as attributes of its file."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from acoustube.base.version import __version__
from acoustube.runs.config import Config, Mechanics


def provenance(config: Config | Mechanics, warnings: Sequence[str], device: str) -> dict[str, Any]:
    """Return the origin of a result of one press, as attributes of a dataset.

    The parameters are those of :func:`acoustube.runs.results.dataset`.
    """
    settings = configuration(config)
    return {
        "title": "One press of a soft acoustic waveguide",
        "source": "simulation",
        "acoustube_version": __version__,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "configuration": settings,
        "configuration_hash": hashlib.sha256(settings.encode()).hexdigest()[:16],
        "device": device,
        "precision": "float64 in the wall, float32 in the air",
        "warnings": "\n".join(warnings),
    }


def configuration(config: Config | Mechanics) -> str:
    """Return settings as JSON text."""
    return json.dumps(dataclasses.asdict(config), sort_keys=True)
