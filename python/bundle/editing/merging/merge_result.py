"""What a merge found and did."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from bundle.base.display import Display, Displayed
from bundle.base.words import number, pixels, plural
from bundle.georeference.similarity import Similarity
from bundle.model.problem import Problem
from bundle.model.pycolmap.joining import Joined

__all__ = ["Merge"]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Merge(Displayed):
    """Two models made one, in the frame and the length unit of the first, A.

    Attributes:
        problem: the merged model, for bundle adjustment.
        similarity: from the frame of B to that of A.
        shared_images: names of the images that both have.
        num_pairs: pairs of points that meet at keypoints of shared images.
        free_before: degrees of freedom of the gauges of both models, 14.
        determined: of these, what the shared images take away, 7.
        rms_points: of the joined points, B's moved minus A's, in length units of A; nan without.
        rms_pixels: of the same as they differ in images: see ``disagreements``; nan without.
        rms_centers: of the centres of the shared images, in length units of A.
        counts: what became of B's images, cameras, points and observations.
        notes: what else there is to know, a sentence each.
    """

    problem: Problem
    similarity: Similarity
    shared_images: tuple[str, ...]
    num_pairs: int
    free_before: int
    determined: int
    rms_points: float
    rms_pixels: float
    rms_centers: float
    counts: Joined
    notes: tuple[str, ...]

    def asdict(self) -> dict[str, Any]:
        """Return all but the problem by name; lengths in units of A."""
        return {
            "shared_images": list(self.shared_images),
            "num_shared_images": len(self.shared_images),
            "num_pairs": self.num_pairs,
            "similarity": self.similarity.asdict(),
            "gauge": {
                "free_before": self.free_before,
                "determined": self.determined,
                "free": self.free_before - self.determined,
            },
            "rms_points": self.rms_points,
            "rms_pixels": self.rms_pixels,
            "rms_centers": self.rms_centers,
            **dataclasses.asdict(self.counts),
            "notes": list(self.notes),
        }

    def _display(self) -> Display:
        counts = self.counts
        return Display(
            title="Merge",
            facts=(
                ("shared", plural(len(self.shared_images), "image")),
                ("scale", number(self.similarity.scale)),
                ("rms", f"{pixels(self.rms_pixels)} px at joined points"),
                ("points", f"{counts.num_points_joined} joined, {counts.num_points_added} added"),
                ("images", f"{counts.num_images} added"),
            ),
        )
