"""Libraries for the inversion: `plan` (tools and depths), `build` and `files`."""
