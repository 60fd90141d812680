"""``bundle.compare``: every method on every problem, each run in its own process."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack, overload

from bundle.base.arrays import check_function
from bundle.errors import InputError, check_keywords
from bundle.graphs.factors.factor_graph import FactorGraph
from bundle.graphs.factors.same_problem import options_of_graph, pose_graph_of, problem_of
from bundle.graphs.pose_graphs.edge_weights import is_graph, refuse_for_graphs
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.interface.environment import Environment
from bundle.interface.option_class import spellings, takes_options
from bundle.interface.option_fields import number
from bundle.interface.options import SolveOptions
from bundle.interface.planning_options import (
    BACKENDS,
    COMPARED,
    LARGEST_PERTURBATION,
    ORDERINGS,
    PRECONDITIONERS,
    REPEAT,
    SHARE_OF_FREE_MEMORY,
    SOLVERS,
    THREADS,
    TIMEOUT,
    TRUST_REGIONS,
)
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.io.files import Source
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.planning.comparison import process
from bundle.planning.comparison.comparison_result import (
    GAPS,
    Comparison,
    PerformanceProfile,
    performance_profiles,
)
from bundle.planning.comparison.graph_comparison import (
    GraphComparison,
    compare_factor_graph,
    compare_graph,
)
from bundle.planning.comparison.measured_run import expand
from bundle.planning.comparison.recommendation import recommend
from bundle.planning.comparison.work import Progress, Work

if TYPE_CHECKING:
    from bundle.interface.option_keywords import PoseGraphKeywords, SolveKeywords


@overload
def compare(
    problems: PoseGraph | PoseGraphResult,
    options: PoseGraphOptions | None = None,
    *,
    backends: Iterable[str] = BACKENDS,
    threads: Iterable[int] = THREADS,
    repeat: int = REPEAT,
    timeout: float = TIMEOUT,
    progress: Callable[[str], None] | None = None,
    **changes: Unpack[PoseGraphKeywords],
) -> GraphComparison: ...


@overload
def compare(
    problems: FactorGraph,
    options: SolveOptions | PoseGraphOptions | None = None,
    **given: Any,
) -> Comparison | GraphComparison: ...


@overload
def compare(
    problems: Source | Sequence[Source],
    options: SolveOptions | None = None,
    *,
    solvers: Iterable[str] = SOLVERS,
    preconditioners: Iterable[str] = PRECONDITIONERS,
    orderings: Iterable[str] = ORDERINGS,
    backends: Iterable[str] = BACKENDS,
    trust_regions: Iterable[str] = TRUST_REGIONS,
    threads: Iterable[int] = THREADS,
    perturb: float = 0.0,
    seed: int = 0,
    repeat: int = REPEAT,
    timeout: float = TIMEOUT,
    memory_cap: int = 0,
    progress: Callable[[Progress], None] | None = None,
    **changes: Unpack[SolveKeywords],
) -> Comparison: ...


@takes_options(SolveOptions)
def compare(
    problems: Source | Sequence[Source] | PoseGraph | PoseGraphResult | FactorGraph,
    options: SolveOptions | PoseGraphOptions | None = None,
    *,
    solvers: Iterable[str] = SOLVERS,
    preconditioners: Iterable[str] = PRECONDITIONERS,
    orderings: Iterable[str] = ORDERINGS,
    backends: Iterable[str] = BACKENDS,
    trust_regions: Iterable[str] = TRUST_REGIONS,
    threads: Iterable[int] = THREADS,
    perturb: float = 0.0,
    seed: int = 0,
    repeat: int = REPEAT,
    timeout: float = TIMEOUT,
    memory_cap: int = 0,
    progress: Callable[[Any], None] | None = None,
    **changes: Any,
) -> Comparison | GraphComparison:
    """Solve the same start by every combination of methods and recommend one.

    Methods that end in different minima are grouped, and none of them is recommended. Runs are
    sequential, each in its own process. A run that fails, crashes or exceeds the time or
    memory limit becomes a row with the reason, and the comparison continues. Ctrl-C ends the
    comparison and returns the completed runs.

    For a pose graph, the result of its solve, or a g2o file, the result is a
    :class:`GraphComparison`. It compares backends, elimination orders and trust regions from one
    start, one run after the other in this process. It takes ``backends``, ``threads``, ``repeat``,
    ``timeout`` and options of :class:`bundle.PoseGraphOptions`. ``progress`` is called with the
    name of each method.

    A :class:`FactorGraph` of reprojections is compared as the problem that it represents, one of
    relative poses as the pose graph; :meth:`FactorGraph.as_problem` and
    :meth:`FactorGraph.as_pose_graph` return these for a solve by the recommended method. For any
    other factor graph, Ceres with each linear solver and trust region is compared with a QR
    factorisation of the Jacobian. It takes ``threads``, ``repeat``, ``timeout`` and options of
    :class:`bundle.SolveOptions`.

    Args:
        problems: one or a list of problems, paths, or pycolmap.Reconstructions.
        options: options of every solve, except those that the methods vary.
        solvers: values of ``linear_solver_type`` to compare.
        preconditioners: values of ``preconditioner_type``, for iterative solvers.
        orderings: values of ``linear_solver_ordering``.
        backends: values of ``backend``.
        trust_regions: values of ``trust_region_strategy_type``; doglegs need a direct solver.
        threads: values of ``num_threads``; 0 for all cores.
        perturb: size of a perturbation of the start, such as 0.01, for inputs at their minimum:
            standard deviation of centres and points relative to their distances, of rotations in
            radians, and of focal lengths relatively. Constant values are not perturbed.
        seed: seed of the perturbation.
        repeat: runs of each method, whose median counts; a run of more than 10 s is not repeated.
        timeout: seconds after which a solve is stopped.
        memory_cap: bytes that a solve may allocate beyond the loaded problem; 0: 90 % of the free
            memory at the start of the comparison.
        progress: called when a run starts, and regularly with its iterations.
        **changes: options by name, which replace those in ``options``.

    Raises:
        InputError: an option does not exist, is out of range, or is a compared option; a problem
            cannot be loaded or has no observations; or there is nothing to compare.

    Example:
        >>> comparison = bundle.compare("problem.txt", solvers=["dense_schur", "sparse_schur"])
        >>> print(comparison.recommendation.command)
    """
    if isinstance(problems, FactorGraph):
        problems, options = _stated(problems, options, changes)
    if is_graph(problems) or isinstance(problems, FactorGraph):
        refuse_for_graphs(
            solvers=None if solvers is SOLVERS else solvers,
            preconditioners=None if preconditioners is PRECONDITIONERS else preconditioners,
            orderings=None if orderings is ORDERINGS else orderings,
            trust_regions=None if trust_regions is TRUST_REGIONS else trust_regions,
            perturb=perturb or None,
            seed=seed or None,
            memory_cap=memory_cap or None,
        )
        if isinstance(problems, FactorGraph):
            refuse_for_graphs(backends=None if backends is BACKENDS else backends)
            return compare_factor_graph(
                problems,
                options,  # type: ignore[arg-type]
                threads=threads,
                repeat=repeat,
                timeout=timeout,
                progress=progress,
                changes=changes,
            )
        return compare_graph(
            problems,
            options,  # type: ignore[arg-type]
            backends=backends,
            threads=threads,
            repeat=repeat,
            timeout=timeout,
            progress=progress,
            **changes,
        )
    started, environment = time.perf_counter(), Environment.now()
    options = _options(options, changes)  # type: ignore[arg-type]
    methods = expand(
        solvers=solvers,
        preconditioners=preconditioners,
        orderings=orderings,
        backends=backends,
        trust_regions=trust_regions,
        threads=threads,
    )
    perturb = number("perturb", perturb, minimum=0, maximum=LARGEST_PERTURBATION)
    seed = number("seed", seed, whole=True, minimum=0)
    repeat = number("repeat", repeat, whole=True, minimum=1)
    timeout = number("timeout", timeout, above=0)
    memory_cap = number("memory_cap", memory_cap, whole=True, minimum=0, maximum=2**63 - 1)
    check_function("progress", progress)
    sources: list[Any] = list(problems) if isinstance(problems, list | tuple) else [problems]
    if not sources:
        raise InputError("problems: expected at least one problem, found 0")
    cap = memory_cap or int(SHARE_OF_FREE_MEMORY * process.available_memory())
    report = progress or (lambda _: None)
    with tempfile.TemporaryDirectory(prefix="bundle-compare-") as folder:
        work = Work(
            folder=Path(folder),
            options=options,
            methods=methods,
            repeat=repeat,
            timeout=timeout,
            memory_cap=cap,
            report=report,
            perturb=perturb,
            seed=seed,
        )
        compared = tuple(work.take_over(index, source) for index, source in enumerate(sources))
        interrupted = work.run_all(compared)
        runs = tuple(work.runs(len(compared), interrupted))
        comparison = Comparison(
            problems=compared,
            runs=runs,
            profiles=(),
            recommendation=None,
            options=options,
            repeat=repeat,
            timeout=timeout,
            memory_cap_in_bytes=cap,
            interrupted=interrupted,
            wall_time_in_seconds=time.perf_counter() - started,
            environment=environment.finished(),
            perturb=perturb,
            seed=seed,
        )
    return dataclasses.replace(
        comparison,
        profiles=_profiles(comparison),
        recommendation=recommend(comparison, work.foreseen),
    )


def _stated(graph: FactorGraph, options: Any, changes: Mapping[str, Any]) -> tuple[Any, Any]:
    """Return the pose graph or problem that a graph represents, or the graph, with options."""
    if (poses := pose_graph_of(graph)) is not None:
        return poses.graph, options
    if (same := problem_of(graph)) is not None:
        return same.problem, options_of_graph(same, SolveOptions.of(options, changes, "compare"))
    return graph, options


def _options(options: SolveOptions | None, changes: Mapping[str, Any]) -> SolveOptions:
    """Return the options of every solve; refuse options that the methods vary."""
    own = ("perturb", "seed", "repeat", "timeout", "memory_cap", "progress", *COMPARED.values())
    known = {
        **{
            spelling: COMPARED.get(name, name) for spelling, name in spellings(SolveOptions).items()
        },
        **{name: name for name in own},
    }
    check_keywords("compare", changes, known)
    chosen = SolveOptions.of(options, changes, "compare")
    for name, argument in COMPARED.items():
        value = getattr(chosen, name)
        if value != SolveOptions.__dataclass_fields__[name].default:
            raise InputError(f"options: {name} is compared; expected {argument}=[{value!r}]")
    return chosen


def _profiles(comparison: Comparison) -> tuple[PerformanceProfile, ...]:
    if len(comparison.problems) < 2:
        return ()
    profiles: list[PerformanceProfile] = []
    for gap in GAPS:
        times = [
            {run.method: comparison.time_to_gap(run, gap) for run in comparison.runs_of(index)}
            for index in range(len(comparison.problems))
        ]
        profiles += performance_profiles(times, comparison.methods, gap)
    return tuple(profiles)
