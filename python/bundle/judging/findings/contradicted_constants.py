r"""Constants that the observations contradict: lenses, poses, points and sensors that a run holds.

What is held at a wrong value bends the rest of the model, and shows as outliers, motion or a lens
that is too small. The score test (C. R. Rao, 1948; larger_lens.py) has the held parameters as its
added terms: of the decreases lambda^2 of twice the cost by a Newton step with and without them,

    T = (lambda^2 - lambda_0^2) / s^2

is chi^2 with as many degrees of freedom as free parameters were added, if the constants are right.
Of a large model, where a covariance is slow, the costs of two solves take the place of the steps.
Constants from another model have an error of their own; T above 4 per term allows for it.

A right calibration fails the test, too, where a free lens absorbs small errors of another kind: on
a stereo rig of KITTI, T is 350 for 4 terms and the cost falls by 1.4 %; with poses from half of the
tracks of real models, the cost of the other half falls by up to 8 %. So the finding needs 10 %.
Free parameters also absorb outliers of a least-squares fit; beside these, a solve with free ones
must have at most half as many (find.py). Of several kinds of constants and a larger lens, the one
that explains most is named (H. Akaike, 1974): the others can imitate it.
"""

from __future__ import annotations

import math
from collections.abc import Set
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import distinct
from bundle.base.tails import chi2_tail
from bundle.base.words import named, number, plural, rounded
from bundle.errors import InputError
from bundle.interface.finding import Finding
from bundle.interface.option_fields import SENSORS
from bundle.interface.options import SolveOptions
from bundle.judging.findings.larger_lens import BY_TERM, MOST_WORK, SIGNIFICANT, Step, explains_more
from bundle.judging.findings.measured import SMALLEST_SCALE, Measured
from bundle.judging.findings.repaired import solved_free
from bundle.model.problem import Problem

if TYPE_CHECKING:
    from bundle.interface.summary import Summary
    from bundle.solving.result import Result

NOTABLE = 0.1  # smallest fall of the cost for which constants are named


class Held(NamedTuple):
    """A kind of parameters that a run can hold."""

    kind: str  # of the finding
    owner: str
    values: str  # the parameters in a sentence
    names: Set[str]  # in ``SolveOptions.refine``
    option: str  # option that holds the parameters of some owners

    def ids(self, problem: Problem, options: SolveOptions) -> list[Any]:
        """Return the ids of the owners whose parameters are held; (rig, camera) of sensors."""
        if self.names <= {*options.refine, SENSORS * options.refine_sensor_from_rig}:
            return list(getattr(options, self.option))
        if self.owner == "sensor":
            rigs, cameras = problem.sensor_rig_ids, problem.sensor_camera_ids
            return [*zip(rigs.tolist(), cameras.tolist(), strict=True)]
        owners: NDArray[np.int64] = getattr(problem, f"{self.owner}_ids")
        used = distinct(problem.image_camera) if self.owner == "camera" else slice(None)
        return [*owners[used].tolist()]


HELD = (
    Held("constant_lens", "camera", "parameters", {"focal", "extra"}, "fixed_camera_ids"),
    Held("constant_poses", "image", "poses", {"poses"}, "fixed_image_ids"),
    Held("constant_points", "point", "positions", {"points"}, "fixed_point_ids"),
    Held("constant_sensors", "sensor", "poses", {SENSORS}, "fixed_sensors"),
)


def is_notable(fall: float, squares: float, count: int, redundancy: int) -> bool:
    """Return True if a fall of the squares by free parameters is significant and large.

    squares: weighted squares with the ``count`` parameters free, of ``redundancy`` degrees.
    """
    if not (count > 0 < squares and redundancy > 0 and fall > NOTABLE * (squares + fall)):
        return False
    statistic = fall * redundancy / squares
    return chi2_tail(statistic, count) < SIGNIFICANT and statistic > BY_TERM * count


def release(held: Summary, free: Summary) -> tuple[float, float, int, int]:
    """Return the arguments of is_notable for two solves, the second with fewer constants."""
    count = free.num_parameters_reduced - held.num_parameters_reduced
    redundancy = free.num_residuals_reduced - free.num_parameters_reduced
    return 2 * (held.final_cost - free.final_cost), 2 * free.final_cost, count, redundancy


def _by_steps(
    measured: Measured, present: Step, free: SolveOptions
) -> tuple[float, float, int, int] | None:
    """Return the same for steps of Newton; None if a larger lens explains more."""
    try:
        opened = Step(measured.whole, free)
    except InputError:
        return None
    redundancy = opened.num_residuals - opened.num_parameters
    count = opened.num_parameters - present.num_parameters
    found = opened.decrease - present.decrease, opened.variance * redundancy, count, redundancy
    return None if is_notable(*found) and explains_more(measured, opened) else found


def contradicted_constants(measured: Measured) -> tuple[Finding | None, Measured | None]:
    """Return the finding, or None, and the model without these constants if it was solved."""
    options, problem = measured.options, measured.whole
    is_large = measured.work > MOST_WORK
    rows = HELD[:-1] if is_large else HELD  # sensors, held by default, do not pay for two solves
    held = [(one, ids) for one in rows if (ids := one.ids(problem, options))]
    if not held or not measured.scale > SMALLEST_SCALE or (is_large and not measured.is_minimum):
        return None, None
    try:
        present = solved_free(measured) if is_large else Step(problem, options)
    except InputError:  # something is not determined
        return None, None
    found: list[tuple[float, Measured, Result | None, Finding]] = []
    for one, ids in held:
        free = options.replace(refine={*options.refine, *one.names}, **{one.option: ()})
        model = replace(measured, options=free)
        result = solved_free(model) if is_large else None
        if isinstance(present, Step):
            released = _by_steps(measured, present, free)
        elif present is None or result is None:
            continue
        else:
            released = release(present.summary, result.summary)
        if released is None or not is_notable(*released):
            continue
        fall, squares, count, redundancy = released
        statistic, share = fall * redundancy / squares, fall / (squares + fall)
        command = measured.command.without(f"--fix-{one.owner}s", lambda _: True)
        # By name even if it is the default: options of COLMAP may hold them.
        refine = ["--refine", ",".join(free.refine).replace("_", "-")]
        refine *= free.refine != options.refine
        sensors = free.refine_sensor_from_rig and not options.refine_sensor_from_rig
        refine += ["--refine-sensor-from-rig"] * sensors
        names = named(one.owner, [":".join(map(str, np.atleast_1d(key))) for key in ids])
        finding = Finding(
            kind=one.kind,
            sentence=f"The observations contradict the constant {one.values} of {names}: with free "
            f"ones, the cost falls by {rounded(100 * share)} % (chi2 {number(statistic)} for "
            f"{plural(count, 'term')}).",
            command=command.refine(*refine),
            evidence={f"{one.owner}_ids": ids, "chi2": statistic, "dof": count, "share": share},
        )
        found.append((problem.num_observations * math.log(squares) + count, model, result, finding))
    if not found:
        return None, None
    _, model, result, best = min(found, key=lambda one: one[0])
    result = solved_free(model) if result is None else result
    return best, None if result is None else replace(model, whole=result.problem)
