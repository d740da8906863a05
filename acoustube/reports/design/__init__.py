"""Designed sensors: `drawing`, `figures`, HTML `page`, and `files` (the content of a folder)."""
