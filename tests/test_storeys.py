"""Layers of the package: commands, reports, runs, the stages in the order of data, and the base."""

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import acoustube

PACKAGE = Path(acoustube.__file__).parent
STAGES = (
    "tube", "air", "indentation", "lumen", "waves", "ranging", "recordings", "signals",
    "estimation", "inversion", "sleeve",
)  # fmt: skip
STOREYS = ("base", *STAGES, "runs", "sensor", "reports", "cli")
"""Layers from the lowest up: a package imports only those that are listed before it."""
AT_TOP = {"__init__", "__main__", "py"}
PRINTING = {"rich", "cyclopts", "argparse"}
FILE_FORMATS = {"h5py", "h5netcdf", "tomlkit", "tomllib"}
LEAVES = ("signals/calibration_file.py", "estimation/model_file.py", "recordings/")
"""Modules in which stages read and write their own file formats."""
LONGEST_MODULE, LONGEST_FUNCTION = 400, 60


def modules():
    return sorted(path for path in PACKAGE.rglob("*.py"))


def room(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports(tree):
    """Yield every module that is imported at any place, by its full name."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{name.name}" for name in node.names)
        elif isinstance(node, ast.Import):
            yield from (name.name for name in node.names)


def test_top_level_holds_the_layers_only():
    found = {path.stem for path in PACKAGE.iterdir() if path.name != "__pycache__"}
    assert found - AT_TOP == set(STOREYS)


@pytest.mark.parametrize(
    "path",
    [
        path
        for path in modules()
        if path.name == "__init__.py" and room(path) not in {"cli", *AT_TOP}
    ],
    ids=lambda path: str(path.parent.relative_to(PACKAGE)),
)
def test_package_names_its_modules_in_reading_order(path):
    named = set(re.findall(r"`([\w.]+)`", ast.get_docstring(ast.parse(path.read_text("utf-8")))))
    found = {one.stem for one in path.parent.iterdir() if not one.name.startswith("_")}
    data = {one.stem for one in path.parent.iterdir() if one.suffix not in {".py", ""}}
    assert found - data <= named


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_module_imports_only_lower_layers(path):
    here = room(path)
    if here in AT_TOP:
        return
    names = set(imports(ast.parse(path.read_text(encoding="utf-8"))))
    inner = {name.split(".")[1] for name in names if name.startswith("acoustube.")} & set(STOREYS)
    above = {name for name in inner if STOREYS.index(name) > STOREYS.index(here)}
    assert not above
    outer = {name.split(".")[0] for name in names}
    if here != "cli" and path.name != "console.py":
        assert not outer & PRINTING
    if here in STAGES:
        assert not outer & FILE_FORMATS or str(path.relative_to(PACKAGE)).startswith(LEAVES)


def test_modules_import_each_other_in_no_circle():
    """Imports in functions and imports for types are included."""
    names = {
        ".".join(("acoustube", *path.relative_to(PACKAGE).with_suffix("").parts)): path
        for path in modules()
        if path.name not in ("__init__.py", "__main__.py")
    }
    graph = {
        name: {
            known
            for found in imports(ast.parse(path.read_text(encoding="utf-8")))
            for known in (found, found.rpartition(".")[0])
            if known in names
        }
        for name, path in names.items()
    }
    assert len(list(TopologicalSorter(graph).static_order())) == len(names)


def test_signals_do_not_import_the_wave_solvers():
    """A recording from a sensor passes through the same code as a simulated one."""
    names = {
        name
        for path in (PACKAGE / "signals").rglob("*.py")
        for name in imports(ast.parse(path.read_text(encoding="utf-8")))
    }
    assert not {n for n in names if n.startswith(("acoustube.waves", "acoustube.ranging"))}


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_modules_and_functions_are_short(path):
    """At most 400 lines per module, and 60 per function without its docstring."""
    text = path.read_text(encoding="utf-8")
    assert text.count("\n") <= LONGEST_MODULE
    long = {}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            words = ast.get_docstring(node, clean=False) or ""
            length = node.end_lineno - node.lineno + 1 - (words.count("\n") + bool(words))
            if length > LONGEST_FUNCTION:
                long[node.name] = length
    assert not long


def documented_attributes(words):
    """Return the names in the section Attributes of a class's docstring."""
    section = re.search(r"Attributes\n-+\n(.*?)(?:\n\n[A-Z]\w+\n-+|\Z)", words, re.DOTALL)
    lines = section[1].splitlines() if section else []
    names = (re.match(r"([\w, ]+?)(?: : .*)?$", line) for line in lines if line[:1].strip())
    return {name.strip() for found in names if found for name in found[1].split(",")}


def test_documented_attributes_exist():
    """As fields, properties, or attributes of `self`."""
    for path in modules():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                inner = list(ast.walk(node))
                there = {one.name for one in inner if isinstance(one, ast.FunctionDef)}
                there |= {one.id for one in inner if isinstance(one, ast.Name)}
                there |= {one.attr for one in inner if isinstance(one, ast.Attribute)}
                missing = documented_attributes(ast.get_docstring(node) or "") - there
                assert not missing, (path, node.name)


def test_nothing_prints_but_commands():
    for path in modules():
        if room(path) in ("cli", "__main__") or path.name == "console.py":
            continue
        calls = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        names = {getattr(node.func, "id", "") for node in calls if isinstance(node, ast.Call)}
        assert "print" not in names, path
