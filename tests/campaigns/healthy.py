"""Healthy synthetic blocks of every kind, none of which a diagnosis may accuse of anything.

python -m tests.campaigns.healthy COUNT [SEED]
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np

import bundle
from bundle.interface.scene_options import CAMERA_MODELS

SCENES = ("street", "orbit", "photo_collection")
"""Sound scenes. Strips of a drone that looks down do not separate focal length and height."""


class Verdict(NamedTuple):
    """Findings of a diagnosis of a sound block."""

    options: dict
    found: bundle.Diagnosis

    @property
    def accusations(self) -> list[str]:
        """The problems that it found."""
        named = [entry.sentence for entry in self.found.findings if entry.is_problem]
        return named if self.found.nullity == self.found.expected_nullity == 7 else ["rank", *named]


def draw(rng: np.random.Generator) -> dict:
    """Options of a block in which points hold all images together: ten images, six a point."""
    num_images = int(rng.choice([10, 12, 16, 24, 40, 80]))
    return {
        "scene": str(rng.choice(SCENES)),
        "num_images": num_images,
        "num_points": num_images * int(rng.choice([60, 100, 150])),
        "mean_track_length": float(rng.uniform(4, 6)),
        "camera_model": str(rng.choice(CAMERA_MODELS)),
        "cameras": str(rng.choice(["shared", "individual"])),
        "pixel_noise": float(rng.choice([0.0, 0.5, 1.0])),
        "outlier_share": float(rng.choice([0.0, 0.02])),
        "seed": int(rng.integers(2**31)),
    }


def campaign(count: int, seed: int = 0) -> list[Verdict]:
    """Diagnose so many blocks."""
    rng = np.random.default_rng(seed)
    verdicts = []
    while len(verdicts) < count:
        options = draw(rng)
        try:
            problem = bundle.synthesize(**options).problem
        except bundle.InputError:  # no such scene: too few images see a point
            continue
        verdicts.append(Verdict(options, bundle.diagnose(problem)))
    return verdicts


def main() -> int:
    """Print every accusation: 0 if there is none."""
    count = int(sys.argv[1])
    verdicts = campaign(count, int(sys.argv[2]) if len(sys.argv) > 2 else 0)
    accused = [verdict for verdict in verdicts if verdict.accusations]
    for verdict in accused:
        print(verdict.options, *verdict.accusations, sep="\n  ")
    print(f"{count} healthy blocks, {len(accused)} accused")
    return 1 if accused else 0


if __name__ == "__main__":
    sys.exit(main())
