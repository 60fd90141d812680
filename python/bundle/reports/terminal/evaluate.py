"""Report of `bundle evaluate`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bundle.base.words import format_name, number, plural
from bundle.errors import shown
from bundle.interface.judging_options import AUC_DEFINITIONS, EvaluateOptions
from bundle.judging.evaluation.check_points import CheckPointEvaluation
from bundle.judging.evaluation.evaluation_result import Evaluation, SharedImage
from bundle.model.pose_table import ErrorStatistics
from bundle.reports.sections import Column, Report, Section, Table

if TYPE_CHECKING:
    from bundle.figures.drawing import Figure

MOST_IMAGES = 5
MOST_LENSES, MOST_DRAWN = 5, 4
MOST_POINTS = 12
FIELD = "Projection by B minus projection by A, in pixels of A, for distant points."


def evaluated(
    paths: tuple[str, str],
    found: Evaluation | CheckPointEvaluation,
    options: EvaluateOptions | None = None,
) -> Report:
    """Return the report on a comparison.

    Args:
        paths: paths or names of A and of the reference B.
        found: the comparison.
        options: options of the comparison; None if they are unknown.
    """
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
        inputs += _facts(found)
    body = _of_points(found) if isinstance(found, CheckPointEvaluation) else _of_poses(found)
    return Report(
        command="evaluate",
        title=f"{shown(paths[0])} against {shown(paths[1])}",
        headline=found.headline,
        findings=found.findings,
        sections=[Section(facts=inputs), *body, *_notes(notes)],
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
    """Return format and size of an input, such as "COLMAP, 8 images"."""
    name = FORMATS.get(kind["format"]) or format_name(kind["format"])
    for count, noun in (("num_poses", "pose"), ("num_images", "image"), ("num_points", "point")):
        if count in kind:
            name += f", {plural(kind[count], noun)}"
            break
    has_direction = direction and kind["format"] == "poses"
    return f"{name}, {direction.replace('_', '-')}" if has_direction else name


def _notes(notes: Sequence[str]) -> list[Section]:
    return [Section(notes=notes)] if notes else []


def _of_poses(found: Evaluation) -> list[Section]:
    relative, unit = found.relative, found.unit if found.unit == "m" else "units of B"
    rows = [("position (APE)", found.position, unit), ("rotation", found.rotation, "degrees")]
    if found.points is not None:
        rows.append(("points of common tracks", found.points.distance, unit))
    motion = [
        (f"motion over {relative.delta} (RPE)", relative.position, unit),
        ("rotation over it", relative.rotation, "degrees"),
    ]
    is_path = found.association.by in ("time", "frame number", "order")
    errors = _errors([*rows, *motion] if is_path else rows)
    return [
        Section(title="Errors", tables=[errors]),
        *([] if is_path else [Section(title="Motion", tables=[_errors(motion)], is_detail=True)]),
        Section(tables=[_pairs(found)]),
        Section(figures=lambda: _figures(found), is_page_only=True),
        Section(title="Images", tables=[_worst(found)], is_detail=True),
        *(_lenses(found) if found.lenses else []),
    ]


def _figures(found: Evaluation) -> list[Figure]:
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


def _facts(found: Evaluation) -> list[tuple[str, str]]:
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
        (point.name, point.role, point.num_images, *(number(float(value)) for value in error))
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
