"""Files that other programs wrote: limits, errors, readers in a child process.

Reading order: `limits`, `documents` (TOML, JSON), `archives` (NPZ), `results` (netCDF of this
package), `child` (the process that reads the others), `serve` and `readers` (what runs in it).
"""
