"""Seeded visual-inertial sequences with ground truth."""

from bundle.synthetic.flight.synthetic_flight import SyntheticFlight, save_flight, synthesize_flight

__all__ = ["SyntheticFlight", "save_flight", "synthesize_flight"]
