"""Validation of lens models, sharing and losses by observations that the fits did not see."""
