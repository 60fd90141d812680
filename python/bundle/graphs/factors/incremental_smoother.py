"""Incremental smoothing of a growing factor graph by iSAM2 of GTSAM's Python package.

iSAM2 stores the factorised problem as a Bayes tree. An update eliminates only the part of the tree
that new factors or relinearised variables affect (M. Kaess et al., iSAM2: Incremental smoothing and
mapping using the Bayes tree, IJRR 31, 2012). GTSAM is an optional dependency, ``pip install
gtsam``. Tangent coordinates, errors and losses are those of :class:`bundle.FactorGraph`: rotation
first in se3, full logarithms.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Mapping
from itertools import islice
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bundle.base.display import Display, Displayed
from bundle.base.optional_packages import require_package
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.graphs.factors.factor_graph import FactorGraph
from bundle.graphs.factors.factors import BetweenFactor, Factor, PriorFactor, as_information
from bundle.graphs.factors.variables import Array, Key, variable_name
from bundle.interface.option_fields import number

_TYPES = {"euclidean": "Vector", "so2": "Rot2", "so3": "Rot3", "se2": "Pose2", "se3": "Pose3"}
_LOSSES = {"huber": "Huber", "cauchy": "Cauchy", "tukey": "Tukey"}


@dataclass(frozen=True)
class IncrementalUpdate:
    """Statistics of one update.

    Attributes:
        seconds: wall time, including the new estimate of all variables.
        num_variables: variables in the graph after the update.
        num_reeliminated: variables whose part of the factorisation was recomputed.
        num_relinearized: variables with a new linearization point.
    """

    seconds: float
    num_variables: int
    num_reeliminated: int
    num_relinearized: int

    @property
    def share_reeliminated(self) -> float:
        """Fraction of re-eliminated variables, num_reeliminated / num_variables."""
        return self.num_reeliminated / self.num_variables


class IncrementalSmoother(Displayed):
    """Factor graph that iSAM2 solves again after each addition.

    It supports :class:`bundle.PriorFactor` and :class:`bundle.BetweenFactor` with the losses
    trivial, huber, cauchy and tukey. Example::

        smoother = bundle.IncrementalSmoother()
        smoother.add_variable(0, [0, 0, 0], "se2")
        smoother.add_factor(bundle.PriorFactor(0, [0, 0, 0], 1e8))
        smoother.update()
        smoother.add_variable(1, [1.1, 0, 0], "se2")
        smoother.add_factor(bundle.BetweenFactor(0, 1, [1, 0, 0], 100))
        smoother.update()
        smoother.values[1]

    Args:
        relinearize_threshold: change of a tangent coordinate (metres or radians) above which a
            variable gets a new linearization point.
        relinearize_skip: number of updates between checks of this threshold.

    Attributes:
        updates: one :class:`bundle.IncrementalUpdate` per update.

    Raises:
        InputError: GTSAM is not installed, or a number is out of range.
    """

    def __init__(self, relinearize_threshold: float = 0.01, relinearize_skip: int = 1) -> None:
        require_package("gtsam", "gtsam", "IncrementalSmoother")
        import gtsam  # optional dependency

        self._gtsam: ModuleType = gtsam
        parameters = self._gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(
            number("relinearize_threshold", relinearize_threshold, above=0)
        )
        parameters.relinearizeSkip = number(
            "relinearize_skip", relinearize_skip, whole=True, minimum=1
        )
        self._solver = self._gtsam.ISAM2(parameters)
        self._graph = FactorGraph()
        self._places: dict[Key, int] = {}
        self._estimate: Mapping[Key, Array] = {}
        self._num_factors = 0
        self._broken = ""
        self.updates: list[IncrementalUpdate] = []

    def add_variable(self, key: Key, value: ArrayLike, manifold: str = "euclidean") -> None:
        """Add a variable for the next update; see :meth:`bundle.FactorGraph.add_variable`.

        Raises:
            InputError: the key is taken, or the value does not lie on the manifold.
        """
        self._graph.add_variable(key, value, manifold)

    def add_factor(self, factor: Factor) -> None:
        """Add a factor for the next update; see :meth:`bundle.FactorGraph.add_factor`.

        Raises:
            InputError: for the reasons of :meth:`bundle.FactorGraph.add_factor`, or iSAM2 does not
                support this kind of factor or loss.
        """
        if isinstance(factor, Factor):
            if type(factor) not in (PriorFactor, BetweenFactor):
                raise InputError(
                    f"{factor.name}: expected a PriorFactor or BetweenFactor for iSAM2, "
                    f"found {type(factor).__name__}"
                )
            if factor.loss not in ("trivial", *_LOSSES):
                raise InputError(
                    f"{factor.name}: loss: expected trivial, {', '.join(_LOSSES)} for iSAM2, "
                    f"found {factor.loss}"
                )
        self._graph.add_factor(factor)

    def update(self) -> IncrementalUpdate:
        """Solve with all additions since the last update. Without additions, do one more step.

        Raises:
            InputError: the factors do not determine a variable, which the message names; the
                smoother is then unusable, because iSAM2 has lost its factorisation. Or the graph is
                empty.
        """
        if self._broken:
            raise InputError(
                f"update: expected a usable smoother, found a smoother that {self._broken}"
            )
        if not self._graph.keys:
            raise InputError("update: expected at least one variable, found 0")
        values, factors = self._gtsam.Values(), self._gtsam.NonlinearFactorGraph()
        variables = self._graph._variables
        keys = self._graph.keys
        for key in keys[len(self._places) :]:
            self._places[key] = len(self._places)
            variable = variables[key]
            values.insert(self._places[key], self._given(variable.manifold, variable.value))
        added = self._graph.factors
        for factor in added[self._num_factors :]:
            factors.add(self._translated(factor))
        self._num_factors = len(added)
        start = time.perf_counter()
        try:
            result = self._solver.update(factors, values)
            estimate = self._solver.calculateEstimate()
        except RuntimeError as error:
            raise self._refusal(error) from None
        seconds = time.perf_counter() - start
        self._estimate = _Estimate(self, estimate)
        self.updates.append(
            IncrementalUpdate(
                seconds,
                len(self._places),
                int(result.getVariablesReeliminated()),
                int(result.getVariablesRelinearized()),
            )
        )
        return self.updates[-1]

    @property
    def values(self) -> Mapping[Key, Array]:
        """Estimate of the last update, by key, converted on access."""
        return self._estimate

    @property
    def graph(self) -> FactorGraph:
        """Graph of all variables and factors at the estimate, for batch solves."""
        return self._graph.with_values(dict(self._estimate))

    def statistics(self) -> dict[str, float]:
        """Return p50, p95 and max of seconds, and the mean fraction of re-eliminated variables.

        All values are over all updates.

        Raises:
            InputError: there was no update.
        """
        if not self.updates:
            raise InputError("statistics: expected at least one update, found 0")
        seconds = np.array([update.seconds for update in self.updates])
        share = np.mean([update.share_reeliminated for update in self.updates])
        return {
            "p50_seconds": float(np.percentile(seconds, 50)),
            "p95_seconds": float(np.percentile(seconds, 95)),
            "max_seconds": float(seconds.max()),
            "mean_share_reeliminated": float(share),
        }

    def _refusal(self, error: RuntimeError) -> InputError:
        found = re.search(r"near variable\s+(\d+)", str(error))
        first = str(error).strip().splitlines()[0]
        self._broken = "failed"
        if found is None or int(found[1]) >= len(self._places):
            return InputError(f"update: iSAM2 failed: {first}")
        key = list(self._places)[int(found[1])]
        self._broken = f"failed at {variable_name(key)}"
        return InputError(
            f"{variable_name(key)}: expected factors that determine it, found an "
            "undetermined direction (iSAM2); give a variable of its component a PriorFactor"
        )

    def _given(self, manifold: str, value: Array) -> Any:
        gtsam = self._gtsam
        if manifold == "euclidean":
            return np.array(value)
        if manifold == "so2":
            return gtsam.Rot2(float(value[0]))
        if manifold == "se2":
            return gtsam.Pose2(*map(float, value))
        # measurements may have any norm
        x, y, z, w = map(float, value[:4] / np.linalg.norm(value[:4]))
        turn = gtsam.Rot3(w, x, y, z)
        return turn if manifold == "so3" else gtsam.Pose3(turn, np.array(value[4:]))

    def _taken(self, key: Key, estimate: Any, place: int) -> Array:
        manifold = self._graph._variables[key].manifold
        found = getattr(estimate, f"at{_TYPES[manifold]}")(place)
        if manifold == "euclidean":
            return np.array(found, np.float64)
        if manifold == "so2":
            return np.array([found.theta()])
        if manifold == "se2":
            return np.array([found.x(), found.y(), found.theta()])
        turn = found if manifold == "so3" else found.rotation()
        quaternion = turn.toQuaternion()
        parts = [quaternion.x(), quaternion.y(), quaternion.z(), quaternion.w()]
        return np.array(parts if manifold == "so3" else [*parts, *found.translation()])

    def _translated(self, factor: Factor) -> Any:
        assert isinstance(factor, PriorFactor | BetweenFactor)
        variable = self._graph._variables[factor.keys[0]]
        size = len(variable.coordinates)
        name = f"{type(factor).__name__}{_TYPES[variable.manifold]}"
        models = self._gtsam.noiseModel
        noise = models.Gaussian.Information(
            as_information(factor.name, np.asarray(factor.information), size)
        )
        if factor.loss != "trivial":
            loss = getattr(models.mEstimator, _LOSSES[factor.loss]).Create(factor.loss_scale)
            noise = models.Robust.Create(loss, noise)
        measured = factor.value if isinstance(factor, PriorFactor) else factor.measurement
        value = self._given(variable.manifold, np.asarray(measured))
        places = [self._places[key] for key in factor.keys]
        return getattr(self._gtsam, name)(*places, value, noise)

    def _display(self) -> Display:
        facts = [
            ("variables", str(len(self._graph.keys))),
            ("factors", str(len(self._graph.factors))),
            ("updates", str(len(self.updates))),
        ]
        if self.updates:
            found = self.statistics()
            times = [1e3 * found[f"{name}_seconds"] for name in ("p50", "p95", "max")]
            facts.append(("ms an update", "p50 {:.3g}, p95 {:.3g}, max {:.3g}".format(*times)))
            facts.append(
                ("re-eliminated", f"{100 * found['mean_share_reeliminated']:.1f} % on average")
            )
        return Display(
            title=f"IncrementalSmoother: {plural(len(self.updates), 'update')}", facts=tuple(facts)
        )


class _Estimate(Mapping[Key, Array]):
    """GTSAM's estimate after one update."""

    def __init__(self, smoother: IncrementalSmoother, estimate: Any) -> None:
        self._smoother, self._estimate = smoother, estimate
        self._size = len(smoother._places)

    def __getitem__(self, key: Key) -> Array:
        place = self._smoother._places[key]
        if place >= self._size:
            raise KeyError(key)
        return self._smoother._taken(key, self._estimate, place)

    def __iter__(self) -> Iterator[Key]:
        return islice(self._smoother._places, self._size)

    def __len__(self) -> int:
        return self._size
