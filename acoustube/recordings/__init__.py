"""Recordings of ultrasonic rangefinders: from files of many kinds to one dataset."""

from acoustube.recordings.reading import find, read, read_all, write

__all__ = ["find", "read", "read_all", "write"]
