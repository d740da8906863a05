"""Error of the loss model in channels of a few boundary layers' width, and where they narrow.

    PYTHONPATH=tests OMP_NUM_THREADS=1 python benchmarks/thermoviscous_channels.py [--write FILE]

The reference is the linearised Navier-Stokes-Fourier equations by finite elements in two dimensions
(tests/thermoviscous.py): the wavenumber in slits of 20 um to 1 mm, and R and T of the plane mode
through channels of 4 mm that are narrowed over 8 mm, between planes (the model's boundary impedance
in finite elements on the same mesh) and round (the spectral solver itself). ``--write`` stores the
reference for the tests. Three minutes. Needs scikit-fem.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from thermoviscous import (
    AIR,
    Channel,
    by_layers,
    narrowed,
    scattered,
    spectral_scattering,
    thermoviscous,
    uniform_wavenumber,
)

from acoustube.base.units import MM

SLITS = 20e-6, 50e-6, 0.1e-3, 0.2e-3, 0.5e-3, 1e-3
THROATS = 0.1e-3, 0.2e-3, 0.5e-3, 1e-3
SLIT_FREQUENCIES = 5e3, 20e3, 42e3, 60e3
FREQUENCIES = 10e3, 20e3, 40e3
HEADER = """# R and T of the plane mode through channels of 4 mm, narrowed over 8 mm, in air with
# viscosity and heat conduction: finite elements, benchmarks/thermoviscous_channels.py; their own
# error is below 5e-4.
# round, least width in m, frequency in Hz, R, T (real, imaginary)
"""


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, help="file of the reference")
    parser.add_argument("--parts", nargs="+", default=("slits", "channels"))
    given = parser.parse_args()
    if "slits" in given.parts:
        compare_slits()
    if "channels" in given.parts:
        rows = compare_channels()
        if given.write is not None:
            given.write.write_text(HEADER + "\n".join(rows) + "\n")


def compare_slits() -> None:
    """Print the relative differences of the wavenumber."""
    print("slit um | kHz | relative difference of the wavenumber, real and imaginary part")
    for height in SLITS:
        slit = Channel(height, height, 2e-3, 2e-3)
        for frequency in SLIT_FREQUENCIES:
            found = uniform_wavenumber(slit, frequency, AIR)
            model = slit.wavenumber(frequency, height, AIR)
            real, imaginary = model.real / found.real - 1, model.imag / found.imag - 1
            print(f"{1e3 * MM * height:g} | {frequency:g} | {real:.1e} {imaginary:.1e}", flush=True)


def compare_channels() -> list[str]:
    """Print the differences of R and T; return the reference's lines."""
    rows = []
    print("channel | least mm | kHz | |R| |T| | dR dT | dT / T")
    for is_round, widths in ((False, SLITS), (True, THROATS)):
        for width in widths:
            channel = narrowed(width, is_round=is_round)
            known = [scattered(thermoviscous, channel, f, AIR) for f in FREQUENCIES]
            model = (
                spectral_scattering(channel, FREQUENCIES) if is_round
                else [scattered(by_layers, channel, f, AIR) for f in FREQUENCIES]
            )  # fmt: skip
            for frequency, (r, t), (r_model, t_model) in zip(
                FREQUENCIES, known, model, strict=True
            ):
                parts = [r.real, r.imag, t.real, t.imag]
                numbers = ",".join(f"{part:.6f}" for part in parts)
                rows.append(f"{int(is_round)},{width:g},{frequency:g},{numbers}")
                print(
                    f"{'round' if is_round else 'planes'} | {MM * width:g} | {frequency:g} | "
                    f"{abs(r):.4f} {abs(t):.4f} | {abs(r_model - r):.1e} {abs(t_model - t):.1e} | "
                    f"{abs(t_model / t - 1):.1e}",
                    flush=True,
                )
    return rows


if __name__ == "__main__":
    main()
