"""Odd values, and mutations of bytes, texts, trees and arrays, all random by `random`."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping
from random import Random
from typing import Any

import numpy as np

NUMBERS = (
    0, 1, -1, 2, 0.0, -0.0, 0.5, 1e-320, 1e-30, 1e-9, 1e6, 1e12, 1e30, 1e308, -1e308, 2**31, 2**63,
    -(2**63) - 1, 10**400, float("nan"), float("inf"), -float("inf"), True, False,
)  # fmt: skip
TEXTS = (
    "", " ", "nan", "inf", "-1", "1e999999999", "0:1e999999999:1", "1,2", "../x", "/dev/zero", "~",
    "[red]", "[/", "<b>&amp;</b>", "{}", "%s%n", "\0", "\n", "é", "😀", "\udce9", "\u202e", "$HOME",
    "a" * 300, "9" * 5000, "-", "--", "--out", "*", "a\tb", "None", "true", "1_0", "0x10", "١٢",
)  # fmt: skip
BREAKING = (
    b"", b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\x89HDF\r\n\x1a\n", b"PK\x03\x04", b"RIFF", b"nan",
    b"1e999", b"-", b"[" * 20_000, b"{" * 300, b'"', b"\n" * 50, b",", b"\xff" * 8,
    b"\x7f\xff\xff\xff",
)  # fmt: skip


def odd_number(chance: Random) -> Any:
    """Return an odd number, or one near a power of ten."""
    if chance.random() < 0.3:
        return chance.choice((-1, 1)) * chance.uniform(1, 10) * 10.0 ** chance.randint(-12, 12)
    return chance.choice(NUMBERS)


def odd_text(chance: Random) -> str:
    """Return an odd word."""
    return chance.choice(TEXTS) if chance.random() < 0.8 else "x" * chance.choice((999, 100_000))


def odd_value(chance: Random) -> Any:
    """Return an unexpected number, text, list or mapping."""
    kind = chance.random()
    if kind < 0.5:
        return odd_number(chance)
    if kind < 0.7:
        return odd_text(chance)
    if kind < 0.9:
        return [odd_number(chance) for _ in range(chance.choice((0, 1, 2, 5, 1000)))]
    if kind < 0.95:
        return {odd_text(chance)[:50]: odd_number(chance)}
    nested: Any = odd_number(chance)
    for _ in range(chance.choice((2, 10, 90))):
        nested = [nested] if chance.random() < 0.5 else {"a": nested}
    return nested


def mutated_bytes(chance: Random, content: bytes, other: bytes = b"") -> bytes:
    """Return bytes with some of them altered, lost, doubled, or taken from another file."""
    data = bytearray(content)
    for _ in range(chance.choice((1, 1, 1, 2, 4, 16))):
        at = chance.randrange(len(data) + 1)
        if chance.random() < 0.4:  # most formats begin with their header
            at = min(at, chance.randrange(600))
        kind = chance.randrange(9)
        if kind == 0 and data:
            data[at % len(data)] ^= 1 << chance.randrange(8)
        elif kind == 1:
            data[at : at + 1] = chance.randbytes(1)
        elif kind == 2:
            width, code = chance.choice(((1, "<B"), (2, "<H"), (4, "<I"), (8, "<Q")))
            value = chance.choice((0, 1, 255, 2**15, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**64 - 1))
            data[at : at + width] = struct.pack(code, value % 256**width)
        elif kind == 3:
            del data[at : at + chance.choice((1, 4, 100, 10_000))]
        elif kind == 4:
            data[at:at] = chance.choice(BREAKING)
        elif kind == 5:
            piece = data[at : at + chance.choice((4, 64, 4096))]
            data[at:at] = piece * chance.choice((1, 2, 50))
        elif kind == 6:
            del data[at:]
        elif kind == 7 and other:
            start = chance.randrange(len(other))
            data[at : at + 500] = other[start : start + 500]
        else:
            data[at : at + 16] = chance.randbytes(16)
    return bytes(data)


def mutated_tree(chance: Random, tree: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested mappings with some keys or values changed, lost, added or moved."""
    found = {
        key: mutated_tree(chance, value) if isinstance(value, Mapping) else value
        for key, value in tree.items()
    }
    for _ in range(chance.choice((0, 1, 1, 2))):
        key = chance.choice([*found, "unknown"])
        kind = chance.randrange(6)
        if kind <= 2:
            found[key] = odd_value(chance)
        elif kind == 3:
            found.pop(key, None)
        elif kind == 4:
            found[odd_text(chance)[:200]] = found.pop(key, 1)
        else:
            found[key] = {key: found.get(key)}
    return found


