"""Scenes in 3-D by PyVista: `tube` and `sleeve`, rendered by `offscreen`."""
