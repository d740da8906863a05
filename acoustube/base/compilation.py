"""Options of XLA, the compiler behind JAX, which it reads when JAX is first imported."""

import os
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

QUICK = {"--xla_cpu_use_fusion_emitters": "false", "--xla_backend_optimization_level": "1"}
"""Options of XLA for CPUs, with which it compiles faster: fused loops without its fusion emitters,
and machine code with fewer of LLVM's optimisations."""
KNOWN = "0.10."
"""Prefix of the versions of jaxlib for which `QUICK` is used. XLA aborts on unknown options."""
FOR_GPUS = "jax_cuda12_plugin", "jax_cuda13_plugin", "jax_rocm7_plugin"
"""Modules of JAX for GPUs; the second option of `QUICK` would also affect their code."""


def compile_quickly() -> None:
    """Let XLA compile with the options `QUICK`, in this process and its children.

    With jaxlib 0.10.2 this halves the compile time. Presses, cycles of a sensor and epochs of a
    network take as long as without; time stepping (FDTD) in JAX, which on a CPU serves derivatives
    only, takes 3 to 9 % longer. Options that the user has set are kept. Nothing is done for
    versions of jaxlib other than `KNOWN`, or where JAX is installed for GPUs.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    new = [f"{name}={value}" for name, value in QUICK.items() if name not in flags]
    try:
        known = version("jaxlib").startswith(KNOWN)
    except PackageNotFoundError:
        return
    if known and new and not any(map(find_spec, FOR_GPUS)):
        os.environ["XLA_FLAGS"] = " ".join([*filter(None, [flags]), *new])
