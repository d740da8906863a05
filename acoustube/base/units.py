"""Factors from SI units to those that people read: ``MM * length`` is in mm.

For messages, figures and tables only. Settings become SI in :mod:`acoustube.runs.config.si`.
"""

CM, MM, UM = 1e2, 1e3, 1e6
"""For lengths in m."""
CM2, MM2 = 1e4, 1e6
"""For areas in m2."""
MS, US = 1e3, 1e6
"""For times in s."""
KHZ = 1e-3
"""For frequencies in Hz."""
MPA = 1e-6
"""For stresses in Pa."""
PERCENT = 100
"""For fractions."""
