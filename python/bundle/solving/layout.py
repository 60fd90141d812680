"""Layout of a solve: factors by index, restrictions as arrays, resolved options."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

import bundle._core as _core
from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.model.residuals import resolve_cheirality
from bundle.solving.ranks.launch import threads_of_one_process

if TYPE_CHECKING:
    from bundle.graphs.factors.factors import Factor
    from bundle.graphs.factors.problem_factors import ProblemFactors
    from bundle.solving.constraints.ends import Applied
    from bundle.solving.constraints.restrictions import Restrictions
    from bundle.solving.request import Bounds


class Layout(NamedTuple):
    """Arguments of the core in addition to the problem."""

    options: SolveOptions  # resolved options, without "auto"
    known: ProblemFactors | None  # factors, including those of priors and rules; None without any
    # bounds, and the parameters that rules make constant or tie; None without any
    limits: Restrictions | None

    def core_factors(self) -> Any:
        """Return the factors in the form that the core expects."""
        return None if self.known is None else self.known.core()


def lay_out(
    problem: Problem,
    options: SolveOptions,
    factors: Iterable[Factor],
    bounds: Bounds | None = None,
    applied: Applied | None = None,
) -> Layout:
    """Check factors and bounds, add those of the rules, and resolve the options."""
    if applied is not None and applied.factors:
        factors = (*factors, *applied.factors)
    known = _problem_factors(problem, factors)
    if problem.rolling_shutter is not None or options.twists != "free":
        known, options = _with_twists(problem, options, factors, known)
    locate = (known is not None and known.locate) or (applied is not None and applied.locate)
    if locate and options.gauge == "auto":
        options = options.replace(gauge="none")
    limits = _restrictions(problem, bounds, applied)
    if options.twists == "hard" and limits is not None and limits.held_pose_parts is not None:
        raise InputError(
            "constraints: expected free rotations and positions with hard twists, which follow them"
        )
    options = resolve_defaults(problem, options)
    has_planes = applied and any(one.normals or one.flatness for one in applied.priors)
    if options.gauge == "none" and known and applied and has_planes:
        from bundle.solving.gauge_freedom import can_shrink  # for planes and lines only

        if can_shrink(problem, options, known.factors, applied):
            raise InputError(
                "constraints: expected positions, scale bars, two fixed images or gauge "
                "two-cameras beside points on planes and lines, which fit a smaller world better"
            )
    return Layout(options, known, limits)


def _restrictions(
    problem: Problem, bounds: Bounds | None, applied: Applied | None
) -> Restrictions | None:
    if bounds is None and applied is None:
        return None
    from bundle.solving.constraints.restrictions import Restrictions  # slow to import

    return Restrictions.make(problem, bounds, applied)


def _with_twists(
    problem: Problem,
    options: SolveOptions,
    factors: Iterable[Factor],
    known: ProblemFactors | None,
) -> tuple[ProblemFactors | None, SolveOptions]:
    """Add the ties of twists, and fix the scale of the world, which ties alone would shrink."""
    from bundle.graphs.factors.image_factors import twist_ties  # only with rolling shutters

    shutter = problem.rolling_shutter
    if shutter is None:
        raise InputError(
            f"twists: expected free for a problem without rolling shutters, found {options.twists}"
        )
    given = () if known is None else known.factors
    measured = {factor.keys[1] for factor in given if factor.kind == "velocity"}
    if options.twists == "hard":
        shutter.check_tied(problem)
        if measured:
            raise InputError(
                "twists: expected free or tied with velocities, because hard twists are not "
                "unknowns, found hard"
            )
    if options.twists != "tied":
        return known, options
    holds = known is not None and known.holds_scale
    # Beside a velocity, a tie of the translation would bias a refined readout.
    ties = twist_ties(problem, options.twist_sigma, measured if options.refine_readout else set())
    if not holds and options.gauge == "auto":
        options = options.replace(gauge="two_cameras")
    return _problem_factors(problem, (*factors, *ties)), options


def refuse_shrinking(layout: Layout) -> None:
    """Refuse a solve with tied twists in which nothing determines the scale of the world."""
    options, known, _ = layout
    if options.twists != "tied" or options.gauge != "none" or options.fixed_image_ids:
        return
    if known is None or not known.holds_scale:
        raise InputError(
            "gauge: expected two-cameras, positions or velocities, because tied twists fit a "
            "smaller world better, found gauge none"
        )


def _problem_factors(problem: Problem, factors: Iterable[Factor]) -> ProblemFactors | None:
    if not factors:
        return None
    from bundle.graphs.factors.problem_factors import ProblemFactors  # slow to import

    return ProblemFactors(problem, factors)


def resolve_defaults(problem: Problem, options: SolveOptions) -> SolveOptions:
    """Resolve the options that depend on the source of the problem and on this machine."""
    cores = _core.hardware_threads()
    gauge = options.gauge
    if gauge == "auto":
        gauge = "none" if problem.format == "bal" else "two_cameras"
    return options.replace(
        gauge=gauge,
        cheirality=resolve_cheirality(problem, options.cheirality),
        num_threads=min(options.num_threads or threads_of_one_process(cores), cores),
    )
