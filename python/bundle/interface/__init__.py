"""Options of each command and solve, and the records of what happened."""
