"""Design of a sensor for a goal.

Reading order: `acoustube.runs.config.goal` (what it must do), `tubes` (presses and their sound),
`candidates`, `search`, `choice` (the recommended sensors), `parts` (tolerances of these, and two
presses at once), `run` (all of these) and `files`.
"""
