"""Forces of rods, a punch and a sphere up to a closed lumen, held and free.

Presses the default tube to 8 mm with each, draws the force against the depth in one figure,
``indentation_presses.png``, and prints a table: ``python benchmarks/indentation_presses.py``. Ten
presses of about a minute each on two cores; each is cached, so that a second run only draws.
The sharpest turn is the largest angle between neighbouring chords from node to node along the sides
of any section of the lumen, at any depth: a smooth fold turns by 180 degrees over some five chords,
a creased one turns back and forth by up to 150 degrees from chord to chord.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from acoustube import Mechanics, load_config, pressed
from acoustube.indentation import Indentation
from acoustube.lumen import measure

TOOLS = (("rod", 10), ("rod", 25), ("rod", 35), ("punch", 10), ("sphere", 20))
DEPTHS_MM = np.arange(0.5, 8.01, 0.5)

FOLD = 0.7
"""Sine of the angle from the bottom beyond which the lumen's wall belongs to a side that folds."""


def sharpest_turn(press: Indentation) -> float:
    """Return the largest angle in degrees between neighbouring chords of the lumen's sides."""
    mesh = press.mesh
    inner = np.unique(mesh.inner_faces)
    station, across = mesh.sweep.station[inner], np.abs(mesh.sweep.across[inner])
    largest = 0.0
    # Half way along an element there are nodes at every other position only.
    for each in np.unique(station)[::2]:
        ring = inner[(station == each) & (across > FOLD)]
        chords = np.diff(press.mesh.points[ring] + press.displacement[:, ring], axis=1)[..., :2]
        along = np.arctan2(chords[..., 1], chords[..., 0])
        largest = max(largest, float(np.abs(np.diff(np.unwrap(along, axis=1), axis=1)).max()))
    return float(np.rad2deg(largest))


if __name__ == "__main__":
    sheet = Figure(figsize=(10, 4.5), layout="constrained")
    panels = dict(zip(("held", "free"), sheet.subplots(1, 2, sharey=True), strict=True))
    forces = "force at 4 mm, N | at 6 | at 7 | at 8 | area at 8 mm, mm2"
    state = "smallest J | sharpest turn, deg | gap mm | iterations in increments"
    print(f"| support | tool | {forces} | {state} |")
    print("|" + "---|" * 11)
    for support, axes in panels.items():
        for shape, diameter in TOOLS:
            config = load_config(
                None, Mechanics, shape=shape, indenter_mm=diameter, depth_mm=8, support=support
            )
            press = pressed(config, list(1e-3 * DEPTHS_MM))
            rows = [int(np.argmin(np.abs(press.depth - 1e-3 * d))) for d in (4, 6, 7, 8)]
            forces = " | ".join(f"{press.contact_force[i]:.3f}" for i in rows)
            area = 1e6 * measure(press, -1, np.zeros(1)).area[0]
            print(
                f"| {support} | {diameter} mm {shape} | {forces} | {area:.2f} "
                f"| {press.smallest_volume_ratio.min():.2f} | {sharpest_turn(press):.0f} "
                f"| {1e3 * press.smallest_gap.min():.3f} "
                f"| {press.iterations.sum()} in {len(press.depth) - 1} |",
                flush=True,
            )
            axes.plot(1e3 * press.depth, press.contact_force, label=f"{diameter} mm {shape}")
            closed = press.closed
            axes.plot(1e3 * press.depth[closed], press.contact_force[closed], "k.", ms=4)
        axes.set(title=f"support {support}", xlabel="depth (mm)", xlim=(0, 8), ylim=(0, None))
        axes.grid(alpha=0.3)
    panels["held"].set_ylabel("force (N)")
    panels["held"].plot([], [], "k.", label="lumen closed")
    panels["held"].legend()
    sheet.savefig("indentation_presses.png", dpi=130)
