"""Categories of cases: each makes the words of a command, and the files that these name."""

from __future__ import annotations

import json
import os
import shutil
import tomllib
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from tests.fuzz.corpus import recording
from tests.fuzz.functions import functions
from tests.fuzz.harness import Case, Maker
from tests.fuzz.oddities import (
    as_json,
    as_toml,
    mutated_arrays,
    mutated_bytes,
    mutated_tree,
    odd_number,
    odd_text,
)
from tests.fuzz.streams import streams
from tests.fuzz.writers import npz, written

RECORDINGS = (
    "good.npz", "packed.npz", "good.npy", "good.wav", "good.flac", "good.mat", "packed.mat",
    "old.mat", "good.h5", "good.nc", "old.nc", "good.csv",
)  # fmt: skip
SURFACES = tuple(
    f"{shape}{ending}"
    for shape in ("lumen", "wall")
    for ending in (".stl", "_text.stl", ".ply", ".obj", ".vtp", "_text.vtp")
)
PROCESS = ("--rate", "200000", "--temperature", "20")


def settings(chance: Random, corpus: Path, folder: Path) -> Case:
    """Settings, plans, rangefinders, calibrations and sidecars."""
    kind = chance.choice(("settings", "plan", "cases", "sensor", "calibration", "sidecar", "goal"))
    if kind == "sidecar":
        ending = chance.choice((".toml", ".json"))
        shutil.copy(corpus / "good.npy", folder / "a.npy")
        _text_of(chance, _tree(corpus / f"sidecar{ending}"), folder / f"a{ending}")
        return Case(
            ("process", "a.npy", *chance.choice(((), PROCESS))), told=("a.npy", f"a{ending}")
        )
    if kind == "calibration":
        shutil.copy(corpus / "good.npz", folder / "a.npz")
        _text_of(chance, _tree(corpus / "calibration.toml"), folder / "c.toml")
        return Case(("process", "a.npz", "--calibration", "c.toml"), told=("a.npz", "c.toml"))
    if kind == "sensor":
        _text_of(chance, _tree(corpus / "sensor.json"), folder / "s.toml")
        return Case(
            ("dataset", str(corpus / "sweep"), "--rangefinder", "s.toml", "--out", "o"),
            told=("s.toml",),
        )
    _text_of(chance, _tree(corpus / f"{kind}.toml"), folder / "p.toml")
    if kind == "goal":
        return Case(("design", "p.toml", "--out", "o"), told=("p.toml",))
    if kind == "settings" and chance.random() < 0.5:
        command = chance.choice(("simulate", "indent"))
        return Case((command, "--config", "p.toml", "--out", "o"), told=("p.toml",))
    return Case(("sweep", "--plan", "p.toml", "--dry-run"), told=("p.toml",))


def _tree(path: Path) -> dict[str, Any]:
    text = path.read_text()
    found = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    return dict(found)


def _text_of(chance: Random, tree: dict[str, Any], path: Path) -> None:
    """Write a mutated tree, sometimes with mutated bytes, in some encoding."""
    for _ in range(chance.choice((0, 1, 1, 2))):
        tree = mutated_tree(chance, tree)
    text = as_json(tree) if path.suffix == ".json" else as_toml(tree)
    code = chance.choice(("utf-8",) * 12 + ("utf-16", "latin-1", "utf-8-sig"))
    content = text.encode(
        code, errors=chance.choice(("replace", "surrogatepass" if "utf" in code else "replace"))
    )
    if chance.random() < 0.3:
        content = mutated_bytes(chance, content)
    path.write_bytes(content)


def recordings(chance: Random, corpus: Path, folder: Path) -> Case:
    """Recordings of all kinds, mutated in their arrays or in their bytes."""
    made = chance.random()
    if made < 0.35:
        name = written(chance, mutated_arrays(chance, recording()), folder)
    else:
        source = chance.choice([n for n in RECORDINGS if (corpus / n).exists()])
        other = chance.choice([n for n in RECORDINGS if (corpus / n).exists()])
        ending = Path(other).suffix if chance.random() < 0.05 else Path(source).suffix
        name = f"a{ending}"
        content = mutated_bytes(
            chance, (corpus / source).read_bytes(), (corpus / other).read_bytes()
        )
        (folder / name).write_bytes(content)
    words = ["process", name, *chance.choice(((), PROCESS, PROCESS, ("--samples", "600")))]
    if chance.random() < 0.2:
        words += ["--out", "o.csv"]
    if chance.random() < 0.05:
        words += ["--calibration", str(corpus / "calibration.toml")]
    if chance.random() < 0.05:
        words = ["train", name, "--estimator", "boosting", "--out", "o.model", "--epochs", "1"]
    if chance.random() < 0.05:
        words = ["calibrate", name, "--untouched", str(corpus / "good.npz"), "--out", "o.toml"]
    return Case(tuple(words), told=(name, "good.npz"))


