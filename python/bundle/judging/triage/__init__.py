"""Cause of the difference between two reports of one input."""
