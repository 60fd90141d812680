"""Options of commands and solves, and records of their results."""
