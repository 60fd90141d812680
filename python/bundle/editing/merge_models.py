"""Merge of two reconstructions with common images into one.

Each model has its own gauge of 7 degrees of freedom. Shared images and points determine the
similarity between the models (``frame_of_a``), so that the merged model has one gauge. Models with
rigs, whose scale may be known, are refused.

Two points that may be the same point are compared in the images that observe either of them.

The compared distance is between the two projections, not to the keypoints. It shows if the points
are the same, and does not depend on the accuracy of the measurements. The median over the images of
both tracks removes the influence of single misplaced images. If only one of the points is in front
of an image, the distance there is infinite.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter, defaultdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base import words
from bundle.base.arrays import rows_among
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import pixels, plural
from bundle.editing.frame_of_a import DEGREES, find_similarity
from bundle.editing.joining import AddedImages, Joined, added_images, join, shared_keypoints
from bundle.errors import InputError
from bundle.georeference.similarity import Similarity, moved
from bundle.interface.option_fields import number
from bundle.io.colmap import problem_of_records
from bundle.io.files import Source, as_problem
from bundle.model.cameras import camera_models, project
from bundle.model.colmap.model_records import ModelRecords, model_records
from bundle.model.problem import Problem
from bundle.model.rigid_motions import rotation_matrices
from bundle.model.rolling_shutter import RollingShutter

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def disagreements(a: Problem, b: Problem, pairs: Indices) -> Array:
    """Return the median distance of each pair in pixels.

    ``b``: the second model, in the frame of the first. ``pairs``: (n, 2) indices of a point of A
    and of a point of B.
    """
    first, second = a.points[pairs[:, 0]], b.points[pairs[:, 1]]
    rows, distances = [], []
    for problem, point in ((a, pairs[:, 0]), (b, pairs[:, 1])):
        row, image = _views(problem, point)
        here = _pixels(problem, image, first[row])
        there = _pixels(problem, image, second[row])
        distance = np.linalg.norm(here - there, axis=1)
        rows.append(row)
        distances.append(np.where(np.isnan(distance), np.inf, distance))
    row, distance = np.concatenate(rows), np.concatenate(distances)
    order = np.lexsort((distance, row))
    counts = np.bincount(row, minlength=len(pairs))
    # Use the lower of the two middle values, because their mean may be infinite.
    middle = np.cumsum(counts) - counts + (counts - 1) // 2
    median: Array = distance[order][middle]
    return median


def _views(problem: Problem, points: Indices) -> tuple[Indices, Indices]:
    """Return for each observation of each point its row in ``points`` and its image."""
    order = np.argsort(problem.observation_point, kind="stable")
    counts = np.bincount(problem.observation_point, minlength=problem.num_points)
    starts = np.cumsum(counts) - counts
    length = counts[points]
    row = np.repeat(np.arange(len(points)), length)
    within = np.arange(len(row)) - np.repeat(np.cumsum(length) - length, length)
    observation = order[starts[points][row] + within]
    return row, problem.observation_image[observation].astype(np.int64)


def _pixels(problem: Problem, image: Indices, points: Array) -> Array:
    """Return (n, 2) projections, nan for points that the camera cannot see."""
    turned = np.einsum("nij,nj->ni", rotation_matrices(problem.cam_from_world[image, :4]), points)
    in_camera = turned + problem.cam_from_world[image, 4:]
    pixels = np.full((len(image), 2), np.nan)
    camera = problem.image_camera[image]
    for index in np.unique(camera):
        rows = camera == index
        model = problem.camera_models[index]
        params = problem.camera_params[index, : len(camera_models()[model])]
        found, valid = project(model, params, in_camera[rows])
        pixels[rows] = np.where(valid[:, None], found, np.nan)
    return pixels


MAX_ERROR = 8.0
"""Default in pixels. Larger than in a filter, because both models are distorted where they meet."""


def merge(a: Source, b: Source, *, max_error: float = MAX_ERROR) -> Merge:
    """Merge two reconstructions with common images, without adjusting anything.

    Images of the same name are the same image. They keep A's pose and camera. Other images of B
    with the same camera as a shared image get the camera of A. B moves into the frame of A by the
    similarity on which shared points and centres of shared images agree. Points that meet at a
    keypoint of a shared image are joined at A's coordinates if their projections differ by at most
    ``max_error``. Other points stay separate; such keypoints then belong to A's point. Run bundle
    adjustment afterwards.

    Args:
        a: a Problem, the path of a COLMAP model, or a pycolmap.Reconstruction; not modified.
        b: the other model, in the same forms; not modified. Ids that A also uses are replaced.
        max_error: largest median distance in pixels over the images of both tracks.

    Raises:
        InputError: a model is not a COLMAP model or has rigs, the shared images do not determine
            the similarity, or no shared points agree.
        OSError: a path cannot be read.

    Example:
        >>> merged = bundle.merge("sparse/0", "sparse/1")
        >>> result = bundle.solve(merged.problem, loss="huber")
        >>> bundle.save(result.problem, "sparse/merged")
    """
    limit = number("max_error", max_error, above=0)
    first, second = as_problem(a, "a"), as_problem(b, "b")
    rows = _shared_images(_rows("a", first), _rows("b", second))
    images = np.array(rows, np.int64).reshape(-1, 2)
    records = _records(first), _records(second)
    shared = np.column_stack(
        [
            rows_among(problem.image_ids[row], record.image_ids)
            for record, problem, row in zip(records, (first, second), images.T, strict=True)
        ]
    )
    keypoints = shared_keypoints(*records, shared)
    meetings = keypoints.meetings(*records)
    by_id = np.argsort(first.point_ids), np.argsort(second.point_ids)
    image, point_a, point_b = keypoints.meetings_by_image(*records).T
    similarity = find_similarity(
        first, second, images, np.column_stack([image, by_id[0][point_a], by_id[1][point_b]])
    )
    second = moved(second, similarity)
    pairs = np.column_stack([by_id[0][meetings.point_a], by_id[1][meetings.point_b]])
    distance = disagreements(first, second, pairs)
    one = distance <= limit
    if len(pairs) and not one.any():
        raise InputError(
            f"b: expected points within {limit:g} pixels of those of the first model after "
            f"alignment, found 0 among {len(pairs)} that shared images observe in both "
            f"models; the nearest differs by {distance.min():.4g}"
        )
    cameras, notes = _cameras(first, second, images)
    there = dataclasses.replace(
        records[1],
        points=second.points[by_id[1]],
        cam_from_world=second.cam_from_world[rows_among(records[1].image_ids, second.image_ids)],
    )
    added = added_images(records[0], there, shared, cameras)
    merged, counts = join(records[0], there, added, keypoints, meetings, one)
    if not counts.num_images:
        notes.append("Every image of B is in A: only points and observations were added.")
    if records[0].num_without_pose:
        notes.append(f"Images of A without a pose are left out ({records[0].num_without_pose}).")
    apart = second.points[pairs[one, 1]] - first.points[pairs[one, 0]]
    centers = second.projection_centers[images[:, 1]] - first.projection_centers[images[:, 0]]
    return Merge(
        problem=with_shutters(problem_of_records(merged), first, second, added, records),
        similarity=similarity,
        shared_images=tuple(first.image_names[row] for row in images[:, 0]),
        num_pairs=len(pairs),
        free_before=2 * DEGREES,
        determined=DEGREES,
        rms_points=_root_mean_square((apart**2).sum(axis=1)),
        rms_pixels=_root_mean_square(distance[one] ** 2),
        rms_centers=_root_mean_square((centers**2).sum(axis=1)),
        counts=counts,
        notes=tuple(notes),
    )


def _records(problem: Problem) -> ModelRecords:
    return model_records(problem, vars(problem)["source"])


def _rows(name: str, problem: Problem) -> dict[str, int]:
    """Return the images by name."""
    if problem.num_images and not any(problem.image_names):
        raise InputError(
            f"{name}: expected images with names, which identify the same image in both "
            "models; BAL files have no names"
        )
    if problem.num_frames:
        raise InputError(
            f"{name}: expected a model without rigs, found {plural(problem.num_frames, 'frame')} "
            f"of {plural(problem.num_rigs, 'rig')}: those cannot be merged yet"
        )
    rows: dict[str, int] = {}
    for row, image in enumerate(problem.image_names):
        if image and rows.setdefault(image, row) != row:
            raise InputError(
                f"{name}: expected unique image names, found {image} for images "
                f"{problem.image_ids[rows[image]]} and {problem.image_ids[row]}"
            )
    return rows


def _shared_images(a: dict[str, int], b: dict[str, int]) -> list[tuple[int, int]]:
    shared = [(row, b[name]) for name, row in a.items() if name in b]
    if not shared:
        raise InputError(
            "b: expected images with the same names as in the first model, found 0 common "
            f"names among {len(a)} and {len(b)} images, which determine 0 of the {DEGREES} "
            "degrees of freedom between the models"
        )
    return shared


def _cameras(a: Problem, b: Problem, images: NDArray[np.int64]) -> tuple[dict[int, int], list[str]]:
    """Return the cameras of A for images of B, by ids, and notes on them.

    A camera of B is replaced by the camera that most of its shared images have in A (if tied, the
    one with the lowest id), unless the image size differs.
    """
    votes: dict[int, Counter[int]] = defaultdict(Counter)
    for row_a, row_b in images.tolist():
        votes[int(b.image_camera[row_b])][int(a.image_camera[row_a])] += 1
    others = set(range(b.num_images)) - set(images[:, 1].tolist())
    needed = {int(b.image_camera[row]) for row in others}
    taken, notes = {}, []
    for old in sorted(votes.keys() & needed):
        found = votes[old]
        new = min(found, key=lambda camera: (-found[camera], int(a.camera_ids[camera])))
        names = f"camera {b.camera_ids[old]} of B", f"camera {a.camera_ids[new]} of A"
        if (a.camera_sizes[new] != b.camera_sizes[old]).any():
            notes.append(
                f"{names[0]} stays, because its image size differs from that of {names[1]}."
            )
            continue
        if shutter_of(b).direction[old] != shutter_of(a).direction[new]:
            notes.append(f"{names[0]} stays, because its shutter differs from that of {names[1]}.")
            continue
        taken[int(b.camera_ids[old])] = int(a.camera_ids[new])
        models = b.camera_models[old], a.camera_models[new]
        if models[0] != models[1]:
            notes.append(
                f"Images of {names[0]} ({models[0]}) get {names[1]} of another model "
                f"({models[1]}): adjust before judging errors."
            )
        if len(found) > 1:
            notes.append(
                f"Shared images of {names[0]} have {len(found)} cameras in A; its other images "
                f"get {names[1]}."
            )
    return taken, notes


def _root_mean_square(squares: NDArray[np.float64]) -> float:
    return float(np.sqrt(squares.mean())) if len(squares) else float("nan")


# Rolling shutters of a merged model.
#
# Cameras and images of both models keep the shutter and the twist of A. Twists of B are those after
# B moved into the frame of A. Neighbours become indices of the merged images.


def shutter_of(problem: Problem) -> RollingShutter:
    """Return the shutters of a problem, global ones if it has none."""
    return problem.rolling_shutter or RollingShutter(
        direction=("global",) * problem.num_cameras, twist=np.zeros((problem.num_images, 6))
    )


def with_shutters(
    merged: Problem,
    a: Problem,
    b: Problem,
    added: AddedImages,
    records: tuple[ModelRecords, ModelRecords],
) -> Problem:
    """Return the merged model with the rolling shutters of A and of what B adds.

    ``b``: model B in the frame of A.
    """
    known = [one.rolling_shutter for one in (a, b) if one.rolling_shutter is not None]
    if not known:
        return merged
    if known[0].row_time != known[-1].row_time:
        raise InputError(
            f"b: expected rolling shutters with the row time {known[0].row_time}, as in the first "
            f"model, found {known[-1].row_time}"
        )
    of_a, of_b = records
    images = dict(
        zip(
            [*of_b.image_ids[added.shared[:, 1]], *of_b.image_ids[added.added]],
            [*of_a.image_ids[added.shared[:, 0]], *added.image_ids],
            strict=True,
        )
    )
    cameras = dict(zip(of_b.camera_ids[added.camera_rows], added.camera_ids, strict=True))
    image_at = {one: row for row, one in enumerate(merged.image_ids.tolist())}
    camera_at = {one: row for row, one in enumerate(merged.camera_ids.tolist())}
    direction = ["global"] * merged.num_cameras
    readout = np.full(merged.num_cameras, np.nan)
    twist = np.zeros((merged.num_images, 6))
    frames = np.full(merged.num_images, np.nan)
    neighbours = np.full((merged.num_images, 2), -1, np.int32)
    own = {one: one for one in [*a.image_ids.tolist(), *a.camera_ids.tolist()]}
    for problem, new_image, new_camera in ((b, images, cameras), (a, own, own)):  # A has priority
        shutter = shutter_of(problem)
        for row, camera in enumerate(problem.camera_ids.tolist()):
            if camera in new_camera:
                direction[camera_at[new_camera[camera]]] = shutter.direction[row]
                readout[camera_at[new_camera[camera]]] = shutter.readout[row]
        rows = [image_at[new_image[one]] for one in problem.image_ids.tolist()]
        twist[rows] = shutter.twist
        frames[rows] = np.nan if shutter.frames is None else shutter.frames
        pairs = shutter.neighbours
        neighbours[rows] = -1 if pairs is None else np.append(rows, -1)[pairs]
    rates = [one.frame_rate for one in known if math.isfinite(one.frame_rate)]
    return merged.replace(
        rolling_shutter=RollingShutter(
            direction=tuple(direction),
            readout=readout,
            twist=twist,
            frames=None if np.isnan(frames).all() else frames,
            neighbours=None if (neighbours < 0).all() else neighbours,
            frame_rate=rates[0] if rates else math.nan,
            row_time=known[0].row_time,
        )
    )


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
                ("scale", words.number(self.similarity.scale)),
                ("rms", f"{pixels(self.rms_pixels)} px at joined points"),
                ("points", f"{counts.num_points_joined} joined, {counts.num_points_added} added"),
                ("images", f"{counts.num_images} added"),
            ),
        )
