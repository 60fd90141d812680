"""Seeded scenes of known lens, sharing and noise, on which a choice of the camera model is judged.

A scene has a layout (around an object, an aerial block, along a facade), 3 to 60 images, and a lens
whose terms move the corner of the image by 0.02 to 40 px. The truth says which pixels the lens
produces without noise, at the observations and at further visible points of the images.

Effects that no candidate describes: rows of an image move linearly with the height (a rolling
shutter under constant motion), points occur twice with the same measurements, observations are
outliers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import bundle
from bundle import Problem
from bundle.judging.validation.validate_problem import FEWEST_HELD_OUT
from bundle.model.folds import folds_of

Array = NDArray[np.float64]

MODELS = (
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "FULL_OPENCV",
    "OPENCV_FISHEYE",
)
LAYOUTS = ("object", "aerial", "facade")
SHARING = ("all", "size", "each", "focal")
SIZES = ((1600, 1200), (1920, 1080), (1200, 1600))
FEWEST = 40
"""Observations of an image, at least."""


@dataclass(frozen=True, eq=False, kw_only=True)
class JudgeScene:
    """A scene and its truth.

    Attributes:
        seed: seed of the scene.
        facts: model, sharing, layout and noise, by name.
        problem: start of the candidates: SIMPLE_RADIAL (fisheye: OPENCV_FISHEYE) near the truth.
        truth: the same observations with the true poses, points and cameras.
        is_clean: (num_points,) True for points without an outlier.
        true_xy: (num_observations, 2) true pixels of the observations, without noise and row shift.
        image, point: (n,) indices of visible image-point pairs, observed or not.
        xy: (n, 2) their true pixels, likewise.
        centers: (num_images, 3) true projection centres.
    """

    seed: int
    facts: dict
    problem: Problem
    truth: Problem
    is_clean: NDArray[np.bool_]
    true_xy: Array
    image: NDArray[np.int64]
    point: NDArray[np.int64]
    xy: Array
    centers: Array


def make(seed: int) -> JudgeScene:
    """Draw a scene. Further attempts follow if its images see too few points in common."""
    for attempt in range(500):
        if attempt % 50 == 0:
            facts = _draw_facts(seed, np.random.default_rng([seed, attempt] if attempt else seed))
        most = 6000 / facts["num_images"] + 40
        facts["per_image"] = int(min(1.1 * facts["per_image"], most))
        found = _attempt(seed, np.random.default_rng([seed, attempt]), dict(facts))
        if found is not None:
            return found
    raise AssertionError(f"seed {seed}: no scene")


def _attempt(seed: int, rng: np.random.Generator, facts: dict) -> JudgeScene | None:
    n = facts["num_images"]
    rotations, centers, points = _layout(rng, facts)
    models, params, sizes, image_camera = _cameras(rng, facts)
    image, point, xy = _visible(rotations, centers, points, models, params, sizes, image_camera)
    chosen = _tracks(rng, facts, image, point, len(points))
    if chosen is None or np.bincount(image[chosen], minlength=n).min() < FEWEST:
        return None
    kept = np.unique(point[chosen])
    number = np.full(len(points), -1)
    number[kept] = np.arange(len(kept))
    inside = number[point] >= 0
    of_chosen = np.flatnonzero(chosen[inside])
    image, point, xy = image[inside], number[point[inside]], xy[inside]
    points = points[kept]

    seen_image, seen_point = image[of_chosen], point[of_chosen]
    measured, is_outlier = _measure(rng, facts, xy[of_chosen], seen_image, sizes[image_camera])
    is_clean = np.bincount(seen_point, weights=is_outlier, minlength=len(points)) == 0
    truth = Problem(
        cam_from_world=_poses(rotations, centers),
        image_ids=np.arange(1, n + 1),
        image_names=[f"image{i:03d}.jpg" for i in range(n)],
        image_camera=image_camera,
        camera_ids=np.arange(1, len(params) + 1),
        camera_models=models,
        camera_params=params,
        camera_sizes=sizes,
        points=points,
        point_ids=np.arange(1, len(points) + 1),
        observation_image=seen_image,
        observation_point=seen_point,
        observation_xy=measured,
        observation_keypoint=np.full(len(seen_image), -1),
        format="colmap",
    )
    true_xy = xy[of_chosen]
    if (folds_of(truth) >= 0).sum() < FEWEST_HELD_OUT:
        return None
    if facts["duplicated"]:
        truth, rows, twins = _duplicate(rng, truth, facts["duplicated"])
        true_xy = np.concatenate([true_xy, true_xy[rows]])
        is_clean = np.concatenate([is_clean, is_clean[twins]])
    return JudgeScene(
        seed=seed,
        facts=facts,
        problem=_start(rng, truth, facts),
        truth=truth,
        is_clean=is_clean,
        true_xy=true_xy,
        image=image,
        point=point,
        xy=xy,
        centers=centers,
    )


def _draw_facts(seed: int, rng: np.random.Generator) -> dict:
    """Draw kind and amounts; every tenth seed each: rows shifted, points duplicated."""
    rows, twins = seed % 5 == 3, seed % 10 == 7
    sharing = str(rng.choice(SHARING, p=(0.5, 0.1, 0.25, 0.15)))
    num_images = int(np.exp(rng.uniform(np.log(3), np.log(60))).round())
    sigma = float(np.exp(rng.uniform(np.log(0.2), np.log(2.0))))
    return {
        "model": str(rng.choice(MODELS, p=(0.08, 0.08, 0.2, 0.16, 0.22, 0.14, 0.12))),
        "sharing": "all" if rows else "all" if num_images < 4 and sharing == "size" else sharing,
        "layout": str(rng.choice(LAYOUTS)),
        "num_images": num_images,
        "per_image": int(min(np.exp(rng.uniform(np.log(90), np.log(400))), 5000 / num_images)),
        "track": float(rng.uniform(2.3, 8.0)),
        "two_view": float(rng.choice([0.0, 0.2, 0.5])),
        "sigma": sigma,
        "tails": str(rng.choice(["gaussian", "student"], p=(0.65, 0.35))),
        "outliers": float(rng.choice([0.0, 0.0, 0.02, 0.05, 0.15])),
        "rows": float(rng.uniform(2.0, 5.0) * sigma) if rows else 0.0,
        "duplicated": float(rng.choice([0.1, 0.3])) if twins else 0.0,
    }


def _layout(rng: np.random.Generator, facts: dict) -> tuple[Rotation, Array, Array]:
    """Return camera-from-world rotations, centres, and points."""
    n = facts["num_images"]
    wanted = max(int(1.5 * n * facts["per_image"] / facts["track"]), 150)
    if facts["layout"] == "object":
        span = rng.uniform(0.25, 1.0) * 2 * np.pi * min(1.0, n / 12)
        around = np.sort(rng.uniform(0, span, n)) if n > 6 else np.linspace(0, span, n)
        up = rng.uniform(-0.2, 0.7, n)
        distance = rng.uniform(2.6, 4.0, n)
        centers = distance[:, None] * np.stack(
            [np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], 1
        )
        target = rng.normal(0, 0.15, (n, 3))
        points = rng.normal(size=(wanted, 3))
        points *= (rng.uniform(0.3, 1.3, wanted) / np.linalg.norm(points, axis=1))[:, None]
    elif facts["layout"] == "aerial":
        columns = int(np.ceil(np.sqrt(n)))
        grid = np.stack([np.arange(n) % columns, np.arange(n) // columns], 1) * rng.uniform(
            0.2, 0.4
        )
        centers = np.c_[grid + rng.normal(0, 0.02, (n, 2)), rng.normal(1.0, 0.03, n)]
        target = np.c_[centers[:, :2] + rng.normal(0, 0.08, (n, 2)), np.zeros(n)]
        low, high = grid.min(0) - 0.4, grid.max(0) + 0.4
        points = np.c_[rng.uniform(low, high, (wanted, 2)), np.zeros(wanted)]
        points[:, 2] = rng.uniform(0.02, 0.25) * rng.uniform(-1, 1, wanted)
    else:
        along = np.arange(n) * rng.uniform(0.2, 0.5)
        centers = np.c_[along, rng.normal(-1.5, 0.2, n), rng.normal(0, 0.2, n)]
        target = np.c_[along + rng.normal(0, 0.3, n), np.zeros(n), rng.normal(0, 0.15, n)]
        points = np.c_[
            rng.uniform(along[0] - 1, along[-1] + 1, wanted),
            rng.uniform(-0.4, 0.8, wanted),
            rng.uniform(-1, 1, wanted),
        ]
    return _looking(rng, centers, target, aerial=facts["layout"] == "aerial"), centers, points


def _looking(rng: np.random.Generator, centers: Array, target: Array, *, aerial: bool) -> Rotation:
    """Return rotations that look at the targets, some turned by 90 degrees about the axis."""
    forward = target - centers
    forward /= np.linalg.norm(forward, axis=1)[:, None]
    right = np.cross(forward, [0.0, 1.0, 0.0] if aerial else [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1)[:, None]
    looking = Rotation.from_matrix(np.stack([right, np.cross(forward, right), forward], 1))
    turns = rng.choice([0.0, np.pi / 2, np.pi], len(centers), p=(0.7, 0.15, 0.15))
    turns += rng.normal(0, 0.05, len(centers))
    return Rotation.from_rotvec(np.c_[np.zeros((len(centers), 2)), turns]) * looking


def _cameras(
    rng: np.random.Generator, facts: dict
) -> tuple[list[str], Array, NDArray[np.int64], NDArray[np.int64]]:
    """Return models, parameters and sizes of the cameras, and the camera of each image."""
    n, model, sharing = facts["num_images"], facts["model"], facts["sharing"]
    count = {"all": 1, "size": 2, "each": n, "focal": n}[sharing]
    image_camera = np.zeros(n, int) if count == 1 else np.arange(n) % count
    size = SIZES[int(rng.integers(len(SIZES)))]
    sizes = np.tile(size, (count, 1))
    if sharing == "size":
        sizes[1] = (1280, 960)
    names = bundle.camera_models()[model]
    wide = "FISHEYE" in model
    width = sizes.max(1)
    f = rng.uniform(0.4, 0.55) * width if wide else rng.uniform(0.7, 1.5) * width
    f = f * (1 + (rng.uniform(0.005, 0.03) * rng.normal(size=count) if sharing != "all" else 0.0))
    # Where only the focal length is an image's own, the coefficients are those of the mean one.
    common = f if sharing != "focal" else np.full(count, f.mean())
    corner = np.hypot(*sizes.T) / 2 / common
    corner = np.arctan(corner) if wide else corner
    moved = {
        name: rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(0.02), np.log(8))) for name in names
    }
    moved["k"] = moved["k1"] = -np.exp(rng.uniform(np.log(1.0), np.log(40.0)))
    if sharing == "each":
        spread = np.exp(rng.uniform(np.log(0.05), np.log(0.5)))
        moved = {name: e * (1 + spread * rng.normal(size=count)) for name, e in moved.items()}
    elif sharing == "size":
        moved = {name: e * rng.uniform(0.5, 1.5, count) for name, e in moved.items()}
    power = {"k": 3, "k1": 3, "k2": 5, "k3": 7, "k4": 3, "k5": 5, "k6": 7, "p1": 2, "p2": 2}
    if wide:
        power |= {"k3": 7, "k4": 9}
    params = np.zeros((count, len(names)))
    for column, name in enumerate(names):
        if name in ("f", "fx", "fy"):
            params[:, column] = f + (moved["fy"] / (width / 2) * f if name == "fy" else 0)
        elif name in ("cx", "cy"):
            params[:, column] = sizes[:, int(name == "cy")] / 2
        else:
            params[:, column] = moved[name] / (common * corner ** power[name])
    return [model] * count, params, sizes, image_camera


def _visible(
    rotations: Rotation,
    centers: Array,
    points: Array,
    models: list[str],
    params: Array,
    sizes: NDArray[np.int64],
    image_camera: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return all pairs of image and point inside of the image, with their pixels."""
    found = []
    for index, camera in enumerate(image_camera):
        local = rotations[index].apply(points - centers[index])
        xy, valid = bundle.project(models[camera], params[camera], local)
        angle = np.arctan2(np.hypot(local[:, 0], local[:, 1]), local[:, 2])
        with np.errstate(invalid="ignore"):
            inside = ((xy > 0) & (xy < sizes[camera])).all(1) & valid & (angle < 1.3)
        # A lens polynomial folds far outside of the image.
        straight = _straight(params[camera], models[camera])
        rows = np.flatnonzero(inside & (angle < straight) & (local[:, 2] > 0.05))
        found.append((np.full(len(rows), index), rows, xy[rows]))
    image, point, xy = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return image, point, xy


