"""Verdict of a validation in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bundle.base.words import plural
from bundle.judging.validation.candidates import groups_of
from bundle.judging.validation.decision import Decision
from bundle.judging.validation.row_test import RowTest
from bundle.judging.validation.validation_result import ValidatedCandidate
from bundle.model.problem import Problem

RELEVANT_RATIO = 1.5
"""Ratio of position sigmas that the headline mentions."""


class Verdict(NamedTuple):
    """Verdict of a validation.

    Attributes:
        verdict: one of the words that :class:`Validation` lists.
        present: index of the candidate with the input's lenses; -1: none.
        headline: the verdict in sentences.
        notes: sentences about the comparison.
    """

    verdict: str
    present: int
    headline: tuple[str, ...]
    notes: tuple[str, ...]


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
    """Return the index of the candidate with the input's models and sharing; -1: none.

    Of several losses and refined sets those of the recommended candidate count.
    """
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
    """Return the price in certainty of positions: of the change, else of the worst candidate."""
    chosen = records[decision.recommended].position_sigma
    if not chosen > 0:
        return []
    now = records[present].position_sigma if present >= 0 else float("nan")
    if chosen > RELEVANT_RATIO * now:
        return [f"It costs certainty: the sigma of the positions becomes {chosen / now:.1f} x."]
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
        notes.append(f"not converged in every fold: {'; '.join(loose)}")
    usable = [k for k, one in enumerate(records) if np.isfinite(one.bic)]
    if usable:
        by_bic = min(usable, key=lambda k: records[k].bic)
        if not decision.is_equal[by_bic]:
            notes.append(
                f"BIC prefers {records[by_bic].name}; it assumes independent noise without outliers"
            )
    return notes
