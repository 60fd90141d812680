"""One problem larger than the memory: refined by `bundle refine --out-of-core`.

A drive one way: image i is at i / 2 along a street and sees points beside it; each point is seen by
six consecutive images, each with a camera of its own, as BAL files have it. Measurements have one
decimal and noise of half a pixel. The file is written block by block, points from a generator of
their own per block, so that nothing of the size of the problem is in memory.

Rows that are to stay go into `large_problems.md`, of which `run.py` makes a section of its page.

On disk are INPUT (35 bytes an observation), then the scratch files (81) or OUTPUT (35).

Run: python -m benchmarks.out_of_core --observations 20e6 --folder DIR [--max-steps 3] [--compare]
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from benchmarks import table
from benchmarks.measure import Child
from benchmarks.scale import TRACK_LENGTH, refine_arguments, refuse_small_disk, run_command

PER_IMAGE = 10_000
BYTES_ON_DISK = 118
_BLOCK = 1 << 18
_LOOKS_ASIDE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_SPACING, _FOCAL, _K1, _K2 = 0.5, 1000.0, -0.02, 0.01
HEADER = (
    "observations",
    "images",
    "made",
    "refine",
    "load",
    "solve",
    "a step",
    "save",
    "statistics",
    "processor",
    "its memory",
    "on disk",
    "RMSE [px]",
)


def num_images(num_observations: int) -> int:
    """Return the images of a problem."""
    return max(2 * TRACK_LENGTH, num_observations // PER_IMAGE)


def write_scene(path: Path, num_observations: int, seed: int = 4) -> None:
    """Write the BAL file of a problem that starts near its truth."""
    images, points = num_images(num_observations), -(-num_observations // TRACK_LENGTH)
    rng = np.random.default_rng(seed)
    rotation = _small_rotations(rng.normal(0, 0.02, (images, 3))) @ _LOOKS_ASIDE
    center = rng.normal(0, 0.05, (images, 3))
    center[:, 0] += _SPACING * np.arange(images)
    params = np.tile([_FOCAL, 0.0, 0.0, _K1, _K2], (images, 1))
    stream = _core.BalStream([path], images, points)
    for block, begin in enumerate(range(0, points, _BLOCK)):
        index = np.arange(begin, min(begin + _BLOCK, points))
        xyz, first = _points(index, images, points, (seed, block))
        image = (first[:, None] + np.arange(TRACK_LENGTH)).ravel().astype(np.int32)
        seen = np.repeat(xyz, TRACK_LENGTH, 0) - center[image]
        noise = np.random.default_rng((seed, block, 1)).normal(0, 0.5, (len(image), 2))
        xy = np.round(_project(np.einsum("nij,nj->ni", rotation[image], seen)) + noise, 1)
        stream.add_observations(params, image, np.repeat(index, TRACK_LENGTH).astype(np.int32), xy)
    center += rng.normal(0, 5e-4, center.shape)
    translation = -np.einsum("nij,nj->ni", rotation, center)
    stream.add_cameras(0, np.c_[_quaternions(rotation), translation], params)
    for block, begin in enumerate(range(0, points, _BLOCK)):
        index = np.arange(begin, min(begin + _BLOCK, points))
        xyz, _ = _points(index, images, points, (seed, block))
        noise = np.random.default_rng((seed, block, 2)).normal(0, 5e-4, xyz.shape)
        stream.add_points(0, xyz + noise)
    stream.close()


def _points(
    index: NDArray[np.int64], images: int, points: int, seed: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return points beside the street, and the first image that sees each."""
    first = index * (images - TRACK_LENGTH + 1) // points
    xyz = np.random.default_rng(seed).uniform((-1.5, 8.0, -3.0), (1.5, 16.0, 3.0), (len(index), 3))
    xyz[:, 0] += _SPACING * (first + 0.5 * (TRACK_LENGTH - 1))
    return xyz, first


