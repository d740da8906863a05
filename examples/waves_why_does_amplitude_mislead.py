"""
Why does amplitude mislead?
===========================

The harder the press, the narrower is the lumen, so one expects a higher echo. At 42 kHz the echo
does not grow steadily with depth, since most of the reflected power is in higher modes. At lower
carriers only the plane wave propagates, and the echo grows with depth.
"""

# %%
# Four depths, three carriers
# ---------------------------
# A 10 mm rod presses the middle of a tube of 1 m, with losses, on eleven grid cells across the
# bore. The four scattering matrices serve all carriers. The sweep's workers are threads here.
# Without ``executor`` they are processes, and a script must then start the sweep under
# ``if __name__ == "__main__":``.
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import acoustube
from acoustube import load_plan, run_sweep
from acoustube.reports.studies.presses import matrices

plan = load_plan(
    None,
    {
        "indenter_mm": ["10"], "depth_mm": ["3:6:1"], "frequency_khz": ["10", "20", "42"],
        "position_cm": ["50"], "length_cm": ["100"], "losses": ["on"], "prominence": ["0.001"],
        "mesh": ["coarse"], "resolution": ["11"],
    },
)  # fmt: skip
with tempfile.TemporaryDirectory() as folder:
    run_sweep(plan, Path(folder) / "sweep", executor=ThreadPoolExecutor(2))
    cases = acoustube.open_dataset(Path(folder) / "sweep").load()
    scattering = {float(some["depth"][0]): s for some, s in matrices(Path(folder) / "sweep")}

# %%
# The highest echo
# ----------------
# At 10 and at 20 kHz the echo rises with every step of depth. At 42 kHz it falls and rises again.
absorbing = cases.sel(source_end="absorbing")
heights = {}
for khz in (10, 20, 42):
    some = absorbing.isel(press=np.isclose(absorbing["carrier_frequency"], 1e3 * khz))
    some = some.sortby("depth")
    depth_mm, heights[khz] = 1e3 * some["depth"].values, 100 * some["echo_amplitude"].values
    print(f"{khz} kHz: {', '.join(f'{height:.2f}' for height in heights[khz])} % of the pulse")

# %%
# Where the power goes
# --------------------
# The right panel shows the power that a press of 4 mm reflects of an incident plane wave, by mode.
# Above 25.4 kHz mode (1,1) propagates too, with ten times the power or more. A piston is not
# sensitive to that mode. The plane wave's part falls as the wavelength approaches the length of the
# press, since the reflections of its two flanks cancel. For this short rod that happens above
# 20 kHz. For rods of 25 and 35 mm it happens at 20 kHz, so that only 10 kHz remains.
matrix = scattering[4e-3]
plane = matrix.modes.index("00")
reflected = np.abs(matrix.s[:, 0, :, 0, plane]) ** 2

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for khz, height in heights.items():
    left.plot(depth_mm, height / height[0], "o-", label=f"{khz} kHz")
left.set(
    xlabel="depth (mm)", ylabel=f"highest echo, over that at {depth_mm[0]:g} mm", xticks=depth_mm,
    ylim=(0, None),
)  # fmt: skip
left.legend()
for mode, label in (("00", "plane wave"), ("11c", "(1,1)")):
    share = reflected[:, matrix.modes.index(mode)]
    right.plot(1e-3 * matrix.frequency, 100 * np.where(share > 0, share, np.nan), label=label)
for khz in heights:
    right.axvline(khz, color="0.7", ls=":")
right.set(
    xlabel="frequency (kHz)", ylabel="reflected power at 4 mm (%)", yscale="log",
    ylim=(1e-4, 10), xlim=(5, 50),
)  # fmt: skip
right.legend()
plt.show()
