"""Headline of a refinement: its outcome in a few sentences, each true on its own.

The first sentence compares the RMSE and the median before and after on the same observations: those
of the output that have a projection on both sides. "Before" is the input before all edits. Further
sentences name what would otherwise mislead: deleted observations, outliers that a robust loss
downweights, observations without a projection, parts that stayed constant.

"Already at its minimum" needs a converged solve whose steps, taken together, lowered the cost by at
most ``SMALLEST_DECREASE`` of it, with a trust region that did not shorten them. They must also have
moved cameras and focal lengths by at most ``SMALLEST_MOVEMENT`` of the scene and of themselves:
undetermined parameters move far at almost no change of the cost.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from bundle.base.words import number, pixels, plural, rounded
from bundle.interface.summary import short_outcome

if TYPE_CHECKING:
    from bundle.solving.kept_errors import KeptErrors
    from bundle.solving.measured_result import MeasuredResult as Result

SMALLEST_DECREASE = 1e-4
"""Relative decrease of the cost at a minimum; the RMSE then changes by at most 0.005 %."""

FARTHEST = 0.3
"""Distance of the cameras from a minimum, in standard deviations (minimize/sigma_rule.h)."""

FEW = 0.005  # share of the observations below which nobody asks why rounds deleted them

SMALLEST_MOVEMENT = 1e-3  # relative movement at a minimum

EDITS = {
    "camera_model": "camera model",
    "share_cameras": "shared cameras",
    "split_cameras": "split cameras",
    "rig_config": "rigs",
    "loops": "closed loops",
    "alignment": "alignment",
    "rules": "rules",
}


def headline(result: Result) -> list[str]:
    """Return the sentences of a result."""
    if not result.summary.is_solution_usable and not result.summary.interrupted:
        error = result.reprojection_error_before
        rmse = f"RMSE of the input is {_px(error.rmse)} px" if error.num_observations else ""
        return [result.outcome, f"There is no usable solution{'; ' * bool(rmse)}{rmse}."]
    return [
        _verdict(result),
        *_distance(result),
        *_tracks(result),
        *_deletions(result),
        *_held_out(result),
        *_outliers(result),
        *_starts(result),
        *_pulls(result),
        *_without_projection(result),
        *_part(result),
        _movement(result),
    ]


def edit_facts(result: Result) -> list[tuple[str, str]]:
    """Return one row for each edit: RMSE before and after, of all observations of the input."""
    return [
        (EDITS[name], f"RMSE {_change(before.rmse, after.rmse)} px")
        for name, before, after in result.edit_errors
    ]


def is_at_minimum(result: Result) -> bool:
    """Return True if the input was at the minimum of the cost."""
    summary = result.summary
    changed = any(name.edit != "alignment" for name in result.edits)
    if summary.termination_type != "CONVERGENCE" or changed or result.deleted.num_observations:
        return False
    if _is_far(result) or "No non-constant" in summary.message:
        return False
    radius = float(np.asarray(result.iterations["trust_region_radius"])[-1])
    decrease = summary.initial_cost - summary.final_cost
    found = result.movement
    moved = (found.position / found.scene_size if found.num_images else 0.0, found.focal)
    return (
        decrease <= SMALLEST_DECREASE * summary.initial_cost
        and not any(share > SMALLEST_MOVEMENT for share in moved)
        and not radius < 1
    )


def _verdict(result: Result) -> str:
    """Return the outcome with the errors before and after."""
    kept, done = result.kept, result.work
    if is_at_minimum(result):
        outcome = f"Already at its minimum ({done}, {_stillness(result)})"
    else:
        outcome = short_outcome(result.summary, done)
    if not kept.before.num_observations:
        return f"{outcome}; no observation has a projection before and after."
    rmse = _change(kept.before.rmse, kept.after.rmse)
    median = _change(kept.before.median, kept.after.median)
    return f"{outcome}: RMSE {rmse} px (median {median}) on {_observations(result, kept)}."


def _is_far(result: Result) -> bool:
    return (result.summary.largest_camera_step_in_sigmas or 0.0) > FARTHEST


def _distance(result: Result) -> list[str]:
    """Return the remaining distance to the minimum, if it is not small."""
    if not _is_far(result):
        return []
    left = rounded(result.summary.largest_camera_step_in_sigmas or 0.0)
    return [f"The minimum is about {left} standard deviations of the cameras away: refine again."]


def _stillness(result: Result) -> str:
    """Return the change of the cost, and the distance to the minimum if it was computed."""
    initial, final = result.summary.initial_cost, result.summary.final_cost
    share = (initial - final) / initial if initial > 0 else 0.0
    fall = f"cost -{100 * share:.1g} %" if share > 0 else "cost unchanged"
    left = result.summary.largest_camera_step_in_sigmas
    return fall if left is None else f"{fall}, cameras within {rounded(left)} sigmas of it"


def _observations(result: Result, kept: KeptErrors) -> str:
    count, compared = kept.num_observations, kept.before.num_observations
    if compared < count:
        return f"the {compared:,} of {count:,} observations with a projection before and after"
    if result.tracks:
        return f"the {count:,} observations in INPUT and OUTPUT"
    if result.deleted.num_observations:
        return f"the {count:,} observations kept"
    return f"all {count:,} observations" if count > 1 else "its only observation"


def _tracks(result: Result) -> list[str]:
    """Return what the rounds added, merged and deleted."""
    if not result.tracks:
        return []
    first, last = result.source_problem, result.problem
    names = ("triangulated", "completed", "merged", "deleted")
    sums = [sum(getattr(done, name) for done in result.tracks) for name in names]
    told = ", ".join(f"{count:,} {name}" for count, name in zip(sums, names, strict=True))
    return [
        f"Tracks: {first.num_observations:,} -> {last.num_observations:,} observations of "
        f"{first.num_points:,} -> {last.num_points:,} points ({told})."
    ]


def _deletions(result: Result) -> list[str]:
    deleted = result.deleted
    if not deleted.num_observations:
        return []
    share = deleted.num_observations / result.source_problem.num_observations
    observations = plural(deleted.num_observations, "observation", grouped=True)
    things = [f"{observations} ({_percent(share)})"]
    things += [plural(deleted.num_points, "point", grouped=True)] * (deleted.num_points > 0)
    things += [f"all of {plural(deleted.num_images, 'image')}"] * (deleted.num_images > 0)
    listed = " and ".join([", ".join(things[:-1]), things[-1]] if len(things) > 1 else things)
    causes = f" ({result.causes})" if result.causes else ""
    before, after = result.reprojection_error_before, result.kept.before
    alone = f"RMSE {_change(before.rmse, after.rmse)} px at the input"
    sentences = [f"Deleted {listed}{causes}: this alone changes {alone}."]
    if _fitted_the_input(result):
        sentences.append(
            "Most of them fitted the input: a rule, a measurement or a constant parameter of this "
            "run may be wrong instead."
        )
    return sentences


def _fitted_the_input(result: Result) -> bool:
    """Return True if the RMSE at the input of what rounds deleted is half of their limit."""
    all_of, kept = result.reprojection_error_before, result.kept.before
    count = all_of.num_observations - kept.num_observations
    squares = all_of.num_observations * all_of.rmse**2 - kept.num_observations * kept.rmse**2
    far, limit = result.deleted_for_error
    few = max(FEW * all_of.num_observations, 0.5 * count)
    return far > few and squares < count * (0.5 * limit) ** 2


def _held_out(result: Result) -> list[str]:
    """Return the error of a second fit at the held-out observations."""
    held = result.held_out
    if held is None:
        return []
    doubt = "" if held.is_converged else "; the second fit did not converge"
    alone = result.tracks[0].held_out_rmse if result.tracks else None
    if alone is not None:
        return [
            f"Held out {held.percent:g} %: RMSE {_px(held.clipped_rmse)} px with these tracks, "
            f"{_px(alone)} px by adjusting alone (errors clipped at {held.clip:g} px){doubt}."
        ]
    return [
        f"Held out {held.percent:g} %: RMSE {_px(held.clipped_rmse)} px against "
        f"{_px(held.fitted.clipped_rmse)} px fitted (errors clipped at {held.clip:g} px){doubt}."
    ]


def _outliers(result: Result) -> list[str]:
    """Return the outliers that a robust loss downweights, and the errors without them."""
    found, kept = result.kept.inliers, result.kept
    if found is None or not found.num_outliers:
        return []
    loss = result.options.loss.replace("_", "-")
    share = found.num_outliers / kept.after.num_observations
    many = plural(found.num_outliers, "outlier", grouped=True)
    outliers = f"the {loss} loss downweights {many} above {found.limit:g} px ({_percent(share)})"
    rest = f"RMSE of the others is {_px(found.rmse)} px"
    if not _rises(kept):
        return [f"{outliers[0].upper()}{outliers[1:]}; {rest}."]
    if found.num_inliers:
        rest = (
            f"below {found.limit:g} px before and after: RMSE "
            f"{_change(found.rmse_before, found.rmse_after)} px"
        )
    return [f"RMSE of all rises because {outliers}; {rest}."]


def _starts(result: Result) -> list[str]:
    """Return the error after the edits, at the start of the solve."""
    edited = [after for name, _, after in result.edit_errors if name != "alignment"]
    if not edited or _px(edited[-1].rmse) == _px(result.reprojection_error_before.rmse):
        return []
    start, given = edited[-1].rmse, result.reprojection_error_before.rmse
    verb = "raised" if start > given else "lowered"
    return [f"The edits {verb} RMSE to {_px(start)} px, where the solve began."]


def _pulls(result: Result) -> list[str]:
    """Return a sentence if factors, such as measured positions, explain a larger RMSE."""
    kept = result.kept
    if not _rises(kept) or (kept.inliers is not None and kept.inliers.num_outliers):
        return []
    before, after = result.initial_factor_cost, float(result.factor_costs_after.sum())
    if before is None:
        before = float(result.factor_costs_before.sum())
    if not after < before:
        return []
    count = result.summary.num_factors
    factors = plural(count, "factor", grouped=True)
    if count and not (result.priors or result.factors) and result.constraints:
        factors = "the rules"
    elif count <= len(result.priors):  # a factor of each that is used, and no others
        from bundle.georeference.measurements import kinds_of  # few runs need it

        factors = " and ".join(row.noun for row in kinds_of(result.priors))
    return [f"RMSE rises because the cost of {factors} falls, {number(before)} -> {number(after)}."]


def _rises(kept: KeptErrors) -> bool:
    before, after = kept.before.rmse, kept.after.rmse
    return after > before and _px(after) != _px(before)


def _without_projection(result: Result) -> list[str]:
    kept, held = result.kept, result.summary.held_cost
    before, after = kept.before.num_behind_camera, kept.after.num_behind_camera
    sentences = []
    if before or after:
        sentences.append(f"Observations behind their camera: {before:,} before, {after:,} after.")
    if held:
        cost = f"a cost of {number(held)}, which the final cost does not include"
        sentences.append(f"Observations without a projection have {cost}.")
    return [" ".join(sentences)] if sentences else []


def _part(result: Result) -> list[str]:
    part = result.part
    if part is None:
        return []
    images = f"{part.num_images:,} of {plural(result.problem.num_images, 'image', grouped=True)}"
    points = plural(part.num_points, "point", grouped=True)
    return [f"Only {images} and {points} were refined; the errors include all others."]


def _movement(result: Result) -> str:
    """Return the movement of camera positions and lenses."""
    found, count = result.movement, result.problem.num_images
    if not found.num_images:
        said = ["No camera moved"]
    else:
        some = f"{found.num_images:,} of {count:,} cameras" * (found.num_images < count - 2)
        size = found.position / found.scene_size if found.scene_size > 0 else math.nan
        share = f"; {_percent(size)} of the scene" if math.isfinite(size) else ""
        placed = result.similarity  # a turn alone keeps the unit
        unit = " m" if placed is not None and placed.scale != 1 else ""
        said = [
            f"{some or 'Cameras'} moved by {rounded(found.position)}{unit} (median{share})",
            f"turned by {rounded(found.rotation)} degrees",
        ]
    if found.num_cameras and found.focal > 0:
        said.append(f"focal lengths changed by {_percent(found.focal)}")
    elif found.num_cameras:
        said.append(f"{plural(found.num_cameras, 'lens', 'lenses')} changed at equal focal length")
    return f"{', '.join(said)}."


def _percent(share: float) -> str:
    return f"{rounded(100 * share)} %"


def _px(value: float) -> str:
    return f"{value:.3g}" if 0 < value < 0.01 else pixels(value)


def _change(before: float, after: float) -> str:
    return f"{_px(before)} -> {_px(after)}"
