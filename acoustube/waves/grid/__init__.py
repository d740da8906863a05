"""The lumen on a Cartesian grid of cells cut by the wall.

Reading order: `polyhedron` (fractions of cells and faces), `cells`, `straight_part` (ends and
symmetries), `repeated_layers` (runs of equal layers), `section` (stiffness and cut-ons),
`small_cells` (small cells, which would limit the time step).
"""
