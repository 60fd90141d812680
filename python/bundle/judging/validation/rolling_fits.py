"""Motion or a rolling shutter, found by what a shutter predicts.

A lens per image absorbs part of a motion during the exposure, predicts better than one lens, and
moves the cameras; so does a shared lens with further terms if the motions do not average out. Such
gains are no evidence on the lens. Where the row test (:mod:`.row_test`) suspects motion, the
candidates with shared lenses are therefore fitted again with a rolling shutter, in all folds.

- The shutter explains the residuals if the best shared lens with it predicts better by 1 % than the
  best without: an error of a lens that images share does not need a shutter. The row test has
  already shown, at 1e-4, that no lens without it describes the images. Held-out errors of a few
  images cannot: four images have 3 degrees of freedom.
- It is motion if, besides, one of the lenses with a shutter predicts as well as the best of all,
  lenses per image among them, by the rule of the decision (two standard errors and 1 %): lenses
  that differ would predict better.

Where motion is found, by this or by the row test, a lens per image is vetoed. If the shutter
explains the residuals, the scores of the shared lenses are those with the shutter, which compare
lens with lens. But a shutter also absorbs a term that all images lack, such as fx / fy. Motion that
varies from image to image moves such a term by chance only, and the standard error over the images
contains this chance: a shared lens is vetoed, too, if without a shutter it predicts worse than the
best one by more than the quantile 0.9995 of Student's t with (images - 1) degrees of freedom: t^2
has the distribution F(1, images - 1).

Fits, positions and commands do not include it: a separate test compares its gain with the loss of
certainty (:func:`bundle.judging.findings.images.gain_of_shutter`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.tails import f_tail
from bundle.editing.rolling_shutters import with_shutters
from bundle.errors import InputError
from bundle.interface.camera_edit_options import ShutterOptions
from bundle.judging.findings.images import direction, named_order
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.systematic import SystematicResiduals
from bundle.judging.validation.candidate_fits import CandidateFit, Fitting, fit_candidates
from bundle.judging.validation.candidates import is_shared
from bundle.judging.validation.validation_result import Decision, DecisionRule, decide
from bundle.model.shutter_motion import can_roll

_CLEAR = 0.001

_Floats = NDArray[np.float64]


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
    found = _decision(plain, image, rule)
    freedom = len(np.unique(image)) - 1
    above = np.zeros(len(plain), bool)
    for k in np.flatnonzero(found.standard_errors > 0).tolist():
        statistic = float(found.differences[k] / found.standard_errors[k]) ** 2
        above[k] = f_tail(statistic, 1, freedom) < _CLEAR
    relevant: NDArray[np.bool_] = found.differences > rule.threshold * found.scores[found.best]
    return above & relevant


def _decision(errors: _Floats, image: NDArray[np.int64], rule: DecisionRule) -> Decision:
    return decide(errors, image, np.zeros(len(errors)), None, rule)
