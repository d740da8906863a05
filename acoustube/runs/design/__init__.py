"""Design of a sensor for a goal.

Reading order: `acoustube.runs.config.goal` (what it must do), `tubes` (presses and their sound),
`candidates`, `search`, `choice` (the recommended sensors), `parts` (their tolerances, and their
errors for two presses at once), `run` (the whole design) and `files`.
"""
