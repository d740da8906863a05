"""The first lines that commands print: the tube and its material."""

from __future__ import annotations

from acoustube.base.report import Reporter
from acoustube.runs.config import Config, Mechanics


def print_wall(config: Config | Mechanics, report: Reporter) -> None:
    """Print the tube's sizes or its file, its hardness or shear modulus, and Poisson's ratio."""
    tube = config.tube
    hardness = (
        f"{tube.shore_a:g} Shore A"
        if tube.shore_a is not None
        else f"shear modulus {tube.shear_modulus_mpa:g} MPa"
    )
    shape = (
        f"bore {tube.inner_diameter_mm:g} mm, wall {tube.wall_mm:g} mm, {tube.length_cm:g} cm long"
        if tube.surface is None
        else f"surface {tube.surface}"
    )
    report.line(f"tube: {shape}, {hardness}, Poisson's ratio {tube.poisson_ratio:g}")
