"""Result of a merge."""

from __future__ import annotations

import dataclasses
from typing import Any

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import number, pixels, plural
from bundle.editing.joining import Joined
from bundle.georeference.similarity import Similarity
from bundle.model.problem import Problem


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Merge(Displayed):
    """Merged model in the frame and the length unit of the first model, A.

    Attributes:
        problem: merged model, ready for bundle adjustment.
        similarity: similarity from the frame of B to that of A.
        shared_images: names of the images in both models.
        num_pairs: number of pairs of points that meet at keypoints of shared images.
        free_before: gauge degrees of freedom of both models, 14.
        determined: degrees of freedom that the shared images remove, 7.
        rms_points: rms distance between joined points of A and the moved points of B, in length
            units of A; nan without joined points.
        rms_pixels: rms of the same distances in pixels, see ``disagreements``; nan without joined
            points.
        rms_centers: rms distance of the centres of shared images, in length units of A.
        counts: results for B's images, cameras, points and observations.
        notes: remarks, one sentence each.
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
        """Return all fields except the problem by name; lengths in units of A."""
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
