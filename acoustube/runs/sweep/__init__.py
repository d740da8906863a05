"""Many presses: a plan of cases, the tasks that they share, and their resumable execution."""
