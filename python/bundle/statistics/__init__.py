"""What a problem holds, and what looks wrong with it, before any solve."""

from bundle.statistics.covisibility import Covisibility
from bundle.statistics.description import CameraGroup, Description, Distribution, describe
from bundle.statistics.suspicions import Suspicion

__all__ = [
    "CameraGroup",
    "Covisibility",
    "Description",
    "Distribution",
    "Suspicion",
    "describe",
]
