"""Figures by matplotlib, which are returned: they are neither shown nor saved.

`run` (one press), `sweep`, `cycles` (recordings, calibrations), `estimates` (against true values),
`posterior` (an inversion) and `twin`.
"""
