"""Options of all commands, as the commands themselves state them."""

from __future__ import annotations

from acoustube.cli._app import COMMANDS, app

POSITIONAL = {
    "process": ("good.npz",), "scatter": ("lumen.stl",), "sleeve": ("markers.csv",),
    "evaluate": ("boosting.model", "good.npz"), "train": ("good.npz",), "calibrate": ("good.npz",),
    "twin": ("good.npz", "good.npz"), "design": ("goal.toml",),
    "show": (".",), "export": (".",), "dataset": (".",), "cite": (".",), "reproduce": ("all",),
}  # fmt: skip
"""Valid words that come before the options."""


def _options(command: str) -> list[str]:
    found = app[command].assemble_argument_collection()
    return sorted({name for argument in found for name in argument.names if name.startswith("--")})


OPTIONS = {name: _options(name) for name in COMMANDS} | {
    f"cache {name}": ["--quiet", "--help"] for name in ("list", "size", "clear")
}
"""Options by command."""
