"""Factors from SI units to those that people read: ``MM * length`` is in mm.

For messages, figures and tables only. Settings become SI in :mod:`acoustube.runs.config.si`.
"""

CM, MM, UM = 1e2, 1e3, 1e6
"""Of a length in m."""
CM2, MM2 = 1e4, 1e6
"""Of an area in m2."""
MS, US = 1e3, 1e6
"""Of a time in s."""
KHZ = 1e-3
"""Of a frequency in Hz."""
MPA = 1e-6
"""Of a stress in Pa."""
PERCENT = 100
"""Of a fraction."""
MEGABYTES, GIGABYTES = 1e-6, 1e-9
"""Of a number of bytes."""
