"""Reports of `bundle evaluate`, `triage` and `validate`."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bundle.base.words import format_name, number, pixels, plural, span
from bundle.errors import shown
from bundle.interface.judging_options import AUC_DEFINITIONS, EvaluateOptions, TriageOptions
from bundle.judging.evaluation.check_points import CheckPointEvaluation
from bundle.judging.evaluation.evaluation_result import Evaluation, SharedImage
from bundle.judging.triage.triage_result import Triage
from bundle.judging.validation.row_test import RowTest
from bundle.judging.validation.validation_result import ValidatedCandidate, Validation
from bundle.model.pose_table import ErrorStatistics
from bundle.model.problem import Problem
from bundle.reports.sections import Column, Report, Section, Table
from bundle.reports.terminal.inputs import about_input, input_facts

if TYPE_CHECKING:
    from bundle.figures.marks import Figure

MOST_IMAGES = 5
MOST_LENSES, MOST_DRAWN = 5, 4
MOST_POINTS = 12
FIELD = "Projection by B minus projection by A, in pixels of A, for distant points."


def evaluated(
    paths: tuple[str, str],
    found: Evaluation | CheckPointEvaluation,
    options: EvaluateOptions | None = None,
) -> Report:
    """Return the report on a comparison; ``paths`` may be names of A and of the reference B."""
    if isinstance(found, CheckPointEvaluation):
        problem = found.alignment.problem
        notes = found.alignment.notes
        kinds = (
            {"format": problem.format, "num_images": problem.num_images},
            {"format": "gcp", "num_points": len(found.alignment.control_points)},
        )
    else:
        notes, kinds = found.notes, found.inputs
    ways = (options.input_pose_direction, options.pose_direction) if options else ("", "")
    inputs = [
        (label, f"{shown(path)} ({_described(kind, way)})")
        for label, path, kind, way in zip("AB", paths, kinds, ways, strict=True)
    ]
    if isinstance(found, Evaluation):
        inputs += _facts_of_poses(found)
    body = _of_points(found) if isinstance(found, CheckPointEvaluation) else _of_poses(found)
    return Report(
        command="evaluate",
        title=f"{shown(paths[0])} against {shown(paths[1])}",
        headline=found.headline,
        findings=found.findings,
        sections=[Section(facts=inputs), *body, *([Section(notes=notes)] if notes else [])],
        input={"path": paths[0], **kinds[0]},
        data={
            "reference": {"path": paths[1], **kinds[1]},
            "options": options and options.asdict(),
            **found.asdict(),
        },
    )


FORMATS = {
    "tum": "TUM",
    "euroc": "EuRoC",
    "kitti": "KITTI",
    "gcp": "ground control points",
    "poses": "list",
    "memory": "in memory",
}


def _described(kind: dict[str, Any], direction: str) -> str:
    name = FORMATS.get(kind["format"]) or format_name(kind["format"])
    for count, noun in (("num_poses", "pose"), ("num_images", "image"), ("num_points", "point")):
        if count in kind:
            name += f", {plural(kind[count], noun)}"
            break
    has_direction = direction and kind["format"] == "poses"
    return f"{name}, {direction.replace('_', '-')}" if has_direction else name


def _of_poses(found: Evaluation) -> list[Section]:
    relative, unit = found.relative, found.unit if found.unit == "m" else "units of B"
    rows = [("position (APE)", found.position, unit), ("rotation", found.rotation, "degrees")]
    if found.points is not None:
        rows.append(("points of common tracks", found.points.distance, unit))
    motion = [
        (f"motion over {plural(relative.delta, 'pose')} (RPE)", relative.position, unit),
        ("rotation over it", relative.rotation, "degrees"),
    ]
    is_path = found.association.by in ("time", "frame number", "order")
    errors = _errors([*rows, *motion] if is_path else rows)
    return [
        Section(title="Errors", tables=[errors]),
        *([] if is_path else [Section(title="Motion", tables=[_errors(motion)], is_detail=True)]),
        Section(tables=[_pairs(found)]),
        Section(figures=lambda: _pose_figures(found), is_page_only=True),
        Section(title="Images", tables=[_worst(found)], is_detail=True),
        *(_lenses(found) if found.lenses else []),
    ]


def _pose_figures(found: Evaluation) -> list[Figure]:
    from bundle.figures.evaluation_figures import error_figures, paths_figure  # for pages only

    return [paths_figure(found), *error_figures(found)]


def _errors(rows: Sequence[tuple[str, ErrorStatistics, str]]) -> Table:
    columns = [
        Column("error", 0),
        Column("unit", 2),
        Column("rms", lambda row: number(row[1].rmse)),
        Column("mean", lambda row: number(row[1].mean)),
        Column("median", lambda row: number(row[1].median)),
        Column("max", lambda row: number(row[1].max)),
    ]
    return Table(columns, rows, left=2)


def _pairs(found: Evaluation) -> Table:
    pairs = found.pairs
    limits = list(found.auc)
    rows = [
        ("AUC", *(f"{found.auc[limit]:.4f}" for limit in limits)),
        ("RRA", *(f"{pairs.rotation_accuracy[limit]:.4f}" for limit in limits)),
        ("RTA", *(f"{pairs.translation_accuracy[limit]:.4f}" for limit in limits)),
    ]
    return Table.of(
        (f"{plural(pairs.num_pairs, 'pair', grouped=True)}", *(f"{limit} deg" for limit in limits)),
        rows,
        legend=f"AUC: {AUC_DEFINITIONS[found.auc_definition]}. RRA, RTA: share of pairs below.",
    )


def worst_first(found: Evaluation) -> list[SharedImage]:
    """Return the images, those with the largest position errors first."""
    images = found.images
    return [images[row] for row in np.argsort(-found.position_errors, kind="stable")]


def _worst(found: Evaluation) -> Table:
    columns = [
        Column("worst images", "name"),
        Column("position", "position", number),
        Column("rotation [deg]", "rotation", number),
    ]
    if found.movement is not None:
        columns.append(Column("sigmas", "sigmas", number))
    return Table(columns, worst_first(found), most=MOST_IMAGES)


def _lenses(found: Evaluation) -> list[Section]:
    columns = [
        Column("camera of A", "camera_a"),
        Column("of B", "camera_b"),
        Column("images", "num_images"),
        Column("rms [px]", "pixels.rmse", number),
        Column("max [px]", "pixels.max", number),
        Column("removed rotation [deg]", "angle", number),
    ]
    rows = sorted(found.lenses, key=lambda lens: -np.nan_to_num(lens.pixels.rmse, nan=-1.0))
    known = [lens for lens in rows if np.isfinite(lens.pixels.rmse)][:MOST_DRAWN]

    def figures() -> list[Figure]:
        from bundle.figures.evaluation_figures import lens_difference_figure  # for pages only

        return [lens_difference_figure(lens) for lens in known]

    table = Table(columns, rows, most=MOST_LENSES)
    drawn = Section(title="Worst lenses", text=[FIELD], figures=figures, is_page_only=True)
    sections = [Section(title="Lenses", tables=[table], is_detail=True)]
    return [*sections, drawn] if known else sections


def _facts_of_poses(found: Evaluation) -> list[tuple[str, str]]:
    pairs, similarity = found.association, found.similarity
    facts = [("association", f"{len(pairs)} {pairs.sentence}")]
    angle = np.degrees(np.arccos(np.clip((np.trace(similarity.rotation) - 1) / 2, -1, 1)))
    facts.append(
        (
            "alignment",
            f"{found.alignment}: scale {similarity.scale:.9g}, rotation {number(float(angle))} "
            f"degrees, translation {number(float(np.linalg.norm(similarity.translation)))}",
        )
    )
    if found.points is not None:
        points = found.points
        facts.append(("common tracks", f"{points.num_shared} of {points.num_a} points of A"))
    return facts


def _of_points(found: CheckPointEvaluation) -> list[Section]:
    rows = [
        (point.name, point.role, str(point.num_images), *(number(float(value)) for value in error))
        for point, error in zip(found.points, found.errors, strict=True)
    ]
    order = np.argsort(-np.nansum(found.errors**2, axis=1), kind="stable")
    head = ("point", "role", "images", "east [m]", "north [m]", "up [m]")
    table = Table.of(
        head,
        [rows[k] for k in order],
        left=2,
        most=MOST_POINTS,
        others=lambda count: f"{plural(count, 'more point')} with smaller errors.",
    )
    return [Section(tables=[table])]


NAMES = {
    "columns": "columns n",
    "measurements": "residuals",
    "information_nonzeros": "nnz(Lambda)",
    "factor_nonzeros": "nnz(L)",
    "factor_flops": "flops",
    "ordering": "ordering",
    "initial_cost": "cost at the start",
    "final_cost": "cost at the end",
    "steps": "steps",
    "rejected": "rejected steps",
    "least_radius": "smallest radius (1 / lambda)",
    "seconds": "time [s]",
    "num_threads": "threads",
    "error": "position error [m]",
}
"""Names of the quantities in the table."""


def triaged(paths: tuple[str, str], found: Triage, options: TriageOptions) -> Report:
    """Return the report on two reports: causes first, then the quantities side by side."""
    columns = (
        Column("", lambda one: NAMES[one.name]),
        Column("old", lambda one: _word(one.old)),
        Column("new", lambda one: _word(one.new)),
        Column("ratio", "ratio", lambda ratio: "" if ratio is None else number(ratio)),
    )
    methods = [
        f"{cause.cause}: {', '.join(named)}."
        for cause in found.causes
        if (named := found.methods.get(cause.cause))
    ]
    return Report(
        command="triage",
        headline=[cause.sentence for cause in found.causes] or [found.headline],
        sections=[
            Section(tables=[Table(columns, found.quantities)], notes=found.notes),
            *([Section(notes=methods, is_detail=True)] if methods else []),
        ],
        data={
            "old": {"path": paths[0]},
            "new": {"path": paths[1]},
            "options": options.asdict(),
            **found.asdict(),
        },
    )


def _word(value: float | str | None) -> str:
    if value is None:
        return "-"
    if isinstance(value, str):
        return shown(value)
    return f"{value:.0f}" if float(value).is_integer() and abs(value) < 1e9 else number(value)


OF_VALIDATION = (
    *("verdict", "recommended", "command", "best", "candidates", "num_folds", "seed", "clip"),
    *("sigma", "rule", "notes", "time_in_seconds"),
)
"""Properties of a validation for programs."""


def validated(path: str, problem: Problem, found: Validation, options: Mapping[str, Any]) -> Report:
    """Return the report on a validation; the options are those of its solves."""
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
            **{name: getattr(found, name) for name in OF_VALIDATION},
            "present": None if found.present < 0 else found.present,
            "num_held_out": len(found.observations),
            "row_test": _row_test(found.row_test),
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
    known = found.candidates
    base = known[found.recommended].position_sigma
    columns = [Column("lens", "lens"), Column("sharing", "sharing")]
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
        words.append("difference and =: only shared lenses are compared with a rolling shutter")
    return words


def _details(found: Validation) -> Table:
    columns = [
        Column("lens", "lens"),
        Column("sharing", "sharing"),
        Column("rank", "num_parameters"),
        Column("AIC", "aic", _one),
        Column("BIC", "bic", _one),
        Column("median held out", "held_out_median", pixels),
        Column("clipped [%]", "share_clipped", lambda share: _three(100 * share)),
        Column("iterations", "num_iterations"),
    ]
    return Table(columns, list(found.candidates), left=2, keys=2)


def _facts(found: Validation) -> list[tuple[str, str]]:
    predicted = plural(len(found.observations), "observation")
    facts = [
        ("folds", f"{found.num_folds}, seed {found.seed}, {predicted}"),
        ("noise", f"{found.sigma:.4g} px per coordinate"),
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
    if test is None:
        return None
    names = [field.name for field in dataclasses.fields(test)]
    hidden = ("images", "slopes", "errors")
    return {name: getattr(test, name) for name in names if name not in hidden} | {
        "num_images": test.num_images
    }


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
