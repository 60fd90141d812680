"""Solve a model again without a fault that was found, for the tests that follow.

One fault causes symptoms of others. Outliers of a least-squares fit and rolling shutters bend the
model, a lens model that is too small makes focal lengths differ, wrong positions pull images away.
So the tests run in stages. If a stage finds a fault, the model is solved again from its present
values with the remedy of the finding: a cauchy loss, a larger lens model, a rolling shutter, or no
positions. The next stage looks at that model. Only faults that the original also has are reported.
If the robust solve does not converge, the fault has destroyed the model, and no later stage can be
trusted. A solve with a larger lens or a shutter starts at a minimum; a few steps are enough. Later
stages need only large changes, so both solves may end at a cost that is 1e-4 too high. This takes a
third of the steps, and slow steps near the minimum do not count as failures. Positions that bend a
model take it far from the minimum without them, and the return is slow, because a drift costs
little. So that solve has more steps and a smaller tolerance.

The second solve takes about as long as the first. It is made for models of at most 50,000
observations and 100 images; of larger ones, later stages look at the model itself, without those
tests that the fault would mislead.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.judging.findings.measured import Measured
from bundle.model.problem import Problem

if TYPE_CHECKING:
    from bundle.solving.result import Result

MOST_OBSERVATIONS, MOST_IMAGES = 50_000, 100
MOST_STEPS = 50
TOLERANCE = 1e-4
MOST_FREE_STEPS, FREE_TOLERANCE = 200, 1e-6
"""Limits of a solve without the positions, rules or constants that bend the model."""


def is_affordable(measured: Measured, times: int = 1) -> bool:
    """Return True if the model is small enough, or times as large, to be solved again."""
    whole, observations = measured.whole, times * MOST_OBSERVATIONS
    return whole.num_observations <= observations and whole.num_images <= times * MOST_IMAGES


def solved(
    measured: Measured,
    start: Problem,
    options: SolveOptions,
    priors: Sequence[Any],
    gauge: str = "auto",
) -> Result:
    """Return the result of a start in the frame of a model, with its rules.

    Raises:
        InputError: the solve cannot start, or has no usable result.
    """
    from bundle.solving.executors import solve_prepared
    from bundle.solving.prepare import prepare
    from bundle.solving.request import SolveRequest

    request = SolveRequest(
        problem=start,
        options=options.replace(gauge=gauge, check_solution=False),
        priors=priors,
        align=False,
        constraints=measured.constraints,
    )
    prepared = prepare(request)
    result = prepared.finished(solve_prepared(prepared, None))
    if not result.summary.is_solution_usable:
        raise InputError(result.summary.message)
    return result


def solved_free(measured: Measured, gauge: str = "auto") -> Result | None:
    """Return the result far from the present values, with fewer constants than the model had.

    None if something is undetermined, or if the model is more than ten times as large as others
    that are solved again: a user who gives a rule pays for its test.
    """
    options = measured.options.replace(
        max_num_iterations=MOST_FREE_STEPS, function_tolerance=FREE_TOLERANCE
    )
    if not is_affordable(measured, 10):
        return None
    try:
        return solved(measured, measured.whole, options, measured.priors, gauge)
    except InputError:
        return None


def repaired(
    measured: Measured,
    lens_model: str = "",
    shutter: str = "",
    *,
    with_priors: bool = False,
    is_bent: bool = False,
) -> Measured | None:
    """Return the model solved again with a robust loss; None if it fails.

    Printed commands begin with the same repair, because findings on this model hold only after it.

    "" is the present lens model, and no shutter. The solve has no positions. With `is_bent` (they
    have bent the model), it takes more steps.
    """
    options = measured.options.replace(
        loss="cauchy",
        loss_scale=max(2.0 * measured.scale, 1e-3),
        max_num_iterations=MOST_FREE_STEPS if is_bent else MOST_STEPS,
        function_tolerance=FREE_TOLERANCE if is_bent else TOLERANCE,
    )
    priors = measured.priors if with_priors else ()
    try:
        problem, options = _edited(measured.whole, options, lens_model, shutter)
        start = _edited(measured.start or measured.whole, options, lens_model, shutter)[0]
        result = solved(measured, problem, options, priors)
    except InputError:
        return None
    flags = ["--camera-model", lens_model] if lens_model else []
    flags += ["--rolling-shutter", shutter] if shutter else []
    if not flags and result.summary.termination_type != "CONVERGENCE":
        return None
    return dataclasses.replace(
        measured,
        whole=result.problem,
        start=start,
        command=measured.command.after(*(flags or ("--loss", "cauchy"))),
        options=options,
        lens_sigmas=None,
        priors=priors,
        is_minimum=True,
    )


def _edited(
    problem: Problem, options: SolveOptions, lens_model: str, shutter: str
) -> tuple[Problem, SolveOptions]:
    if lens_model:
        from bundle.editing.model_change import change_camera_model

        problem = change_camera_model(problem, lens_model).problem
    if not shutter:
        return problem, options
    from bundle.editing.rolling_shutters import with_shutters
    from bundle.interface.camera_edit_options import ShutterOptions

    return with_shutters(problem, ShutterOptions(rolling_shutter=shutter), options)
