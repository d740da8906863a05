"""Does the echo at 10 kHz still increase with depth in a tube that can be built?

The finding (docs/findings.md) holds for a rigid wall, a Gaussian pulse and an exact tube. Here a
25 mm rod presses the sleeve paper's tube, 50 cm from the face, and two with 5 % narrower and wider
bores; the spectral solver computes the scattering of each lumen with losses from 5 to 60 kHz. The
end of the tube and the face absorb. Added one by one:

* a wall that yields: along the straight tube by its wavenumber
  (``acoustube.waves.modes.yielding_wall``); in the press by the change of the reflection in a horn
  equation with the wall compliance per perimeter of the round bore. This is an upper limit, as rod
  and floor hold part of the wall;
* a loudspeaker: a diaphragm on its suspension, which sends into the endless tube the pressure of
  its velocity, a second-order band-pass. The resonance, 1050 Hz, is that of a dynamic speaker of
  13 mm (data sheet, CUI CDMG13008L-02, 2006), which does not state Q: 1.21 is that of a tweeter of
  19 mm whose resonance is 973 Hz (data sheet, Vifa XT19NC30-04, 2015). The microphone is flat;
* errors of handling: bore exact or 5 % off, position +-5 mm, depth +-0.1 mm. Forces are estimated
  from the echo's height by the curve of the exact tube.

Usage: python benchmarks/audio_band_echo.py [FIGURE.png]; some minutes, which the cache keeps.
"""

from __future__ import annotations

import sys
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import hilbert

from acoustube.air import air_at
from acoustube.indentation import DepthPath
from acoustube.lumen import measure, pressed_part
from acoustube.ranging import Rangefinder
from acoustube.runs import presses
from acoustube.runs.libraries.build import scattering_at
from acoustube.runs.libraries.plan import ToolPlan, tool_plans
from acoustube.waves import Pulse
from acoustube.waves.modes import axial_wavenumber
from acoustube.waves.modes.yielding_wall import YieldingWall, wall_compliance, yielding_wavenumber

BORE, PLACE, BAND = 7.9, 0.5, (5e3, 60e3)
BORES = {0.95: "1:7.5:0.5", 1.0: "1:8:0.5", 1.05: "1:8:0.5"}
"""Bores relative to the exact one, and the depths in mm to which they are pressed."""
CARRIERS, SCAN = (10e3, 20e3, 42e3), np.arange(7e3, 46e3, 1e3)
SPEAKER = Rangefinder(resonance=1050.0, quality_factor=1.21)
RATE, DURATION = 1e6, 8e-3
SLICES, EVERY = 300, 5
HAND_PLACE, HAND_DEPTH = 5e-3, 0.1e-3
AIR, WALL = air_at(20.0), YieldingWall()


class Pressed(NamedTuple):
    """A pressed tube: depth (n,), force (n,), frequency (n_f,), reflections (n, n_f)."""

    radius: float
    depth: np.ndarray
    force: np.ndarray
    frequency: np.ndarray
    rigid: np.ndarray
    yielding: np.ndarray


@cache
def pressed_tube(scale):
    """Return the plane wave's reflections by a tube with a scaled bore, at the press's middle."""
    over = {"indenter_mm": ["25"], "inner_diameter_mm": [f"{scale * BORE:g}"], "losses": ["on"],
            "depth_mm": [BORES[scale]]}  # fmt: skip
    (tool,) = tool_plans(over, 0.005)
    plan = ToolPlan(tool.config, tool.settings, tool.pressed, tool.first, 0.005, BAND)
    path = DepthPath(presses.press_to(plan.settings, plan.pressed))
    depths, rigid, change, f = [], [], [], None
    for depth in plan.first:
        part = pressed_part(path.at([depth]))
        found = scattering_at(plan, depth, part).result
        if isinstance(found, str):
            print(f"bore {scale * BORE:.3f} mm, {1e3 * depth:g} mm is left out: {found}")
            continue
        f = np.asarray(found.frequency, float)
        z = np.linspace(-part.position, part.position, SLICES + 1)
        middle, radius = (z[1:] + z[:-1]) / 2, plan.settings.radius
        area = measure(path.at([depth]), 0, middle).area
        modelled = 0.98 * np.abs(middle[area > 0]).max()  # the rim of the model is partly cut off
        area[np.abs(middle) > modelled] = np.pi * radius**2
        horns = [horn(f[::EVERY], area, z[1] - z[0], radius, yields) for yields in (0, 1)]
        depths.append(depth)
        rigid.append(found.s[:, 0, 0, 0, 0])
        change.append(CubicSpline(f[::EVERY], horns[1] - horns[0])(f))
        if scale == 1.0:
            i = int(np.argmin(np.abs(f[::EVERY] - 10e3)))
            print(f"{1e3 * depth:.2f} mm at 10 kHz: reflection {abs(rigid[-1][EVERY * i]):.4f}, by "
                  f"the horn equation {abs(horns[0][i]):.4f}, yielding {abs(horns[1][i]):.4f}",
                  flush=True)  # fmt: skip
    rigid = np.array(rigid)
    force = np.asarray(path.contact_force(depths), float)
    return Pressed(
        plan.settings.radius, np.array(depths), force, f, rigid, rigid + np.array(change)
    )


