"""Decision and result of a validation: candidates, recommendation, verdict in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.tails import student_quantile
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.interface.finding import Finding
from bundle.interface.tabular import Tabular
from bundle.judging.validation.candidates import SHARING, Candidate, groups_of
from bundle.judging.validation.row_test import RowTest
from bundle.model.problem import Problem

# Decision between candidates from their held-out errors: a pure function of arrays.
#
# A candidate's score is the RMS of its normalised held-out errors e, clipped at c sigmas:
#
#     S = sqrt(sum min(e, c)^2 / n)
#
# An observation without a projection counts as the clip. All candidates predict the same
# observations, so their scores are paired. Errors within an image are correlated; the standard
# error of a difference D of two scores therefore comes from the jackknife over the m images with
# held-out observations. D_(i) is the difference without the observations of image i, D_(.) their
# mean:
#
#     SE^2 = (m - 1) / m  sum_i (D_(i) - D_(.))^2
#
# (Efron and Tibshirani 1993, "An introduction to the bootstrap", chapter 11.) The SE of few images
# is itself uncertain: D / SE has Student's t distribution with m - 1 degrees of freedom. Its limit
# z is the quantile that has the probability of 2 in a normal distribution: 2.1 for 20 images, 2.9
# for 5, 4.5 for 3. A candidate is as good as the best if its score is not significantly higher (D
# <= z SE), or not higher by a relevant amount (D <= t S_best): with many observations, any
# difference is significant. A candidate with fewer parameters and a lower score than such a
# candidate also is as good, although its smaller difference may have a smaller error. The
# recommended candidate is the one of these with the fewest free parameters, as in the
# one-standard-error rule of Breiman, Friedman, Olshen and Stone (1984). Among equal numbers of
# parameters the lower score decides.
#
# Two exceptions depend on the cameras (docs/which_lens.md, with m = 1 standard deviation).
#
# A few images have no power in this test: among three, a difference must be 4.5 standard errors.
# But their fits to all observations tell lenses apart. A candidate is refuted by another that
# predicts better by the relevant amount t and has a Bayesian criterion lower by more than b = 10:
# "very strong" evidence (Kass and Raftery 1995, "Bayes factors", section 3.2). The criterion alone
# prefers too many parameters where the noise of an image is correlated; the better prediction
# excludes these.
#
# ``tests/campaigns/judge.py`` measures the numbers z and t on scenes of known truth. Lower limits
# choose larger lenses: with z = 1.5 and t = 0.5 %, three times as many scenes get a larger lens
# than the true one, and the noise-free error is not lower.
#
# Vetoed candidates take no part. Their scores and differences are still computed.


_Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class DecisionRule:
    """Numbers of the rule."""

    clip: float = 3.0  # largest normalised error that counts, in sigmas
    num_standard_errors: float = 2.0  # significance z of a difference over infinitely many images
    threshold: float = 0.01  # relevant difference t, relative to the best score
    movement: float = 1.0  # relevant distance m of the cameras, in their standard deviations
    expensive: float = 3.0  # ratio of the standard deviations of positions that has its price
    price: float = 3.0  # relevant difference, in thresholds, of an expensive candidate
    evidence: float = 10.0  # difference b of the Bayesian criteria that refutes a candidate


@dataclass(frozen=True, eq=False, kw_only=True)
class Cameras:
    """Cameras of the candidates; NaN if not known."""

    distances: _Floats  # (n, n) rms distances of the centres of two fits after a similarity
    sigmas: _Floats  # (n,) rms standard deviation of the centres, without a similarity
    certainties: _Floats  # (n,) median standard deviation of a position beside cameras and points


@dataclass(frozen=True, eq=False, kw_only=True)
class Decision:
    """Decision between candidates; arrays have one entry per candidate."""

    recommended: int  # index of the recommended candidate
    best: int  # index of the candidate with the lowest score that is not vetoed
    scores: _Floats  # RMS of normalised errors, clipped; NaN for a candidate without errors
    differences: _Floats  # score minus the score of the best candidate
    standard_errors: _Floats  # standard error of each difference over the images; 0 for the best
    num_standard_errors: float  # significance z of a difference over these images
    is_equal: NDArray[np.bool_]  # True for a candidate as good as the best; False if vetoed
    by_price: NDArray[np.bool_]  # True: predicts worse, but costs less certainty than the best


def decide(
    errors: ArrayLike,
    image: ArrayLike,
    num_parameters: ArrayLike,
    vetoes: Sequence[str] | None = None,
    rule: DecisionRule | None = None,
    cameras: Cameras | None = None,
    criteria: ArrayLike | None = None,
) -> Decision:
    """Return the recommended candidate.

    ``errors``: (num_candidates, num_held_out) normalised errors, in sigmas; NaN without a
    projection. A row of NaN alone is a candidate without a fit. ``image``: (num_held_out,) image
    index of each held-out observation. ``vetoes``: reason why a candidate may not be recommended;
    "" if it may. Without ``cameras``, only the errors count. ``criteria``: (num_candidates,
    num_candidates) differences of the Bayesian criteria, [i, j] of i minus j; NaN where two fits
    cannot be compared. Without them, nothing is refuted.
    """
    rule = DecisionRule() if rule is None else rule
    values, of_image = np.asarray(errors, float), np.asarray(image)
    cost = np.asarray(num_parameters)
    has_fit = np.isfinite(values).any(axis=1)
    takes_part = has_fit & np.array([not veto for veto in vetoes or [""] * len(values)])
    if not takes_part.any():
        raise InputError("candidates: expected a candidate with a fit and without a veto, found 0")
    count = int(of_image.max(initial=-1)) + 1
    clipped = np.minimum(np.where(np.isfinite(values), values, rule.clip), rule.clip) ** 2
    sums = np.array([np.bincount(of_image, row, count) for row in clipped])
    counts = np.bincount(of_image, minlength=count).astype(float)
    scores = np.where(has_fit, np.sqrt(sums.sum(1) / counts.sum()), np.nan)
    best = int(np.argmin(np.where(takes_part, scores, np.inf)))
    spread = np.array([jackknife(row, sums[best], counts) for row in sums])
    spread[~has_fit] = np.nan
    above = scores - scores[best]
    limit = np.full(len(scores), rule.threshold * scores[best])
    if cameras is not None:  # comparisons with NaN are False
        is_cheaper = cameras.certainties[best] > rule.expensive * cameras.certainties
        limit[is_cheaper] *= rule.price
        moved = cameras.distances[:, best] > rule.movement * cameras.sigmas[best]
        limit[moved & ~is_cheaper & (cost < cost[best])] = 0.0
    num_errors = student_quantile(rule.num_standard_errors, int((counts > 0).sum()) - 1)
    is_equal = takes_part & ((above <= num_errors * spread) | (above <= limit))
    for k in np.flatnonzero(is_equal).tolist():
        is_equal |= takes_part & (cost < cost[k]) & (scores <= scores[k])
    if criteria is not None:  # comparisons with NaN are False
        is_worse = scores[:, None] - scores > rule.threshold * scores[best]
        is_less_likely = np.asarray(criteria, float) > rule.evidence
        is_equal &= ~(is_worse & is_less_likely & takes_part).any(axis=1)
    order = np.lexsort((scores, cost))
    return Decision(
        recommended=int(order[is_equal[order]][0]),
        best=best,
        scores=scores,
        differences=above,
        standard_errors=spread,
        is_equal=is_equal,
        num_standard_errors=num_errors,
        by_price=is_equal & (above > num_errors * spread) & (above > rule.threshold * scores[best]),
    )


def jackknife(sums: _Floats, others: _Floats, counts: _Floats) -> float:
    """Return the standard error of the difference of two RMS values from (num_images,) sums."""
    used = counts > 0
    if used.sum() < 2:
        return float("inf") if (sums != others).any() else 0.0
    sums, others, counts = sums[used], others[used], counts[used]
    left = counts.sum() - counts
    difference = np.sqrt((sums.sum() - sums).clip(0) / left)
    difference -= np.sqrt((others.sum() - others).clip(0) / left)
    count = len(counts)
    deviations = difference - difference.mean()
    return float(np.sqrt((count - 1) / count * (deviations @ deviations)))


@dataclass(frozen=True, eq=False, kw_only=True)
class ValidatedCandidate(Candidate):
    """A candidate and its errors; NaN if it has no fit. Pixels are per observation, not per axis.

    Attributes:
        num_cameras: number of lenses with an image.
        num_intrinsics: number of free lens parameters; shared parameters count once.
        num_parameters: number of all free parameters that the fit determines, by rank.
        fitted_rmse: RMSE of the fit to all observations, at its observations.
        fitted_median: their median.
        fitted_clipped_rmse: the same RMSE, clipped at ``clip`` pixels.
        held_out_rmse: RMSE of predictions of held-out observations, clipped at ``clip`` pixels.
        held_out_median: their median.
        share_clipped: share of the predictions whose error is limited to the clip.
        num_without_projection: number of held-out observations without a projection.
        score: RMS of the normalised predictions, clipped, in sigmas.
        difference: score minus the score of the best candidate.
        standard_error: standard error of this difference over the images.
        aic: Akaike's criterion, minus the smallest of all candidates with this loss.
        bic: Bayesian criterion, minus the smallest of all candidates with this loss.
        position_sigma: median standard deviation of the cameras' positions, per axis, in the unit
            of the model.
        check_points_rms: RMS of the residuals at check points; NaN without check points.
        gps_rms: RMS of the residuals at measured positions; NaN without positions.
        is_converged: True if all fits converged.
        num_iterations: number of iterations of all fits.
        vetoed: reason why the candidate is not recommended whatever its score; "" if it may be.
        error: reason why the candidate has no fit; "" if it has.
        command: command line that refines the input in this way.
    """

    num_cameras: int
    num_intrinsics: int
    num_parameters: int
    fitted_rmse: float
    fitted_median: float
    fitted_clipped_rmse: float
    held_out_rmse: float
    held_out_median: float
    share_clipped: float
    num_without_projection: int
    score: float
    difference: float
    standard_error: float
    aic: float
    bic: float
    position_sigma: float
    check_points_rms: float
    gps_rms: float
    is_converged: bool
    num_iterations: int
    vetoed: str
    error: str
    command: str

    @property
    def lens(self) -> str:
        """Camera model in words."""
        return self.camera_model or "as in the input"

    @property
    def sharing(self) -> str:
        """Sharing in words."""
        return SHARING[self.share]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Validation(Displayed, Tabular):
    """Candidates, compared by observations that their fits did not see.

    Attributes:
        candidates: the candidates in the order of the request.
        recommended: index of the recommended candidate.
        best: index of the candidate with the lowest score that is not vetoed.
        present: index of the candidate with the lenses and the sharing of the input; -1: none.
        verdict: "better": the recommended candidate predicts better than the input's lenses;
            "simpler": as well, with fewer parameters; "keep": it has the input's lenses; "vetoed":
            the input's lenses are vetoed; "no difference": no two candidates differ; "unknown": the
            input's lenses are no candidate.
        headline: the verdict in sentences.
        command: command line that refines the input as recommended; "" if the input is as
            recommended.
        findings: the finding about motion or a rolling shutter, if one explains the residuals.
        num_folds: number of folds.
        seed: seed of the folds.
        clip: largest error that counts in ``held_out_rmse``, in pixels.
        sigma: noise of a coordinate, in pixels or in units of ``observation_sigma``.
        row_test: test for motion or a rolling shutter; None without shared lenses.
        rule: numbers of the decision.
        decision: scores, differences and standard errors as arrays.
        observations: (num_held_out,) indices of the held-out observations in the input.
        image: (num_held_out,) their image indices.
        errors: (num_candidates, num_held_out) errors of the predictions in pixels; NaN without a
            projection.
        normalized: (num_candidates, num_held_out) normalised errors in sigmas; where motion was
            found, those of shared lenses beside a rolling shutter.
        notes: sentences about the comparison.
        time_in_seconds: elapsed time.
    """

    candidates: tuple[ValidatedCandidate, ...]
    recommended: int
    best: int
    present: int
    verdict: str
    headline: tuple[str, ...]
    command: str
    findings: tuple[Finding, ...] = ()
    num_folds: int
    seed: int
    clip: float
    sigma: float
    row_test: RowTest | None
    rule: DecisionRule
    decision: Decision
    observations: NDArray[np.int64]
    image: NDArray[np.int64]
    errors: NDArray[np.float64]
    normalized: NDArray[np.float64]
    notes: tuple[str, ...]
    time_in_seconds: float

    def _display(self) -> Display:
        rows = tuple(
            (
                f"{'*' if k == self.recommended else ' '} {one.name}, {one.loss}",
                str(one.num_intrinsics),
                f"{one.fitted_rmse:.3f}",
                f"{one.held_out_rmse:.3f}",
                f"{one.difference:+.4f} ± {one.standard_error:.4f}",
            )
            for k, one in enumerate(self.candidates)
        )
        return Display(
            title=f"Validation of {plural(len(self.candidates), 'candidate')}: {self.headline[0]}",
            facts=(("next", self.command),) if self.command else (),
            head=("candidate", "intrinsics", "fitted [px]", "held out [px]", "difference"),
            rows=rows,
        )


RELEVANT_RATIO = 1.5  # ratio of position sigmas that the headline mentions


class Verdict(NamedTuple):
    """Verdict of a validation."""

    verdict: str  # one of the words that :class:`Validation` lists
    present: int  # index of the candidate with the input's lenses; -1: none
    headline: tuple[str, ...]  # the verdict in sentences
    notes: tuple[str, ...]  # sentences about the comparison


def verdict_of(
    records: Sequence[ValidatedCandidate],
    decision: Decision,
    test: RowTest | None,
    problem: Problem,
) -> Verdict:
    """Return the verdict on the input's lenses."""
    chosen = records[decision.recommended]
    present = present_candidate(records, problem, chosen)
    word = _word(records, decision, present)
    headline = [_sentence(word, records, decision, present)]
    if test is not None and test.fires:
        headline.append("Motion or rolling shutter: a lens per image would absorb it.")
    headline += _cost(records, decision, present)
    return Verdict(word, present, tuple(headline), tuple(_notes(records, decision)))


