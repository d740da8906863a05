"""The lumen on a Cartesian grid of cells cut by the wall.

Read `polyhedron`, then `section`, `cells` and `small_cells`.
"""
