"""The command ``acoustube cite``: the references of the methods, or of those that a result used."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any
from zipfile import is_zipfile

from acoustube.base.errors import ConfigError
from acoustube.base.foreign.limits import reading
from acoustube.cli._options import FLAG, Limits
from acoustube.cli.references import TOPICS, Reference, references

CREASING = 0.72
"""Depth, as a fraction of the bore, beyond which the inner surface of the folds may crease."""
OF_ESTIMATORS = {
    "network": {"network", "intervals"},
    "echo": {"network", "ensemble", "intervals"},
    "boosting": {"intervals"},
}
"""Topics of the methods of each estimator."""


def cite(
    result: Path | None = None,
    /,
    *,
    bibtex: Annotated[bool, FLAG] = False,
    limits: Limits = Limits(),  # noqa: ARG001  acts through the environment
) -> None:
    """List what a publication should cite: the program, and the sources of its methods.

    Parameters
    ----------
    result : Path
        Result to cite for, in place of all methods: a folder of simulate, indent, sweep, dataset or
        sleeve, or a file of scatter or train.
    bibtex : bool
        BibTeX entries instead of text.
    """
    if result is not None and not result.exists():
        raise ConfigError(f"{result} does not exist; name a result, or nothing for all methods")
    found = references(None if result is None else topics_of(result))
    print("\n\n".join(entry.bibtex() for entry in found) if bibtex else in_words(found))


def in_words(found: Iterable[Reference]) -> str:
    """Return references under the headings of their topics."""
    listed = list(found)
    parts = []
    for topic, heading in TOPICS.items():
        lines = [f"  {entry.in_words()}" for entry in listed if entry.topic == topic]
        if lines:
            parts.append("\n".join([f"{heading}:", *lines]))
    return "\n".join(parts)


def topics_of(result: Path) -> set[str]:
    """Return the topics of the methods that a result used.

    Parameters
    ----------
    result : Path
        A folder of ``simulate``, ``indent``, ``sweep``, ``dataset`` or ``sleeve``, or a file of
        ``scatter`` or ``train``.

    Raises
    ------
    ConfigError
        If it is not a result of acoustube.
    """
    result = result.parent if result.name == "run.nc" else result
    if (result / "run.nc").is_file():
        path = result / "run.nc"
        return _of_text(_attributes(path).get("configuration"), path)
    if (result / "sleeve.csv").is_file() and (result / "layout.txt").is_file():
        with (result / "layout.txt").open("rb") as file:
            fitted = file.read(7) == b"markers"
        return {"arm"} if fitted else set()
    if result.is_file() and is_zipfile(result):  # a trained model, under any name
        from acoustube.estimation import load

        return set(OF_ESTIMATORS[load(result).name])
    if result.is_file() and result.suffix == ".nc":
        origin = _attributes(result)
        if str(origin.get("title")).startswith("Scattering") and "losses" in origin:
            found = {"air", "scattering"} | ({"losses"} if origin["losses"] != "none" else set())
            return found if origin.get("solver") == "spectral" else found | {"absorber", "grid"}
    return _of_sweep(result)


def _of_sweep(result: Path) -> set[str]:
    """Return the topics of the methods of a sweep's cases, or of cycles recorded from them."""
    from acoustube.runs.opening import PATTERNS, files_of, open_dataset

    paths = []
    with suppress(ConfigError):
        paths = files_of(result)
    if not any(path.match(pattern) for path in paths for pattern in PATTERNS.values()):
        raise ConfigError(
            f"{result} is not a result of acoustube; name a folder of simulate, indent, sweep, "
            "dataset or sleeve, or a file of scatter or train"
        )
    data = open_dataset(paths)
    if "cycle" in data.dims:
        return {
            "press", "air", "losses", "absorber", "grid", "scattering", "cascade", "rangefinder",
        }  # fmt: skip
    with reading(result, "is damaged", "repeat acoustube sweep, which computes it again"):
        texts = data["configuration"].values if "configuration" in data else [None]
    return set().union(*(_of_text(text, result) for text in texts))


def _of_text(text: Any, source: Path) -> set[str]:
    """Return the topics of a run's methods from its settings as JSON; raise if there are none."""
    from acoustube.base.foreign.results import settings_in

    with reading(source, "holds no settings of acoustube", "name a result that it wrote"):
        return _of_settings(settings_in(text, source))


def _of_settings(settings: dict[str, Any]) -> set[str]:
    """Return the topics of the methods of a run with these settings."""
    press, tube = settings["indentation"], settings["tube"]
    found = {"press"}
    if press["depth_mm"] > CREASING * tube["inner_diameter_mm"]:
        found.add("folds")
    if tube.get("surface"):
        found.add("surface")
    waves = settings.get("waves")
    if waves is not None:
        # Both source ends are computed, one of them absorbing.
        found |= {"air"} if waves["method"] == "spectral" else {"air", "absorber", "grid"}
        found |= {"losses"} if waves["losses"] == "on" else set()
        found |= {"scattering", "cascade"} if waves["method"] != "full" else set()
    return found


def _attributes(path: Path) -> dict[str, Any]:
    import h5py

    from acoustube.base.foreign.results import check_result

    advice = "name an intact result"
    check_result(path, advice)
    with reading(path, "cannot be read", advice), h5py.File(path) as file:
        return dict(file.attrs)
