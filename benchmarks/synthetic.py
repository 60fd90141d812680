"""Synthetic scenes, made once by `bundle.synthesize` and kept as BAL files.

Most are drives one way through streets, a thousand observations an image: what grows is the length
of the drive alone, and co-visibility stays banded, so that work should grow with the observations.
Drives in laps come back to the same streets, the more often the longer they are: from 200 to 5000
images, the blocks of the reduced camera system that belong to one image become 2.4 times as many.
The photo collection has the same size as the drives of 1000 images, and the densest system. Orbits
have 3 to 300 observations a point, and as many images as that needs, 320 or more.

`python -m benchmarks.synthetic NAME PATH` makes one: in a process of its own, since what starts the
measured processes must stay small.
"""

from __future__ import annotations

import dataclasses
import hashlib
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import measure
from benchmarks.problems import CACHE, ROOT, BenchmarkProblem

_SOURCES = ROOT / "python" / "bundle" / "synthetic"
_TIMEOUT = 600.0


# The start of a drive: a tenth of the generator's perturbation, so that its length alone decides
# how hard it is. From the generator's own start some of a million points lie so close before a
# camera that Levenberg-Marquardt, whoever runs it, rejects step after step: in laps, 50 images
# converge in 6 steps, 5000 have not in 47. More points have more of such luck; what a step costs
# has nothing to do with it.
NEAR_START = {
    "rotation_noise": 0.05,
    "translation_noise": 0.0005,
    "point_noise": 0.0005,
    "focal_noise": 0.001,
    "distortion_noise": 0.0005,
}


@dataclass(frozen=True)
class Scene:
    """Request to the generator; every image has its own camera, as in BAL."""

    kind: str
    num_images: int
    num_observations: int
    has_laps: bool = False
    track_length: int = 5

    @property
    def name(self) -> str:
        """Return the name of the problem, such as street-1000."""
        if self.kind == "orbit":
            return f"tracks-{self.track_length}"
        kind = "laps" if self.has_laps else self.kind.replace("_", "-")
        return f"{kind}-{self.num_images}"

    def options(self) -> dict[str, Any]:
        """Return the fields of bundle.SceneOptions."""
        return {
            "scene": self.kind,
            "num_images": self.num_images,
            "num_points": self.num_observations // self.track_length,
            "mean_track_length": float(self.track_length),
            "camera_model": "RADIAL",
            "cameras": "individual",
            "seed": 4,
            **({**NEAR_START, "loop_closure": self.has_laps} if self.kind == "street" else {}),
        }

    def path(self, folder: Path) -> Path:
        """Return the file's name, which changes with the options and with the generator."""
        digest = hashlib.sha256(repr(dataclasses.astuple(self)).encode())
        digest.update(repr(self.options()).encode())
        for source in sorted(_SOURCES.glob("*.py")):
            digest.update(source.read_bytes())
        return folder / f"{self.name}-{digest.hexdigest()[:8]}.txt"


SCENES = (
    Scene("street", 50, 50_000),
    Scene("street", 200, 200_000),
    Scene("street", 1000, 1_000_000),
    Scene("street", 1000, 1_000_000, has_laps=True),
    Scene("photo_collection", 1000, 1_000_000),
    Scene("street", 5000, 5_000_000),
    Scene("street", 5000, 5_000_000, has_laps=True),
    *(Scene("orbit", max(320, 5 * n), 60_000, track_length=n) for n in (3, 10, 30, 100, 300)),
)


def problem(scene: Scene, folder: Path = CACHE / "synthetic") -> BenchmarkProblem:
    """Return the problem of a scene, whose file may not be there yet."""
    return BenchmarkProblem(
        scene.name,
        "bal",
        scene.path(folder),
        is_synthetic=True,
        num_images=scene.num_images,
        num_observations=scene.num_observations,
        is_for_pair=scene.kind == "orbit",
    )


def ensure(wanted: BenchmarkProblem) -> None:
    """Make the file of a synthetic problem if it is missing.

    Raises:
        RuntimeError: the generator failed.
    """
    if wanted.path.exists():
        return
    wanted.path.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "benchmarks.synthetic", wanted.name, str(wanted.path)]
    child = measure.run_child(command, measure.environment(ROOT, 1), _TIMEOUT)
    if child.failure:
        raise RuntimeError(f"{wanted.name}: {child.failure}")
    print(f"{wanted.name}: made in {child.wall:.0f} s", file=sys.stderr)


def _main() -> None:
    import bundle

    name, path = sys.argv[1], Path(sys.argv[2])
    (scene,) = (scene for scene in SCENES if scene.name == name)
    made = bundle.synthesize(**scene.options())
    partial = path.with_name(f"partial-{path.name}")
    bundle.save(made.problem, partial)
    partial.replace(path)


if __name__ == "__main__":
    _main()
