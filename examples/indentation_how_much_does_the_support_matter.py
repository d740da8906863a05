"""
How much does the support matter?
=================================

A tube that lies free on the floor lifts off it on both sides of the press. A tube whose bottom line
is fixed to the floor does not. The section under the rod hardly depends on the support; the force
does.
"""

# %%
# Press the sleeve paper's tube both ways
# ---------------------------------------
# The mesh is coarser than usual, which does not affect the comparison.
import matplotlib.pyplot as plt
import numpy as np

from acoustube.indentation import Indenter, MeshSize, indent
from acoustube.lumen import measure
from acoustube.tube import Tube

DEPTH = 2e-3
coarse = MeshSize(through_wall=1, around=12, along=10)
presses = {
    support: indent(Tube(), Indenter(diameter=25e-3), depth=DEPTH, support=support, mesh=coarse)
    for support in ("held", "free")
}

# %%
# Compare force and area
# ----------------------
force = {support: press.contact_force[-1] for support, press in presses.items()}
area = {support: measure(press, -1, np.zeros(1)).area[0] for support, press in presses.items()}
stiffening = force["held"] / force["free"] - 1
print(
    f"held against free at {1e3 * DEPTH:g} mm: force {100 * stiffening:+.1f} %, "
    f"area {1e6 * (area['held'] - area['free']):+.3f} mm2"
)

# %%
# Force against depth
# -------------------
figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
for support, press in presses.items():
    axes.plot(1e3 * press.depth, press.contact_force, "o-", ms=3, label=support)
axes.set(xlabel="depth (mm)", ylabel="force (N)")
axes.legend(title="support")
plt.show()
