"""Complete computations: settings, one press, sweeps, datasets, and their files.

Reading order for one press: `config` (settings, their checks, and in `config.si` their SI units),
`imported_wall`, `presses` (with the cache), `by_force`, `walls` (deformed walls for files),
`surface_scattering` and `sound` (band, solvers, probe), `costs` (expected time and memory),
`simulate`, `provenance` and `results` (the variables of a run's file), `scattering_file` and
`selftest`. For many presses: `sweep`, `opening` (its files as one dataset) and `libraries`.

For recordings: `recordings` (processing), `training` (features and errors), `sensor_file` and
`wrap` (a sensor's file), `inversion`, `contact_table`, `sensor_check` (stated parameters against
the recordings), `two_ends`, `inverted_cycles` (labelled cycles), `live` and `live_contacts`. For a
sensor's twin, the simulator fitted to it: `twin`, `twin_file`, `twin_pressed`, `twin_sessions`,
`twin_calibration`. For a new sensor: `design`.
"""
