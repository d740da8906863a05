"""Results of a design: `drawing`, `figures`, `page` and `files` (the content of its folder)."""