def _straight(params: Array, model: str) -> float:
    """Return the largest angle up to which the lens of a camera does not fold."""
    angle = np.linspace(0, 1.4, 141)
    rays = np.c_[np.sin(angle), np.zeros(len(angle)), np.cos(angle)]
    x = bundle.project(model, params, rays)[0][:, 0]
    rising = np.diff(x) > 0
    return float(angle[len(rising) if rising.all() else int(np.argmin(rising))])


def _tracks(
    rng: np.random.Generator,
    facts: dict,
    image: NDArray[np.int64],
    point: NDArray[np.int64],
    num_points: int,
) -> NDArray[np.bool_] | None:
    """Choose the observed pairs: track lengths are 2 for a share of points, else geometric."""
    length = 2 + rng.geometric(1 / max(facts["track"] - 1, 1.01), num_points) - 1
    length[rng.random(num_points) < facts["two_view"]] = 2
    order = np.lexsort((rng.random(len(point)), point))
    starts = np.searchsorted(point[order], np.arange(num_points))
    rank = np.empty(len(point), int)
    rank[order] = np.arange(len(point)) - starts[point[order]]
    chosen = rank < length[point]
    count = np.bincount(point[chosen], minlength=num_points)
    chosen &= count[point] >= 2
    seen = np.bincount(image[chosen], minlength=facts["num_images"])
    return chosen if (seen > 0).all() and _is_connected(image, point, chosen) else None


