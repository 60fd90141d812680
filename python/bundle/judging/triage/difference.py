"""Difference of two solves: which facts changed beyond noise.

A cost is noise if threads or instruction sets may change it: sums in another order end a solve
elsewhere within its tolerances. Steps of a solve without progress vary more. Times vary most: with
the load of the machine, its clock, and in short solves with the scheduler, which gives the cores to
others for some milliseconds. A time is therefore compared with the time that the steps and flops
explain, without the time in which others held the cores, and the more tolerantly the shorter it is
and the larger the load was.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from functools import cached_property
from typing import Any

from bundle.base.records import dataclass
from bundle.interface.judging_options import TriageOptions
from bundle.judging.triage.solve_facts import SolveFacts

Entry = Mapping[str, Any]

WITHOUT_EFFECT = ("nullity", "covariance", "check_solution")
"""Options that change a report, but not the solve."""

THREADS = "num_threads"
LEAST_STEPS = 2.0
FLOPS_NOISE, FACTOR_NOISE, NONZEROS_NOISE = 1.1, 1.05, 1.01
PERMUTED_FLOPS_NOISE, PERMUTED_FACTOR_NOISE = 1.6, 1.3
"""Noise of the same matrix with its variables in another order, by which orderings break ties."""
SECONDS_NOISE = 0.02
OTHER_HOST_NOISE, MOST_THREADS_NOISE = 3.0, 2.0
FLIGHT_COST_NOISE = 10.0  # times the noise of other costs
LATE_COST_NOISE = 10.0  # of solves that ended at their time budget, again
ERROR_NOISE = 0.1
SAME_COST = 1e-6
SAME_GRADIENT = 1e-3
LESS_RADIUS, MORE_REJECTED = 0.2, 0.15


@dataclass(frozen=True)
class Difference:
    """Two solves of one input by one method.

    Attributes:
        old, new: facts of both solves.
        inputs: path, format, counts and digests of both inputs.
        environments: machine, load and versions of both; empty if unknown.
        limits: largest differences that are noise.
    """

    old: SolveFacts
    new: SolveFacts
    inputs: tuple[Entry, Entry]
    environments: tuple[Entry, Entry]
    limits: TriageOptions

    def pair(self, name: str) -> tuple[Any, Any]:
        """Return a fact of both solves."""
        return getattr(self.old, name), getattr(self.new, name)

    def ratio(self, name: str) -> float | None:
        """Return the new value divided by the old one; None if one is unknown or 0."""
        old, new = self.pair(name)
        return quotient(new, old)

    def is_same(self, name: str) -> bool:
        """Return True if both solves have the same known value."""
        old, new = self.pair(name)
        return old is not None and old == new

    @cached_property
    def options(self) -> dict[str, tuple[Any, Any]]:
        """Options that differ, by name, without threads and those of the report alone.

        Some reports list an option only if it is given: None stands for the others.
        """
        old, new = self.old.options, self.new.options
        names = [name for name in {**old, **new} if name not in (*WITHOUT_EFFECT, THREADS)]
        pairs = {name: (old.get(name), new.get(name)) for name in names}
        return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}

    @cached_property
    def counts(self) -> dict[str, tuple[Any, Any]]:
        """Counts of the input that differ, by name."""
        old, new = self.inputs
        names = [name for name in new if name.startswith("num_") or name == "duration"]
        return {name: (old.get(name), new[name]) for name in names if old.get(name) != new[name]}

    def differs(self, *parts: str) -> bool | None:
        """Return True if a digest of these parts of the input differs; None if it is unknown."""
        digests = [given.get("digests") or {} for given in self.inputs]
        if not all(part in one for part in parts for one in digests):
            return None
        return any(digests[0][part] != digests[1][part] for part in parts)

    @cached_property
    def has_other_data(self) -> bool:
        """True if the measurements or their structure differ."""
        differs = self.differs("structure", "measurements")
        if differs is not None and self.differs("start") is not None:
            is_same_start = not self.differs("start")
            # the same residuals at the same start cost the same
            return differs or (is_same_start and not self.options and not self.is_same_start_cost)
        return bool(self.counts) or not (self.options or self.is_same_start_cost)

    @cached_property
    def is_same_start_cost(self) -> bool:
        """True if the costs at the start agree, or are unknown."""
        old, new = self.pair("initial_cost")
        return old is None or new is None or abs(new - old) <= SAME_COST * max(abs(old), abs(new))

    @cached_property
    def cost_changed(self) -> bool:
        """True if the final cost, or the error against a ground truth, changed beyond noise."""
        if self.old.is_usable != self.new.is_usable:
            return True
        noise = self.limits.cost_noise
        old, new = self.pair("final_cost")
        if self.old.initial_cost is None:  # odometry
            noise *= FLIGHT_COST_NOISE
            if any(solve.warnings.get("out of time") for solve in (self.old, self.new)):
                noise *= LATE_COST_NOISE
        if (old is None) != (new is None):
            return True
        # a cost that is 0 up to rounding has no relative noise
        floor = 1e-12 * (self.old.initial_cost or 0.0)
        if old is not None and new is not None and abs(new - old) > noise * abs(old) + floor:
            return True
        old, new = self.pair("error")
        return bool(old is not None and new is not None and abs(new - old) > ERROR_NOISE * old)

    @cached_property
    def steps_changed(self) -> bool:
        """True if the number of steps changed beyond noise."""
        old, new = self.pair("steps")
        if old is None or new is None:
            return False
        return bool(abs(new - old) > max(LEAST_STEPS, self.limits.step_noise * min(old, new)))

    @cached_property
    def converges_otherwise(self) -> bool:
        """True if one solve converged and the other did not."""
        return self.old.is_converged != self.new.is_converged

    @cached_property
    def factor_changed(self) -> bool:
        """True if flops or nonzeros of the factor changed beyond noise."""
        is_permuted = self.differs("structure") and self.is_same("columns")
        if is_permuted and not self.information_changed:
            flops, nonzeros = PERMUTED_FLOPS_NOISE, PERMUTED_FACTOR_NOISE
        else:
            flops, nonzeros = FLOPS_NOISE, FACTOR_NOISE
        return self._moved("factor_flops", flops) or self._moved("factor_nonzeros", nonzeros)

    @cached_property
    def information_changed(self) -> bool:
        """True if nnz(Lambda) changed beyond noise."""
        return self._moved("information_nonzeros", NONZEROS_NOISE)

    def _moved(self, name: str, noise: float) -> bool:
        ratio = self.ratio(name)
        return ratio is not None and not 1 / noise <= ratio <= noise

    @cached_property
    def has_other_gradient(self) -> bool:
        """True if the gradient J^T r at the start differs; with the same residuals r, J does."""
        old, new = self.pair("start_gradient")
        if old is None or new is None:
            return False
        return bool(abs(new - old) > SAME_GRADIENT * max(abs(old), abs(new)))

    @cached_property
    def radius_fell(self) -> bool:
        """True if the trust region shrank more, or rejected a larger share of the steps."""
        old, new = self.pair("least_radius")
        if old is not None and new is not None and new < LESS_RADIUS * old:
            return True
        shares = [(s.rejected or 0.0) / s.steps if s.steps else 0.0 for s in (self.old, self.new)]
        return shares[1] - shares[0] > MORE_REJECTED

    @cached_property
    def time_excess(self) -> float | None:
        """Ratio of the times beyond what steps and flops explain; None within noise."""
        old, new = self.pair("seconds")
        if not old or not new or old < 0 or new < 0:
            return None
        steps = self.ratio("steps") or 1.0
        work = steps * (self.ratio("factor_flops") or 1.0)
        least, most = min(1.0, steps, work), max(1.0, steps, work)
        noise = self.limits.time_noise + SECONDS_NOISE / min(old, new)
        noise *= self._machine_noise()
        slowed = [_slowed(environment) for environment in self.environments]
        ratio = quotient(new, old)
        if new - self.new.waiting > old * most * noise * slowed[1]:
            return quotient(ratio, most)
        is_less = new * noise * slowed[0] < (old - self.old.waiting) * least
        return quotient(ratio, least) if is_less else None

    def _machine_noise(self) -> float:
        noise = 1.0
        if self.has_other_host:
            noise = max(noise, OTHER_HOST_NOISE / self.limits.time_noise)
        threads = self.ratio("num_threads") or 1.0
        return noise * min(max(threads, 1 / threads), MOST_THREADS_NOISE)

    @cached_property
    def has_other_host(self) -> bool:
        """True if another processor ran the second solve."""
        models = [given.get("cpu_model") for given in self.environments]
        return None not in models and models[0] != models[1]

    def new_warnings(self, kinds: tuple[str, ...]) -> list[str]:
        """Return the kinds of these warnings that only the new solve has."""
        return [
            kind
            for kind in kinds
            if self.new.warnings.get(kind) and not self.old.warnings.get(kind)
        ]


def quotient(new: float | None, old: float | None) -> float | None:
    """Return new divided by old, a finite number; None if one is unknown or 0."""
    if not old or not new:
        return None
    return max(-sys.float_info.max, min(new / old, sys.float_info.max))


def _slowed(environment: Entry) -> float:
    """Return the factor by which the load of the machine may have slowed a solve down."""
    load, cores = environment.get("load_before"), environment.get("num_cores")
    return max(load / cores, 1.0) if load and cores else 1.0


def is_busy(environment: Entry, num_threads: int | None) -> bool:
    """Return True if other work left too few cores for the threads of a solve."""
    load, cores = environment.get("load_before"), environment.get("num_cores")
    if load is None or cores is None:
        return False
    return bool(load + (num_threads or 1) > cores + 0.5)
