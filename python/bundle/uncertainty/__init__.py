"""How certain a solution is."""

from __future__ import annotations

from bundle.uncertainty.compute_covariance import covariance
from bundle.uncertainty.covariance_result import Covariance
from bundle.uncertainty.graph_covariance import GraphCovariance

__all__ = ["Covariance", "GraphCovariance", "covariance"]
