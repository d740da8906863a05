"""Results in the files that other programs read: sounds, tables, surfaces, meshes, episodes."""
