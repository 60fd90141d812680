"""Solves that take a second in all, and the rates that follow from their times."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from time import perf_counter
from typing import NamedTuple

from bundle import _core
from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.planning.inspection.calibration_scene import make_scene
from bundle.planning.inspection.problem_pattern import (
    ProblemPattern,
    count_dense,
    count_factor,
    find_pattern,
)
from bundle.planning.inspection.rates import FactorRate, Rates

__all__ = ["calibrate"]

STEPS = 3
LEAST_REPEATS, MOST_REPEATS, ENOUGH_SECONDS = 2, 12, 0.06
LEAST = 1e-12  # of a rate that drowned in noise


class Timing(NamedTuple):
    """Seconds of a step, of its linear solve, and conjugate gradients' iterations a step."""

    step: float
    linear_solver: float
    iterations: float


def calibrate(num_threads: int) -> Rates:
    """Measure the rates for solves by ``num_threads``.

    Raises:
        MemoryError: its solves, of up to 100 MB, do not fit into the memory that is free.
    """
    try:
        return _Calibration(num_threads).run()
    except InputError as error:  # what is wrong cannot be the scenes nor the options
        raise MemoryError("the solves that measure this machine's rates do not fit") from error


class _Calibration:
    """The scenes, what was timed on them, and the equations."""

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
        """Return the least of many solves, by median steps: what else runs only adds to it."""
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
        # The entries' share of the small one lies between none and all of it.
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
        # Every tenth iteration computes the residual afresh.
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
        """Tracks are long enough for CHOLMOD to go by supernodes, as it does on most problems."""
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
        """Solve for both, with as many observations in short tracks (quick) as in long ones."""
        short, long = self._pattern(self.short), self._pattern(self.long)
        pair = max((slow - quick) / (pairs(long) - pairs(short)), 0.0)
        # Noise must not leave nothing for the observations themselves.
        pair = min(pair, 0.8 * max(quick, LEAST) / pairs(short))
        observation = (quick - pair * pairs(short)) / short.num_observations
        return max(observation, LEAST), pair
