"""Time of a step of a bundle adjustment: counts of its work, and the solves that calibrate them.

The work of a step is what ``find_pattern`` and ``FactorCounter`` count, by the features below; the
numbers hold for blocks of 9 camera parameters, and larger blocks count more. Rates of the features
are fitted to solves of small scenes in about a second (``machine_rates``). The time of the linear
solver is fitted separately from the rest of the step.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Mapping
from time import perf_counter

import numpy as np

import bundle._core as _core
from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.planning.inspection.machine_rates import Rates, Work, cached_rates, fitted
from bundle.planning.inspection.peak_memory import FactorCounter, FactorizedSystem
from bundle.planning.inspection.problem_pattern import FactorCount, ProblemPattern, find_pattern

FEATURES = (
    # Flops of factorisations with one BLAS thread and with all, and entries of their factors:
    # dense, dense with threads, and sparse. Panels of sparse factors are too narrow for threads.
    *("flop", "threaded_flop", "dense_entry", "threaded_entry", "sparse_entry"),
    "reduced_byte",  # read of S by conjugate gradients, or written
    "fused_step",  # constant cost of a step: starting threads, the trust region
    "fused_observation",  # linearise, back-substitute and evaluate an observation
    "fused_pair",  # block product of two observations of a point
    "fused_scattered_pair",  # add a pair of images of a chunk to an S larger than the caches
    "ceres_step",
    "ceres_evaluation",  # evaluate an observation, and all work outside the linear solver
    "ceres_elimination",  # eliminate and back-substitute an observation
    "ceres_pair",  # two blocks that observe a point, in kernels of fixed size
    "ceres_dynamic_pair",  # the same in kernels of dynamic size
    "ceres_reduced_value",  # find, convert and copy a value of a sparse S
    "ceres_product",  # an observation in an implicit product with S
    "ceres_normal_entry",  # update an entry of the full system's factor to eliminate a point
)

OF_LINEAR_SOLVERS = (
    *("factorisation", "conjugate gradients", "elimination", "reduced system", "normal equations"),
)
"""Terms that a solver reports as the time of its linear solver."""


def problem_rates(num_threads: int, *, recalibrate: bool = False) -> Rates:
    """Return the rates for solves on ``num_threads`` threads; measure them unless cached."""
    return cached_rates("problem", FEATURES, num_threads, calibrate, recalibrate=recalibrate)


PRODUCTS_PER_STEP, PRODUCTS_WITH_TWO_LEVELS = 200, 80
"""Assumed products with S per step by conjugate gradients. Measurements range from 2 to 500,
most of them in late steps; with two levels from 2 to 100 (cpp/core/prepare/choose_solver.cpp).
"""

POWER_SERIES_PRODUCTS = 6  # products of one iteration with the power series as preconditioner

_MOST_PASSES, _PASSES_OF_FULL_SYSTEM = 240.0, 30.0
"""Assumed passes over the observations per step without S, as in choose_solver.cpp."""
_TIME_OF_A_PASS = 2.5
"""Time of such a pass relative to that of linearising and evaluating the observations (measured
with 72,000 observations of 900 images)."""

# Blocks that the rates assume: 9 camera parameters, 9 x 12 doubles in chunks.
_COLUMNS, _BLOCK_DOUBLES = 9, 108

# Size from which S does not fit into the caches.
_CACHED_BYTES = 8e6

# Size from which factorisations use BLAS threads: columns of a dense matrix, or entries of the
# average column of a sparse factor (cpp/core/parallel/blas.h, linear/direct_solvers.cpp).
_COLUMNS_WORTH_THREADS = 1000


def factor_work(
    is_dense: bool, num_columns: int, count: FactorCount, num_threads: int
) -> dict[str, float]:
    """Return the work of a factorisation of this kind and size, with its substitutions."""
    size = num_columns if is_dense else count.flops / max(count.nnz, 1)
    if size >= _COLUMNS_WORTH_THREADS and num_threads > 1:
        return {"threaded_flop": count.flops, "threaded_entry": count.nnz}
    is_alone = is_dense or size >= _COLUMNS_WORTH_THREADS
    return {"flop": count.flops, "dense_entry" if is_alone else "sparse_entry": count.nnz}


def fused_work(
    pattern: ProblemPattern,
    linear_solver_type: str,
    counted: FactorizedSystem | None,
    num_threads: int,
    products: float = 0.0,
    coarse_entries: float = 0.0,
) -> Work:
    """Return the work of a step by the fused backend; ``counted`` is the factorised system.

    ``products``: products with S of conjugate gradients. ``coarse_entries``: entries of the factor
    of the coarse system (TWO_LEVEL).
    """
    plan = pattern.plan
    block = plan.block_doubles / _BLOCK_DOUBLES
    is_dense = linear_solver_type == "DENSE_SCHUR"
    if counted is None:
        values = pattern.num_reduced_values
    else:
        values = counted.values if is_dense else counted.panel_values
    work = {
        "observations": {"fused_observation": math.sqrt(block) * plan.num_observations},
        "pairs of observations": {"fused_pair": block * plan.num_pairs},
        "other": {"fused_step": 1.0},
    }
    if 8 * values > _CACHED_BYTES:
        scattered = block * plan.num_chunk_pairs
        work["adding to S"] = {"fused_scattered_pair": scattered, "reduced_byte": 8 * values}
    if counted is not None:
        work["factorisation"] = factor_work(is_dense, counted.columns, counted.factor, num_threads)
    else:
        read = 8 * (values + 2 * coarse_entries)
        work["conjugate gradients"] = {"reduced_byte": products * read}
    return work


def implicit_work(pattern: ProblemPattern) -> Work:
    """Return the work of a step by conjugate gradients without S."""
    plan = pattern.plan
    linearise = math.sqrt(plan.block_doubles / _BLOCK_DOUBLES) * plan.num_observations
    passes = passes_per_step(pattern) * _TIME_OF_A_PASS
    return {
        "observations": {"fused_observation": linearise},
        "conjugate gradients": {"fused_observation": passes * linearise},
        "other": {"fused_step": 1.0},
    }


def ceres_work(
    pattern: ProblemPattern,
    linear_solver_type: str,
    counted: FactorizedSystem | None,
    num_threads: int,
    products: float = 0.0,
) -> Work:
    """Return the work of a step by Ceres; ``counted`` is the factorised system or None."""
    observations = pattern.num_observations
    width = (pattern.nnz_jacobian / (2 * max(observations, 1))) / (3 + _COLUMNS)
    work: dict[str, Mapping[str, float]] = {
        "evaluation": {"ceres_evaluation": width * observations},
        "other": {"ceres_step": 1.0},
    }
    if counted is not None and linear_solver_type == "SPARSE_NORMAL_CHOLESKY":
        work["normal equations"] = {"ceres_normal_entry": pattern.pair_entries}
        updates = 3 * 2 * pattern.pair_entries  # the rate above includes the points' columns
        work["factorisation"] = {"flop": max(counted.factor.flops - updates, 0.0)}
        return work
    pair = "ceres_pair" if pattern.has_equal_blocks else "ceres_dynamic_pair"
    work["elimination"] = {
        "ceres_elimination": width * observations,
        pair: pattern.block_pairs,
    }
    if counted is None:
        work["conjugate gradients"] = {"ceres_product": width * products * observations}
        return work
    if linear_solver_type == "SPARSE_SCHUR":
        work["reduced system"] = {"ceres_reduced_value": counted.values}
    is_dense = linear_solver_type == "DENSE_SCHUR"
    work["factorisation"] = factor_work(is_dense, counted.columns, counted.factor, num_threads)
    return work


def passes_per_step(pattern: ProblemPattern) -> float:
    """Return the assumed number of products without S per step, as in ``choose_solver.cpp``."""
    columns = float(max(pattern.num_camera_columns, 1))
    density = min(2 * pattern.num_reduced_values / columns**2, 1.0)
    return min(_MOST_PASSES, _PASSES_OF_FULL_SYSTEM / density)


def products_per_step(preconditioner: str) -> int:
    """Return the assumed number of products with S per step."""
    if preconditioner == "TWO_LEVEL":
        return PRODUCTS_WITH_TWO_LEVELS
    is_series = preconditioner == "SCHUR_POWER_SERIES_EXPANSION"
    return PRODUCTS_PER_STEP * (POWER_SERIES_PRODUCTS if is_series else 1)


# Calibration: scenes, and the solves of them that are timed.

STEPS = 3
LEAST_REPEATS, MOST_REPEATS, ENOUGH_SECONDS = 2, 12, 0.06

_FOCAL, _DEPTH, _NOISE = 500.0, 10.0, 0.5


def make_scene(
    num_images: int,
    num_points: int,
    track_length: int,
    *,
    scattered: bool = False,
    shared_camera: bool = False,
    seed: int = 0,
) -> Problem:
    """Return a synthetic scene: images along a line, points in front of them, 0.5 px of noise.

    ``track_length``: number of images that observe a point: neighbours, or spread over all images
    if ``scattered``. ``scattered``: True if each image shares points with most other images, in
    random order. ``shared_camera``: True for one camera for all images, instead of one per image.
    """
    rng = np.random.default_rng(seed)
    if scattered:
        # Random steps around the ring of images: distinct while their sum is below its length.
        steps = rng.integers(1, max(num_images // track_length, 2), (num_points, track_length))
        images = (rng.integers(num_images, size=(num_points, 1)) + steps.cumsum(1)) % num_images
    else:
        # Draw from 1.5 times as many neighbours; the order of the points is random.
        reach = min(track_length + track_length // 2, num_images)
        chosen = rng.random((num_points, reach)).argsort(axis=1)[:, :track_length]
        images = rng.integers(num_images - reach + 1, size=(num_points, 1)) + chosen
    images = np.sort(images, axis=1)
    position = np.zeros((num_images, 3))
    position[:, 0] = np.linspace(0.0, 2.0, num_images) if scattered else np.arange(num_images)
    points = np.empty((num_points, 3))
    points[:, 0] = position[images, 0].mean(1) + rng.uniform(-1.0, 1.0, num_points)
    points[:, 1] = rng.uniform(-2.0, 2.0, num_points)
    points[:, 2] = rng.uniform(_DEPTH, 2.0 * _DEPTH, num_points)
    image, point = images.ravel(), np.repeat(np.arange(num_points, dtype=np.int32), track_length)
    seen = points[point] - position[image]
    xy = _FOCAL * seen[:, :2] / seen[:, 2:] + rng.normal(0.0, _NOISE, (len(image), 2))
    poses = np.zeros((num_images, 7))
    poses[:, 3] = 1.0
    poses[:, 4:] = -position
    num_cameras = 1 if shared_camera else num_images
    return Problem(
        cam_from_world=poses,
        image_ids=np.arange(num_images),
        image_names=("",) * num_images,
        image_camera=np.zeros(num_images, np.int32)
        if shared_camera
        else np.arange(num_images, dtype=np.int32),
        camera_ids=np.arange(num_cameras),
        camera_models=("RADIAL",) * num_cameras,
        camera_params=np.tile([_FOCAL, 0.0, 0.0, 0.0, 0.0], (num_cameras, 1)),
        camera_sizes=np.zeros((num_cameras, 2), int),
        points=points,
        point_ids=np.arange(num_points),
        observation_image=image,
        observation_point=point,
        observation_xy=xy,
        observation_keypoint=np.full(len(image), -1),
    )


SCENES = {
    "tiny": (5, 60, 4),
    "short": (40, 2500, 4),
    "long": (40, 500, 20),
    "poses": (40, 1000, 10),
    "few": (30, 150, 15),
    "shared": (40, 500, 20),
    "banded": (300, 1800, 8),
    "scattered": (360, 5000, 6),
    **{f"dense-{images}": (images, 4 * images, 4) for images in (50, 105, 115, 175)},
}
"""Images, points and track length of the scenes; those of three kinds are made accordingly."""

DIRECT = "DENSE_SCHUR"
SOLVES = (
    *(("FUSED", DIRECT, name, "step") for name in ("tiny", "short", "long", "poses")),
    *(("FUSED", DIRECT, name, "solver") for name in ("dense-50", "dense-105")),
    *(("FUSED", DIRECT, name, "threads") for name in ("dense-115", "dense-175")),
    ("FUSED", "SPARSE_SCHUR", "banded", "solver"),
    ("FUSED", "ITERATIVE_SCHUR", "scattered", "both"),
    ("CERES", DIRECT, "tiny", "step"),
    *(("CERES", DIRECT, name, "both") for name in ("short", "long")),
    ("CERES", DIRECT, "shared", "solver"),
    ("CERES", "ITERATIVE_SCHUR", "short", "solver"),
    ("CERES", "SPARSE_SCHUR", "banded", "solver"),
    ("CERES", "SPARSE_NORMAL_CHOLESKY", "few", "solver"),
)
"""Timed solves: backend, linear solver, scene, and which times count: that of the linear solver,
that of the rest of the step, or both; "threads": that of the linear solver with several threads."""


def calibrate(num_threads: int) -> Rates:
    """Measure the rates for solves on ``num_threads`` threads."""
    try:
        return fitted(FEATURES, num_threads, _timed(num_threads))
    except InputError as error:  # scenes and options are valid: memory is the cause
        raise MemoryError(
            "the solves that measure this machine's rates do not fit into the free memory"
        ) from error


def _timed(num_threads: int) -> Iterator[tuple[Work, float]]:
    """Yield work and seconds of the linear solver of each timed solve, and of the rest."""
    scenes = {
        name: make_scene(*size, scattered=name == "scattered", shared_camera=name == "shared")
        for name, size in SCENES.items()
    }
    for backend, solver, name, counts in SOLVES:
        if counts == "threads" and num_threads == 1:
            continue
        scene = scenes[name]
        options = SolveOptions(
            backend=backend.lower(),
            linear_solver_type=solver.lower(),
            num_threads=num_threads,
            # Without free points there are no pairs, which tells both rates apart.
            refine=("poses", "focal", "extra", *([] if name == "poses" else ["points"])),
            max_num_iterations=STEPS,
            function_tolerance=0.0,
            gradient_tolerance=0.0,
            parameter_tolerance=0.0,
            gauge="none",
            cheirality="algebraic",
        )
        pattern = find_pattern(scene, options)
        counter = FactorCounter(scene, options, pattern)
        counted = None
        if solver == "DENSE_SCHUR":
            counted = counter.dense()
        elif solver != "ITERATIVE_SCHUR":
            is_reduced = solver == "SPARSE_SCHUR"
            counted = counter.sparse("amd") if is_reduced else counter.whole()
        step, linear_solver, iterations = _time(scene, options)
        of_backend = fused_work if backend == "FUSED" else ceres_work
        # Every tenth iteration of the fused backend recomputes the residual.
        products = max((1.1 if backend == "FUSED" else 1.0) * iterations, 1.0)
        work = of_backend(pattern, solver, counted, num_threads, products)
        solves = {term: one for term, one in work.items() if term in OF_LINEAR_SOLVERS}
        if counts != "step":
            yield solves, linear_solver
        if counts in ("step", "both"):
            yield (
                {term: one for term, one in work.items() if term not in solves},
                step - linear_solver,
            )


def _time(problem: Problem, options: SolveOptions) -> tuple[float, float, float]:
    """Return seconds of a step and of its linear solve, and conjugate gradient iterations.

    Each is the least of several solves, of a median step: other load only adds time.
    """
    timings: list[tuple[float, float, float]] = []
    begun = perf_counter()
    while len(timings) < LEAST_REPEATS or (
        len(timings) < MOST_REPEATS and perf_counter() - begun < ENOUGH_SECONDS
    ):
        output = _core.solve(problem, options.asdict(), None)
        summary, iterations = output["summary"], output["iterations"]
        timings.append(
            (
                statistics.median(iterations["iteration_time_in_seconds"][1:].tolist()),
                summary["linear_solver_time_in_seconds"] / summary["num_linear_solves"],
                statistics.fmean(iterations["linear_solver_iterations"][1:].tolist()),
            )
        )
    step, linear_solver, iterations = map(min, zip(*timings, strict=True))
    return step, linear_solver, iterations
