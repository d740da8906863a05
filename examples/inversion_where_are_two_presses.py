"""
Where are two presses?
======================

The highest echo locates one press at best, and its distance is too large. The whole waveform
contains both presses. Here a forward model, built on a library of the scattering of presses over
depth, is fitted to the cycles. The fit estimates the number of contacts, and the position, depth
and force of each with their uncertainty.
"""

# %%
# A library
# ---------
# A library is computed once for each tube. This one contains the scattering of a 25 mm rod at
# depths from 1 to 5 mm. Its mesh is coarse and its accuracy low, so that it takes seconds. At a
# terminal, ``acoustube library --indenter 25 --depth 0.5:8:0.25 --out lib`` computes one for
# lasting use.
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import acoustube
from acoustube.air import air_at
from acoustube.inversion import ForwardModel, Inverter, Priors, baseband_of, measured_clutter
from acoustube.inversion.detection import limits_along
from acoustube.lumen import pressed_part
from acoustube.ranging import Rangefinder, record
from acoustube.runs.libraries.build import build_library
from acoustube.runs.libraries.files import open_library
from acoustube.runs.libraries.plan import tool_plans
from acoustube.signals import Processing, locate
from acoustube.waves import PlacedScatterer
from acoustube.waves.spectral import scatter_spectral, wall_of

BORE, LENGTH, AIR = 7.9e-3, 1.8, 20.0
with tempfile.TemporaryDirectory() as folder:
    coarse = Path(folder) / "coarse.toml"
    coarse.write_text('[indentation]\nmesh = "coarse"\n')
    words = {"indenter_mm": ["25"], "depth_mm": ["1:5:0.5"]}
    with ThreadPoolExecutor(2) as workers:
        plans = tool_plans(words, 0.1, coarse)
        build_library(plans, Path(folder) / "lib", executor=workers)
    library = open_library(Path(folder) / "lib")

# %%
# A recording
# -----------
# The recording is of two presses at once, at depths that the library does not contain. Another
# recording, of two hundred cycles of the untouched tube, serves to learn the tube's irregularities.
# Both are simulated here; recordings of a sensor are read by :func:`acoustube.recordings.read`.
TRUE_PLACES, TRUE_DEPTHS = [0.612, 0.874], [2.7e-3, 4.2e-3]
wall = acoustube.load_config(indenter_mm=25, depth_mm=5, mesh="coarse")
press, frequency = acoustube.pressed(wall, TRUE_DEPTHS), np.arange(30e3, 54e3, 50.0)
presses = []
for row, place in zip(press.rows_at(TRUE_DEPTHS), TRUE_PLACES, strict=True):
    lumen = wall_of(pressed_part(press, row))
    scattering = scatter_spectral(lumen, air_at(AIR), frequency, lossy=True, symmetric_only=True)
    presses.append(PlacedScatterer(scattering, place))
rangefinder = Rangefinder()
tube = {"radius": BORE / 2, "length": LENGTH, "temperature": AIR, "tube_seed": 5}
untouched = record([], rangefinder, n_cycles=200, seed=1, **tube)["signal"].values
recording = record(presses, rangefinder, n_cycles=20, seed=2, **tube)
cycles = recording["signal"].values

# %%
# Its inversion
# -------------
# The forward model consists of the band of the rangefinder, the clutter (the echoes of the tube's
# irregularities), and priors of the parameters that are not known exactly: temperature, gain, and
# the transducer's resonance and quality factor.
base = baseband_of(rangefinder, library.radius, LENGTH, AIR, library.modes)
model = ForwardModel(library, base, measured_clutter(base, untouched), Priors())
found = Inverter(model)(cycles)
for contact in found.contacts:
    print(
        f"{100 * contact.distance.value:.2f} ± {100 * contact.distance.deviation:.2f} cm, "
        f"{1e3 * contact.depth.value:.2f} ± {1e3 * contact.depth.deviation:.2f} mm, "
        f"{contact.force.value:.2f} ± {contact.force.deviation:.2f} N, "
        f"probability {contact.probability:.3f}"
    )
print(f"misfit {found.misfit:.3g}, residual {found.residual:.3g}: explained {found.fits}")

# %%
# The highest echo
# ----------------
# The sleeve paper's processing of the same cycles, with a lower prominence, gives one distance. It
# is that of sound that was trapped under the second press, and is 8 cm too large.
highest = locate(recording["time"].values, cycles, Processing(prominence=2e-3), temperature=AIR)
print(f"highest echo at {100 * np.median(highest.distance):.1f} cm")

# %%
# The picture
# -----------
# The upper panel shows the recorded echo and the echo of the two contacts by the forward model. The
# lower panel shows the contacts, and in grey the depths at which a third press may have been
# missed: behind a press more is hidden. ``acoustube invert --figure`` draws more.
places, limits = limits_along(found.detection_limit, model.span)
limits = np.minimum(limits, library.tools[0].depth[-1])
_, (echo, where) = plt.subplots(2, 1, sharex=True, figsize=(8, 6), layout="constrained")
echo.semilogy(100 * found.place, np.abs(found.measured), label="recorded")
echo.semilogy(100 * found.place, np.abs(found.explained), "--", label="explained by two contacts")
echo.axvline(100 * np.median(highest.distance), color="0.5", ls=":", label="highest echo")
echo.set(ylim=(0.03, 20), ylabel="echo without clutter (counts)")
echo.legend()
where.fill_between(100 * places, 0, 1e3 * limits, color="0.85", lw=0)
where.plot(100 * np.array(TRUE_PLACES), 1e3 * np.array(TRUE_DEPTHS), "k+", ms=14, label="true")
for contact in found.contacts:
    low, high = 1e3 * np.array(contact.depth.intervals[0.9])
    middle = 1e3 * contact.depth.value
    bars = [[middle - low], [high - middle]]
    where.errorbar(100 * contact.distance.value, middle, bars, fmt="o", ms=4, color="C3")
where.set(xlim=(25, 100 * LENGTH), xlabel="distance (cm)", ylabel="depth (mm)")
where.legend()
plt.show()
