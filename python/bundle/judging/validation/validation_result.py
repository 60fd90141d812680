"""Result of a validation: a record per candidate, and the recommendation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.interface.finding import Finding
from bundle.interface.tabular import Tabular
from bundle.judging.validation.candidates import SHARING, Candidate
from bundle.judging.validation.decision import Decision, DecisionRule
from bundle.judging.validation.row_test import RowTest


@dataclass(frozen=True, eq=False, kw_only=True)
class ValidatedCandidate:
    """Errors of one candidate; NaN if it has no fit. Pixels are per observation, not per axis.

    Attributes:
        camera_model: COLMAP's name of the model of all cameras; "" keeps the models of the input.
        share: "each", "focal", "size", "all" or "input" (docs/which_lens.md).
        loss: robust loss of the fits.
        refine: groups of refined variables.
        num_cameras: number of lenses with an image.
        num_intrinsics: number of free lens parameters; shared parameters count once.
        num_parameters: number of all free parameters that the fit determines, by rank.
        fitted_rmse: RMSE of the fit to all observations, at its observations.
        fitted_median: their median.
        fitted_clipped_rmse: the same RMSE, clipped at ``clip`` pixels.
        held_out_rmse: RMSE of predictions of held-out observations, clipped at ``clip`` pixels.
        held_out_median: their median.
        share_clipped: share of the predictions that count as the clip.
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

    camera_model: str
    share: str
    loss: str
    refine: tuple[str, ...]
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

    @property
    def name(self) -> str:
        """Name of the lens, such as "OPENCV, shared"."""
        return Candidate(camera_model=self.camera_model, share=self.share).name


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
