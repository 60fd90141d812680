"""Report of `bundle validate`: recommendation, command, and a row per candidate."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from bundle.base.words import number, pixels, plural, span
from bundle.errors import shown
from bundle.judging.validation.row_test import RowTest
from bundle.judging.validation.validation_result import ValidatedCandidate, Validation
from bundle.model.problem import Problem
from bundle.reports.sections import Column, Report, Section, Table, fields
from bundle.reports.terminal.inputs import about_input, input_facts

if TYPE_CHECKING:
    from bundle.figures.drawing import Figure


def validated(path: str, problem: Problem, found: Validation, options: Mapping[str, Any]) -> Report:
    """Return the report on a validation.

    Args:
        path: path of the input.
        problem: the input.
        found: the validation.
        options: options of the solves.
    """
    mark = dict(zip(found.candidates, _marks(found), strict=True))
    rows = list(found.candidates)
    first, *others = _columns(found)
    name = Column("  lens", lambda one: f"{mark[one]:1} {first.cell(one)}")
    why = Column("note", lambda one: one.error or one.vetoed, is_page_only=True)
    table = Table([name, *others, why], rows, left=2, keys=2, best=found.recommended)
    return Report(
        command="validate",
        title=f"Which lens: {shown(path)}",
        input=about_input(path, problem),
        headline=found.headline,
        findings=found.findings,
        sections=[
            Section(command=found.command),
            Section(title="Candidates", tables=[table], notes=_legend(found)),
            Section(title="Curves", figures=lambda: _figures(found), is_page_only=True),
            *([Section(notes=found.notes, is_warning=True)] if found.notes else []),
            Section(title="More numbers", tables=[_details(found)], is_detail=True),
            Section(
                title="Input", facts=[*input_facts(path, problem), *_facts(found)], is_detail=True
            ),
        ],
        data={
            "options": {**options, "num_folds": found.num_folds, "seed": found.seed},
            "verdict": found.verdict,
            "recommended": found.recommended,
            "command": found.command,
            "best": found.best,
            "present": None if found.present < 0 else found.present,
            "candidates": [fields(one) for one in found.candidates],
            "num_held_out": len(found.observations),
            "num_folds": found.num_folds,
            "seed": found.seed,
            "clip": found.clip,
            "sigma": found.sigma,
            "rule": fields(found.rule),
            "row_test": _row_test(found.row_test),
            "notes": found.notes,
            "time_in_seconds": found.time_in_seconds,
        },
    )


def _figures(found: Validation) -> list[Figure]:
    from bundle.figures import evaluation_figures as figures

    drawn = (figures.error_figure, figures.difference_figure)
    return [draw(found) for draw in (*drawn, figures.distribution_figure, figures.image_figure)]


def _marks(found: Validation) -> list[str]:
    """Return the role of each candidate: "*" recommended, "=" as good, "x" out, "" worse."""
    words = []
    for k, one in enumerate(found.candidates):
        if k == found.recommended:
            words.append("*")
        elif one.vetoed or one.error:
            words.append("x")
        else:
            words.append("=" if found.decision.is_equal[k] else "")
    return words


def _columns(found: Validation) -> list[Column]:
    """Return the columns of the candidates, without their mark."""
    known = found.candidates
    base = known[found.recommended].position_sigma
    columns = [
        Column("lens", "lens"),
        Column("sharing", "sharing"),
    ]
    if len({one.loss for one in known}) > 1:
        columns.append(Column("loss", "loss", lambda word: word.replace("_", "-")))
    if len({one.refine for one in known}) > 1:
        columns.append(
            Column("cx, cy", lambda one: "yes" if "principal_point" in one.refine else "no")
        )
    columns += [
        Column("free", "num_intrinsics"),
        Column("fitted", "fitted_clipped_rmse", _three),
        Column("held out", "held_out_rmse", _three),
        Column("difference", _difference),
        Column("sigma", lambda one: _times(one.position_sigma, base)),
    ]
    if any(math.isfinite(one.check_points_rms) for one in known):
        columns.append(Column("check points", "check_points_rms", number))
    if any(math.isfinite(one.gps_rms) for one in known):
        columns.append(Column("GPS", "gps_rms", number))
    return columns


def _legend(found: Validation) -> list[str]:
    words = ["*: recommended; =: predicts as well as the best"]
    if any(one.vetoed or one.error for one in found.candidates):
        words[0] += "; x: vetoed or without a fit"
    words.append(
        "free: lens parameters; fitted: RMSE of the fit to all [px]; held out: of "
        f"{len(found.observations)} predictions in {found.num_folds} folds [px], errors at most "
        f"{found.clip:g}; difference: of the normalised errors to the best, with its standard "
        "error; sigma: of the positions, relative to the recommended"
    )
    if found.row_test is not None and math.isfinite(found.row_test.gain):
        words.append("difference and =: shared lenses with a rolling shutter, all else without")
    return words


def _details(found: Validation) -> Table:
    """Return further numbers of each candidate."""
    columns = [
        Column("lens", "lens"),
        Column("sharing", "sharing"),
        Column("rank", "num_parameters"),
        Column("AIC", "aic", _one),
        Column("BIC", "bic", _one),
        Column("median held out", "held_out_median", pixels),
        Column("clipped", "share_clipped", lambda share: f"{100 * share:.2f} %"),
        Column("iterations", "num_iterations"),
    ]
    return Table(columns, list(found.candidates), left=2, keys=2)


def _facts(found: Validation) -> list[tuple[str, str]]:
    predicted = plural(len(found.observations), "observation")
    facts = [
        ("folds", f"{found.num_folds}, seed {found.seed}, {predicted}"),
        ("noise", f"{found.sigma:.4g} per coordinate"),
        ("time", span(found.time_in_seconds)),
    ]
    test = found.row_test
    if test is not None and math.isfinite(test.shear):
        facts.insert(
            2,
            (
                "row test",
                f"anisotropy {test.anisotropy:.1f}, shear {test.shear:.1f} (chi2 per degree of "
                f"freedom over {plural(test.num_images, 'image')})",
            ),
        )
    return facts


def _row_test(test: RowTest | None) -> dict[str, Any] | None:
    """Return the scalars of the test, for JSON."""
    if test is None:
        return None
    names = [field.name for field in dataclasses.fields(test)]
    hidden = ("images", "slopes", "errors")
    return {name: getattr(test, name) for name in names if name not in hidden} | {
        "num_images": test.num_images
    }


def _lens_parts(refine: Sequence[str]) -> list[str]:
    return [name.replace("_", " ") for name in refine if name not in ("poses", "points")]


def _difference(one: ValidatedCandidate) -> str:
    if one.difference == 0 and one.standard_error == 0:
        return "best"
    if not math.isfinite(one.difference):
        return "-"
    return f"{one.difference:+.3f} +- {one.standard_error:.3f}"


def _three(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "-"


def _one(value: float) -> str:
    return f"{value:.1f}" if math.isfinite(value) else "-"


def _times(sigma: float, base: float) -> str:
    return f"x {sigma / base:.1f}" if base > 0 and math.isfinite(sigma) else "-"
