"""Validation of candidates by k folds: the public function ``validate``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import check_function
from bundle.errors import InputError
from bundle.interface.option_fields import choice, number
from bundle.interface.options import LOSSES, SolveOptions
from bundle.io.files import Source, as_problem
from bundle.judging.validation.candidate_fits import Fitting, Progress, fit_candidates
from bundle.judging.validation.candidates import SHARES, Candidate, default_candidates
from bundle.judging.validation.judgement import judged
from bundle.judging.validation.validation_result import DecisionRule, Validation
from bundle.model.cameras import camera_models as all_models
from bundle.model.folds import folds_of
from bundle.model.problem import Problem
from bundle.model.residuals import CLIP

if TYPE_CHECKING:
    from bundle.georeference.measurements import Prior
    from bundle.solving.constraints.rules import Rule

FEWEST_HELD_OUT = 50  # smallest number of held-out observations that can be compared

MOST_CANDIDATES = 100


def validate(
    problem: Source,
    options: SolveOptions | None = None,
    *,
    num_folds: int = 5,
    seed: int = 0,
    camera_models: str | Iterable[str] = (),
    share: str | Iterable[str] = (),
    losses: str | Iterable[str] = "cauchy",
    refine_sets: Iterable[Iterable[str]] = (),
    priors: Iterable[Prior] = (),
    constraints: Iterable[str | Rule] = (),
    clip: float = CLIP,
    rule: DecisionRule | None = None,
    source: str = "INPUT",
    flags: str = "",
    progress: Progress | None = None,
    **changes: Any,
) -> Validation:
    """Compare lens models, sharings and losses by how well they predict observations.

    The observations are divided into folds (:mod:`bundle.model.folds`), the same for all
    candidates. Each candidate is fitted to all observations except those of a fold, and predicts
    this fold. Its score is the RMS of the normalised errors of all folds, clipped at 3 sigmas. The
    recommended candidate is the one with the fewest parameters among those that predict as well as
    the best: within 2 standard errors or 1 %, unless its cameras moved or the best one is much less
    certain (:mod:`bundle.judging.validation.validation_result`). Errors at repeated measurements
    (points that occur twice) do not count in the decision. Where the residuals of shared lenses
    show motion or a rolling shutter, and one lens with a shutter predicts as well as any lenses per
    image (:mod:`bundle.judging.validation.judgement`), the latter are vetoed, and shared lenses are
    compared beside a shutter.

    Args:
        problem: the problem, which is not changed; also the path of one, or a
            pycolmap.Reconstruction.
        options: options of the solves, as in :func:`bundle.solve`; loss and refined variables are
            the candidates'.
        num_folds: number of folds.
        seed: seed of the folds.
        camera_models: COLMAP's names of models. By default the models of the input's kind.
        share: sharings: "each" (a lens per image), "focal" (a focal length per image, all else
            shared by images of one size), "size" (a lens per image size), "all" (one lens), "input"
            (as in the input). By default those that make a difference.
        losses: robust losses.
        refine_sets: sets of refined variables, each as ``refine`` of :class:`bundle.SolveOptions`.
        priors: measured positions of images, and control points, as in :func:`bundle.solve`. Check
            points and residuals at positions are reported for each candidate.
        constraints: rules that hold in all fits, as in :func:`bundle.solve`.
        clip: largest error that counts in ``held_out_rmse``, in pixels.
        rule: numbers of the decision.
        source: path of the input, for the command lines.
        flags: further flags of the command lines, such as those of the priors.
        progress: function called after each solve, with the number of solves done, their total
            number, and the name of the candidate.
        **changes: options by name, which replace those in ``options``.

    Raises:
        InputError: an argument is wrong, there are too few observations to hold out, or no
            candidate has a fit.
        KeyboardInterrupt: Ctrl-C.
        OSError: the path cannot be read.

    Example:
        >>> validation = bundle.validate("sparse/0")
        >>> validation.candidates[validation.recommended].name
        >>> validation.command
    """
    begun = perf_counter()
    given = as_problem(problem)
    check_function("progress", progress)
    options = SolveOptions.of(options, changes, "validate")
    clip = number("clip", clip, above=0.0)
    folds = _folds(given, num_folds, seed)
    candidates = _candidates(
        given,
        _words("camera_models", camera_models, tuple(all_models())),
        _words("share", share, SHARES),
        _words("losses", losses, LOSSES) or ("cauchy",),
        [options.replace(refine=tuple(one)).refine for one in refine_sets] or [options.refine],
    )
    fitting = Fitting(
        problem=given,
        folds=folds,
        options=options,
        priors=tuple(priors),
        rules=tuple(constraints),
        progress=progress,
    )
    fits = fit_candidates(candidates, fitting)
    if all(fit.error for fit in fits):
        name, error = fits[0].candidate.name, fits[0].error
        raise InputError(f"candidates: expected one with a fit, found none; {name}: {error}")
    return judged(
        fitting,
        fits,
        rule=DecisionRule() if rule is None else rule,
        clip=clip,
        num_folds=num_folds,
        seed=seed,
        source=source,
        flags=flags,
        begun=begun,
    )


def _words(name: str, given: str | Iterable[str], choices: Sequence[str]) -> tuple[str, ...]:
    values = given.split(",") if isinstance(given, str) else list(given)
    return tuple(dict.fromkeys(choice(name, one, choices) for one in values if one != ""))


def _folds(problem: Problem, num_folds: int, seed: int) -> NDArray[np.int16]:
    """Return the folds."""
    folds = folds_of(problem, num_folds, seed)
    count = int((folds >= 0).sum())
    if count < FEWEST_HELD_OUT:
        raise InputError(
            f"problem: expected at least {FEWEST_HELD_OUT} observations that can be held out (of "
            f"points with two more images), found {count} of {problem.num_observations}"
        )
    if len(np.unique(problem.observation_image[folds >= 0])) < 2:
        raise InputError("problem: expected observations to hold out in two images or more")
    return folds


def _candidates(problem: Problem, *wanted: Any) -> list[Candidate]:
    """Return the requested candidates."""
    candidates = default_candidates(problem, *wanted)
    if len(candidates) > MOST_CANDIDATES:
        raise InputError(
            f"candidates: expected at most {MOST_CANDIDATES} combinations, found {len(candidates)}"
        )
    return candidates
