"""Seeded synthetic scenes with ground truth, from tiny to millions of observations."""
