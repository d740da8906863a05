"""Processor time of a press: to one depth, to many, with each indenter, on each ground.

Processor time in s on one thread, without compilation, and the force at the last depth:
``OMP_NUM_THREADS=1 XLA_FLAGS=--xla_cpu_multi_thread_eigen=false python
benchmarks/indentation_press_times.py [NAME ...]``, some ten minutes for all. Run at another commit,
it compares the two.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np

from acoustube.indentation import Indenter, Layer, MeshSize, indent
from acoustube.tube import Tube

ROD = Indenter(diameter=25e-3)
MIDDLE = MeshSize(through_wall=2, around=12, along=10)
SMALL = MeshSize(through_wall=2, around=10, along=8)
TWO = (
    Indenter(diameter=10e-3, z=-20e-3),
    Indenter(shape="sphere", diameter=10e-3, z=20e-3, depth_fraction=0.7),
)
FREE: dict[str, Any] = {"support": "free"}
CASES: dict[str, tuple[Any, Any, dict[str, Any]]] = {
    "4 mm": (ROD, [4], FREE),
    "8 mm": (ROD, [8], FREE),
    "16 depths": (ROD, np.arange(1, 17) / 2, FREE),
    "60 depths": (ROD, np.arange(1, 61) * 8 / 60, FREE),
    **{
        f"{shape} {diameter} mm {support}": (
            Indenter(shape=shape, diameter=1e-3 * diameter),
            [2, 4, 6, 7, 8],
            {"support": support},
        )
        for support in ("held", "free")
        for shape, diameter in (("rod", 10), ("rod", 35), ("punch", 10), ("sphere", 20))
    },
    "yaw": (Indenter(diameter=25e-3, yaw=0.35), [2, 4, 6], {"mesh": MIDDLE}),
    "offset sphere": (
        Indenter(shape="sphere", diameter=10e-3, x=2e-3), [2, 4, 6], {"mesh": MIDDLE},
    ),
    "layer": (
        ROD, [2, 4, 8], {"layer": Layer(thickness=10e-3, modulus=1e5), "mesh": MIDDLE, **FREE},
    ),
    "two indenters": (TWO, [2, 4, 6], {"mesh": MIDDLE}),
    "whole tube": (ROD, [2, 4, 7], {"whole": True, "mesh": SMALL}),
}  # fmt: skip


if __name__ == "__main__":
    print("| case | processor time s | force N | iterations | rows |\n" + "|---" * 5 + "|")
    for name in sys.argv[1:] or CASES:
        indenter, depths, options = CASES[name]
        indent(Tube(), indenter, depth=2e-5, **options)
        start = time.process_time()
        found = indent(Tube(), indenter, depth=1e-3 * np.asarray(depths), **options)
        seconds = time.process_time() - start
        print(
            f"| {name} | {seconds:.1f} | {found.contact_force[-1]:.4f} "
            f"| {found.iterations.sum()} | {len(found.depth) - 1} |",
            flush=True,
        )
