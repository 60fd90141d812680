"""Rates of this machine, measured once and cached.

Each rate is measured on real solves of small problems by the solver that it predicts. It therefore
includes the instruction set, caches, BLAS and threads of the machine. Calibration takes about a
second. (Pose graphs: ``graph_rates``; other factor graphs: ``factor_graph_time``.)

The cache folder has one file per version and number of threads.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import math
import os
import platform
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

import bundle._core as _core
from bundle.base.paths import cache_folder, write_cached
from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.planning.inspection.factor_graph_time import FEATURES as FACTOR_GRAPH_FEATURES
from bundle.planning.inspection.factor_graph_time import calibrate_factor_graphs
from bundle.planning.inspection.graph_rates import FEATURES, GraphRates, calibrate_graphs
from bundle.planning.inspection.problem_pattern import (
    ProblemPattern,
    count_dense,
    count_factor,
    find_pattern,
)
from bundle.planning.inspection.rates import FactorRate, Rates, implausible

RATE_NAMES = tuple(field.name for field in dataclasses.fields(Rates))

KERNELS = 4
"""Number of the generation of kernels; rates of earlier ones are measured anew."""

ATTEMPTS = 3
"""Number of calibrations after which implausible rates are used once, without caching them."""


def machine_rates(num_threads: int, *, recalibrate: bool = False) -> Rates:
    """Return the rates for solves on ``num_threads`` threads; measure them unless cached."""
    path = cache_path(num_threads)
    rates = None if recalibrate else _read(path)
    if rates is None:
        rates = _measure(num_threads)
        if implausible(rates):  # used once, not cached
            return rates
        with contextlib.suppress(OSError):  # if they cannot be cached, the next call measures again
            _write(path, dataclasses.asdict(rates))
    return rates


def graph_rates(num_threads: int, *, recalibrate: bool = False) -> GraphRates:
    """Return the rates of pose graphs on ``num_threads`` threads; measure them unless cached."""

    def measure() -> dict[str, Any]:
        found = calibrate_graphs(num_threads)
        return {"seconds": dict(found.seconds), "efficiency": found.efficiency}

    path = cache_path(num_threads, "graph-rates", FEATURES)
    return GraphRates(num_threads=num_threads, **_fitted(path, FEATURES, measure, recalibrate))


def factor_graph_rates(*, recalibrate: bool = False) -> dict[str, float]:
    """Return the rates of factor graphs that Ceres solves; measure them unless cached."""
    path = cache_path(1, "factor-graph-rates", FACTOR_GRAPH_FEATURES)

    def measure() -> dict[str, Any]:
        return {"seconds": calibrate_factor_graphs(), "efficiency": 1.0}

    return dict(_fitted(path, FACTOR_GRAPH_FEATURES, measure, recalibrate)["seconds"])


def _fitted(
    path: Path, names: Sequence[str], measure: Callable[[], dict[str, Any]], recalibrate: bool
) -> dict[str, Any]:
    """Return seconds per unit of these names and the efficiency of threads, cached in a file."""
    try:
        given = {} if recalibrate else json.loads(path.read_text(encoding="ascii"))
        numbers = [given["efficiency"], *given["seconds"].values()]
        is_complete = set(given) == {"seconds", "efficiency"} and set(given["seconds"]) == {*names}
        if is_complete and all(map(math.isfinite, numbers)):
            return given
    except (OSError, ValueError, TypeError, KeyError):
        pass
    found = measure()
    with contextlib.suppress(OSError):
        _write(path, found)
    return found


def _measure(num_threads: int) -> Rates:
    """Calibrate until the rates are plausible; return the least implausible of ATTEMPTS."""
    attempts: list[Rates] = []
    while len(attempts) < ATTEMPTS:
        attempts.append(calibrate(num_threads))
        if not implausible(attempts[-1]):
            return attempts[-1]
    return min(attempts, key=lambda rates: len(implausible(rates)))


def cache_path(num_threads: int, kind: str = "rates", names: Sequence[str] = RATE_NAMES) -> Path:
    """Return the path of the cached rates of a kind, which have these names."""
    # Machines may share a home folder, and one processor may offer several instruction sets.
    machine = (
        _core.__version__,
        KERNELS,
        _core.CERES_VERSION,
        platform.node(),
        platform.machine(),
        _processor(),
        _blas(),
        os.environ.get("BUNDLE_INSTRUCTION_SET", ""),
        _core.hardware_threads(),
        list(names),
    )
    digest = hashlib.sha256(repr(machine).encode()).hexdigest()[:12]
    return cache_folder() / f"{kind}-{digest}-{num_threads}.json"


def _processor() -> tuple[str, ...]:
    """Return the processor model and the instruction sets that this (virtual) machine offers."""
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        return (platform.processor(),)
    heads = ("model name", "flags", "Features")
    return tuple(next((line for line in lines if line.startswith(head)), "") for head in heads)


def _blas() -> tuple[str, ...]:
    """Return the loaded BLAS libraries with sizes and dates, and the choice of their kernels."""
    choice = os.environ.get("OPENBLAS_CORETYPE", "")
    try:
        maps = Path("/proc/self/maps").read_text(errors="replace").splitlines()
    except OSError:
        return (choice,)
    found = set()
    for path in {line.split(maxsplit=5)[5] for line in maps if len(line.split(maxsplit=5)) == 6}:
        if "blas" in Path(path).name.lower():
            with contextlib.suppress(OSError):
                status = Path(path).stat()
                found.add(f"{path} {status.st_size} {int(status.st_mtime)}")
    return (choice, *sorted(found))


def _read(path: Path) -> Rates | None:
    """Return the rates of a file; None if it is missing, incomplete or of another version."""
    try:
        fields = json.loads(path.read_text(encoding="ascii"))
        for name in ("dense", "dense_threaded", "sparse"):
            fields[name] = FactorRate(**fields[name])
        rates = Rates(**fields)
        numbers = [
            number
            for value in dataclasses.asdict(rates).values()
            for number in (value.values() if isinstance(value, dict) else (value,))
        ]
        sound = all(math.isfinite(number) and number >= 0 for number in numbers)
    except (OSError, ValueError, TypeError, KeyError):
        return None
    return rates if sound and not implausible(rates) else None


def _write(path: Path, rates: dict[str, Any]) -> None:
    write_cached(path, json.dumps(rates, indent=2) + "\n")


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


STEPS = 3
LEAST_REPEATS, MOST_REPEATS, ENOUGH_SECONDS = 2, 12, 0.06
LEAST = 1e-12  # lower bound of a rate whose time vanishes in the noise


class Timing(NamedTuple):
    """Seconds of a step and of its linear solve, and conjugate gradient iterations per step."""

    step: float
    linear_solver: float
    iterations: float


def calibrate(num_threads: int) -> Rates:
    """Measure the rates for solves on ``num_threads`` threads."""
    try:
        return _Calibration(num_threads).run()
    except InputError as error:  # scenes and options are valid: memory is the cause
        raise MemoryError(
            "the solves that measure this machine's rates do not fit into the free memory"
        ) from error


class _Calibration:
    """Scenes, their timings, and the equations for the rates."""

    def __init__(self, num_threads: int) -> None:
        self.num_threads = num_threads
        self.tiny = make_scene(5, 60, 4)
        self.short = make_scene(40, 2500, 4)
        self.long = make_scene(40, 500, 20)
        self.long_few = make_scene(30, 150, 15)
        self.shared = make_scene(40, 500, 20, shared_camera=True)
        self.banded = make_scene(300, 1800, 8)
        self.scattered = make_scene(360, 5000, 6, scattered=True)

    def run(self) -> Rates:
        dense = self._factor_rate((50, 105))
        threaded = self._factor_rate((115, 175)) if self.num_threads > 1 else dense
        sparse = FactorRate(
            flops_per_second=dense.flops_per_second,
            seconds_per_entry=self._sparse_entry(dense),
        )
        return Rates(
            num_threads=self.num_threads,
            dense=dense,
            dense_threaded=threaded,
            sparse=sparse,
            **self._fused(),
            **self._ceres(dense, sparse),
        )

    def _time(self, problem: Problem, solver: str, backend: str = "fused") -> Timing:
        """Return the shortest of several solves' median step times; other load only adds time."""
        options = self._options(solver, backend)
        timings: list[Timing] = []
        begun = perf_counter()
        while len(timings) < LEAST_REPEATS or (
            len(timings) < MOST_REPEATS and perf_counter() - begun < ENOUGH_SECONDS
        ):
            output = _core.solve(problem, options.asdict(), None)
            summary, iterations = output["summary"], output["iterations"]
            timings.append(
                Timing(
                    statistics.median(iterations["iteration_time_in_seconds"][1:].tolist()),
                    summary["linear_solver_time_in_seconds"] / summary["num_linear_solves"],
                    statistics.fmean(iterations["linear_solver_iterations"][1:].tolist()),
                )
            )
        return Timing(*map(min, zip(*timings, strict=True)))

    def _options(self, solver: str, backend: str = "fused") -> SolveOptions:
        return SolveOptions(
            backend=backend,
            linear_solver_type=solver,
            num_threads=self.num_threads,
            max_num_iterations=STEPS,
            function_tolerance=0.0,
            gradient_tolerance=0.0,
            parameter_tolerance=0.0,
            gauge="none",
            cheirality="algebraic",
        )

    def _pattern(self, problem: Problem) -> ProblemPattern:
        return find_pattern(problem, self._options("dense_schur"))

    def _factor_rate(self, num_images: tuple[int, int]) -> FactorRate:
        """Solve for flops and entries with two dense systems of 9 columns per image."""
        counts, times = [], []
        for images in num_images:
            scene = make_scene(images, 4 * images, 4)
            counts.append(count_dense(9 * images, 0, images))
            times.append(self._time(scene, "dense_schur").linear_solver)
        (small, large), (quick, slow) = counts, times
        # The entries take between 0 and 100 % of the small system's time.
        ratio = large.nnz / small.nnz
        by_flops = slow - ratio * quick
        flops = large.flops - ratio * small.flops
        rate = max(flops / max(by_flops, LEAST), LEAST)
        rate = min(rate, 1.5 * large.flops / slow)
        rate = max(rate, large.flops / slow)
        entry = max(quick - small.flops / rate, 0.0) / small.nnz
        return FactorRate(flops_per_second=rate, seconds_per_entry=entry)

    def _sparse_entry(self, dense: FactorRate) -> float:
        pattern = self._pattern(self.banded).reduced
        count = count_factor(pattern, _core.order_blocks(*pattern, "amd"))
        taken = self._time(self.banded, "sparse_schur").linear_solver
        return max(taken - count.flops / dense.flops_per_second, LEAST) / count.nnz

    def _fused(self) -> dict[str, float]:
        def passes(problem: Problem) -> float:
            timing = self._time(problem, "dense_schur")
            return timing.step - timing.linear_solver

        step = passes(self.tiny)
        observation, pair = self._observation_and_pair(
            passes(self.short) - step,
            passes(self.long) - step,
            lambda pattern: pattern.plan.num_pairs,
        )
        pattern = self._pattern(self.scattered)
        timing = self._time(self.scattered, "iterative_schur")
        plan = pattern.plan
        known = step + observation * plan.num_observations + pair * plan.num_pairs
        scattered = timing.step - timing.linear_solver - known
        # Every tenth iteration recomputes the residual.
        products = max(1.1 * timing.iterations, 1.0)
        return {
            "fused_step": step,
            "fused_observation": observation,
            "fused_pair": pair,
            "fused_scattered_pair": max(scattered, 0.0) / plan.num_chunk_pairs,
            "reduced_bytes_per_second": (
                8 * pattern.num_reduced_values * products / timing.linear_solver
            ),
        }

    def _ceres(self, dense: FactorRate, sparse: FactorRate) -> dict[str, float]:
        def elimination(problem: Problem, timing: Timing) -> float:
            count = count_dense(self._pattern(problem).num_camera_columns, 0, 0)
            return timing.linear_solver - dense.seconds(count.flops, count.nnz)

        tiny = self._time(self.tiny, "dense_schur", "ceres")
        short = self._time(self.short, "dense_schur", "ceres")
        observations = self._pattern(self.short).num_observations
        evaluation = (short.step - short.linear_solver - tiny.step) / observations
        quick = elimination(self.short, short)
        long = self._time(self.long, "dense_schur", "ceres")
        eliminated, pair = self._observation_and_pair(
            quick, elimination(self.long, long), lambda pattern: pattern.block_pairs
        )
        implicit = self._time(self.short, "iterative_schur", "ceres")
        products = observations * max(implicit.iterations, 1.0)
        return {
            "ceres_step": tiny.step,
            "ceres_evaluation": max(evaluation, LEAST),
            "ceres_elimination": eliminated,
            "ceres_pair": pair,
            "ceres_dynamic_pair": max(self._dynamic_pair(elimination, eliminated), pair),
            "ceres_reduced_value": self._reduced_value(sparse, eliminated, pair),
            "ceres_product": max(implicit.linear_solver - quick, LEAST) / products,
            "ceres_normal_entry": self._normal_entry(tiny.step, max(evaluation, LEAST)),
        }

    def _dynamic_pair(
        self, elimination: Callable[[Problem, Timing], float], eliminated: float
    ) -> float:
        pattern = self._pattern(self.shared)
        timing = self._time(self.shared, "dense_schur", "ceres")
        seconds = elimination(self.shared, timing) - eliminated * pattern.num_observations
        return seconds / pattern.block_pairs

    def _normal_entry(self, step: float, evaluation: float) -> float:
        """Return seconds per normal equation entry; on these long tracks CHOLMOD is supernodal."""
        pattern = self._pattern(self.long_few)
        seconds = self._time(self.long_few, "sparse_normal_cholesky", "ceres").step
        seconds -= step + evaluation * pattern.num_observations
        return max(seconds, LEAST) / pattern.pair_entries

    def _reduced_value(self, sparse: FactorRate, eliminated: float, pair: float) -> float:
        pattern = self._pattern(self.banded)
        count = count_factor(pattern.reduced, _core.order_blocks(*pattern.reduced, "amd"))
        known = eliminated * pattern.num_observations + pair * pattern.block_pairs
        known += sparse.seconds(count.flops, count.nnz)
        timing = self._time(self.banded, "sparse_schur", "ceres")
        return max(timing.linear_solver - known, 0.0) / pattern.num_reduced_values

    def _observation_and_pair(
        self, quick: float, slow: float, pairs: Callable[[ProblemPattern], int]
    ) -> tuple[float, float]:
        """Solve for seconds per observation and per pair.

        Both scenes have equally many observations: in short tracks (quick) and in long ones (slow).
        """
        short, long = self._pattern(self.short), self._pattern(self.long)
        pair = max((slow - quick) / (pairs(long) - pairs(short)), 0.0)
        # Noise must not reduce the observations' share to zero.
        pair = min(pair, 0.8 * max(quick, LEAST) / pairs(short))
        observation = (quick - pair * pairs(short)) / short.num_observations
        return max(observation, LEAST), pair
