"""Cache of results, in files named by the hash of all that a result depends on.

An entry is a NumPy archive with the SHA-256 of its own content. An entry that cannot be read, or
whose content has changed, counts as missing and is replaced. Next to the entries JAX keeps the
machine code that it compiled.
"""

from __future__ import annotations

import ast
import hashlib
import io
import json
import os
import re
import tempfile
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from platformdirs import user_cache_path

import acoustube
from acoustube.base.errors import ConfigError

if TYPE_CHECKING:  # the command line lists and clears without NumPy
    from numpy.typing import NDArray

    Arrays = Mapping[str, NDArray[Any]]

DIGEST = "digest"
NAME, PREFIX = re.compile("[0-9a-f]{32}"), "acoustube-"
LIBRARIES = ("ipctk", "pytetwild")
"""Packages whose versions are part of the key of a result, besides a hash of acoustube's code."""
CODE = {
    "press": ("acoustube.runs.presses", "acoustube.indentation"),
    "scattering": ("acoustube.runs.sound", "acoustube.runs.surface_scattering", "acoustube.lumen"),
}
"""Modules that compute each kind of result; its key includes a hash of them and their imports."""
NOT_FOLLOWED = tuple(
    f"acoustube.{name}."
    for name in (
        *(f"base.{part}" for part in (
            "cache", "checks", "errors", "files", "foreign", "interrupts", "moved", "names",
            "netcdf", "remnants", "report", "rules", "version", "writing")),
        "runs.config", "runs.results", "runs.scattering_file", "signals", "waves.bends",
        "waves.bent_parts", "waves.network",
    )
)  # fmt: skip
"""Prefixes of modules whose code is not hashed into the key of a cached result. They prepare
settings, which the key contains in SI units, read and write files, report, or process results."""
SOURCES = "sources.json"
"""File of the cache with the digest of each module, so that computing a key takes milliseconds."""
COMPILED = "compiled-"
"""Start of the names of folders in which JAX keeps machine code."""
MOST_COMPILED = 4000
"""Largest number of files of machine code for a kind of processor; each new mesh adds some, of 7 kB
on average."""
UNUSABLE = (
    "Error reading persistent compilation cache entry",
    "Error writing persistent compilation cache entry",
)
"""Warnings of JAX about a file that another process has half written, or about a disk that is full
or cannot be written. JAX then compiles as without a cache."""


class Entry(NamedTuple):
    """A result in the cache.

    Attributes
    ----------
    path : Path
    size : int
        In bytes.
    modified : float
        Time of writing, in seconds since 1970.
    """

    path: Path
    size: int
    modified: float

    @property
    def label(self) -> str:
        """Description of the result, from the file; empty where it cannot be read."""
        try:
            with zipfile.ZipFile(self.path) as archive:
                return archive.comment.decode(errors="replace")
        except (OSError, zipfile.BadZipFile):
            return ""


def folder() -> Path:
    """Return the folder of the cache: ``$ACOUSTUBE_CACHE``, or the user's cache folder.

    Raises
    ------
    ConfigError
        If the path is that of a file, or in the home folder of an unknown user.
    """
    chosen = os.environ.get("ACOUSTUBE_CACHE") or str(user_cache_path("acoustube"))
    found = Path(os.path.expanduser(chosen))  # noqa: PTH111  Path raises RuntimeError
    if str(found).startswith("~"):
        raise ConfigError(f"ACOUSTUBE_CACHE = {found} is in no known home folder; name a folder")
    if os.path.isfile(found):  # noqa: PTH113  False where it cannot be looked up
        raise ConfigError(f"ACOUSTUBE_CACHE = {found} is a file; name a folder")
    return found


