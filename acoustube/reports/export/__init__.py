"""Results in the files that other programs read.

`sounds` (WAV), `tables` (CSV), `press` and `geometry` (surfaces and meshes), `vtu` (for ParaView)
and `lerobot` (episodes for robot learning).

A function ``write_...`` takes results and an empty folder, and returns a summary of the files that
it has written there.
"""