def horn(frequency, area, step, radius, yields):
    """Return the reflection (n_f,) of sections of an area (n,) by slices of the horn equation.

    Losses in the air are left out, as they would be equal in both reflections of a difference.
    """
    omega, full = 2 * np.pi * frequency, np.pi * radius**2
    k = omega / AIR.sound_speed
    moved = yields * wall_compliance(frequency, k, radius, WALL)
    perimeter = 2 * np.pi * radius

    def line(section):
        inertance = 1j * omega * AIR.density / section
        compliance = 1j * omega * (section / (AIR.density * AIR.sound_speed**2) + perimeter * moved)
        return np.sqrt(inertance * compliance), np.sqrt(inertance / compliance)

    free, impedance = line(full)
    total = np.broadcast_to(np.eye(2, dtype=complex), (len(frequency), 2, 2))
    for section in np.maximum(area, 1e-9):
        gamma, z = line(section)
        c, s = np.cosh(gamma * step), np.sinh(gamma * step)
        total = total @ np.stack([np.stack([c, z * s], -1), np.stack([s / z, c], -1)], -2)
    pressure = total[:, 0, 0] * impedance + total[:, 0, 1]
    flow = total[:, 1, 0] * impedance + total[:, 1, 1]
    found = (pressure - impedance * flow) / (pressure + impedance * flow)
    # From the first section to the middle.
    return found * np.exp(free * step * len(area))