def key(kind: str, dependencies: Mapping[str, Any]) -> str:
    """Return the key of a result: a hash of all that it depends on.

    Parameters
    ----------
    kind : {"press", "scattering"}
        Kind of result.
    dependencies : mapping
        Everything that the result depends on, as values of JSON, but for the source code that
        computes it, which is added here.

    Returns
    -------
    str
        32 hexadecimal digits.
    """
    text = json.dumps(dict(dependencies) | {"code": _code(kind)}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


@cache
def _code(kind: str) -> str:
    """Return the hash of the code that computes a kind of result, and the libraries' versions."""
    # Slow to import, and the command line's help needs neither.
    from importlib.metadata import version

    found = code_digest(Path(acoustube.__file__).parents[1], CODE[kind])
    return " ".join([found, *(version(library) for library in LIBRARIES)])


def code_digest(root: Path, entries: Sequence[str]) -> str:
    """Return the hash of modules and of all that they import from their own package.

    Docstrings, comments and line breaks do not count. No module is imported.

    Parameters
    ----------
    root : Path
        Folder that holds the package.
    entries : sequence of str
        Full names of modules.

    Raises
    ------
    ModuleNotFoundError
        If there is no file of one of ``entries``.
    """
    known = _known_sources()
    parsed: dict[str, list[Any]] = {}
    found: dict[str, str] = {}
    waiting = list(entries)
    while waiting:
        name = waiting.pop()
        path = _module_file(root, name)
        if path is None and name in entries:
            raise ModuleNotFoundError(f"{name} is not in {root}")
        if path is None or name in found:
            continue
        status = path.stat()
        stamp = [status.st_mtime_ns, status.st_size]
        source = known.get(str(path))
        if source is None or source[:2] != stamp:
            tree = ast.parse(path.read_bytes())
            imports = sorted(set(_imports(tree, name.partition(".")[0])))
            source = parsed[str(path)] = [*stamp, _tree_digest(tree), imports]
        found[name] = source[2]
        waiting += [name for name in source[3] if not f"{name}.".startswith(NOT_FOLLOWED)]
    if parsed:
        _write_in_one_step(SOURCES, json.dumps(known | parsed).encode())
    return hashlib.sha256(json.dumps(sorted(found.items())).encode()).hexdigest()


def _known_sources() -> dict[str, list[Any]]:
    """Return recorded time of change in ns, size in bytes, digest, imports of modules, by path."""
    try:
        known = json.loads((folder() / SOURCES).read_bytes())
        return {path: source for path, source in known.items() if len(source) == 4}
    except (OSError, ValueError, TypeError, AttributeError):  # missing, damaged, or not ours
        return {}


def _module_file(root: Path, name: str) -> Path | None:
    """Return the file of a module or package; None if the name is that of something else."""
    path = root.joinpath(*name.split("."))
    candidates = path / "__init__.py", path.with_suffix(".py")
    return next((file for file in candidates if file.is_file()), None)


def _imports(tree: ast.AST, package: str) -> Iterator[str]:
    """Yield the full names that a module imports from a package, type-checking imports excluded.

    ``from a.b import c`` yields both a.b and a.b.c, since c may be a module.
    """
    if isinstance(tree, ast.If) and ast.unparse(tree.test).endswith("TYPE_CHECKING"):
        return
    names: list[str] = []
    if isinstance(tree, ast.Import):
        names = [alias.name for alias in tree.names]
    elif isinstance(tree, ast.ImportFrom) and tree.module:
        names = [tree.module, *(f"{tree.module}.{alias.name}" for alias in tree.names)]
    # The package's own __init__ computes nothing.
    yield from (name for name in names if name.startswith(f"{package}."))
    for part in ast.iter_child_nodes(tree):
        yield from _imports(part, package)


def _tree_digest(tree: ast.AST) -> str:
    """Return the hash of a module's syntax tree, from which docstrings are removed."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [part for part in node.body if not _is_text(part)]
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest()


def _is_text(node: ast.stmt) -> bool:
    """Return whether a statement is only a text: a docstring, or the text below a constant."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def holds(name: str) -> bool:
    """Return whether there is an entry for a key (:func:`key`); it may be damaged."""
    return os.path.isfile(folder() / f"{name}.npz")  # noqa: PTH113


def recall(name: str) -> dict[str, NDArray[Any]] | None:
    """Return the arrays, by name, of the entry for a key; None if it is missing or damaged."""
    import numpy as np

    try:
        with (folder() / f"{name}.npz").open("rb") as file, np.load(file) as archive:
            arrays = {array: archive[array] for array in archive.files}
    except Exception:  # a damaged archive fails in many ways, and all mean the same
        return None
    digest = arrays.pop(DIGEST, None)
    if digest is None or str(digest) != _digest(arrays):
        return None
    _KEPT.add(True)
    return arrays


def store(name: str, arrays: Arrays, label: str = "") -> None:
    """Write an entry atomically; where that is impossible, nothing is cached.

    Parameters
    ----------
    name : str
        From :func:`key`.
    arrays : mapping of str to array
    label : str
        Description, which :attr:`Entry.label` returns.
    """
    import numpy as np

    content = io.BytesIO()
    named: dict[str, Any] = {**arrays, DIGEST: np.array(_digest(arrays))}
    np.savez_compressed(content, **named)
    with zipfile.ZipFile(content, "a") as archive:
        archive.comment = label.encode()
    _KEPT.add(_write_in_one_step(f"{name}.npz", content.getvalue()))


_KEPT: set[bool] = set()
"""Contains True once a result was written to or read from the cache, False once one could not be
written."""


def has_kept() -> bool | None:
    """Return whether every result that this process tried to cache was written to the cache.

    None if the process has neither tried to write a result nor read one from the cache.
    """
    return None if not _KEPT else False not in _KEPT


def _write_in_one_step(name: str, content: bytes) -> bool:
    """Write a file of the cache atomically; return whether the folder could be written."""
    try:
        folder().mkdir(parents=True, exist_ok=True)
        part: dict[str, Any] = {"dir": folder(), "prefix": PREFIX, "suffix": ".part"}
        with tempfile.NamedTemporaryFile(**part, delete=False) as file:
            try:
                file.write(content)
                file.close()
                Path(file.name).replace(folder() / name)
            except BaseException:
                file.close()
                Path(file.name).unlink(missing_ok=True)
                raise
    except OSError:
        return False
    return True


def _digest(arrays: Arrays) -> str:
    import numpy as np

    content = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        content.update(f"{name} {array.dtype.str} {array.shape}".encode())
        content.update(array.tobytes())
    return content.hexdigest()


def entries() -> list[Entry]:
    """Return all entries, the newest first."""
    return _listed(path for path in folder().glob("*.npz") if NAME.fullmatch(path.stem))


def _listed(paths: Iterable[Path]) -> list[Entry]:
    """Return files as entries, the newest first."""
    found = []
    for path in paths:
        with suppress(FileNotFoundError):  # another process has removed it
            status = path.stat()
            found.append(Entry(path, status.st_size, status.st_mtime))
    return sorted(found, key=lambda entry: -entry.modified)


def clear() -> list[Entry]:
    """Remove all entries, compiled code, module digests and files of interrupted writes.

    Other files in the folder are kept.

    Returns
    -------
    list of Entry
        The removed results, without the compiled code.
    """
    gone = entries()
    paths = [entry.path for entry in [*gone, *compiled()]]
    for path in [*paths, *folder().glob(f"{PREFIX}*.part"), folder() / SOURCES]:
        path.unlink(missing_ok=True)
    for emptied in folder().glob(f"{COMPILED}*"):
        with suppress(OSError):  # it holds a foreign file
            emptied.rmdir()
    return gone


def compiled() -> list[Entry]:
    """Return the files of machine code that JAX compiled, of all machines, the newest first."""
    return _listed(folder().glob(f"{COMPILED}*/*-cache"))


def keep_compiled_code() -> None:
    """Let JAX keep in the cache what it compiles, in this process and those that it starts.

    This must be called before JAX is imported. It does nothing if ``$JAX_COMPILATION_CACHE_DIR`` is
    set. Each kind of processor has its own folder, since JAX would also load code compiled for
    another processor, and log a line each time. In this folder only the newest `MOST_COMPILED`
    files are kept.
    """
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    try:
        kept = folder() / f"{COMPILED}{_processor()}"
    except ConfigError:  # the command that needs the cache says so
        return
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(kept)
    # Hundreds of small functions take longer to compile together than the few large ones.
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")
    for message in UNUSABLE:
        warnings.filterwarnings("ignore", re.escape(message), UserWarning)
    said = os.environ.get("PYTHONWARNINGS", "")
    os.environ["PYTHONWARNINGS"] = ",".join([*filter(None, [said]), *_IGNORED])
    with suppress(OSError):
        for entry in _listed(kept.glob("*-cache"))[MOST_COMPILED:]:
            entry.path.unlink(missing_ok=True)


_IGNORED = tuple(f"ignore:{message}:UserWarning" for message in UNUSABLE)


def _processor() -> str:
    """Return a hash of the processor's model and features, which compiled code depends on."""
    kind = os.uname().machine
    with suppress(OSError):  # the file exists on Linux only
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        fields = [line for line in lines if line.startswith(("model name", "flags", "Features"))]
        kind += " ".join(sorted(set(fields)))
    return hashlib.sha256(kind.encode()).hexdigest()[:12]
