"""Run the fuzzer: ``python -m tests.fuzz --seconds 30``; see CONTRIBUTING."""

from __future__ import annotations

import argparse
import hashlib
import os
import secrets
import sys
import tempfile
import time
from itertools import count
from pathlib import Path

from tests.fuzz.harness import BATCH, Finding, run

ROOT = Path(__file__).parents[2]
REPORTED = 2000
"""Cases between two lines of progress."""


def main() -> int:
    """Run cases for a time or a number, print the findings, and return 1 if there are any."""
    given = _given()
    kept = given.keep or Path(tempfile.mkdtemp(prefix="acoustube-fuzz-"))
    kept.mkdir(parents=True, exist_ok=True)
    print(f"seed {given.seed}; what is found is kept in {kept}", flush=True)
    corpus = _corpus()
    os.environ["MPLBACKEND"] = "agg"
    from tests.fuzz import stubs
    from tests.fuzz.categories import CATEGORIES

    stubs.install()
    chosen = given.category or list(CATEGORIES)
    end = time.monotonic() + (given.seconds or float("inf"))
    passed, found = dict.fromkeys(chosen, 0), dict.fromkeys(chosen, 0)
    share = -(-given.count // len(chosen)) if given.count else sys.maxsize
    reported = 0
    batch = min(BATCH, max(int(given.seconds or BATCH), 10))  # so that all categories take part
    for start in count(given.first, batch):
        left = given.first + share - start
        if time.monotonic() > end or left <= 0:
            break
        for name in chosen:
            numbers = list(range(start, start + min(batch, left)))
            for outcome in run(CATEGORIES[name], name, numbers, given.seed, corpus, kept):
                if isinstance(outcome, Finding):
                    found[name] += 1
                    _print(outcome, given.seed)
                else:
                    passed[name] += 1
                if time.monotonic() > end:
                    break
            if time.monotonic() > end:
                break
        if (done := sum(passed.values()) + sum(found.values())) - reported >= REPORTED:
            reported = done
            print(f"{done} cases, {sum(found.values())} found", flush=True)
    for name in chosen:
        print(f"{name:12} {passed[name] + found[name]:7} cases, {found[name]} found")
    total = sum(found.values())
    print(f"{sum(passed.values()) + total} cases with seed {given.seed}, {total} found")
    return 1 if total else 0


def _given() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--seed", type=int, default=secrets.randbits(32), help="drawn if not given")
    parser.add_argument("--category", action="append", help="one or more; all if not given")
    parser.add_argument("--count", type=int, help="cases, of all categories together")
    parser.add_argument("--seconds", type=float, help="time after which no case begins")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--keep", type=Path, help="folder for the cases that fail")
    given = parser.parse_args()
    if not (given.count or given.seconds):
        parser.error("give --count, --seconds or both")
    return given


def _corpus() -> Path:
    """Return the folder of valid files, made by a child process if it does not exist."""
    cache = ROOT / ".pytest_cache" / "d"
    code = hashlib.sha256((Path(__file__).parent / "corpus.py").read_bytes())
    for path in sorted((ROOT / "acoustube").rglob("*.py")):
        code.update(path.read_bytes())
    folder = cache / f"fuzz-{code.hexdigest()[:12]}"
    if not folder.is_dir():
        os.environ.setdefault("ACOUSTUBE_CACHE", str(cache / "acoustube"))
        print("making the good files", flush=True)
        child = os.fork()  # what they load must not be loaded here, before further forks
        if child == 0:
            from tests.fuzz.corpus import build

            build(folder)
            os._exit(0)
        if os.waitpid(child, 0)[1]:
            raise SystemExit("the good files could not be made")
    return folder


def _print(finding: Finding, seed: int) -> None:
    again = f"--seed {seed} --category {finding.category} --first {finding.number} --count 1"
    print(f"\n{finding.category} {finding.number}: {in_short(finding.what)}")
    print(f"  again: python -m tests.fuzz {again}\n  kept: {finding.folder}", flush=True)


def in_short(what: str) -> str:
    """Return a complaint with a short traceback: acoustube's last lines, and the error."""
    lines = what.splitlines()
    frames = [line for line in lines if line.lstrip().startswith("File ") and "acoustube/" in line]
    text = [line for line in lines if line.strip() and not line.startswith("  ")]
    kept = [*text[:1], *frames[-2:], *(text[-2:] if frames else text[1:])]
    return "\n  ".join(line.strip()[:300] for line in kept)


if __name__ == "__main__":
    sys.exit(main())
