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
from dataclasses import replace
from typing import Any, NamedTuple

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

LENS = {"focal", "extra"}  # names in ``SolveOptions.refine``
NOTABLE = 0.1  # smallest fall of the cost for which constants are named


class Held(NamedTuple):
    """A kind of parameters that a run can hold."""

    kind: str  # of the finding
    owner: str
    values: str  # the parameters in a sentence
    names: frozenset[str]  # in ``SolveOptions.refine``
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
    Held("constant_lens", "camera", "parameters", frozenset(LENS), "fixed_camera_ids"),
    Held("constant_poses", "image", "poses", frozenset({"poses"}), "fixed_image_ids"),
    Held("constant_points", "point", "positions", frozenset({"points"}), "fixed_point_ids"),
    Held("constant_sensors", "sensor", "poses", frozenset({SENSORS}), "fixed_sensors"),
)


def is_notable(fall: float, squares: float, count: int, redundancy: int) -> bool:
    """Return True if a fall of the squares by free parameters is significant and large.

    squares: weighted squares with the ``count`` parameters free, of ``redundancy`` degrees.
    """
    if not (count > 0 < squares and redundancy > 0 and fall > NOTABLE * (squares + fall)):
        return False
    statistic = fall * redundancy / squares
    return chi2_tail(statistic, count) < SIGNIFICANT and statistic > BY_TERM * count


def _by_steps(measured: Measured, free: SolveOptions) -> tuple[float, float, int, int]:
    """Return the arguments of is_notable for options that refine more, by steps of Newton."""
    present, opened = Step(measured.whole, measured.options), Step(measured.whole, free)
    redundancy = opened.num_residuals - opened.num_parameters
    count = opened.num_parameters - present.num_parameters
    return opened.decrease - present.decrease, opened.variance * redundancy, count, redundancy


def _by_solves(measured: Measured, free: SolveOptions) -> tuple[float, float, int, int] | None:
    """Return the same from solves, which take less than steps of large models."""
    found = [solved_free(replace(measured, options=one)) for one in (measured.options, free)]
    if found[0] is None or found[1] is None:
        return None
    held, opened = found[0].summary, found[1].summary
    count = opened.num_parameters_reduced - held.num_parameters_reduced
    redundancy = opened.num_residuals_reduced - opened.num_parameters_reduced
    return 2 * (held.final_cost - opened.final_cost), 2 * opened.final_cost, count, redundancy


def _name(key: Any) -> str:
    return ":".join(map(str, key)) if isinstance(key, tuple) else str(key)


def contradicted_constants(measured: Measured) -> tuple[Finding | None, Measured | None]:
    """Return the finding, or None, and the model without these constants if it was solved."""
    options, problem = measured.options, measured.whole
    held = [(one, ids) for one in HELD if (ids := one.ids(problem, options))]
    is_large = measured.work > MOST_WORK
    if is_large:  # sensors, which are held by default, do not pay for two solves
        held = [(one, ids) for one, ids in held if one.owner != "sensor"]
    if not held or not measured.scale > SMALLEST_SCALE or (is_large and not measured.is_minimum):
        return None, None
    found: list[tuple[float, SolveOptions, Finding]] = []
    for one, ids in held:
        free = options.replace(refine={*options.refine, *one.names}, **{one.option: ()})
        try:
            released = (_by_solves if is_large else _by_steps)(measured, free)
        except InputError:  # something is not determined
            continue
        if released is None or not is_notable(*released):
            continue
        if not is_large and explains_more(measured, Step(problem, free)):
            continue
        fall, squares, count, redundancy = released
        statistic, share = fall * redundancy / squares, fall / (squares + fall)
        command = measured.command.without(f"--fix-{one.owner}s", lambda _: True)
        # By name even if it is the default: options of COLMAP may hold them.
        refine = ["--refine", ",".join(free.refine).replace("_", "-")]
        refine = [] if free.refine == options.refine else refine
        if free.refine_sensor_from_rig != options.refine_sensor_from_rig:
            refine.append("--refine-sensor-from-rig")
        names = named(one.owner, [_name(key) for key in ids])
        finding = Finding(
            kind=one.kind,
            sentence=f"The observations contradict the constant {one.values} of {names}: with free "
            f"ones, the cost falls by {rounded(100 * share)} % (chi2 {number(statistic)} for "
            f"{plural(count, 'term')}).",
            command=command.refine(*refine),
            evidence={f"{one.owner}_ids": ids, "chi2": statistic, "dof": count, "share": share},
        )
        found.append((2.0 * (problem.num_observations * math.log(squares) + count), free, finding))
    if not found:
        return None, None
    _, free, best = min(found, key=lambda one: one[0])
    model = replace(measured, options=free)
    result = solved_free(model)
    return best, None if result is None else replace(model, whole=result.problem)
