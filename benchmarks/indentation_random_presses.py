"""How many presses of random tubes by random indenters reach their depth, and are they right?

Draws the tube (bore 3 to 20 mm, wall 0.5 to 4 mm, hardness 10 to 70 Shore A), the indenter (rod,
punch or sphere, 4 to 60 mm, half of them off the axis, half of the rods turned), the ground and the
depth (up to 95 % of the bore), and presses a mesh of one or two layers of 12 by 10 elements:
``OMP_NUM_THREADS=1 python benchmarks/indentation_random_presses.py FILE``. FILE gets a line of JSON
for each press; a second run computes those that FILE lacks, and prints a summary of all. ``--help``
lists the options. A press depends on its number only, and is ended after two minutes of
processor time.

Each press that reached its depth is checked: at every row the residual, no crossing of the lumen's
walls, a gap and volume ratios above zero; and the work of the force against the change of the
potential energy, which are equal on a fixed ground for any contact. Where the wall snaps from
one shape to another at a constant depth, energy is lost between two rows, and never gained.
Intervals of depth in which work and energy differ are therefore computed again at closer rows: an
error of the cubics through the forces vanishes, while a snap remains in any short interval.
The closer rows are checked as well.
"""

from __future__ import annotations

import argparse
import json
import signal
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy.interpolate import PchipInterpolator

from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.base.units import MM
from acoustube.indentation import Indentation, Indenter, Layer, MeshSize, PressError, indent
from acoustube.indentation.assembly import evaluate
from acoustube.indentation.load_path import FORCE_TOLERANCE
from acoustube.indentation.press import press_model
from acoustube.tube import Tube, shear_modulus_from_shore

DEPTHS = 12
"""Number of depths of each press, so that the work can be integrated."""
STATES = ("reached", "stopped", "refused", "unfinished")
LIMIT = 120
"""Processor time in s after which a press is ended."""
WORK_TOLERANCE = 0.01
"""Largest relative difference of work and energy, by the error of cubics through twelve forces."""
PARTS = 4
"""Number of parts into which an interval is divided if work and energy differ in it."""
NARROWEST = 1 / 300
"""Length of an interval, in bores, below which it is not divided."""
ROUNDS = 4


def drawn(number: int) -> tuple[Tube, Indenter, float, dict[str, Any]]:
    """Return the tube, the indenter, the largest depth in m and the options of a press."""
    rng = np.random.default_rng(number)
    shape = str(rng.choice(["rod", "punch", "sphere"]))
    diameter = float(np.exp(rng.uniform(np.log(4e-3), np.log(60e-3))))
    bore, wall = float(rng.uniform(3e-3, 20e-3)), float(rng.uniform(0.5e-3, 4e-3))
    tube = Tube(
        inner_diameter=bore,
        wall_thickness=wall,
        shear_modulus=shear_modulus_from_shore(float(rng.uniform(10, 70))),
    )
    offset = float(rng.uniform(-0.4, 0.4)) * tube.outer_diameter * (rng.random() < 0.5)
    yaw = float(rng.uniform(-0.8, 0.8)) * (rng.random() < 0.5) * (shape == "rod")
    indenter = Indenter(shape=shape, diameter=diameter, x=offset * (shape != "rod"), yaw=yaw)
    layer = None
    if rng.random() < 0.3:
        thickness, modulus = rng.uniform(2e-3, 20e-3), np.exp(rng.uniform(*np.log([3e4, 1e6])))
        layer = Layer(thickness=float(thickness), modulus=float(modulus))
    support = "free" if layer or rng.random() < 0.5 else "held"
    size = MeshSize(through_wall=int(rng.integers(1, 3)), around=12, along=10)
    depth = float(rng.uniform(0.1, 0.95)) * bore
    return tube, indenter, depth, {"support": support, "layer": layer, "mesh": size}


def wrong(press: Indentation, again: Callable[[Array], Indentation]) -> tuple[list[str], str]:
    """Return what is wrong with a press, and where the wall snaps with the energy lost.

    ``again`` presses anew to given depths.
    """
    narrowest = NARROWEST * press.tube.inner_diameter
    found = unsound(press)
    lost, allowed = losses(press)
    for _ in range(ROUNDS):
        wide = np.diff(press.depth) > narrowest
        if np.abs(lost[wide]).sum() <= allowed:
            break
        divided = wide & (np.abs(lost) > allowed / len(lost))
        steps = np.diff(press.depth)[divided, None] * np.arange(1, PARTS) / PARTS
        between = press.depth[:-1][divided, None] + steps
        press = again(np.unique(np.union1d(press.depth[1:], between).round(12)))
        found += [f"{what} at closer rows" for what in unsound(press)]
        lost, allowed = losses(press)
    wide = np.diff(press.depth) > narrowest
    snapped = ~wide & (lost > allowed / len(lost))
    gained = -np.minimum(lost, 0.0)
    if gained.max() > allowed:
        worst = int(np.argmax(gained))
        found.append(f"gains {gained[worst]:.3g} J before {MM * press.depth[worst + 1]:.4f} mm")
    if abs(lost[~snapped].sum()) > allowed:
        found.append(f"loses {lost[~snapped].sum():.3g} J beside snaps, {allowed:.3g} J allowed")
    at = [f"{MM * press.depth[i + 1]:.3f} mm: {lost[i]:.3g} J" for i in np.flatnonzero(snapped)]
    return found, "; ".join(at)


