"""Synthetic models with a COLMAP database of their matches, and damaged tracks."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

import bundle

DAMAGES = ("split", "observations", "points", "merges", "noise")

PIXEL_NOISE = 0.7


def synthesize(folder: Path, seed: int = 3, **changes: Any) -> bundle.Problem:
    """Write database.db and truth/ to a folder; return the truth, with noisy pixels."""
    sizes = {"num_rigs": 1, "num_cameras_per_rig": 1, "num_frames_per_rig": 12}
    sizes |= {"num_points3D": 300, "num_points2D_without_point3D": 30}
    options = pycolmap.SyntheticDatasetOptions(inlier_match_ratio=0.95, **(sizes | changes))
    pycolmap.set_random_seed(seed)
    with pycolmap.Database.open(folder / "database.db") as database:
        made = pycolmap.synthesize_dataset(options, database)
        noise = pycolmap.SyntheticNoiseOptions(point2D_stddev=PIXEL_NOISE)
        pycolmap.synthesize_noise(noise, made, database)
    (folder / "truth").mkdir()
    made.write_binary(folder / "truth")
    return bundle.load(folder / "truth")


def damaged(truth: bundle.Problem, kind: str, seed: int = 0) -> bundle.Problem:
    """Return a model with damaged tracks.

    Args:
        truth: the model with all tracks.
        kind: "split" (half of the observations left, each track cut in two), "observations" (30 %
            left), "points" (20 % left), "merges" (40 % of the observations left, three of ten
            pairs of points made one), or "noise" (40 % left, cameras and points moved by about
            20 px).
        seed: seed of the choice.
    """
    rng = np.random.default_rng(seed)
    if kind == "points":
        return truth.select(points=rng.random(truth.num_points) < 0.2).problem
    share = {"split": 0.5, "observations": 0.3, "merges": 0.4, "noise": 0.4}[kind]
    left = truth.select(observations=rng.random(truth.num_observations) < share).problem
    point = left.observation_point.astype(np.int64)
    if kind == "split":
        return _with_tracks(left, 2 * point + (rng.random(len(point)) < 0.5), is_split=True)
    if kind == "merges":
        joined = rng.random(left.num_points) < 0.3
        return _with_tracks(left, np.where(joined[point // 2 * 2], point // 2 * 2, point))
    if kind == "noise":
        poses = left.cam_from_world + rng.normal(0, 0.01, left.cam_from_world.shape)
        poses[:, :4] /= np.linalg.norm(poses[:, :4], axis=1, keepdims=True)
        moved = left.points + rng.normal(0, 0.05, left.points.shape)
        return left.replace(cam_from_world=poses, points=moved)
    return left


def _with_tracks(
    problem: bundle.Problem, track: np.ndarray[Any, Any], is_split: bool = False
) -> bundle.Problem:
    """Return a problem whose observations belong to other tracks, with at least two each."""
    points = problem.points if not is_split else np.repeat(problem.points, 2, axis=0)
    kept = np.bincount(track, minlength=len(points))[track] >= 2
    order = np.flatnonzero(kept)[np.argsort(track[kept], kind="stable")]
    used, rows = np.unique(track[order], return_inverse=True)
    return problem.replace(
        points=points[used],
        point_ids=used + 1,
        observation_point=rows.astype(np.int32),
        **{
            name: getattr(problem, name)[order]
            for name in ("observation_image", "observation_xy", "observation_keypoint")
        },
    )


def write_database(problem: bundle.Problem, path: Path) -> None:
    """Write a database of the keypoints of a model, whose matches are all pairs of its tracks."""
    path.unlink(missing_ok=True)
    model = problem.to_pycolmap()
    problem = bundle.Problem.from_pycolmap(model)
    tracks: list[dict[int, int]] = [{} for _ in range(problem.num_images)]
    for point, image, keypoint in zip(
        problem.observation_point.tolist(),
        problem.observation_image.tolist(),
        problem.observation_keypoint.tolist(),
        strict=True,
    ):
        tracks[image][point] = keypoint
    ids = problem.image_ids.tolist()
    with pycolmap.Database.open(path) as database:
        for camera in model.cameras.values():
            database.write_camera(camera, use_camera_id=True)
        for key in ids:
            image = model.image(key)
            alone = pycolmap.Image(image.name, np.zeros((0, 2)), image.camera_id, key)
            database.write_image(alone, use_image_id=True)
            pixels = np.array([point.xy for point in image.points2D], np.float32)
            database.write_keypoints(key, pixels)
        for one, other in itertools.combinations(range(len(ids)), 2):
            shared = sorted(tracks[one].keys() & tracks[other].keys())
            matches = [(tracks[one][point], tracks[other][point]) for point in shared]
            geometry = pycolmap.TwoViewGeometry()
            geometry.inlier_matches = np.array(matches, np.uint32).reshape(-1, 2)
            database.write_two_view_geometry(ids[one], ids[other], geometry)
