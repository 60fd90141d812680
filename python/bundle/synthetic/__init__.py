"""Seeded synthetic scenes with ground truth, from toy to millions of observations."""

from bundle.synthetic.flight_options import FlightOptions
from bundle.synthetic.scene_options import SceneOptions
from bundle.synthetic.synthesis import SyntheticScene, synthesize

__all__ = ["FlightOptions", "SceneOptions", "SyntheticScene", "synthesize"]