def unsound(press: Indentation) -> list[str]:
    """Return which of residual, gap and volume ratios are wrong at any row."""
    found = []
    with jax.enable_x64(True):
        lumen = press_model(press).lumen
        crossing = any(lumen.crosses_itself(press.position(row)) for row in range(len(press.depth)))
    allowed = FORCE_TOLERANCE * press.tube.shear_modulus * press.tube.inner_diameter**2
    if press.residual.max() > allowed:
        found.append("residual")
    if crossing or press.smallest_gap.min() <= 0:
        found.append("gap")
    if press.smallest_volume_ratio.min() <= 0:
        found.append("J")
    return found


def losses(press: Indentation) -> tuple[Array, float]:
    """Return the work less the gain of energy between rows in J, and the largest sum allowed."""
    with jax.enable_x64(True):
        model = press_model(press)
        energy = [
            model.mesh.copies * evaluate(model, press.displacement[row], press.bodies(row)).energy
            for row in range(len(press.depth))
        ]
    work_to = PchipInterpolator(press.depth, press.contact_force).antiderivative()
    lost = np.diff(work_to(press.depth)) - np.diff(energy)
    return lost, WORK_TOLERANCE * (max(energy) - energy[0])


def pressed(number: int) -> dict[str, Any]:
    """Return the record of a press."""
    tube, indenter, depth, options = drawn(number)
    start = time.process_time()
    record: dict[str, Any] = {
        "number": number, "shape": indenter.shape, "diameter_mm": MM * indenter.diameter,
        "x_mm": MM * indenter.x, "yaw": indenter.yaw, "bore_mm": MM * tube.inner_diameter,
        "wall_mm": MM * tube.wall_thickness, "depth_mm": MM * depth,
        "support": options["support"], "layer": options["layer"] is not None,
        "layers": options["mesh"].through_wall,
    }  # fmt: skip
    done: list[float] = [0.0]
    depths = depth * np.arange(1, DEPTHS + 1) / DEPTHS
    signal.setitimer(signal.ITIMER_PROF, LIMIT)
    try:
        press = indent(tube, indenter, depth=depths, progress=done.append, **options)
        signal.setitimer(signal.ITIMER_PROF, 0)
        record |= {"state": "reached", "force_N": float(press.contact_force[-1])}
        record |= {"closed": bool(press.closed[-1]), "rows": len(press.depth)}
        record["iterations"] = int(press.iterations.sum())
        record |= _examined(press, partial(indent, tube, indenter, **options))
    except ConfigError as error:
        record |= {"state": "refused", "reason": str(error)}
    except PressError as error:
        last = MM * float(error.indentation.depth[-1])
        record |= {"state": "stopped", "reason": str(error), "stopped_mm": last}
    except TimeoutError:
        record |= {"state": "unfinished", "part_done": done[-1]}
    signal.setitimer(signal.ITIMER_PROF, 0)
    return record | {"seconds": round(time.process_time() - start, 2)}


def _examined(press: Indentation, again: Callable[..., Indentation]) -> dict[str, Any]:
    """Return what is wrong with a press that has reached its depth, and where it snaps."""
    signal.setitimer(signal.ITIMER_PROF, LIMIT)
    try:
        found, snap = wrong(press, lambda depths: again(depth=depths))
    except (PressError, TimeoutError) as error:  # although the press itself succeeded
        reason = str(error) or f"not within {LIMIT} s"
        return {"wrong": [f"not examined at closer rows: {reason}"], "snap": ""}
    return {"wrong": found, "snap": snap}


def _give_up(*_: object) -> None:
    raise TimeoutError


def summary(records: list[dict[str, Any]]) -> str:
    """Return a summary of all presses, and a line for each that is wrong."""
    states = [record["state"] for record in records]
    lines = [f"{states.count(state)} {state}" for state in STATES]
    lines.append(f"{sum(bool(record.get('wrong')) for record in records)} wrong")
    lines.append(f"{sum(record['seconds'] for record in records):.0f} s of processor time")
    rest = [
        each for each in records if each["state"] != "reached" or each["wrong"] or each.get("snap")
    ]
    return "\n".join([", ".join(lines), *(json.dumps(each) for each in rest)])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("file", type=Path, help="gets a line of JSON for each press")
    parser.add_argument("--first", type=int, default=0, help="number of the first press")
    parser.add_argument("--last", type=int, default=199, help="number of the last press")
    asked = parser.parse_args()
    old = asked.file.read_text().splitlines() if asked.file.exists() else []
    known = [json.loads(line) for line in old]
    signal.signal(signal.SIGPROF, _give_up)
    missing = set(range(asked.first, asked.last + 1)) - {each["number"] for each in known}
    for number in sorted(missing):
        known.append(pressed(number))
        with asked.file.open("a") as file:
            file.write(json.dumps(known[-1]) + "\n")
    print(summary(known))