def surfaces(chance: Random, corpus: Path, folder: Path) -> Case:
    """Lumens for `scatter` and walls for `indent`, mutated in their corners, facets or bytes."""
    source = chance.choice(SURFACES)
    path = folder / f"a{Path(source).suffix}"
    if chance.random() < 0.5:
        other = corpus / chance.choice(SURFACES)
        path.write_bytes(mutated_bytes(chance, (corpus / source).read_bytes(), other.read_bytes()))
    else:
        _export(chance, corpus / source, path)
    if source.startswith("lumen"):
        words = ("scatter", path.name, "--resolution", "8", "--band", "5", "20", "--out", "o.nc")
    else:
        words = ("indent", "--tube", path.name, "--depth", "1", "--out", "o")
    return Case(words, told=(path.name,))


def _export(chance: Random, source: Path, path: Path) -> None:
    """Write a surface with some corners moved and some facets changed."""
    import pyvista
    import trimesh

    plain = source.with_name(source.name.replace("_text", "")).with_suffix(".stl")
    surface = trimesh.load_mesh(plain)
    corners, facets = np.array(surface.vertices), np.array(surface.faces)
    for _ in range(chance.choice((1, 1, 3))):
        kind = chance.randrange(8)
        i, j = chance.randrange(len(corners)), chance.randrange(len(facets))
        number = min(odd_number(chance), 1e308)
        if kind == 0:
            corners[i, chance.randrange(3)] = number
        elif kind == 1:
            corners = corners * number
        elif kind == 2:
            corners[:, chance.randrange(3)] *= chance.choice((-1, 0, 0.01, 1e3, 1e6))
        elif kind == 3:
            facets = np.delete(facets, j, axis=0)
        elif kind == 4:
            facets[j] = facets[j][::-1]
        elif kind == 5:
            facets[j, chance.randrange(3)] = i
        elif kind == 6:
            facets = np.concatenate([facets, facets + len(corners)])
            corners = np.concatenate([corners, corners + chance.choice((0, 1, 100))])
        else:
            corners = corners[:, chance.sample(range(3), 3)] + chance.choice((0, 1e9))
        if not len(facets):
            break
    changed = trimesh.Trimesh(corners, facets, process=False)
    if path.suffix == ".vtp":
        count = np.full((len(facets), 1), 3)
        pyvista.PolyData(corners, np.hstack([count, facets]).ravel()).save(path)
    else:
        changed.export(path)


def markers(chance: Random, corpus: Path, folder: Path) -> Case:
    """Markers of motion capture, as tables and C3D files."""
    good = [name for name in ("markers.csv", "markers.c3d") if (corpus / name).exists()]
    source = corpus / chance.choice(good)
    path = folder / f"m{source.suffix}"
    if source.suffix == ".csv" and chance.random() < 0.6:
        rows = [line.split(",") for line in source.read_text().splitlines()]
        for _ in range(chance.choice((1, 2, 8))):
            row = chance.choice(rows)
            if row and chance.random() < 0.7:
                row[chance.randrange(len(row))] = chance.choice(
                    (odd_text(chance)[:3000], "1e308", "0")
                )
            else:
                del row[chance.randrange(len(row) + 1) :]
        text = chance.choice(("\n", "\r\n")).join(",".join(row) for row in rows)
        path.write_bytes(text.encode("utf-8", errors="replace"))
    else:
        path.write_bytes(mutated_bytes(chance, source.read_bytes()))
    words = ["sleeve", path.name, "--loops", "4", "--out", "o"]
    words += chance.choice(((), ("--axis", "z"), ("--unit", "cm"), ("--columns", "A", "B")))
    return Case(tuple(words), told=(path.name,))


def models(chance: Random, corpus: Path, folder: Path) -> Case:
    """Models, mutated in their header, their arrays or their bytes."""
    source = corpus / f"{chance.choice(('boosting', 'echo', 'network'))}.model"
    path = folder / "m.model"
    if chance.random() < 0.4:
        path.write_bytes(mutated_bytes(chance, source.read_bytes()))
    else:
        with np.load(source) as archive:
            arrays = {name: archive[name] for name in archive.files}
        if chance.random() < 0.5:
            tree = json.loads(str(arrays["header"]))
            for _ in range(chance.choice((1, 2))):
                tree = mutated_tree(chance, tree)
            arrays["header"] = np.array(as_json(tree))
        else:
            arrays = mutated_arrays(chance, arrays)
        npz(chance, arrays, path)
    if chance.random() < 0.2:
        return Case(("cite", "m.model"), told=("m.model",))
    return Case(
        ("evaluate", "m.model", str(corpus / "labelled.nc")), told=("m.model", "labelled.nc")
    )


