"""Scenes in 3-D by PyVista: `sleeve`, and `tube`, which `offscreen` renders."""
