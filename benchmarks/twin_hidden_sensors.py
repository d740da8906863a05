"""Coverage of the parameters of hidden sensors by the intervals that a twin states.

Random sensors of a wide range are recorded by independent code: drive and transducer in the time
domain at 3.2 MHz, Kirchhoff's asymptotic losses of a wide tube instead of Zwikker and Kosten's, a
temperature that varies along the tube, clutter at random positions that attenuates transmitted
sound, closures of random levels and positions, a trigger with jitter, a gain that varies, a
decimating filter, 8 to 16 bits. Every sensor is a row of a CSV file; existing rows are not
computed again.

Usage: python benchmarks/twin_hidden_sensors.py out.csv --count 40
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from resumed_table import completed
from scipy.signal import firwin, lfilter

from acoustube.air import air_at
from acoustube.base.errors import ConfigError
from acoustube.inversion.twin import Group, Twin, fit_twin
from acoustube.inversion.twin.estimate import radius

PARAMETERS = ("inner_diameter_mm", "resonance_khz", "quality_factor", "temperature_offset_c")
COLUMNS = (
    "number", "bits", "closures", "used", "seconds", "error",
    *(f"{name}{suffix}" for name in PARAMETERS for suffix in ("", "_sd", "_true")),
)  # fmt: skip
FINE, RATE, SAMPLES, LENGTH = 3.2e6, 200e3, 4000, 2.5
N90 = 1.645
"""Half a 90 % interval in standard deviations."""


@dataclass
class Hidden:
    """A sensor under test: SI units, temperatures in degC."""

    bore: float
    resonance: float
    quality: float
    offset: float
    gradient: float
    gain: float
    send: float
    face: float
    carrier: float
    cycles: int
    air: float
    bits: int
    noise: float
    jitter: float
    wander: float
    clutter: float
    placement: float
    level: float
    n_closures: int
    n_cycles: int


def drawn(random: np.random.Generator) -> Hidden:
    """Return a hidden sensor."""
    bits = int(random.choice([8, 10, 12, 12, 14, 16]))
    return Hidden(
        bore=7.9e-3 * random.uniform(0.9, 1.1), resonance=42e3 + random.uniform(-2e3, 2e3),
        quality=float(np.exp(random.uniform(np.log(5), np.log(40)))),
        offset=random.uniform(-3, 3), gradient=random.normal(0, 0.5),
        gain=float(np.exp(random.normal(0, 0.3))), send=random.uniform(20, 170),
        face=random.uniform(0, 0.5), carrier=42e3 + random.normal(0, 200),
        cycles=int(random.integers(8, 17)), air=random.uniform(15, 28), bits=bits,
        noise=float(np.exp(random.uniform(np.log(1e-4), np.log(1e-3)))),
        jitter=random.uniform(0, 1e-6), wander=random.uniform(0, 0.02),
        clutter=float(np.exp(random.uniform(np.log(5e-6), np.log(1e-4)))),
        placement=random.uniform(0.2e-3, 1.5e-3), level=random.uniform(0.002, 0.02),
        n_closures=int(random.integers(6, 15)), n_cycles=int(random.integers(3, 21)),
    )  # fmt: skip


class Bench:
    """Voltages of a hidden sensor, in the time domain except for the propagation."""

    def __init__(self, sensor: Hidden, random: np.random.Generator) -> None:
        self.sensor, self.random = sensor, random
        self.n = int(SAMPLES / RATE * FINE)
        # A square wave, averaged over the samples, as the derivative of a triangle wave.
        turns = np.clip(np.arange(self.n + 1) * sensor.carrier / FINE, 0, sensor.cycles)
        triangle = 0.5 - np.abs(turns % 1 - 0.5)
        drive = np.diff(triangle) * FINE / sensor.carrier
        # The band-pass's bilinear transform, of exact resonance and bandwidth.
        x = np.pi * sensor.resonance / FINE
        k, quality = 1 / np.tan(x), sensor.quality * np.sin(2 * x) / (2 * x)
        a = np.array([k * k + k / quality + 1, 2 - 2 * k * k, k * k - k / quality + 1])
        b = np.array([k / quality, 0.0, -k / quality])
        self.rung = lfilter(b / a[0], a / a[0], drive)
        self.heard = lfilter(b / a[0], a / a[0], self.rung)
        self.filter = firwin(511, 88e3, fs=FINE)
        n_clutter = random.poisson(LENGTH / 2e-3)
        self.where = np.sort(random.uniform(0, LENGTH, n_clutter))
        self.strength = random.normal(0, np.sqrt(sensor.clutter * 2e-3), n_clutter)
        self.ways = self.way(self.where)

    def way(self, place: np.ndarray) -> np.ndarray:
        """Return the wave's factor over a distance and back, (n_f, n)."""
        f = np.fft.rfftfreq(2 * self.n, 1 / FINE)[: int(80e3 / FINE * 2 * self.n)]
        s, omega = self.sensor, 2 * np.pi * f[:, None]
        kelvin = s.air + 273.15
        mean = np.asarray(place)[None]
        # Slowness integrated over a linear temperature, whose mean is at half the tube.
        ends = kelvin - s.gradient * LENGTH / 2, s.gradient
        c0 = np.sqrt(1.4 * 287.05)
        if abs(s.gradient) > 1e-9:
            total = (
                2 / (c0 * s.gradient) * (np.sqrt(ends[0] + s.gradient * mean) - np.sqrt(ends[0]))
            )
        else:
            total = mean / (c0 * np.sqrt(kelvin))
        air = air_at(s.air)
        layer = np.sqrt(np.maximum(omega, 1.0) * air.viscous_diffusivity / 2)
        rough = layer / (s.bore / 2 * air.sound_speed)
        rough = rough * (1 + (air.heat_capacity_ratio - 1) / np.sqrt(air.prandtl))
        damp = air.absorption(f)[:, None]
        return np.exp(-2 * (1j * omega * total + ((1 + 1j) * rough + damp) * mean))

    def volts(self, place: float | None) -> np.ndarray:
        """Return the voltage at :data:`FINE`, without noise; for None, of the open tube."""
        s = self.sensor
        spectrum = np.fft.rfft(self.heard, 2 * self.n)
        inside = slice(0, int(80e3 / FINE * 2 * self.n))
        before = self.where if place is None else self.where[self.where < place]
        strength = self.strength[: len(before)]
        total = self.ways[:, : len(before)] @ strength
        if place is not None:
            level = np.exp(-abs(self.random.normal(0, s.level))) * np.exp(-np.sum(strength**2))
            loop = self.way(np.array([place]))[:, 0] * level
            total += loop / (1 - s.face * loop)
        else:
            total += 0.05 * self.way(np.array([LENGTH]))[:, 0]
        answer = np.zeros_like(spectrum)
        answer[inside] = spectrum[inside] * total
        echo = np.fft.irfft(answer)[: self.n]
        return s.gain * echo + s.send * self.rung

    def counts(self, volts: np.ndarray) -> np.ndarray:
        """Return cycles in counts."""
        s, found = self.sensor, []
        spectrum = np.fft.rfft(np.convolve(volts, self.filter, "same"), 2 * self.n)
        omega = 2 * np.pi * np.fft.rfftfreq(2 * self.n, 1 / FINE)
        for _ in range(s.n_cycles):
            late = np.exp(-1j * omega * self.random.normal(0, s.jitter))
            one = np.fft.irfft(spectrum * late)[: self.n : int(FINE / RATE)]
            one = one * (1 + self.random.normal(0, s.wander)) + 0.9 + self.random.normal(0, 5e-3)
            one = one + self.random.normal(0, s.noise, SAMPLES)
            found.append(np.clip(np.rint(one / 1.8 * 2**s.bits), 0, 2**s.bits - 1))
        return np.array(found).astype(np.uint16)

    def reading(self) -> float:
        """Return the temperature that the board reports, in degC."""
        return self.sensor.air - self.sensor.offset + float(self.random.normal(0, 0.05))


