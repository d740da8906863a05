"""Figures by matplotlib, returned as they are drawn: not shown and not saved.

`run` (one press), `sweep`, `cycles` (recordings, calibrations), `estimates` (over the truth),
`posterior` (an inversion) and `twin`.
"""
