"""Scenes in 3-D by PyVista."""
