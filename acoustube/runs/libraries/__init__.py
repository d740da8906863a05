"""Libraries of scattering over depth for the inversion.

In reading order: `plan` (tools), `refinement` (of the depths), `build` and `files`.
"""