def heights(tube, carrier, *, yields, speaker, place=PLACE):
    """Return the echo's height over the send pulse's (n,) and the error of distance in m (n,)."""
    pulse, n = Pulse(frequency=carrier), int(RATE * DURATION)
    f = np.fft.rfftfreq(n, 1 / RATE)
    inside = (f >= BAND[0]) & (f <= BAND[1])
    f = f[inside]
    sent = np.fft.rfft(pulse(np.arange(n) / RATE))[inside]
    if speaker:
        sent = sent * SPEAKER.resonator(f)
    if yields:
        wave = yielding_wavenumber(f, tube.radius, AIR, WALL)
    else:
        wave = axial_wavenumber(0, 0, f, tube.radius, AIR)
    reflection = CubicSpline(tube.frequency, tube.yielding if yields else tube.rigid, axis=1)(f)
    spectra = np.zeros((len(reflection) + 1, n // 2 + 1), complex)
    spectra[0, inside] = sent
    spectra[1:, inside] = sent * reflection * np.exp(-2j * wave * place)
    envelope = np.abs(hilbert(np.fft.irfft(spectra, n)))
    late = envelope.argmax(axis=1) / RATE
    error = AIR.sound_speed * (late[1:] - late[0]) / 2 - place
    return envelope[1:].max(axis=1) / envelope[0].max(), error


CASES = {
    "rigid wall": {"yields": False, "speaker": False},
    "yielding wall": {"yields": True, "speaker": False},
    "and a loudspeaker": {"yields": True, "speaker": True},
}


def rising(height):
    """Return whether heights (n_depths,) increase with every step of depth."""
    return bool(np.all(np.diff(height) > 0))


def by_hand(carrier, rng):
    """Return shares of pairs 1 mm apart in the right order, and relative errors of force."""
    tubes = [pressed_tube(scale) for scale in BORES]
    exact = pressed_tube(1.0)
    reading = heights(exact, carrier, **CASES["and a loudspeaker"])[0]
    fine = np.linspace(exact.depth[0], exact.depth[-1], 2000)
    curve = np.exp(CubicSpline(exact.depth, np.log(reading))(fine))
    force = CubicSpline(exact.depth, exact.force)(fine)
    errors, drawn = [], []
    wanted = np.arange(2e-3, 7.01e-3, 1e-3)
    for tube in tubes:
        given = [heights(tube, carrier, **CASES["and a loudspeaker"], place=PLACE + off)[0]
                 for off in (-HAND_PLACE, HAND_PLACE)]  # fmt: skip
        for height in given:
            own = CubicSpline(tube.depth, np.log(height))
            pressed = wanted + rng.uniform(-HAND_DEPTH, HAND_DEPTH, (500, len(wanted)))
            heard = np.exp(own(pressed))
            drawn.append(heard)
            nearest = np.abs(np.log(heard[..., None] / curve)).argmin(axis=-1)
            errors.append(force[nearest] / CubicSpline(tube.depth, tube.force)(pressed) - 1)
    drawn = np.concatenate(drawn)
    other = rng.permutation(drawn)
    return np.mean(drawn[:, 1:] > other[:, :-1]), np.concatenate(errors)


def main():
    """Print tables, and draw a figure."""
    exact = pressed_tube(1.0)
    for carrier in CARRIERS:
        print(f"\n{1e-3 * carrier:g} kHz; height of the echo in % of the pulse at "
              f"{', '.join(f'{1e3 * d:g}' for d in exact.depth[::4])} mm")  # fmt: skip
        for name, case in CASES.items():
            height, error = heights(exact, carrier, **case)
            kept = error[exact.depth >= 2e-3]
            print(f"  {name}: {', '.join(f'{100 * h:.3g}' for h in height[::4])}; "
                  f"{'rises' if rising(height) else 'does not rise'}; distance "
                  f"{1e3 * kept.min():+.1f} to {1e3 * kept.max():+.1f} mm")  # fmt: skip
        order, error = by_hand(carrier, np.random.default_rng(1))
        print(f"  by hand: {100 * order:.1f} % of pairs drawn at random, 1 mm apart, in order; "
              f"force off by {100 * np.median(np.abs(error)):.0f} % (median), "
              f"{100 * np.quantile(np.abs(error), 0.9):.0f} % (90 %)")  # fmt: skip
    for scale in BORES:
        tube = pressed_tube(scale)
        ok = [c for c in SCAN if rising(heights(tube, c, **CASES["and a loudspeaker"])[0])]
        gap = next((c for c in SCAN if c not in ok), np.inf)
        print(
            f"bore {scale * BORE:.2f} mm: the echo rises at every carrier below {1e-3 * gap:g} kHz "
            f"and at {len(ok)} of {len(SCAN)} of {1e-3 * SCAN[0]:g} to {1e-3 * SCAN[-1]:g} kHz"
        )
    if len(sys.argv) > 1:
        draw(sys.argv[1])


def draw(path):
    """Draw heights over depth for all bores, and the least increase per 1 mm over the carrier."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    case = CASES["and a loudspeaker"]
    for carrier, colour in zip(CARRIERS, ("C0", "C1", "C2"), strict=True):
        for scale, style in zip(BORES, (":", "-", "--"), strict=True):
            tube = pressed_tube(scale)
            label = f"{1e-3 * carrier:g} kHz, {scale * BORE:.2f} mm"
            height = 100 * heights(tube, carrier, **case)[0]
            left.semilogy(1e3 * tube.depth, height, style, color=colour, label=label)
    left.set(xlabel="depth (mm)", ylabel="echo (% of the send pulse)")
    left.legend(fontsize=7)
    for scale, style in zip(BORES, (":", "-", "--"), strict=True):
        tube = pressed_tube(scale)
        logs = [np.log(heights(tube, carrier, **case)[0]) for carrier in SCAN]
        least = [20 / np.log(10) * (one[4:] - one[:-4]).min() for one in logs]
        right.plot(1e-3 * SCAN, least, style, color="C0", label=f"bore {scale * BORE:.2f} mm")
    right.axhline(0, color="0.7")
    right.set(xlabel="carrier (kHz)", ylabel="least rise of the echo in 1 mm (dB)", ylim=(-25, 8))
    right.legend()
    figure.savefig(path, dpi=130)


if __name__ == "__main__":
    main()
