"""Complete computations: settings, one press, sweeps, datasets, and their files.

Read `config` (settings, their checks, and in `config.si` their SI units), `presses` (with the
cache), `sound` (band, solvers, probe), `simulate`, `results` (the variables of a run's file), and
for many presses `sweep`; then `libraries`, `inversion`, `recordings`, `training`, `twin`, `live`.
"""
