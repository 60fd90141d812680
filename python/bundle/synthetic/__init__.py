"""Seeded scenes with ground truth, from toy to millions of observations."""
