"""Recordings of ultrasonic rangefinders: from files of many kinds to one dataset.

Read `formats` and `tables` (named arrays of a file), `cycles` (their meaning), `checks` (silent and
clipped cycles), `reading`; and, independent of these, `markers` and `echotube_stream`.
"""

from acoustube.recordings.reading import find, read, read_all, write

__all__ = ["find", "read", "read_all", "write"]
