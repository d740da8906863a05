"""Files that other programs wrote: limits, errors, readers in a child process."""
