"""Recordings of ultrasonic rangefinders: from files of many kinds to one dataset.

Reading order: `formats` and `tables` (named arrays of a file), `cycles` (their meaning), `checks`
(silent and clipped cycles), `reading` (of one file or many); and, independent of these, `markers`
(motion capture) and `echotube_stream` (serial stream of a board).
"""

from acoustube.recordings.reading import find, read, read_all, write

__all__ = ["find", "read", "read_all", "write"]
