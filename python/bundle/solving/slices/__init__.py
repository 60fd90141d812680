"""Files too large for one process, read and solved in slices."""
