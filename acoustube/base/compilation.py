"""Options of XLA, the compiler behind JAX, which it reads when JAX is first imported."""

import os
from importlib.metadata import PackageNotFoundError, version

EMITTERS = "--xla_cpu_use_fusion_emitters"
"""Option of XLA: whether loops are compiled by its newer emitters."""
KNOWN = "0.10."
"""Versions of jaxlib in which the option was measured. An unknown option ends the process."""


def compile_quickly() -> None:
    """Let XLA compile loops for processors by its older emitters, in this process and its children.

    They compile in two thirds of the time, and the code is as fast. Does nothing for other versions
    of jaxlib, or where the user has set the option.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if EMITTERS in flags:
        return
    try:
        known = version("jaxlib").startswith(KNOWN)
    except PackageNotFoundError:
        return
    if known:
        os.environ["XLA_FLAGS"] = f"{flags} {EMITTERS}=false".strip()
