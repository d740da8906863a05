"""Many presses: a plan of cases, the work that they share, and its execution without loss."""
