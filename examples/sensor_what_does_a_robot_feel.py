"""
What does a robot's arm feel?
=============================

A finger slides along a tube on the moving forearm of a robot. MuJoCo computes the motion and the
forces of the contact, and the fast sensor (:class:`acoustube.sensor.TubeSensor`) simulates the
cycles that the tube's rangefinder records. The tracker estimates the contact from these cycles
alone. ``pip install '.[robot]'`` installs MuJoCo.
"""

# %%
# A library
# ---------
# A library is computed once for each tube: the scattering of the finger at depths up to 3 mm. This
# one is coarse, so that it takes seconds; ``acoustube library --depth 0.5:8:0.25`` computes one for
# lasting use.
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np
from matplotlib.animation import FuncAnimation

from acoustube.inversion import Baseband, ForwardModel, measured_clutter
from acoustube.inversion.motion import Motion
from acoustube.inversion.tracking import ContactTracker
from acoustube.runs.libraries.build import build_library
from acoustube.runs.libraries.plan import tool_plans
from acoustube.sensor import Contact, TubeSensor

LENGTH, SOURCE = 1.0, 0.25
"""Length of the tube, and of the part of it before the forearm, in m."""
with tempfile.TemporaryDirectory() as folder:
    settings = Path(folder) / "coarse.toml"
    settings.write_text('[indentation]\nmesh = "coarse"\n')
    words = {"indenter_mm": ["25"], "depth_mm": ["0.5:3:0.5"]}
    with ThreadPoolExecutor(2) as workers:
        plans = tool_plans(words, 0.1, settings)
        build_library(plans, Path(folder) / "lib", executor=workers)
    sensor = TubeSensor.from_library(Path(folder) / "lib", length=LENGTH, most_contacts=1)
strongest = sensor.force_of(3e-3)
print(f"up to {strongest:.2f} N at 3 mm")

# %%
# An arm
# ------
# The forearm swings about the elbow, and the tube lies on it. The finger moves along the tube, and
# presses onto it with a force that rises and falls.
MODEL = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast">
    <flag filterparent="disable"/>
  </option>
  <worldbody>
    <body name="forearm">
      <joint name="elbow" axis="0 -1 0" damping="1"/>
      <geom name="bone" type="capsule" fromto="0 0 0 0.7 0 0" size="0.03" mass="1"/>
      <geom name="tube" type="capsule" fromto="0 0 0.035 0.7 0 0.035" size="0.0055" mass="0.05"
            solref="0.04 1.5" friction="0.3"/>
      <body name="finger" pos="0.1 0 0.06" gravcomp="1">
        <joint name="along" type="slide" axis="1 0 0" damping="2"/>
        <joint name="down" type="slide" axis="0 0 -1" damping="1"/>
        <geom name="tip" type="capsule" fromto="0 -0.02 0 0 0.02 0" size="0.0125" mass="0.05"
              solref="0.04 1.5" friction="0.3"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="elbow" kp="60" kv="8"/>
    <position joint="along" kp="40" kv="4"/>
    <motor joint="down"/>
  </actuator>
