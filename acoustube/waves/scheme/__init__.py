"""The leapfrog scheme of the wave equation, in JAX and compiled for processors.

Read `operator`, then `problem`, `time_step`, `pml`, `losses` and `leapfrog`; `cpu_leapfrog` and
`cpu_kernel` do the same as `leapfrog` on processors.
"""
