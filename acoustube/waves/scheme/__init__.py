"""The leapfrog scheme of the wave equation, in JAX and compiled for the CPU.

Reading order: `pulse`, `operator` (c^2 div grad on cut cells), `time_step` (stability limit), `pml`
(absorbing layers), `relaxation_fit` and `losses` (at the wall and in the air), `problem` (ends,
source and probes), `leapfrog`; `cpu_layout`, `cpu_kernel`, `cpu_leapfrog` and `cpu_ahead` are the
second implementation, for CPUs.
"""

from acoustube.base.moved import renamed

__getattr__ = renamed(__name__, {"prepare": "acoustube.waves.scheme.problem.prepare"})
