"""What force do rods, a punch and a sphere need, to a closed lumen, held and free?

Presses the paper's tube to 8 mm with each, draws the force against the depth in one figure,
``indentation_presses.png``, and prints a table: ``python benchmarks/indentation_presses.py``. Ten
presses of about a minute each on two cores; each is remembered, so that a second run only draws.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from acoustube.config import Mechanics, load_config
from acoustube.lumen import measure
from acoustube.mechanics import pressed

TOOLS = (("rod", 10), ("rod", 25), ("rod", 35), ("punch", 10), ("sphere", 20))
DEPTHS_MM = np.arange(0.5, 8.01, 0.5)

if __name__ == "__main__":
    sheet = Figure(figsize=(10, 4.5), layout="constrained")
    panels = dict(zip(("held", "free"), sheet.subplots(1, 2, sharey=True), strict=True))
    columns = "force at 4 mm, N | at 6 | at 7 | at 8 | area at 8 mm, mm2 | smallest J | gap mm"
    print(f"| support | tool | {columns} | iterations in increments |")
    print("|" + "---|" * 10)
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
                f"| {press.smallest_volume_ratio.min():.2f} "
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
