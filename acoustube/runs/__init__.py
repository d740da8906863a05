"""Complete computations: settings, one press, sweeps, datasets, and their files.

Read `config` with `config.si`, then `presses`, `sound`, `simulate`, and for many presses `sweep`.
"""
