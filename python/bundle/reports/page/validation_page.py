"""Page of a validation: recommendation, candidates, and the curves behind the decision."""

from __future__ import annotations

import math
import os
from html import escape

from bundle.base.arguments import check_type
from bundle.base.paths import as_path
from bundle.base.words import plural, span
from bundle.figures.validation_figures import (
    difference_figure,
    distribution_figure,
    error_figure,
    image_figure,
)
from bundle.judging.validation.validation_result import ValidatedCandidate, Validation
from bundle.reports.page.page import tag, write_page
from bundle.reports.page.svg import grid
from bundle.reports.page.table import Notes, table


def write_validation(
    validation: Validation, path: str | os.PathLike[str], name: str = "validation"
) -> None:
    """Write a validation as one self-contained HTML file.

    Args:
        validation: the validation.
        path: path of the file.
        name: name of the input.

    Raises:
        InputError: the path is a folder, or a path above it is no folder.
        OSError: the file cannot be written.
    """
    check_type("validation", validation, Validation)
    figures = [function(validation) for function in (error_figure, difference_figure)]
    figures += [function(validation) for function in (distribution_figure, image_figure)]
    sections = [
        _recommendation(validation),
        tag("h2", "Candidates"),
        _candidates(validation),
        tag("h2", "Curves"),
        grid(figures),
        *_notes(validation),
    ]
    write_page(as_path(path), f"Which lens: {name}", sections)


def _recommendation(found: Validation) -> str:
    lines = [tag("p", escape(sentence)) for sentence in found.headline]
    lines.append(tag("pre", tag("code", escape(found.command))))
    for finding in found.findings:
        lines.append(tag("p", escape(finding.sentence)))
        if finding.command:
            lines.append(tag("pre", tag("code", escape(finding.command))))
    predicted = plural(len(found.observations), "observation", grouped=True)
    scope = (
        f"{plural(len(found.candidates), 'candidate')} predicted {predicted} in "
        f"{found.num_folds} folds (seed {found.seed}) in {span(found.time_in_seconds)}."
    )
    return tag("div", *lines, class_="recommended") + tag("p", scope, class_="quiet")


def _candidates(found: Validation) -> str:
    head = [
        "lens", "sharing", "loss", "lens parameters", "fitted [px]", "held out [px]",
        "difference [sigma]", "position sigma", "AIC", "BIC", "note",
    ]  # fmt: skip
    notes = Notes()
    rows = []
    for k, one in enumerate(found.candidates):
        role = "recommended" if k == found.recommended else "as good as the best"
        equal = role if found.decision.is_equal[k] else ""
        rows.append([
            one.lens,
            one.sharing,
            one.loss.replace("_", "-"),
            str(one.num_intrinsics),
            _number(one.fitted_rmse),
            _number(one.held_out_rmse),
            _difference(one),
            _number(one.position_sigma),
            _number(one.aic, 1),
            _number(one.bic, 1),
            notes.refer(one.error or one.vetoed or equal),
        ])  # fmt: skip
    return table(head, rows, words={1, 2}, best=found.recommended) + notes.listed()


def _notes(found: Validation) -> list[str]:
    return [tag("p", escape(note), class_="quiet") for note in found.notes]


def _difference(one: ValidatedCandidate) -> str:
    if not math.isfinite(one.difference):
        return "-"
    if one.difference == 0 and one.standard_error == 0:
        return "best"
    return f"{one.difference:+.4f} ± {one.standard_error:.4f}"


def _number(value: float, digits: int = 4) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"