def results(chance: Random, corpus: Path, folder: Path) -> Case:
    """Results of acoustube, damaged, cut, or altered by another program."""
    kind = chance.choice(("sweep", "cycles", "indent", "scatter.nc"))
    where = folder / kind
    if (corpus / kind).is_dir():
        shutil.copytree(corpus / kind, where)
    else:
        shutil.copy(corpus / kind, where)
    files = [where] if where.is_file() else sorted(p for p in where.rglob("*") if p.is_file())
    weights = [10 if path.suffix == ".nc" else 1 for path in files]
    for _ in range(chance.choice((1, 1, 2))):
        _damage(chance, chance.choices(files, weights)[0], corpus)
    command = chance.choice(("show", "show", "export", "export", "cite", "dataset"))
    if command == "show":
        page = chance.choice((("--html", "o.html"), ("--out", "o.png")))
        return Case(("show", kind, *page), told=(kind,))
    if command == "export":
        form = chance.choice(("csv", "wav", "stl", "vtp", "vtu", "lerobot"))
        return Case(("export", kind, "--format", form, "--out", "o"), told=(kind,))
    if command == "dataset":
        return Case(("sweep", "--depth", "0", "--dry-run", "--out", kind), told=(kind,))
    return Case(("cite", kind), told=(kind,))


def _damage(chance: Random, path: Path, corpus: Path) -> None:
    """Damage a file: its bytes, or its contents."""
    if not path.exists():
        return
    kind = chance.random()
    if kind < 0.05:
        path.unlink()
    elif kind < 0.1:
        shutil.copy(corpus / "foreign.nc", path)
    elif kind < 0.55 or path.suffix != ".nc":
        path.write_bytes(mutated_bytes(chance, path.read_bytes()))
    else:
        _alter(chance, path)


def _alter(chance: Random, path: Path) -> None:
    """Change variables and attributes of a netCDF file that stays readable."""
    import h5py

    with h5py.File(path, "a") as file:
        names: list[str] = []
        file.visit(names.append)
        for _ in range(chance.choice((1, 2))):
            name = chance.choice(names)
            what = chance.randrange(4)
            if name not in file:
                continue
            if what == 0:
                del file[name]
            elif what == 1:
                owner = chance.choice((file, file[name]))
                if len(owner.attrs):
                    key = chance.choice(sorted(owner.attrs))
                    if not key.startswith(("_", "DIM", "REF", "CLASS")):
                        owner.attrs[key] = chance.choice(("x", "{}", "[]", 1.5, np.nan, [1, 2]))
            elif isinstance(file[name], h5py.Dataset) and file[name].dtype.kind in "iufb":
                values = file[name]
                if what == 2 and values.size:
                    values[...] = np.full(
                        values.shape, chance.choice((0, 1, 255, -1, np.nan))
                    ).astype(values.dtype)
                else:
                    del file[name]
                    file[name] = np.zeros(chance.choice(((), (1,), (3, 2))))


def words(chance: Random, corpus: Path, folder: Path) -> Case:
    """Words of commands: options that are odd, missing, repeated, unknown or without a value."""
    from tests.fuzz.options import OPTIONS, POSITIONAL

    for name in (
        "good.npz",
        "lumen.stl",
        "markers.csv",
        "boosting.model",
        "plan.toml",
        "goal.toml",
    ):
        os.link(corpus / name, folder / name) if not (folder / name).exists() else None
    command = chance.choice(sorted(OPTIONS))
    said = command.split()
    for good in POSITIONAL.get(command, ()):
        said.append(good if chance.random() < 0.8 else _value(chance))
    for option in chance.sample(OPTIONS[command], min(len(OPTIONS[command]), chance.randrange(5))):
        said.append(
            option if chance.random() < 0.95 else option + chance.choice(("x", "=", "=1", "-"))
        )
        said += [_value(chance) for _ in range(chance.choice((0, 1, 1, 1, 1, 2, 3)))]
    if chance.random() < 0.1:
        said.insert(chance.randrange(len(said) + 1), _value(chance))
    if chance.random() < 0.1 and len(said) > 1:
        said.append(chance.choice(said))
    return Case(tuple(said), told=tuple(said))


def _value(chance: Random) -> str:
    """Return a value of an option."""
    kind = chance.random()
    if kind < 0.3:
        return str(chance.choice((1, 2, 4, 10, 25, 0.5, 20, 40)))
    if kind < 0.5:
        try:
            return str(odd_number(chance))
        except ValueError:
            return "9" * 6000
    if kind < 0.65:
        return chance.choice(
            ("good.npz", "lumen.stl", "o", "o.nc", "o.csv", "o.png", ".", "/etc", "/dev/null")
        )
    if kind < 0.8:
        return ":".join(
            str(min(odd_number(chance), 1e300)) for _ in range(chance.choice((2, 3, 4)))
        )
    return odd_text(chance)


CATEGORIES: dict[str, Maker] = {
    "settings": settings, "words": words, "recordings": recordings, "surfaces": surfaces,
    "markers": markers, "models": models, "results": results, "streams": streams,
    "functions": functions,
}  # fmt: skip