def present_candidate(
    records: Sequence[ValidatedCandidate], problem: Problem, chosen: ValidatedCandidate
) -> int:
    """Return the index of the input's own candidate with the chosen loss; -1: none."""
    used = {problem.camera_models[camera] for camera in set(problem.image_camera.tolist())}
    own = groups_of(problem, "input").tobytes()
    for k, one in enumerate(records):
        same_model = {one.camera_model} == used or (one.camera_model == "" and len(used) > 1)
        same_fit = (one.loss, one.refine) == (chosen.loss, chosen.refine)
        if not same_model or not same_fit or one.share == "focal":
            continue
        if groups_of(problem, one.share).tobytes() == own:
            return k
    return -1


def _word(records: Sequence[ValidatedCandidate], decision: Decision, present: int) -> str:
    candidates = [k for k, one in enumerate(records) if not one.error and not one.vetoed]
    if present >= 0 and records[present].vetoed:
        return "vetoed"
    predicts_alike = decision.is_equal & ~decision.by_price
    if len(candidates) > 1 and predicts_alike[candidates].all():
        return "no difference"
    if present < 0 or records[present].error:
        return "unknown"
    if present == decision.recommended:
        return "keep"
    return "simpler" if decision.is_equal[present] else "better"


def _sentence(
    word: str, records: Sequence[ValidatedCandidate], decision: Decision, present: int
) -> str:
    chosen = records[decision.recommended]
    name = f"{chosen.name} ({plural(chosen.num_intrinsics, 'lens parameter')})"
    if word == "no difference":
        return f"No difference between the candidates. The smallest is enough: {name}."
    if word == "keep":
        return f"Keep the lenses of the input: {name}."
    if word in ("unknown", "vetoed"):
        return f"Recommended: {name}."
    now = records[present]
    if word == "simpler":
        return (
            f"Simpler lenses predict as well: {name} in place of {now.name} ({now.num_intrinsics})."
        )
    change = 100 * (now.score - chosen.score) / now.score
    return f"{name} predicts better than {now.name}: errors {change:.1f} % lower."


