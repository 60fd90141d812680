"""Certificates of pose graphs: global optimality of a chordal cost, and bounds of chi2.

The core moves the given poses to a critical point of the chordal cost by Newton's method and tests
its dual certificate (``cpp/core/pose_graph/dual_certificate.cpp``). A minimum of another cost (chi2
with the logarithm, or with anisotropic information) is not a critical point, but near one.

The verdict is about the given poses as long as the critical point belongs to them. It does if
Newton's method lowers F by at most a tenth. Otherwise two solves decide:

- One from the given poses. If it lowers chi2 by more than a hundredth, they are not at a minimum.
- One from the critical point. If it ends at the chi2 of the first one, both are the same minimum.
  Otherwise F has another minimum, and its certificate does not apply to the given poses.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base import words
from bundle.base.arrays import check_function, check_type, freeze
from bundle.base.paths import as_path, is_path
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.graphs.pose_graphs.edge_weights import checked_information, with_edges
from bundle.graphs.pose_graphs.pose_graph_result import (
    CERTIFIED,
    CHORDAL_MINIMUM,
    NOT_A_MINIMUM,
    NOT_CERTIFIED,
    STAIRCASE,
    Certificate,
    PoseGraphResult,
    Staircase,
)
from bundle.interface.option_fields import choice, number
from bundle.interface.pose_graph_options import POSE_ERRORS, PoseGraphOptions
from bundle.interface.solve_record import Progress
from bundle.io.g2o_files import load_g2o
from bundle.model.pose_graph_arrays import PoseGraph

Floats = NDArray[np.float64]

MOST_RANK = 10
MOST_STEPS = 150
NUM_EIGENVALUES = 3

NEAR_COST = 0.1  # relative decrease of F by Newton's method from poses that are near a minimum of F

NEAR_CHI2 = 0.01  # relative decrease of chi2 by a solve from poses that are near a minimum of chi2

SAME_CHI2 = 1e-6  # relative difference of chi2 below which two solves end at the same minimum

ZERO_COST = 1e-9
"""F and chi2 below this share of the median weight, times the number of edges, are those of exact
measurements."""


def certify(
    graph: PoseGraph | PoseGraphResult | str | os.PathLike[str],
    *,
    error: str | None = None,
    information: str | None = None,
    weights: str = "mean",
    max_rank: int = MOST_RANK,
    num_threads: int = 0,
    progress: Progress | None = None,
) -> Certificate:
    """Test whether the poses of a graph are globally optimal.

    The test is about the chordal cost, with one weight for the rotation and one for the translation
    of an edge. The result also has a lower bound of chi2 with the full information, for any error.
    If the test fails, the Riemannian staircase searches for poses of lower cost.

    Args:
        graph: pose graph at its poses, the path of its file, or the result of a solve without a
            loss.
        error: error of the edges, as in a solve; by default that of the result, otherwise "log".
        information: "file" or "isotropic", as in a solve.
        weights: weights of an edge: "mean", the means of the information's diagonals, or "se-sync",
            those of SE-Sync (harmonic means).
        max_rank: largest rank of the staircase, up to 10; 0: no staircase.
        num_threads: number of threads; 0: all cores.
        progress: called after each step of Newton's method, as by :func:`bundle.solve`, with F as
            the cost.

    Raises:
        InputError: the graph has several components or several fixed poses, an edge has no
            information, or the result has a robust loss.
    """
    options, loss = PoseGraphOptions(), "trivial"
    if isinstance(graph, PoseGraphResult):
        options = graph.options
        loss = graph.summary.loss
        graph = _kept(graph)
    elif is_path(graph):
        graph = load_g2o(as_path(graph))
    check_type("graph", graph, PoseGraph)
    assert isinstance(graph, PoseGraph)
    error = choice("error", options.error if error is None else error, POSE_ERRORS)
    information = choice(
        "information", options.information if information is None else information,
        ("file", "isotropic"),
    )  # fmt: skip
    weights = choice("weights", weights, CHORDAL_WEIGHTS)
    max_rank = number("max_rank", max_rank, minimum=0, maximum=MOST_RANK, whole=True)
    num_threads = number("num_threads", num_threads, minimum=0, whole=True)
    check_function("progress", progress)
    check_certifiable(graph, loss)
    cores = _core.hardware_threads()
    threads = min(int(num_threads) or cores, cores)
    weighed = checked_information(graph, information)
    return _certificate(graph, weighed, error, weights, int(max_rank), threads, progress)


def check_certifiable(graph: PoseGraph, loss: str) -> None:
    """Refuse graphs and losses without a certificate."""
    if loss != "trivial":
        raise InputError(
            f"certify: expected no loss, found {loss.replace('_', '-')}: a robust cost may have "
            "minima below the dual bound; consistency leaves out wrong closures without a loss"
        )
    if graph.num_edges == 0:
        raise InputError("certify: expected at least one edge, found a graph without edges")
    if graph.num_components > 1:
        raise InputError(
            f"certify: expected a connected graph, found {graph.num_components} components: no "
            "edge bounds their relative placement"
        )
    fixed = int(graph.fixed.sum())
    if fixed > 1:
        raise InputError(
            f"certify: expected at most 1 fixed pose, found {fixed}: the dual problem has all "
            "poses free"
        )


def _kept(solved: PoseGraphResult) -> PoseGraph:
    graph = solved.problem
    kept = np.ones(graph.num_edges, bool)
    kept[[entry.edge for entry in solved.left_out]] = False
    return graph if kept.all() else with_edges(graph, kept)


def _certificate(
    graph: PoseGraph,
    weighed: PoseGraph,
    error: str,
    weights: str,
    max_rank: int,
    threads: int,
    progress: Progress | None,
) -> Certificate:
    used = chordal_weights(weighed, weights, error)
    found = _run(weighed, used, max_rank, threads, progress=progress)
    below = bound_weights(weighed, error)
    staircase = _staircase(graph, found)
    bounds = [found["bound"]]
    if staircase is not None:
        bounds.append(staircase.lower_bound)
    is_isotropic = below is not None and used.equals(below)
    chi2_bound = max(bounds)
    if not is_isotropic:
        chi2_bound = _chi2_bound(weighed, below, staircase, threads)
    chi2 = float(_core.edge_chi2(weighed, error).sum())
    verdict, is_settled = _verdict(weighed, found, used, error, chi2, threads)
    return Certificate(
        verdict=verdict,
        is_settled=is_settled,
        cost=found["cost"],
        initial_cost=found["initial_cost"],
        lower_bound=found["bound"],
        min_eigenvalue=_smallest(found),
        eigenvalues=freeze(np.array(found["eigenvalues"])),
        num_steps=found["num_steps"],
        weights=weights,
        error=error,
        is_isotropic=is_isotropic,
        chi2=chi2,
        chi2_lower_bound=max(chi2_bound, 0.0),
        problem=graph.replace(poses=found["poses"], has_poses=True),
        staircase=staircase,
    )


def _run(
    graph: PoseGraph,
    weights: ChordalWeights,
    max_rank: int,
    threads: int,
    explicit: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    return _core.certify_graph(
        graph,
        weights.kappa,
        weights.tau,
        max_rank=max_rank,
        max_steps=MOST_STEPS,
        num_eigenvalues=NUM_EIGENVALUES,
        explicit_form=explicit,
        num_threads=threads,
        progress=progress,
    )


def _smallest(found: dict[str, Any]) -> float:
    smallest: float = min([found["eigenvalue_of_rows"], *found["eigenvalues"][:1]])
    return smallest


def _staircase(graph: PoseGraph, found: dict[str, Any]) -> Staircase | None:
    if not found["rank"]:
        return None
    after = found["staircase"]
    bound = max(found["bound"], after["relaxed_bound"], after["bound"])
    return Staircase(
        verdict=CERTIFIED if after["holds"] else NOT_CERTIFIED,
        rank=found["rank"],
        relaxed_cost=after["relaxed_cost"],
        cost=after["cost"],
        lower_bound=bound,
        min_eigenvalue=_smallest(after),
        eigenvalues=freeze(np.array(after["eigenvalues"])),
        problem=graph.replace(poses=after["poses"], has_poses=True),
    )


def _chi2_bound(
    graph: PoseGraph, below: ChordalWeights | None, staircase: Staircase | None, threads: int
) -> float:
    """Return a lower bound of chi2, by the weights with F <= chi2; nan without such weights."""
    if below is None:
        return float("nan")
    start = graph if staircase is None else graph.replace(poses=staircase.problem.poses)
    return float(_run(start, below, 0, threads)["bound"])


def _verdict(
    graph: PoseGraph,
    found: dict[str, Any],
    weights: ChordalWeights,
    error: str,
    chi2: float,
    threads: int,
) -> tuple[str, bool]:
    """Return the verdict, and True if the poses are near a minimum of F or of chi2."""
    verdict = CERTIFIED if found["holds"] else NOT_CERTIFIED
    zero = ZERO_COST * graph.num_edges * float(np.median(weights.kappa))
    is_critical = found["holds"] or (found["converged"] and found["is_minimum"])
    if found["initial_cost"] <= (1 + NEAR_COST) * found["cost"] + zero:
        return verdict if is_critical else NOT_A_MINIMUM, True
    here = _solved_chi2(graph, graph.poses, error, threads)
    is_settled = chi2 - here <= NEAR_CHI2 * chi2 + zero
    if not is_critical or not is_settled:
        return NOT_A_MINIMUM, is_settled
    there = _solved_chi2(graph, found["poses"], error, threads)
    is_same = abs(there - here) <= SAME_CHI2 * here + zero
    return verdict if is_same else NOT_A_MINIMUM, True


def _solved_chi2(graph: PoseGraph, poses: Floats, error: str, threads: int) -> float:
    held, _, _ = _core.hold_poses(graph)
    options = PoseGraphOptions(error=error, num_threads=threads).asdict()
    nothing = np.zeros(graph.num_edges, bool)
    after = _core.solve_pose_graph(
        graph, held, nothing, options, None, with_trials=True, poses=poses
    )
    return float(after["chi2_after"].sum())


LOWER = 1e-6  # relative decrease of the cost below which the second solve is the same minimum

Solve = Callable[[PoseGraph, PoseGraphOptions], PoseGraphResult]


def certified(
    graph: PoseGraph, options: PoseGraphOptions, solve: Solve, progress: Progress | None = None
) -> PoseGraphResult:
    """Solve, certify the solution, and solve again from the better poses of the certificate.

    These are the staircase's poses if their F is lower, or the critical point of F if this was far
    from the solution. The certificate of the result is that of the first solution. A result without
    a usable solution has none. Ctrl-C during the certificate keeps the solution, as interrupted.
    """
    check_certifiable(graph, options.loss)
    solved = solve(graph, options)
    if not solved.summary.is_solution_usable or solved.summary.interrupted:
        return solved
    solved = dataclasses.replace(solved, options=options)
    try:
        certificate = certify(solved, num_threads=solved.options.num_threads, progress=progress)
    except KeyboardInterrupt:
        interrupted = dataclasses.replace(solved.summary, interrupted=True)
        return dataclasses.replace(solved, summary=interrupted)
    solved = dataclasses.replace(solved, certificate=certificate)
    there, init, how = _lower_poses(certificate)
    if there is None:
        return solved
    first = solved.summary
    second = solve(
        graph.replace(poses=there.poses, has_poses=True),
        options.replace(certify=False, init="file"),
    )
    last = second.summary
    is_lower = last.final_cost < (1 - LOWER) * first.final_cost
    if not (is_lower and last.is_solution_usable and not last.interrupted):
        return solved
    reason = (
        f"The certificate of a first solve failed (chi2 {words.number(first.chi2_final)}). {how}"
    )
    return dataclasses.replace(
        second,
        initial_problem=graph,
        options=options,
        chi2_before=solved.chi2_before,
        certificate=certificate,
        summary=dataclasses.replace(
            last, init=init, init_choice=reason, chi2_initial=first.chi2_initial
        ),
    )


def _lower_poses(certificate: Certificate) -> tuple[PoseGraph | None, str, str]:
    """Return poses of lower cost than the solution, their name and their origin, if any."""
    stairs = certificate.staircase
    if stairs is not None and stairs.cost < (1 - LOWER) * certificate.cost:
        return (
            stairs.problem,
            STAIRCASE,
            f"A convex relaxation, of rank {stairs.rank}, gave poses of lower cost.",
        )
    if certificate.cost * (1 + NEAR_COST) < certificate.initial_cost:
        how = "The minimum of the chordal cost next to it gave poses of lower cost."
        return certificate.problem, CHORDAL_MINIMUM, how
    return None, "", ""


# Weights of a chordal cost from the information of a pose graph's edges.
#
# A chordal cost (``cpp/core/pose_graph/chordal_cost.cpp``) has two numbers per edge,
#
#     F = sum kappa || Y_j - Y_i R ||_F^2 + tau || t_j - t_i - Y_i t ||^2.
#
# Let theta be the angle of the rotation's error, and u the error of the translation. Then
#
#     || Y_j - Y_i R ||_F^2 = 4 (1 - cos theta) = 8 sin^2(theta / 2),
#
# in 2D and in 3D. A solve minimises chi2 = sum e^T Omega e, with e of one of three kinds.
# Isotropic information omega on the rotation and tau on the translation gives
#
#     error  in 3D                                kappa      in 2D
#     log    omega theta^2 + tau ||V^-1 u||^2         omega / 2  omega theta^2 + tau ||V^-1 u||^2
#     ceres  4 omega sin^2(theta/2) + tau ||u||^2     omega / 2  omega theta^2 + tau ||u||^2
#     g2o    omega sin^2(theta/2) + tau ||u||^2       omega / 8  omega theta^2 + tau ||u||^2
#
# and kappa = omega / 2 in 2D. V = int_0^1 exp(s theta) ds is a mean of rotations, so that
# ||V|| <= 1 and ||V^-1 u|| >= ||u||. With 4 sin^2(theta/2) <= theta^2, **F <= chi2 at all poses**,
# for every kind of error; in 3D F = chi2 for g2o's and Ceres' error.
#
# Any information satisfies Omega >= alpha diag(a I, b I), with a and b the smallest eigenvalues of
# its blocks of rotation and translation, and alpha the smallest eigenvalue of the scaled matrix
# D^-1/2 Omega D^-1/2, D = diag(a I, b I), which is 1 without a block that couples both. With the
# weights of alpha a and alpha b ("bound"), F <= chi2 again. A lower bound of this F is a lower
# bound of chi2. "mean" uses the means of the diagonals; for isotropic information it is the same.
# "se-sync" are the weights of SE-Sync's reader of g2o files.

CHORDAL_WEIGHTS = ("mean", "se-sync")

ISOTROPIC = 1e-9  # relative difference of weights below which information is isotropic


@dataclass(frozen=True)
class ChordalWeights:
    """Weights (m,) of the rotations and the translations of edges."""

    kappa: Floats
    tau: Floats

    def equals(self, other: ChordalWeights) -> bool:
        """Tell whether the weights of all edges are the same up to rounding."""
        return all(
            bool((np.abs(a - b) <= ISOTROPIC * np.abs(a)).all())
            for a, b in ((self.kappa, other.kappa), (self.tau, other.tau))
        )


def chordal_weights(graph: PoseGraph, weights: str, error: str) -> ChordalWeights:
    """Return the weights of a graph."""
    rotation, translation = _blocks(graph)
    if weights == "mean":
        kappa = _per_omega(graph, error) * _mean_diagonal(rotation)
        tau = _mean_diagonal(translation)
    else:
        kappa = 0.5 * _harmonic(rotation) if graph.dimension == 3 else rotation[:, 0, 0]
        tau = _harmonic(translation)
    usable = np.isfinite(kappa) & np.isfinite(tau) & (kappa > 0) & (tau > 0)
    if not usable.all():
        edge = int(np.argmin(usable))
        raise InputError(
            f"{graph.edge_name(edge)}: information: a certificate expects weights above 0 on "
            f"rotation and translation, found {kappa[edge]:g} and {tau[edge]:g}"
        )
    return ChordalWeights(kappa, tau)


def bound_weights(graph: PoseGraph, error: str) -> ChordalWeights | None:
    """Return the weights with F <= chi2 at all poses; None if an edge has singular information."""
    rotation, translation = _blocks(graph)
    least_rotation = np.linalg.eigvalsh(rotation)[:, 0]
    least_translation = np.linalg.eigvalsh(translation)[:, 0]
    if not (least_rotation.min() > 0 and least_translation.min() > 0):
        return None
    size, d = graph.tangent_size, graph.dimension
    diagonal = np.empty((graph.num_edges, size))
    diagonal[:, _rotation_of(graph)] = least_rotation[:, None]
    diagonal[:, _translation_of(graph)] = least_translation[:, None]
    root = 1 / np.sqrt(diagonal)
    scaled = root[:, :, None] * graph.information * root[:, None, :]
    # Rounding of eigenvalues must not raise a bound.
    alpha = np.minimum(np.linalg.eigvalsh(scaled)[:, 0], 1) - 8 * d * np.finfo(float).eps
    if not alpha.min() > 0:
        return None
    return ChordalWeights(
        _per_omega(graph, error) * alpha * least_rotation, alpha * least_translation
    )


def _per_omega(graph: PoseGraph, error: str) -> float:
    return 0.125 if error == "g2o" and graph.dimension == 3 else 0.5


def _rotation_of(graph: PoseGraph) -> slice:
    return slice(2, 3) if graph.dimension == 2 else slice(0, 3)


def _translation_of(graph: PoseGraph) -> slice:
    return slice(0, 2) if graph.dimension == 2 else slice(3, 6)


def _blocks(graph: PoseGraph) -> tuple[Floats, Floats]:
    rotation, translation = _rotation_of(graph), _translation_of(graph)
    return (
        graph.information[:, rotation, rotation],
        graph.information[:, translation, translation],
    )


def _mean_diagonal(blocks: Floats) -> Floats:
    mean: Floats = np.einsum("ekk->e", blocks) / blocks.shape[1]
    return mean


def _harmonic(blocks: Floats) -> Floats:
    """Return d / tr(Omega^-1) of each block; 0 for a singular block."""
    values = np.linalg.eigvalsh(blocks)
    safe = np.where(values > 0, values, np.inf)
    mean = blocks.shape[1] / (1 / safe).sum(axis=1)
    return np.where(values[:, 0] > 0, mean, 0.0)
