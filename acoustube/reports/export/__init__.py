"""Results in the files that other programs read: sounds, tables, surfaces, meshes, episodes.

A function ``write_...`` takes results and an empty folder, and returns a summary of the files that
it has written there.
"""
