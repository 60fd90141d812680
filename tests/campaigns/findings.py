"""Findings on seeded scenes with zero to three planted faults: precision and recall per kind.

python -m tests.campaigns.findings COUNT [SEED]

A scene is synthesised, spoiled, solved with default options, and judged as `bundle refine` judges
its result. Seeds below 40,000 were used to choose thresholds; docs/findings.md cites scenes
from seed 40,000. Planted faults are large enough to matter; the functions below say how large.
Faults about the same numbers, such as motion and a lens per image, are not planted together
(EXCLUSIVE).
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from math import sqrt
from typing import Any

import numpy as np

import bundle
from bundle.interface.finding import Finding
from bundle.judging.findings.find import find
from bundle.model.residuals import residuals

KINDS = (
    *("outliers", "lens_model", "motion", "image_residuals", "shared_lens"),
    *("undetermined_intrinsics", "focal_drift", "duplicate_points", "weak_joint"),
    *("positions", "scale_drift", "not_refined"),
)
PINHOLES = {"SIMPLE_PINHOLE", "PINHOLE"}


@dataclass
class Scene:
    """A scene while it is spoiled.

    Attributes:
        rng: random numbers of the scene.
        truth: the true poses, points and cameras, with exact observations.
        start: start of the solve.
        noise: standard deviation of a coordinate [px].
        offsets: (n, 2) what is added to the exact observations [px].
        priors: measured positions.
        planted: kinds of the faults.
        is_solved: False if the start is judged.
    """

    rng: np.random.Generator
    truth: bundle.Problem
    start: bundle.Problem
    noise: float
    offsets: np.ndarray
    priors: list[bundle.PositionPrior] = field(default_factory=list)
    planted: set[str] = field(default_factory=set)
    is_solved: bool = True
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def shared(self) -> bool:
        """True if all images have one camera."""
        return self.truth.num_cameras == 1

    @property
    def xy(self) -> np.ndarray:
        """Positions from the image centre in halves of the longer side."""
        size = self.truth.camera_sizes[self.truth.image_camera[self.truth.observation_image]]
        return (self.truth.observation_xy - size / 2) / (size.max(axis=1, keepdims=True) / 2)

    def keep(self, mask: np.ndarray) -> None:
        """Drop observations, and points that fewer than two images observe."""
        while True:
            count = np.bincount(self.truth.observation_point[mask], minlength=self.truth.num_points)
            better = mask & (count >= 2)[self.truth.observation_point]
            if better.sum() == mask.sum():
                break
            mask = better
        seen = np.zeros(self.truth.num_points, bool)
        seen[self.truth.observation_point[mask]] = True
        self.truth, self.start = (
            one.select(observations=mask, points=seen).problem for one in (self.truth, self.start)
        )
        self.offsets = self.offsets[mask]


def outliers(scene: Scene) -> None:
    """Displace 2 to 8 % of the observations by 15 to 60 px."""
    rng, n = scene.rng, len(scene.offsets)
    chosen = rng.random(n) < rng.uniform(0.02, 0.08)
    angle, length = rng.uniform(0, 2 * np.pi, n), rng.uniform(15, 60, n)
    scene.offsets[chosen] += (length[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1))[chosen]


def lens_model(scene: Scene) -> None:
    """Add a radial or tangential field; its part beyond rotation and k1 is 0.6 to 1.5 sigma."""
    x, y = scene.xy.T
    square = x * x + y * y
    model = scene.truth.camera_models[0]
    power = 3 if model == "RADIAL" else 2
    if scene.rng.random() < 0.6 or model in PINHOLES:
        flat = np.concatenate([x * square**power, y * square**power])
    else:
        flat = np.concatenate([square + 2 * x * x, 2 * x * y])
    one, zero = np.ones_like(x), np.zeros_like(x)
    known = [[one, zero], [zero, one], [-y, x], [x, y], [x * square, y * square]]
    known += [[x * x, x * y], [x * y, y * y]]  # rotations
    known += [[x * square**2, y * square**2]] if model == "RADIAL" else []
    columns = np.array([np.concatenate(pair) for pair in known]).T
    left = flat - columns @ np.linalg.lstsq(columns, flat, rcond=None)[0]
    size = scene.rng.uniform(0.6, 1.5) * scene.noise / np.sqrt((left**2).mean())
    scene.offsets += size * flat.reshape(2, -1).T


def motion(scene: Scene) -> None:
    """Shift rows: each image by its own vector of 4 to 8 sigma, times the row in the image."""
    size = scene.rng.uniform(4, 8) * scene.noise
    shift = size * scene.rng.standard_normal((scene.truth.num_images, 2))
    scene.offsets += shift[scene.truth.observation_image] * scene.xy[:, 1:]


def image_residuals(scene: Scene) -> None:
    """Give one or two well observed images three times the noise."""
    count = np.bincount(scene.truth.observation_image, minlength=scene.truth.num_images)
    usable = np.flatnonzero(count >= 60)
    chosen = scene.rng.choice(usable, min(int(scene.rng.integers(1, 3)), len(usable)), False)
    rows = np.isin(scene.truth.observation_image, chosen)
    scene.offsets[rows] *= 3.0


def shared_lens(scene: Scene) -> None:
    """Give each image a camera of its own, of the same lens."""
    scene.truth = bundle.split_cameras(scene.truth)
    scene.start = bundle.split_cameras(scene.start)


def undetermined_intrinsics(scene: Scene) -> None:
    """Move the cameras away 80 to 160 fold with focal lengths that are as much longer."""
    factor = scene.rng.uniform(80, 160)
    scene.truth, scene.start = (_telephoto(one, factor) for one in (scene.truth, scene.start))


def _telephoto(problem: bundle.Problem, factor: float) -> bundle.Problem:
    depth = np.median(np.linalg.norm(problem.projection_centers - problem.points.mean(0), axis=1))
    poses, params = problem.cam_from_world.copy(), problem.camera_params.copy()
    poses[:, 6] += (factor - 1) * depth
    focal = 2 if problem.camera_models[0] in ("PINHOLE", "OPENCV") else 1
    params[:, :focal] *= factor
    if problem.camera_models[0] not in PINHOLES:
        params[:, focal + 2 :] = 0.0
    return problem.replace(cam_from_world=poses, camera_params=params)


def focal_drift(scene: Scene) -> None:
    """Let the focal lengths of the images grow by 6 to 12 % in their order."""
    scene.truth, scene.start = map(bundle.split_cameras, (scene.truth, scene.start))
    params = scene.truth.camera_params.copy()
    order = np.empty(scene.truth.num_cameras)
    order[scene.truth.image_camera] = np.linspace(-0.5, 0.5, scene.truth.num_images)
    focal = 2 if scene.truth.camera_models[0] in ("PINHOLE", "OPENCV") else 1
    params[:, :focal] *= 1 + scene.rng.uniform(0.06, 0.12) * order[:, None]
    scene.truth = scene.truth.replace(camera_params=params)


def duplicate_points(scene: Scene) -> None:
    """Observe 20 to 40 % of the points twice, at the same pixels."""
    truth, rng = scene.truth, scene.rng
    chosen = rng.random(truth.num_points) < rng.uniform(0.2, 0.4)
    rows = np.flatnonzero(chosen[truth.observation_point])
    number = np.cumsum(chosen) - 1 + truth.num_points

    def doubled(problem: bundle.Problem) -> bundle.Problem:
        points = np.concatenate([problem.points, problem.points[chosen]])
        seen = problem.observation_point
        return bundle.Problem(
            format="colmap",
            cam_from_world=problem.cam_from_world,
            image_camera=problem.image_camera,
            image_ids=problem.image_ids,
            image_names=problem.image_names,
            camera_models=problem.camera_models,
            camera_params=problem.camera_params,
            camera_sizes=problem.camera_sizes,
            camera_ids=problem.camera_ids,
            points=points,
            point_ids=np.arange(1, len(points) + 1),
            observation_image=np.concatenate(
                [problem.observation_image, problem.observation_image[rows]]
            ),
            observation_point=np.concatenate([seen, number[seen[rows]]]).astype(np.int32),
            observation_xy=np.concatenate([problem.observation_xy, problem.observation_xy[rows]]),
        )

    scene.truth, scene.start = doubled(scene.truth), doubled(scene.start)
    scene.offsets = np.concatenate([scene.offsets, scene.offsets[rows]])


def weak_joint(scene: Scene) -> None:
    """Leave 6 to 11 points that both halves of the images observe."""
    truth = scene.truth
    second = (truth.observation_image >= truth.num_images // 2).astype(int)
    count = np.zeros((truth.num_points, 2), int)
    np.add.at(count, (truth.observation_point, second), 1)
    across = np.flatnonzero((count > 0).all(axis=1))
    kept = scene.rng.choice(across, min(int(scene.rng.integers(6, 12)), len(across)), False)
    cut = np.isin(truth.observation_point, np.setdiff1d(across, kept))
    side = count.argmax(axis=1)[truth.observation_point]
    scene.keep(~cut | (second == side))


def positions(scene: Scene) -> None:
    """Displace one to three measured positions by 12 to 30 sigma, or understate all sigmas."""
    rng = scene.rng
    if rng.random() < 0.5:
        for row in rng.choice(len(scene.priors), int(rng.integers(1, 4)), False).tolist():
            prior = scene.priors[row]
            offset = rng.standard_normal(3)
            offset *= rng.uniform(12, 30) * np.max(prior.sigma) / np.linalg.norm(offset)
            scene.priors[row] = _prior(prior.image, prior.position + offset, prior.sigma)
    else:
        factor = rng.uniform(4, 8)
        scene.priors = [_prior(one.image, one.position, one.sigma / factor) for one in scene.priors]


def scale_drift(scene: Scene) -> None:
    """Let the scale of the measured positions grow by 15 to 30 % along the images."""
    centers = scene.truth.projection_centers
    rate = np.linspace(0.0, scene.rng.uniform(0.3, 0.5), len(centers))
    steps = np.diff(centers, axis=0, prepend=centers[:1]) * (1 + rate[:, None])
    moved = centers[0] + np.cumsum(steps, axis=0)
    sigma = scene.priors[0].sigma
    noise = sigma * scene.rng.standard_normal(centers.shape)
    scene.priors = [
        _prior(int(image), position, sigma)
        for image, position in zip(scene.truth.image_ids, moved + noise, strict=True)
    ]


def not_refined(scene: Scene) -> None:
    """Judge the start."""
    scene.is_solved = False


def _different(problem: bundle.Problem, rng: np.random.Generator) -> bundle.Problem:
    """Return cameras whose focal lengths differ by about 10 %."""
    params = problem.camera_params.copy()
    focal = 2 if problem.camera_models[0] in ("PINHOLE", "OPENCV") else 1
    params[:, :focal] *= rng.uniform(0.85, 1.15, (problem.num_cameras, 1))
    return problem.replace(camera_params=params)


def _prior(image: Any, position: Any, sigma: Any) -> bundle.PositionPrior:
    return bundle.PositionPrior(image, position, sigma)


PLANT: dict[str, Callable[[Scene], None]] = {name: globals()[name] for name in KINDS}
FIRST = (
    *("undetermined_intrinsics", "shared_lens", "focal_drift", "image_residuals"),
    *("duplicate_points", "weak_joint"),
)
"""Faults of the scene and its noise, planted first."""
LENS = {"shared_lens", "undetermined_intrinsics", "focal_drift"}
GPS = {"positions", "scale_drift"}
EXCLUSIVE = (
    LENS,
    GPS,
    {"motion", "image_residuals"},
    {"motion", "lens_model"},
    {"motion", *LENS},
    {"lens_model", "undetermined_intrinsics"},
    {"weak_joint", "scale_drift"},
)
"""Faults of which a scene has at most one: they are about the same numbers."""


def draw(rng: np.random.Generator) -> tuple[str, ...]:
    """Return zero to three faults that can be planted together."""
    wanted = int(rng.integers(0, 4))
    if rng.random() < 0.04:
        return ("not_refined",)
    faults: list[str] = []
    for name in rng.permutation([kind for kind in KINDS if kind != "not_refined"]).tolist():
        clash = any(
            name in group and group & set(faults) and {name, *faults} & group != {name}
            for group in EXCLUSIVE
        )
        if len(faults) < wanted and not clash:
            faults.append(name)
    return tuple(faults)


def make(seed: int, faults: tuple[str, ...] | None = None) -> Scene:
    """Return the spoiled scene of a seed: the first possible one of its faults."""
    wanted = draw(np.random.default_rng(seed)) if faults is None else faults
    for attempt in range(50):
        try:
            scene = _scene(np.random.default_rng([seed, attempt]), wanted)
            judge(scene) if scene.priors else None
        except bundle.InputError:  # too few points in view, or positions on one line
            continue
        return scene
    raise ValueError(f"seed {seed}: no scene with {wanted}")


def _scene(rng: np.random.Generator, wanted: tuple[str, ...]) -> Scene:
    needs_gps, in_order = bool(GPS & set(wanted)), {"weak_joint", "scale_drift"} & set(wanted)
    num_images = int(rng.integers(14, 31))
    individual = bool(rng.random() < 0.25) and not LENS & set(wanted)
    is_street = bool(in_order) or bool(rng.random() < 0.5)
    kind = "street" if is_street and not individual and not LENS & set(wanted) else "orbit"
    made = bundle.synthesize(
        scene=kind,
        num_images=num_images,
        num_points=num_images * int(rng.integers(50, 90)),
        mean_track_length=float(rng.uniform(4, 6)),
        camera_model=str(rng.choice(["SIMPLE_RADIAL", "SIMPLE_RADIAL", "RADIAL", "PINHOLE"])),
        cameras="individual" if individual else "shared",
        pixel_noise=0.0,
        seed=int(rng.integers(2**31)),
        **({"loop_closure": False} if "weak_joint" in wanted and kind == "street" else {}),
    )
    truth = _different(made.ground_truth, rng) if individual else made.ground_truth
    noise = float(rng.uniform(0.3, 1.0))
    scene = Scene(rng, truth, made.problem, noise, np.zeros((0, 2)))
    heavy = rng.random() < 0.3
    scene.offsets = (
        rng.standard_t(8, (truth.num_observations, 2)) * noise
        if heavy
        else (noise * rng.standard_normal((truth.num_observations, 2)))
    )
    for name in FIRST:
        if name in wanted:
            PLANT[name](scene)
    if needs_gps or rng.random() < 0.3:
        centers = scene.truth.projection_centers
        step = float(np.median(np.linalg.norm(np.diff(centers, axis=0), axis=1)))
        sigma = step * rng.uniform(0.02, 0.1)
        given = centers + sigma * rng.standard_normal(centers.shape)
        scene.priors = [
            _prior(int(image), position, sigma)
            for image, position in zip(scene.truth.image_ids, given, strict=True)
        ]
    for name in wanted:
        if name not in FIRST:
            PLANT[name](scene)
    scene.planted = set(wanted)
    exact = scene.truth.observation_xy + residuals(scene.truth, "algebraic").xy
    observed = exact + scene.offsets
    good = np.isfinite(observed).all(axis=1)
    scene.start = scene.start.replace(observation_xy=np.where(good[:, None], observed, 0.0))
    return scene


def judge(scene: Scene) -> tuple[Finding, ...]:
    """Return the findings about the solved scene."""
    if not scene.is_solved:
        return find(scene.start)
    known = {"priors": scene.priors, "align": True} if scene.priors else {}
    result = bundle.solve(scene.start, num_threads=1, max_num_iterations=200, **known)
    return find(result.problem, options=result.options, priors=scene.priors)


def interval(good: int, total: int) -> str:
    """Return a share with its 95 % interval of Wilson."""
    if not total:
        return "    -"
    p, z = good / total, 1.96
    middle = (p + z * z / (2 * total)) / (1 + z * z / total)
    half = z * sqrt(p * (1 - p) / total + z * z / (4 * total**2)) / (1 + z * z / total)
    return f"{p:.3f} ({middle - half:.3f} to {middle + half:.3f}, {good} of {total})"


def main() -> int:
    """Print the figures of as many scenes as asked."""
    count, seed = int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0
    right, missed, wrong = Counter(), Counter(), Counter()
    for number in range(seed, seed + count):
        try:
            scene = make(number)
            found = judge(scene)
        except bundle.InputError as error:
            print(f"{number}: no scene: {error}", flush=True)
            continue
        kinds = {finding.kind for finding in found}
        for kind in kinds & scene.planted:
            right[kind] += 1
        for kind in scene.planted - kinds:
            missed[kind] += 1
        for kind in kinds - scene.planted:
            wrong[kind] += 1
        if kinds != scene.planted:
            lost = ", ".join(sorted(scene.planted - kinds)) or "-"
            said = [f"{f.kind}: {f.sentence}" for f in found if f.kind not in scene.planted]
            print(f"{number}: planted {sorted(scene.planted)}; missed {lost}; wrong {said}")
            sys.stdout.flush()
    print("kind: precision | recall")
    for kind in (*KINDS, "all"):
        good, lost, false = (
            sum(table.values()) if kind == "all" else table[kind]
            for table in (right, missed, wrong)
        )
        print(f"{kind:24} {interval(good, good + false)} | {interval(good, good + lost)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