</mujoco>
"""
model = mujoco.MjModel.from_xml_string(MODEL)
data = mujoco.MjData(model)
forearm, finger = (model.body(name).id for name in ("forearm", "finger"))


def touched():
    """Return the position of the contact along the forearm in m, and its normal force in N."""
    total, force = 0.0, np.zeros(6)
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, force)
        total += force[0]
    turned = data.xmat[forearm].reshape(3, 3).T @ (data.xpos[finger] - data.xpos[forearm])
    return turned[0], total


# %%
# Cycles, and the contact estimated from them
# -------------------------------------------
# There are twenty cycles a second. The tracker is given the library, the rangefinder and the
# clutter of the untouched tube. All that it is given of the finger are the cycles, with their noise
# and rounding, and that the finger moves by some centimetres a second. It needs this speed because
# the echo's phase repeats every 4 mm. Sensor and tracker use the same library, so that the errors
# are those of noise and motion, not of the model.
free = np.stack([sensor.read([], seed=1, cycle=i) for i in range(100)])
base = Baseband(
    sensor.rangefinder, sensor.tool_library.radius, LENGTH, 20.0, sensor.tool_library.modes
)
waves = ForwardModel(sensor.tool_library, base, measured_clutter(base, free))
tracker = ContactTracker(waves, most=1, motion=Motion(slide=0.06))

rate = sensor.rangefinder.cycle_rate
frames = []
for i in range(50):
    t = i / rate
    pressing = strongest * (0.55 + 0.3 * np.sin(2 * np.pi * t / 1.5))
    goal = 0.05 * (1 - np.cos(2 * np.pi * t / 4))
    data.ctrl[:] = 0.4 * np.sin(2 * np.pi * t / 3), goal, pressing
    moments = []
    for _ in range(round(1 / rate / model.opt.timestep)):
        mujoco.mj_step(model, data)
        moments.append(touched())
    place, force = moments[-1][0], min(np.mean(moments, axis=0)[1], strongest)
    cycle = sensor.read([Contact(place=SOURCE + place, force=force)], seed=2, cycle=i)
    found = tracker.update(cycle).contacts
    arm = data.xpos[[forearm, finger]].copy(), data.xmat[forearm].reshape(3, 3).copy()
    frames.append((t, SOURCE + place, force, cycle, found, arm))

times, places, forces = (np.array([frame[j] for frame in frames]) for j in range(3))
told = np.array([
    (one.distance.value, one.force.value) if (one := next(iter(frame[4]), None)) else (np.nan,) * 2
    for frame in frames
])  # fmt: skip
place_error, force_error = np.nanmedian(np.abs(told - np.stack([places, forces], 1)), axis=0)
found_share = np.mean(np.isfinite(told[:, 0]))
print(f"detected in {100 * found_share:.0f} % of the cycles; median errors "
      f"{1e3 * place_error:.2f} mm and {force_error:.3f} N")  # fmt: skip

# %%
# True and estimated contact, cycle by cycle
# ------------------------------------------
# The upper panel is drawn to scale: the finger touches the tube on the forearm, and the line
# through the tube is the estimated contact. In the panel below, the echo begins at the dotted line.
# The transducer's resonance and the press itself delay its maximum by 6 to 14 cm.
figure, panels = plt.subplot_mosaic(
    [["scene", "scene"], ["echo", "echo"], ["place", "force"]],
    figsize=(8, 8.5), layout="constrained", height_ratios=(2.3, 1, 1),
)  # fmt: skip
scene, echo = panels["scene"], panels["echo"]
quiet = free.mean(axis=0)
distance = 100 * np.arange(len(quiet)) / sensor.rangefinder.sampling_rate * 343.2 / 2
heard = (distance > 100 * SOURCE) & (distance < 100 * LENGTH)
ends = np.array([[0, 0, 0], [0.7, 0, 0]])
bone = scene.add_patch(plt.Polygon(ends[:, [0, 2]], color="0.8", label="forearm"))
tube = scene.add_patch(plt.Polygon(ends[:, [0, 2]], color="C0", label="tube"))
tip = scene.add_patch(plt.Circle((0, 0), 0.0125, color="C1", label="finger"))
(mark,) = scene.plot([], [], lw=1.5, color="C3", label="estimated contact")
scene.set(xlim=(-0.06, 0.8), ylim=(-0.3, 0.3), aspect="equal", xlabel="x (m)", ylabel="z (m)")
scene.legend(loc="upper left", ncols=4)
change = np.stack([frame[3] - quiet for frame in frames])[:, heard]
change -= np.median(change, axis=1, keepdims=True)  # the slow drift of the offset
(wave,) = echo.plot(distance[heard], change[0], lw=0.7)
where = echo.axvline(0, color="C3", ls=":", label="estimated contact")
largest = 1.1 * np.abs(change).max()
echo.set(xlabel="distance along the tube (cm)", ylabel="ADC counts", xlim=(25, 100))
echo.set(ylim=(-largest, largest), title="cycle, less the untouched tube's")
echo.legend(loc="upper right")
lines = []
for name, true, found, unit in (
    ("place", 100 * places, 100 * told[:, 0], "cm"), ("force", forces, told[:, 1], "N"),
):  # fmt: skip
    panels[name].plot(times, true, color="C1", label="true")
    panels[name].plot(times, found, ".", color="C3", label="estimated")
    panels[name].set(xlabel="time (s)", ylabel=f"{name} ({unit})")
    lines.append(panels[name].axvline(0, color="0.5", lw=0.8))
panels["force"].set_ylim(0, 1.2 * forces.max())
panels["place"].legend(loc="lower right")


def band(low, high, elbow, turn):
    """Return the corners of a bar along the forearm, between two heights above its axis in m."""
    corners = np.array([[0, 0, low], [0.7, 0, low], [0.7, 0, high], [0, 0, high]])
    return (elbow + corners @ turn.T)[:, [0, 2]]


def draw(i):
    """Draw one cycle."""
    (elbow, hand), turn = frames[i][5]
    bone.set_xy(band(-0.03, 0.03, elbow, turn))
    tube.set_xy(band(0.0295, 0.0405, elbow, turn))
    tip.center = hand[0], hand[2]
    across = np.array([[told[i, 0] - SOURCE, 0, height] for height in (0.02, 0.1)])
    mark.set_data(*(elbow + across @ turn.T)[:, [0, 2]].T)
    wave.set_ydata(change[i])
    where.set_xdata([100 * told[i, 0]] * 2)
    for line in lines:
        line.set_xdata([times[i]] * 2)


draw(int(forces.argmax()))  # the picture that the gallery shows
every = range(0, len(frames), 2)
animation = FuncAnimation(figure, draw, frames=every, interval=2e3 / rate)
plt.show()