def _project(seen: NDArray[np.float64]) -> NDArray[np.float64]:
    normalized = seen[:, :2] / seen[:, 2:]
    squared = (normalized**2).sum(axis=1, keepdims=True)
    return np.asarray(_FOCAL * (1 + squared * (_K1 + squared * _K2)) * normalized)


def _small_rotations(w: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation matrices of (N, 3) Rodrigues vectors, by Cayley's formula."""
    cross = np.zeros((len(w), 3, 3))
    cross[:, [2, 0, 1], [1, 2, 0]] = w / 2
    cross[:, [1, 2, 0], [2, 0, 1]] = -w / 2
    return np.asarray(np.linalg.solve(np.eye(3) - cross, np.eye(3) + cross))


def _quaternions(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x y z w of rotations by less than half a turn."""
    w = np.sqrt(1 + np.trace(rotation, axis1=1, axis2=2)) / 2
    r = rotation
    xyz = np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]], 1)
    return np.asarray(np.column_stack([xyz / (4 * w[:, None]), w]))


def row(num_observations: int, made: float, refine: Child, report: dict[str, Any]) -> list[str]:
    """Return the cells of a measured problem, of HEADER."""
    wall, errors = report["wall_time"], report["reprojection_error"]
    steps = max(len(report["iterations"]) - 1, 1)
    per_step = report["summary"]["minimizer_time_in_seconds"] / steps
    on_disk = report.get("out_of_core")
    return [
        f"{errors['after']['num_observations']:,}",
        f"{num_images(num_observations):,}",
        table.seconds(made),
        table.seconds(refine.wall),
        table.seconds(wall["load"]),
        table.seconds(wall["solve"]),
        table.seconds(per_step),
        table.seconds(wall["save"]),
        table.seconds(wall["statistics"]),
        table.seconds(refine.cpu),
        f"{refine.peak_memory / 1e9:.2f} GB",
        "-" if on_disk is None else f"{on_disk['peak_bytes_on_disk'] / 1e9:.1f} GB",
        f"{errors['before']['rmse']:.3f} to {errors['after']['rmse']:.3f}",
    ]


def measure(
    num_observations: int, max_steps: int, folder: Path, *, compare: bool
) -> Iterator[list[str]]:
    """Make and refine a problem; yield its row, and that of the same solve in memory if asked.

    Raises:
        RuntimeError: a command failed, the disk is too small, or the two results differ.
    """
    refuse_small_disk(folder, BYTES_ON_DISK * num_observations)
    scene, refined, report = (folder / name for name in ("scene.txt", "refined.txt", "report.json"))
    begun = time.perf_counter()
    write_scene(scene, num_observations)
    made = time.perf_counter() - begun
    size = scene.stat().st_size
    print(f"made in {made:.0f} s, {size / num_observations:.1f} bytes each", file=sys.stderr)
    arguments = refine_arguments(scene, refined, report, max_steps)
    child = run_command([*arguments, "--out-of-core", str(folder)])
    yield row(num_observations, made, child, json.loads(report.read_text()))
    if not compare:
        return
    in_memory = folder / "in_memory.txt"
    child = run_command(refine_arguments(scene, in_memory, report, max_steps))
    yield row(num_observations, made, child, json.loads(report.read_text()))
    with refined.open("rb") as one, in_memory.open("rb") as other:
        while block := one.read(1 << 24):
            if block != other.read(1 << 24):
                raise RuntimeError(
                    f"expected the bits of {in_memory.name}, found other bits in {refined.name}"
                )


def main() -> int:
    """Measure and print the rows."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--observations", type=float, required=True, metavar="N")
    parser.add_argument("--max-steps", type=int, default=3, metavar="N")
    parser.add_argument("--folder", type=Path, help="where files go (default: a temporary one)")
    parser.add_argument("--compare", action="store_true", help="also solve in memory, and compare")
    given = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        try:
            found = measure(
                int(given.observations), given.max_steps, Path(folder), compare=given.compare
            )
            for cells in found:
                rows.append(cells)
        except RuntimeError as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
    print(table.grid(list(HEADER), rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