def _is_connected(
    image: NDArray[np.int64], point: NDArray[np.int64], chosen: NDArray[np.bool_]
) -> bool:
    """Check that images are connected by steps of at least 15 common points."""
    table = np.zeros((image.max() + 1, point.max() + 1))
    table[image[chosen], point[chosen]] = 1
    linked = table @ table.T >= 15
    reached = linked[0]
    for _ in range(len(linked)):
        reached = linked[reached].any(0)
    return bool(reached.all())


def _measure(
    rng: np.random.Generator, facts: dict, xy: Array, image: NDArray[np.int64], sizes: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Add row shifts, noise and outliers to true pixels."""
    motion = facts["rows"] * rng.normal(size=(facts["num_images"], 2))
    height = sizes[image, 1]
    noise = rng.normal(size=xy.shape)
    if facts["tails"] == "student":
        noise = noise / np.sqrt(rng.chisquare(4, len(xy)) / 4)[:, None]
    out = xy + facts["sigma"] * noise + motion[image] * (xy[:, 1] / height - 0.5)[:, None]
    is_outlier = rng.random(len(xy)) < facts["outliers"]
    far = rng.uniform(8, 100, len(xy)) * facts["sigma"]
    angle = rng.uniform(0, 2 * np.pi, len(xy))
    out += (is_outlier * far)[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    return out, is_outlier


def _duplicate(
    rng: np.random.Generator, truth: Problem, share: float
) -> tuple[Problem, NDArray[np.int64], NDArray[np.int64]]:
    """Append copies of a share of the points; return their observations and points, too."""
    twins = np.flatnonzero(rng.random(truth.num_points) < share)
    number = np.full(truth.num_points, -1)
    number[twins] = truth.num_points + np.arange(len(twins))
    rows = np.flatnonzero(number[truth.observation_point] >= 0)
    appended = {
        name: np.concatenate([getattr(truth, name), getattr(truth, name)[rows]])
        for name in ("observation_image", "observation_xy", "observation_keypoint")
    }
    points = np.concatenate([truth.points, truth.points[twins]])
    problem = truth.replace(
        points=points,
        point_ids=np.arange(1, len(points) + 1),
        observation_point=np.concatenate(
            [truth.observation_point, number[truth.observation_point[rows]]]
        ),
        **appended,
    )
    return problem, rows, twins


def _poses(rotations: Rotation, centers: Array) -> Array:
    return np.hstack([rotations.as_quat(), -rotations.apply(centers)])


def _start(rng: np.random.Generator, truth: Problem, facts: dict) -> Problem:
    """Move poses, points and focal lengths a little, and simplify the lens."""
    n = truth.num_images
    rotations = Rotation.from_quat(truth.cam_from_world[:, :4].copy())
    centers = -rotations.inv().apply(truth.cam_from_world[:, 4:].copy())
    turned = Rotation.from_rotvec(2e-3 * rng.normal(size=(n, 3))) * rotations
    moved = centers + 0.004 * rng.normal(size=(n, 3))
    start = truth.replace(
        cam_from_world=_poses(turned, moved),
        points=truth.points + 0.004 * rng.normal(size=truth.points.shape),
    )
    if "FISHEYE" not in facts["model"]:
        start = bundle.change_camera_model(start, "SIMPLE_RADIAL").problem
    params = start.camera_params.copy()
    params[:, 0] *= 1 + 0.003 * rng.normal(size=len(params))
    start = start.replace(camera_params=params)
    if facts["sharing"] in ("all", "size") and rng.random() < 0.5:
        start = bundle.split_cameras(start)
    return start
