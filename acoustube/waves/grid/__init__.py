"""The lumen on a Cartesian grid of cells cut by the wall.

Reading order: `polyhedron`, `cells`, `straight_part`, `section`, `small_cells`.
"""
