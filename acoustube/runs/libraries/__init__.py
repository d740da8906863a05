"""Libraries of scattering over depth for the inversion: `plan` (tools), `build` and `files`."""
