"""Reading and solving in slices, for files that are too large for one process."""