def recorded(sensor: Hidden, random: np.random.Generator) -> tuple[list[Group], Group]:
    """Return recordings of the closures, and of the open tube."""
    bench = Bench(sensor, random)
    closed = []
    for stated in np.linspace(0.4, random.uniform(1.6, 2.3), sensor.n_closures):
        place = float(stated + random.normal(0, sensor.placement))
        cycles = bench.counts(bench.volts(place))
        closed.append(Group(cycles, bench.reading(), float(stated), f"{stated:.2f} m"))
    return closed, Group(bench.counts(bench.volts(None)), bench.reading(), source="open")


def estimates(twin: Twin) -> dict[str, tuple[float, float]]:
    """Return the compared parameters and their standard deviations."""
    bore, bore_sd = radius(twin)
    resonance, quality = 42 * np.exp(twin.value("log_resonance")), np.exp(twin.value("log_quality"))
    values = (
        (2e3 * bore, 2e3 * bore_sd), (resonance, resonance * twin.deviation("log_resonance")),
        (quality, quality * twin.deviation("log_quality")),
        (twin.value("temperature_offset"), twin.deviation("temperature_offset")),
    )  # fmt: skip
    return dict(zip(PARAMETERS, values, strict=True))


def row_of(number: int) -> dict[str, object]:
    """Return the row of a hidden sensor."""
    random = np.random.default_rng([number, 22])
    sensor = drawn(random)
    closed, free = recorded(sensor, random)
    row: dict[str, object] = {"number": number, "bits": sensor.bits, "closures": len(closed)}
    true = (1e3 * sensor.bore, 1e-3 * sensor.resonance, sensor.quality, sensor.offset)
    row |= {f"{name}_true": value for name, value in zip(PARAMETERS, true, strict=True)}
    started = time.process_time()
    try:
        twin = fit_twin(closed, free, RATE, length=LENGTH)
    except ConfigError as error:
        return row | {"error": str(error)}
    row |= {"used": len(twin.used), "seconds": round(time.process_time() - started, 2)}
    for name, (value, deviation) in estimates(twin).items():
        row |= {name: f"{value:.6g}", f"{name}_sd": f"{deviation:.4g}"}
    return row


def summary(rows: list[dict[str, str]]) -> None:
    """Print the share of truths within the 90 % intervals."""
    fitted = [row for row in rows if not row["error"]]
    print(f"{len(fitted)} of {len(rows)} sensors fitted")
    if not fitted:
        return
    scores = np.array([
        [(float(row[n]) - float(row[f"{n}_true"])) / float(row[f"{n}_sd"]) for n in PARAMETERS]
        for row in fitted
    ])  # fmt: skip
    for name, z in zip(PARAMETERS, scores.T, strict=True):
        deviation = np.median([float(row[f"{name}_sd"]) for row in fitted])
        print(
            f"{name:22} within 90 %: {100 * np.mean(np.abs(z) < N90):3.0f} %, rms of error over "
            f"deviation {np.sqrt(np.mean(z**2)):.2f}, median deviation {deviation:.3g}"
        )
    print(f"all: {100 * np.mean(np.abs(scores) < N90):.0f} %")
    print(f"seconds: up to {max(float(row['seconds']) for row in fitted):.1f}")


def main() -> None:
    """Compute the rows that are missing."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("table", type=Path)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    cases = [(number,) for number in range(given.first, given.first + given.count)]
    summary(completed(given.table, COLUMNS, ["number"], cases, row_of))


if __name__ == "__main__":
    main()
