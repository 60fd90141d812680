"""Judgement of fits: errors, row test, fits with a shutter, decision, a record per candidate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.editing.rolling_shutters import with_shutters
from bundle.errors import InputError
from bundle.georeference.pose_alignment import align_centers
from bundle.interface.camera_edit_options import ShutterOptions
from bundle.interface.finding import Finding
from bundle.interface.options import SolveOptions
from bundle.judging.findings.images import GAIN, direction, gain_of_shutter, named_order, price_of
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.systematic import SystematicResiduals
from bundle.judging.validation.candidate_fits import (
    CandidateFit,
    Fitting,
    dispersion,
    fit_candidates,
    information_criteria,
    normalized_errors,
    prediction_covariances,
    refine_command,
)
from bundle.judging.validation.candidates import groups_of, is_shared
from bundle.judging.validation.known_positions import (
    Certainty,
    KnownErrors,
    certainty,
    known_errors,
)
from bundle.judging.validation.row_test import RowTest, row_test
from bundle.judging.validation.validation_result import (
    Cameras,
    Decision,
    DecisionRule,
    ValidatedCandidate,
    Validation,
    decide,
    verdict_of,
)
from bundle.model.cameras import param_kinds
from bundle.model.folds import are_repeated
from bundle.model.residuals import summarize_clipped
from bundle.model.shutter_motion import can_roll

MOST_REPEATED = 0.5  # share of repeated measurements from which they take part in the decision

MOTION = "motion or rolling shutter: a lens per image would absorb it"

LACKING = "a rolling shutter would absorb what this lens lacks in all images"

_Floats = NDArray[np.float64]


def judged(
    fitting: Fitting,
    fits: Sequence[CandidateFit],
    *,
    rule: DecisionRule,
    clip: float,
    num_folds: int,
    seed: int,
    source: str,
    flags: str,
    begun: float,
) -> Validation:
    """Return the result of the validation; at least one fit is required."""
    problem = fitting.problem
    rows = np.flatnonzero(fitting.folds >= 0)
    residuals = np.stack(
        [fit.held_out[rows] if not fit.error else np.full((len(rows), 2), np.nan) for fit in fits]
    )
    sigmas = 1.0 if problem.observation_sigma is None else problem.observation_sigma[rows, None]
    reference = _reference(fits)
    covariances = prediction_covariances(
        reference.refined, fitting.folds, fitting.options.cheirality
    )
    errors = np.hypot(residuals[..., 0], residuals[..., 1])
    image = problem.observation_image[rows].astype(np.int64)
    # observations without repetitions decide, if they are most
    repeated = are_repeated(problem, fitting.folds)
    counts = (~repeated if repeated.mean() < MOST_REPEATED else np.ones_like(repeated))[rows]
    sharing = [fit for fit in fits if not fit.error and len(_lenses(fit)) < problem.num_images]
    shared = min(  # the largest lens that images share
        sharing,
        key=lambda fit: (fit.candidate.loss == "trivial", len(_lenses(fit)), -_num_intrinsics(fit)),
        default=None,
    )
    test = None if shared is None else row_test(shared.refined, shared.residuals)
    order, rolling = "", {}
    if shared is not None and test is not None and (test.fires or test.is_suspected):
        order = read_order(measured(shared))
        rolling = rolling_fits(fitting, fits, order)
    held_out = np.concatenate([residuals, *(one.held_out[None, rows] for one in rolling.values())])
    normalized, sigma = normalized_errors(held_out / sigmas, covariances[rows])
    normalized, others = normalized[: len(fits)], normalized[len(fits) :]
    certainties = [_certainty(fit) for fit in fits]
    compared, known = list(fits), list(certainties)
    lacking, explained = np.zeros(0, bool), False
    if test is not None and rolling:
        found = motion_test(
            normalized[:, counts], others[:, counts], image[counts], list(rolling), rule
        )
        test = replace(test, fires=test.fires or found.is_motion)
        explained = test.fires and found.explains
        if explained:
            test = replace(test, gain=found.gain)
            lacking = are_clearly_worse(normalized[list(rolling)][:, counts], image[counts], rule)
            normalized[list(rolling)] = others
            for k, fit in rolling.items():
                compared[k], known[k] = fit, _certainty(fit)
    fires = test is not None and test.fires
    vetoes = [
        MOTION if fires and not fit.error and not is_shared(fit.candidate) else "" for fit in fits
    ]
    for k, lacks in zip(rolling, lacking.tolist(), strict=False):
        vetoes[k] = LACKING if lacks else ""
    num_intrinsics = [0 if fit.error else _num_intrinsics(fit) for fit in fits]
    cameras = cameras_of(compared, known)
    criteria = _criteria(fits, certainties, fitting)
    evidence = None  # motion that no shutter explains makes any larger lens more likely
    if explained:
        evidence = evidence_between(compared, _criteria(compared, known, fitting))
    elif not fires:
        evidence = evidence_between(fits, criteria)
    decision = decide(
        normalized[:, counts], image[counts], num_intrinsics, vetoes, rule, cameras, evidence
    )
    records = tuple(
        _record(
            fit, fitting, certainties[k], errors[k], clip, decision, k, criteria[k], vetoes[k],
            num_intrinsics[k], _command(fit, fitting, source, flags),
        )
        for k, fit in enumerate(fits)
    )  # fmt: skip
    words = verdict_of(records, decision, test, problem)
    command = records[decision.recommended].command
    return Validation(
        candidates=records,
        recommended=decision.recommended,
        best=decision.best,
        present=words.present,
        verdict=words.verdict,
        headline=words.headline,
        command=command,
        findings=_findings(test, fits[decision.recommended], order, command),
        num_folds=num_folds,
        seed=seed,
        clip=clip,
        sigma=sigma,
        row_test=test,
        rule=rule,
        decision=decision,
        observations=rows,
        image=image,
        errors=errors,
        normalized=normalized,
        notes=words.notes,
        time_in_seconds=perf_counter() - begun,
    )


def cameras_of(fits: Sequence[CandidateFit], certainties: Sequence[Certainty]) -> Cameras:
    """Return distances and standard deviations of the cameras of all fits."""
    centers = [None if fit.error else fit.refined.projection_centers for fit in fits]
    distances = np.full((len(fits), len(fits)), np.nan)
    for a, b in combinations(range(len(fits)), 2):
        distances[a, b] = distances[b, a] = _distance(centers[a], centers[b])
    return Cameras(
        distances=distances,
        sigmas=np.array([one.camera_sigma for one in certainties]),
        certainties=np.array([one.position_sigma for one in certainties]),
    )


def _distance(source: _Floats | None, target: _Floats | None) -> float:
    """Return the rms distance of centres after a similarity; NaN without one."""
    if source is None or target is None:
        return float("nan")
    try:
        aligned = align_centers(source, target).apply(source)
    except InputError:  # on one line
        return float("nan")
    return float(np.sqrt(((aligned - target) ** 2).sum(axis=1).mean()))


def _reference(fits: Sequence[CandidateFit]) -> CandidateFit:
    """Return the fit whose geometry gives the prediction covariances.

    It is the one with the fewest lenses, and of these the one with the largest model: its points
    are the least bent by lens parameters.
    """
    with_fit = [fit for fit in fits if not fit.error]
    return min(with_fit, key=lambda fit: (len(_lenses(fit)), -_num_intrinsics(fit)))


def _findings(
    test: RowTest | None, fit: CandidateFit, order: str, command: str
) -> tuple[Finding, ...]:
    if test is None or not test.fires:
        return ()
    gain = gain_of_shutter(measured(fit), order)
    spread = f"{float(test.deviations[1:].max()):.2g}"
    better = f": one lens predicts {100 * test.gain:.1f} % better with a shutter by {order}"
    names = ("shear", "anisotropy", "size", "confirmation")
    gains = {"predicted": test.gain if test.gain > 0 else 0.0, "gain": gain}
    found = Finding(
        kind="motion",
        sentence="Motion or a rolling shutter: anisotropy or shear of the residuals differs "
        f"from image to image by {spread} px at its border (standard deviation; noise "
        "subtracted)"
        f"{better if test.gain > 0 else ''}. Keep one lens.{price_of(gain)}",
        command=f"{command} --rolling-shutter {order}" if gain > GAIN else "",
        evidence={name: getattr(test, name) for name in names} | gains,
    )
    return (found,)


def _lenses(fit: CandidateFit) -> set[int]:
    return set(fit.refined.image_camera.tolist())


def _certainty(fit: CandidateFit) -> Certainty:
    if fit.prepared is None or fit.full is None:
        return Certainty(float("nan"), 0)
    return certainty(fit.prepared, fit.full)


def _num_intrinsics(fit: CandidateFit) -> int:
    assert fit.prepared is not None
    problem, applied = fit.refined, fit.prepared.applied
    options = fit.prepared.options
    fixed = set(options.fixed_camera_ids)
    free = {
        (int(problem.camera_ids[camera]), column)
        for camera in _lenses(fit)
        for column, kind in enumerate(param_kinds(problem.camera_models[camera]))
        if kind in options.refine and int(problem.camera_ids[camera]) not in fixed
    }
    if applied is not None:
        held = {(key, c) for key, columns in applied.held_params.items() for c in columns}
        free -= held
        for tie in applied.ties:
            free -= {(key, column) for key, column, _ in tie.members[1:]}
    return len(free)


def _criteria(
    fits: Sequence[CandidateFit], certainties: Sequence[Certainty], fitting: Fitting
) -> list[tuple[float, float]]:
    """Return AIC and BIC relative to the smallest of each loss."""
    found = [(float("nan"), float("nan"))] * len(fits)
    sigmas = fitting.problem.observation_sigma
    for loss in {fit.candidate.loss for fit in fits}:
        known = [
            k
            for k, fit in enumerate(fits)
            if fit.candidate.loss == loss and not fit.error and certainties[k].num_parameters
        ]
        if not known:
            continue
        largest = max(known, key=lambda k: certainties[k].num_parameters)
        full, lengths = fits[largest].full, np.hypot(*fits[largest].residuals.T)
        assert full is not None
        dof = full.summary.num_residuals - certainties[largest].num_parameters
        options = fitting.options.replace(loss=loss)
        variance = dispersion(lengths if sigmas is None else lengths / sigmas, dof, options)
        values = np.zeros((len(known), 2))
        for row, k in enumerate(known):
            end = fits[k].full
            assert end is not None
            counts = certainties[k].num_parameters, end.summary.num_residuals
            values[row] = information_criteria(end.summary.final_cost, variance, *counts)
        for k, row in zip(known, values - values.min(axis=0), strict=True):
            found[k] = (float(row[0]), float(row[1]))
    return found


def evidence_between(fits: Sequence[CandidateFit], criteria: list[tuple[float, float]]) -> _Floats:
    """Return the (n, n) differences of the Bayesian criteria, the second ones.

    NaN between two losses. A fit without a criterion, whose covariance does not exist, has an
    infinite one.
    """
    losses = np.array([fit.candidate.loss for fit in fits])
    values = np.array([bic for _, bic in criteria])
    values[np.isnan(values)] = np.inf
    with np.errstate(invalid="ignore"):  # inf - inf
        return np.where(losses[:, None] == losses, values[:, None] - values, np.nan)


def _record(
    fit: CandidateFit,
    fitting: Fitting,
    known: Certainty,
    errors: _Floats,
    clip: float,
    decision: Decision,
    k: int,
    criteria: tuple[float, float],
    veto: str,
    num_intrinsics: int,
    command: str,
) -> ValidatedCandidate:
    candidate, problem = fit.candidate, fitting.problem
    held = summarize_clipped(errors, clip)
    fitted = summarize_clipped(np.hypot(*fit.residuals.T), clip)
    nan = float("nan")
    known_at = KnownErrors(nan, nan)
    if fit.prepared is not None and fit.full is not None:
        known_at = known_errors(fit.prepared, fit.full, fitting.priors)
    return ValidatedCandidate(
        **{name: getattr(candidate, name) for name in ("camera_model", "share", "loss", "refine")},
        num_cameras=len(set(groups_of(problem, candidate.share).tolist())),
        num_intrinsics=num_intrinsics,
        num_parameters=known.num_parameters,
        fitted_rmse=fitted.rmse,
        fitted_median=fitted.median,
        fitted_clipped_rmse=fitted.clipped_rmse,
        held_out_rmse=nan if fit.error else held.clipped_rmse,
        held_out_median=nan if fit.error else held.median,
        share_clipped=nan if fit.error else held.share_clipped,
        num_without_projection=0 if fit.error else held.num_without_projection,
        score=float(decision.scores[k]),
        difference=float(decision.differences[k]),
        standard_error=float(decision.standard_errors[k]),
        aic=criteria[0],
        bic=criteria[1],
        position_sigma=known.position_sigma,
        check_points_rms=known_at.check_points,
        gps_rms=known_at.positions,
        is_converged=fit.is_converged and not fit.error,
        num_iterations=fit.num_iterations,
        vetoed=veto,
        error=fit.error,
        command=command,
    )


def _command(fit: CandidateFit, fitting: Fitting, source: str, flags: str) -> str:
    names = ("function_tolerance", "num_threads", "max_num_iterations")
    options = fitting.options.replace(**{name: getattr(SolveOptions(), name) for name in names})
    words = refine_command(fitting.problem, fit.candidate, options, source)
    return f"{words} {flags}".strip()


# Motion or a rolling shutter, found by what a shutter predicts (docs/which_lens.md).
#
# The row test has already shown, at 1e-4, that no lens without a shutter describes the images.
# Held-out errors of a few images cannot: four images have 3 degrees of freedom. But a shutter also
# absorbs a lens term that is missing in all images, such as fx / fy. Motion that varies from image
# to image moves such a term by chance only, and the standard error over the images contains this
# chance: a shared lens is vetoed, too, if without a shutter it predicts worse than the best one by
# more than the quantile 0.9995 of the decision.
#
# Fits, positions and commands do not include it: a separate test compares its gain with the loss of
# certainty (:func:`bundle.judging.findings.images.gain_of_shutter`).

_CLEAR = 3.2905  # standard errors: quantile 0.9995 of the normal distribution


class MotionTest(NamedTuple):
    """Result of the test for motion or a rolling shutter."""

    gain: float  # relative decrease of the lowest score with shared lenses by a shutter
    explains: bool  # True if this gain is relevant
    is_motion: bool  # True if, besides, no lens per image predicts better


def measured(fit: CandidateFit) -> Measured:
    """Return a fit in the form that findings read."""
    assert fit.prepared is not None
    return Measured(whole=fit.refined, command=NextCommand(), options=fit.prepared.options)


def read_order(model: Measured) -> str:
    """Return the readout order that the residuals show; "rows" if undecided."""
    rows, columns, _ = direction(SystematicResiduals(model))
    return named_order(rows, columns) or "rows"


def rolling_fits(
    fitting: Fitting, fits: Sequence[CandidateFit], order: str
) -> dict[int, CandidateFit]:
    """Return the fits with a rolling shutter, by candidate; none if it cannot be added."""
    chosen = [
        k
        for k, fit in enumerate(fits)
        if not fit.error and is_shared(fit.candidate) and "poses" in fit.candidate.refine
    ]
    if not chosen or not can_roll(fitting.problem):
        return {}
    given = ShutterOptions(rolling_shutter=order)
    problem, options = with_shutters(fitting.problem, given, fitting.options)
    try:
        found = fit_candidates(
            [fits[k].candidate for k in chosen], replace(fitting, problem=problem, options=options)
        )
    except InputError:  # a fold determines no motion
        return {}
    return {k: fit for k, fit in zip(chosen, found, strict=True) if not fit.error}


def motion_test(
    plain: _Floats, rolling: _Floats, image: NDArray[np.int64], shared: Sequence[int],
    rule: DecisionRule,
) -> MotionTest:  # fmt: skip
    """Return the test of shared lenses with a rolling shutter.

    ``plain``: (num_candidates, n) normalised errors without a shutter; ``rolling``: (m, n) those
    with a shutter, for the m candidates ``shared``.
    """
    count = len(rolling)
    among_all = _decision(np.concatenate([rolling, plain]), image, rule)
    scores, others = among_all.scores[:count], among_all.scores[count:][shared]
    gain = 1.0 - float(np.nanmin(scores) / np.nanmin(others))
    explains = gain > rule.threshold / (1.0 + rule.threshold)
    is_motion = explains and bool(among_all.is_equal[:count].any())
    return MotionTest(gain, explains, is_motion)


def are_clearly_worse(
    plain: _Floats, image: NDArray[np.int64], rule: DecisionRule
) -> NDArray[np.bool_]:
    """Return a mask of the shared lenses that lack a term, by errors (m, n) without a shutter."""
    found = _decision(plain, image, replace(rule, num_standard_errors=_CLEAR))
    above = found.differences > found.num_standard_errors * found.standard_errors
    relevant: NDArray[np.bool_] = found.differences > rule.threshold * found.scores[found.best]
    return above & relevant


def _decision(errors: _Floats, image: NDArray[np.int64], rule: DecisionRule) -> Decision:
    return decide(errors, image, np.zeros(len(errors)), None, rule)
