"""Measured solver choices on the user's data (bundle compare)."""
