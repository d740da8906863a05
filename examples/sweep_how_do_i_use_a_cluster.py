"""
How do I use a cluster?
=======================

A sweep takes any executor for its workers, for example that of Dask. Here the cluster consists of
two threads of this process. For a real cluster only the address differs, as with
``acoustube sweep --dask ADDRESS``. Dask is installed by ``pip install '.[dask]'``.
"""

# %%
# A plan of 24 cases
# ------------------
# The cases are of two depths and twelve positions. They share one load path through both depths,
# and two scattering matrices. The carrier of 20 kHz and the coarse grid save time.
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from distributed import Client, get_task_stream

from acoustube import load_plan, open_dataset, run_sweep

plan = load_plan(
    None,
    {
        "depth_mm": ["2", "4"], "position_cm": ["30:140:10"], "indenter_mm": ["10"],
        "frequency_khz": ["20"], "length_cm": ["200"], "mesh": ["coarse"], "resolution": ["8"],
    },
)  # fmt: skip

# %%
# On the cluster
# --------------
# The task stream records which worker ran each task, and when.
cluster = {"processes": False, "n_workers": 1, "threads_per_worker": 2, "dashboard_address": None}
with (
    tempfile.TemporaryDirectory() as folder,
    Client(**cluster, set_as_default=False) as client,
    get_task_stream(client) as stream,
):
    complete = run_sweep(plan, Path(folder) / "sweep", executor=client.get_executor(), width=4)
    cases = open_dataset(Path(folder) / "sweep").load()
failed = len(plan) - cases.sizes["press"]
print(f"{cases.sizes['press']} cases in {len(stream.data)} tasks, {failed} failed")

# %%
# The tasks over time, and their result
# -------------------------------------
# The press is computed first, then both matrices in parallel, then the recordings. In a second run
# press and matrices are taken from the cache, and their bars are short. The right panel shows that
# losses in the tube attenuate the echo by 19 dB per metre of distance.
colours = {"press": "C0", "scattering": "C1", "simulate_cases": "C2"}
threads = sorted({task["thread"] for task in stream.data})
began = min(task["startstops"][0]["start"] for task in stream.data)
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
for task in stream.data:
    kind, span = task["key"].split("-")[0], task["startstops"][0]
    left.barh(
        threads.index(task["thread"]), span["stop"] - span["start"], left=span["start"] - began,
        height=0.6, color=colours[kind], edgecolor="white",
    )  # fmt: skip
left.set(xlabel="time (s)", ylabel="thread", yticks=range(len(threads)), ylim=(-0.5, 2))
patches = [plt.Rectangle((0, 0), 1, 1, color=colour) for colour in colours.values()]
left.legend(patches, colours, loc="upper center", ncols=3)
level = 20 * np.log10(cases["echo_amplitude"].sel(source_end="absorbing"))
for depth in np.unique(cases["depth"]):
    some = np.isclose(cases["depth"], depth)
    right.plot(
        100 * cases["true_distance"][some], level[some], "o-", label=f"{1e3 * depth:g} mm deep"
    )
right.set(xlabel="place of the press (cm)", ylabel="highest echo (dB of the send pulse)")
right.legend()
plt.show()
