"""Page of a comparison with a reference: verdict, errors of images, centres, lenses."""

from __future__ import annotations

import os
from collections.abc import Sequence
from html import escape

import numpy as np

from bundle.base.arguments import check_type
from bundle.base.paths import as_path
from bundle.base.words import number
from bundle.errors import InputError, brief, shown
from bundle.figures.evaluation_figures import (
    error_figures,
    lens_difference_figure,
    paths_figure,
)
from bundle.interface.evaluate_options import AUC_DEFINITIONS
from bundle.interface.finding import Finding
from bundle.judging.evaluation.check_points import CheckPointEvaluation
from bundle.judging.evaluation.evaluation_result import Evaluation
from bundle.reports.page.page import tag, write_page
from bundle.reports.page.svg import grid
from bundle.reports.page.table import table

ROWS = 12
MOST_IMAGES = 500
MOST_LENSES = 4


def write_evaluation(
    found: Evaluation | CheckPointEvaluation,
    path: str | os.PathLike[str],
    *,
    names: Sequence[str] = ("A", "B"),
) -> None:
    """Write one self-contained HTML page about a comparison.

    Args:
        found: result of :func:`bundle.evaluate`.
        path: path of the page. A failed write leaves no partial file.
        names: names of A and of the reference B, for the title.

    Raises:
        InputError: ``found`` is not an evaluation, or the path cannot hold a page.
        OSError: the page cannot be written.
    """
    if not isinstance(found, Evaluation | CheckPointEvaluation):
        raise InputError(f"found: expected a result of bundle.evaluate, found {brief(found)}")
    for name in names:
        check_type("names", name, str)
    title = f"{shown(names[0])} against {shown(names[1])}"
    sections = [
        _verdict(found.headline[1:], found.findings),
        tag("p", escape(f"A: {shown(names[0])}. B: {shown(names[1])}."), class_="quiet"),
    ]
    if isinstance(found, Evaluation):
        sections += _poses(found)
        notes = found.notes
    else:
        sections.append(_points(found))
        notes = found.alignment.notes
    sections += [tag("p", escape(note), class_="quiet") for note in notes]
    write_page(as_path(path), title, sections, headline=found.headline[0])


def _verdict(more: Sequence[str], findings: Sequence[Finding]) -> str:
    lines = [tag("p", escape(sentence)) for sentence in more]
    for finding in findings:
        lines.append(tag("p", escape(finding.sentence), class_="warn"))
        if finding.command:
            lines.append(tag("pre", tag("code", escape(finding.command))))
    return "".join(lines)


def _poses(found: Evaluation) -> list[str]:
    how = f"{found.num_shared} poses {found.association.sentence}; alignment: {found.alignment}."
    sections = [
        tag("p", escape(how), class_="quiet"),
        tag("h2", "Errors"),
        _statistics(found),
        _pairs(found),
        grid([paths_figure(found), *error_figures(found)]),
        tag("h2", "Images"),
        _images(found),
    ]
    known = [lens for lens in found.lenses if np.isfinite(lens.pixels.rmse)]
    if known:
        worst = sorted(known, key=lambda lens: -lens.pixels.rmse)[:MOST_LENSES]
        shown_of = "" if len(known) <= MOST_LENSES else f" The worst {MOST_LENSES} of {len(known)}."
        meaning = "Projection by B minus projection by A, in pixels of A, for distant points."
        sections += [
            tag("h2", "Lenses"),
            tag("p", meaning + shown_of, class_="quiet"),
            grid(map(lens_difference_figure, worst)),
        ]
    return sections


def _statistics(found: Evaluation) -> str:
    unit = found.unit if found.unit == "m" else "units of B"
    relative = found.relative
    rows = [
        ("position (APE)", unit, found.position),
        ("rotation", "degrees", found.rotation),
        (f"motion over {relative.delta} (RPE)", unit, relative.position),
        (f"rotation over {relative.delta} (RPE)", "degrees", relative.rotation),
    ]
    if found.points is not None:
        rows.append(("points of common tracks", unit, found.points.distance))
    cells = [
        [name, unit, *(number(v) for v in (errors.rmse, errors.mean, errors.median, errors.max))]
        for name, unit, errors in rows
    ]
    return table(["error", "unit", "rms", "mean", "median", "max"], cells, words={1})


def _pairs(found: Evaluation) -> str:
    limits = list(found.auc)
    accuracy = found.pairs
    rows = [
        ["AUC", *(f"{found.auc[limit]:.4f}" for limit in limits)],
        ["RRA", *(f"{accuracy.rotation_accuracy[limit]:.4f}" for limit in limits)],
        ["RTA", *(f"{accuracy.translation_accuracy[limit]:.4f}" for limit in limits)],
    ]
    head = [f"{accuracy.num_pairs:,} pairs", *(f"{limit} deg" for limit in limits)]
    meaning = (
        f"AUC ({found.auc_definition}): {AUC_DEFINITIONS[found.auc_definition]}. RRA and RTA: "
        "share of pairs with a smaller error of the relative rotation, of the direction of the "
        "translation."
    )
    return table(head, rows) + tag("p", escape(meaning), class_="quiet")


def _images(found: Evaluation) -> str:
    head = ["image", "position", "rotation [degrees]"]
    head += ["sigmas"] if found.movement is not None else []
    images = found.images
    rows = []
    for row in np.argsort(-found.position_errors, kind="stable")[:MOST_IMAGES]:
        image = images[row]
        sigmas = [] if image.sigmas is None else [number(image.sigmas)]
        rows.append([shown(image.name), number(image.position), number(image.rotation), *sigmas])
    more = found.num_shared - len(rows)
    rest = tag("p", f"{more} more with smaller errors.", class_="quiet") if more else ""
    return table(head, rows, rows_shown=ROWS) + rest


def _points(found: CheckPointEvaluation) -> str:
    rows = [
        [point.name, point.role, str(point.num_images), *(number(float(v)) for v in error)]
        for point, error in zip(found.points, found.errors, strict=True)
    ]
    head = ["point", "role", "images", "east [m]", "north [m]", "up [m]"]
    return table(head, rows, words={1})
