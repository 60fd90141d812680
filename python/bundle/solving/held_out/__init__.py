"""Held-out observations: their choice, and their errors in a fit without them."""