def _cost(records: Sequence[ValidatedCandidate], decision: Decision, present: int) -> list[str]:
    chosen = records[decision.recommended].position_sigma
    if not chosen > 0:
        return []
    now = records[present].position_sigma if present >= 0 else float("nan")
    if chosen > RELEVANT_RATIO * now:
        return [f"Positions become less certain: their sigma is {chosen / now:.1f} x as large."]
    known = [one for one in records if np.isfinite(one.position_sigma) and not one.error]
    worst = max(known, key=lambda one: one.position_sigma)
    ratio = worst.position_sigma / chosen
    if not ratio > RELEVANT_RATIO:
        return []
    return [f"Positions are {ratio:.1f} x less certain with {worst.name}."]


def _notes(records: Sequence[ValidatedCandidate], decision: Decision) -> list[str]:
    notes = [f"{one.name}: cannot start: {one.error}" for one in records if one.error]
    loose = [one.name for one in records if not one.error and not one.is_converged]
    if loose:
        notes.append(f"not converged in some folds: {'; '.join(loose)}")
    usable = [k for k, one in enumerate(records) if np.isfinite(one.bic)]
    if usable:
        by_bic = min(usable, key=lambda k: records[k].bic)
        if not decision.is_equal[by_bic]:
            notes.append(
                f"BIC prefers {records[by_bic].name}; it assumes independent noise without outliers"
            )
    return notes