def as_toml(value: Any, *, inline: bool = False) -> str:
    """Return a tree as TOML, or nearly so: values without a TOML form are written too."""
    if isinstance(value, Mapping) and not inline:
        plain = {k: v for k, v in value.items() if not isinstance(v, Mapping)}
        lines = [f"{_key(k)} = {as_toml(v, inline=True)}" for k, v in plain.items()]
        for name, part in value.items():
            if isinstance(part, Mapping):
                flat = {k: v for k, v in part.items() if not isinstance(v, Mapping)}
                deep = {k: v for k, v in part.items() if isinstance(v, Mapping)}
                lines.append(f"\n[{_key(name)}]")
                lines += [
                    f"{_key(k)} = {as_toml(v, inline=True)}" for k, v in (flat | deep).items()
                ]
        return "\n".join(lines) + "\n"
    if isinstance(value, Mapping):
        return (
            "{"
            + ", ".join(f"{_key(k)} = {as_toml(v, inline=True)}" for k, v in value.items())
            + "}"
        )
    if isinstance(value, list | tuple):
        return "[" + ", ".join(as_toml(v, inline=True) for v in value) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return _digits(value)
    return json.dumps(str(value))


def _digits(value: float) -> str:
    """Return the digits of a number of any size."""
    try:
        return repr(value)
    except ValueError:  # more digits than Python can print
        return "1" + "0" * 5000


def _key(name: object) -> str:
    text = str(name)
    return text if text.replace("_", "").isalnum() and text.isascii() else json.dumps(text)


def as_json(value: Any) -> str:
    """Return a tree as JSON, with nan and inf as Python writes them."""
    return json.dumps(value, default=str)


def mutated_array(chance: Random, values: Any) -> Any:
    """Return an array with another type, shape or content."""
    array = np.atleast_1d(np.array(values))
    kind = chance.randrange(10)
    if kind == 0:
        types = ("c16", "f2", "u1", "i8", "U8", "S4", "?", "M8[s]", "m8[ms]", ">f8", "V8")
        with np.errstate(all="ignore"):
            try:
                return array.astype(chance.choice(types))
            except (TypeError, ValueError):
                return array.astype(str)
    if kind == 1:
        return array.ravel()[:1].reshape(chance.choice(((), (1,), (1, 1), (1, 1, 1, 1))))
    if kind == 2:
        return array[..., :0]
    if kind == 3:
        return array.T
    if kind == 4:
        return array[np.newaxis]
    if kind == 5:
        return np.full(array.shape, np.nan)
    if kind == 6:
        return np.array(odd_value(chance), dtype=object if chance.random() < 0.2 else None)
    array = array.astype(float) if array.dtype.kind in "iufb" else array
    if array.size and array.dtype.kind == "f":
        number = odd_number(chance)
        with np.errstate(all="ignore"):
            if kind == 7:
                array.flat[chance.randrange(array.size)] = min(number, 1e308)
            elif kind == 8:
                array = array * min(number, 1e308)
            else:
                array = array[..., :: chance.choice((-1, 2, 7))]
    return array


def mutated_arrays(chance: Random, arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return named arrays with some changed, renamed, lost or added."""
    found = dict(arrays)
    for _ in range(chance.choice((1, 1, 2, 3))):
        name = chance.choice([*found, "note"])
        kind = chance.randrange(6)
        if kind <= 2 and name in found:
            found[name] = _safely(lambda value=found[name]: mutated_array(chance, value))
        elif kind == 3:
            found.pop(name, None)
        elif kind == 4:
            others = ("note", "time", "signal", "warnings", "depth_mm", "cycle", "Force (N)", "x/y")
            found[chance.choice((*others, odd_text(chance)[:3000]))] = found.pop(name, np.ones(3))
        else:
            found[chance.choice(("note", "time", "rate", "temperature", "label"))] = _safely(
                lambda: np.array(odd_value(chance))
            )
    return found


def _safely(make: Callable[[], Any]) -> Any:
    """Return the result of a function, or zeros where NumPy raises an error."""
    try:
        return make()
    except (ValueError, TypeError, OverflowError):
        return np.zeros(3)
