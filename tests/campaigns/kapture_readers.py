"""Files of this package read by kapture, and back: counts, poses, points, pixels, errors.

python -m venv KAPTURE && KAPTURE/bin/pip install kapture
python -m tests.campaigns.kapture_readers KAPTURE/bin

kapture (Naver Labs, BSD-3) has importers of its own for Bundler, NVM, OpenMVG, OpenSfM and COLMAP.
Its result is compared after its export to COLMAP, and its OpenMVG export of a COLMAP model of this
package is read here. Two of kapture's conversions (version 1.1.12) lose something, which is undone
here before the comparison, so that the rest is compared exactly:

- NVM: measurements stay relative to the centre of the image; the principal point is not added.
- Bundler: y of the measurements is not negated, with errors of hundreds of pixels. The world is
  turned by 180 degrees about x, which is no loss.

kapture reads no observations of OpenMVG and OpenSfM.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

import bundle
from bundle.model.rigid_motions import rotation_matrices
from tests.io.formats.foreign_files import small

SIZE = (800, 600)


class Comparison(NamedTuple):
    """Largest differences between a model and what kapture made of it."""

    name: str
    counts: tuple[int, int, int]
    centers: float
    rotations: float
    points: float
    pixels: float
    rmse: tuple[float, float]

    def is_equal(self) -> bool:
        # Measurements have five decimals in kapture's COLMAP files.
        return max(self.centers, self.rotations, self.points) < 1e-9 and self.pixels < 1e-4

    def __str__(self) -> str:
        images, points, observations = self.counts
        return (
            f"{self.name:22} {images} images, {points} points, {observations} observations; "
            f"differences: centres {self.centers:.1g}, rotations {self.rotations:.1g}, points "
            f"{self.points:.1g}, pixels {self.pixels:.1g}; RMSE {self.rmse[0]:.6f} and "
            f"{self.rmse[1]:.6f} px: {'equal' if self.is_equal() else 'DIFFERENT'}"
        )


def compared(name: str, ours: bundle.Problem, theirs: bundle.Problem) -> Comparison:
    """Compare two problems image by image and point by point."""
    a, b = (np.argsort(problem.image_names) for problem in (ours, theirs))
    assert [ours.image_names[i] for i in a] == [theirs.image_names[i] for i in b]
    centers = np.abs(ours.projection_centers[a] - theirs.projection_centers[b]).max()
    turns = [rotation_matrices(p.cam_from_world[i, :4]) for p, i in ((ours, a), (theirs, b))]
    points = pixels = 0.0
    errors = [float("nan")] * 2
    if theirs.num_points:
        points = np.abs(np.sort(ours.points, 0) - np.sort(theirs.points, 0)).max()
    if theirs.num_observations:
        pixels = np.abs(np.sort(ours.observation_xy, 0) - np.sort(theirs.observation_xy, 0)).max()
        found = [bundle.reprojection_errors(problem)[0] for problem in (ours, theirs)]
        errors = [float(np.sqrt(np.mean(values**2))) for values in found]
    counts = (theirs.num_images, theirs.num_points, theirs.num_observations)
    difference = float(np.abs(turns[0] - turns[1]).max())
    return Comparison(
        name, counts, float(centers), difference, float(points), float(pixels), tuple(errors)
    )


def mended(name: str, theirs: bundle.Problem) -> bundle.Problem:
    """Undo the losses of kapture's conversions that the module names."""
    xy = theirs.observation_xy
    if name == "nvm":
        return theirs.replace(observation_xy=xy + np.array(SIZE) / 2)
    if name != "bundler":
        return theirs
    flip = np.array([1.0, -1, -1])
    turned = Rotation.from_quat(theirs.cam_from_world[:, :4]) * Rotation.from_matrix(np.diag(flip))
    poses = np.hstack([turned.as_quat(), theirs.cam_from_world[:, 4:]])
    return theirs.replace(
        cam_from_world=poses,
        points=theirs.points * flip,
        observation_xy=np.column_stack([xy[:, 0], SIZE[1] - xy[:, 1]]),
    )


def campaign(tools: Path, folder: Path) -> list[Comparison]:
    """Write models of all formats, let kapture read them, and compare."""

    def kapture(tool: str, *words: object) -> None:
        command = [str(tools / "python"), str(tools / f"kapture_{tool}"), *map(str, words)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr

    images = folder / "images"
    images.mkdir()
    own, shared = small("RADIAL"), small("RADIAL", shared=True)
    pinhole = small("SIMPLE_PINHOLE")
    for name in own.image_names:
        Image.new("RGB", SIZE).save(images / name)
    written = {
        "bundler": (own, "bundle.out", ("-im", images, "-l", folder / "list.txt")),
        "nvm": (pinhole, "model.nvm", ("-im", images)),
        "opensfm": (shared, "sfm", ()),
        "openmvg": (shared, "sfm_data.json", ("--image_action", "skip")),
        "colmap": (shared, "model", ("-im", images)),
    }
    found = []
    for name, (problem, target, more) in written.items():
        path, data, back = folder / target, folder / f"{name}.kapture", folder / f"{name}.colmap"
        bundle.save(problem, path, "colmap-text" if name == "colmap" else name)
        if name == "opensfm":
            (path / "images").symlink_to(images)
        source = {"openmvg": "-s", "colmap": "-txt"}.get(name, "-i")
        tracks = ("--add-reconstruction",) if name in ("bundler", "nvm") else ()
        force = "-y" if name == "openmvg" else "-f"
        kapture(f"import_{name}", force, source, path, "-o", data, *more, *tracks)
        kapture("export_colmap", "-f", "-k", data, "-db", back.with_suffix(".db"), "-txt", back)
        found.append(compared(name, problem, mended(name, bundle.load(back))))
    scene = folder / "openmvg"
    kapture("export_openmvg", "-f", "-k", folder / "colmap.kapture", "-o", scene)
    found.append(compared("openmvg of kapture", shared, bundle.load(scene)))
    return found


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        comparisons = campaign(Path(sys.argv[1]), Path(scratch))
    print(*comparisons, sep="\n")
    sys.exit(not all(comparison.is_equal() for comparison in comparisons))
