"""The leapfrog scheme of the wave equation, in JAX and compiled for processors.

Reading order: `pulse`, `operator`, `time_step`, `pml`, `relaxation_fit`, `losses`, `problem`,
`leapfrog`; `cpu_layout`, `cpu_kernel` and `cpu_leapfrog` are the second implementation, for CPUs.
"""

from acoustube.base.moved import renamed

__getattr__ = renamed(__name__, {"prepare": "acoustube.waves.scheme.problem.prepare"})
