"""Certainty of a reconstruction: sigmas of poses and points, correlations, projections."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.uncertainty.covariance_result import Certainty
from bundle.base.words import number, plural
from bundle.figures.lens_figures import correlation_figure, distance_figure, sigma_figure, top_sigma
from bundle.figures.marks import round_down
from bundle.figures.projection_uncertainty import ProjectionUncertainty
from bundle.figures.scene_view import SceneView
from bundle.model.problem import Problem
from bundle.reports.page.scene_section import packed
from bundle.reports.page.table import rounded
from bundle.reports.sections import Section, Table

MOST_ELLIPSOIDS = 400
LARGE = 0.02
"""Median half axis of the drawn ellipsoids, in units of the view."""


def certainty_sections(
    problem: Problem,
    known: Certainty,
    cameras: Sequence[int],
    projections: Sequence[ProjectionUncertainty],
) -> list[Section]:
    """Return the sigmas of poses and points, the uncertainty of projections, and correlations."""
    given = known.covariance
    scaled = "times" if given.scale == "sigma0" else "not times"
    words = (
        f"Marginal standard deviations, {scaled} sigma0 = {number(given.sigma0)} "
        f"({given.dof:,} degrees of freedom); gauge: {given.gauge.replace('_', ' ')}."
    )
    if num_null := len(given.null_point_ids):
        count = plural(num_null, "point", grouped=True)
        words += f" {count} without parallax: the unobservable direction is left out."
    rows = [
        _row("position of a camera, worst direction [length unit]", known.position_sigmas),
        _row("rotation of a camera, worst axis [degrees]", known.angles),
        _row("point, worst direction [length unit]", known.point_sigmas),
    ]
    head = ["standard deviation", "count", "median", "95th percentile", "largest"]
    table = Table.of(head, [row for row in rows if row])
    made = (correlation_figure(problem, known, k) for k in cameras if k in known.cameras)
    correlations = [figure for figure in made if figure is not None]
    first, *rest = [
        Section(
            title="Certainty", text=[words], notes=given.notes, is_warning=True,
            tables=[table] if table.rows else [],
        ),
        *projection_sections(projections),
    ]  # fmt: skip
    if correlations:
        details = Section(title="Correlations of intrinsics", figures=correlations, is_detail=True)
        rest.insert(min(len(rest), 1), details)
    return [first, *rest]


def scene_ellipsoids(view: SceneView, known: Certainty) -> tuple[dict[str, Any], str]:
    """Return the one-sigma ellipsoids of a view and a sentence about their scale."""
    data, words = {}, []
    for name, drawn, positions, indices, covariance in (
        ("point", view.point_indices, view.points, known.points, known.covariance.point_covariance),
        ("camera", view.image_indices, view.centers, known.images, known.centers),
    ):
        _, there, here = np.intersect1d(drawn, indices, return_indices=True)
        made, factor = ellipsoid_data(positions[there], covariance[here], view.unit)
        if made is not None:
            data[f"{name}_ellipsoids"] = made
            words.append(f"x{factor:g} ({plural(made['count'], name)})")
    sentence = f"1-sigma ellipsoids, drawn {' and '.join(words)}." if words else ""
    return data, sentence


def ellipsoid_data(
    positions: NDArray[np.float64], covariance: NDArray[np.float64], unit: float
) -> tuple[dict[str, Any] | None, float]:
    """Return ellipsoids for the view, and the factor by which their drawing is enlarged.

    Positions are (n, 3) in the frame of the view; of more than 400, every k-th is drawn.
    Covariances are (n, 3, 3) in squared units of the world; ``unit``: world units per unit of the
    view.
    """
    good = np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)))
    good = good[:: max(-(-len(good) // MOST_ELLIPSOIDS), 1)]
    if len(good) == 0:
        return None, 1.0
    values, vectors = np.linalg.eigh(covariance[good] / unit**2)
    halves = np.sqrt(np.maximum(values, 0.0))
    typical = float(np.median(halves[:, 2]))
    factor = 1.0
    if typical > 0:
        factor = round_down(LARGE / typical, 1e-3)
    # Rows are the half axes; an axis of length zero would leave no volume to draw.
    half_axes = np.swapaxes(vectors * np.maximum(factor * halves, 1e-6)[:, None, :], 1, 2)
    # A mirrored sphere is a sphere, but its faces would point inwards.
    half_axes[np.linalg.det(half_axes) < 0, 0] *= -1
    data = {"positions": packed(positions[good]), "axes": packed(half_axes), "factor": factor,
            "count": len(good)}  # fmt: skip
    return data, factor


def _row(name: str, values: NDArray[np.float64]) -> list[str]:
    known = values[np.isfinite(values) & (values > 0)]  # constant parameters have no sigma
    if len(known) == 0:
        return []
    shares = np.quantile(known, [0.5, 0.95, 1.0])
    return [name, f"{len(known):,}", *(number(float(value)) for value in shares)]


WORDS = (
    "Standard deviation of the pixel of a point that is fixed to the camera, in the worst "
    "direction, from the noise of the measurements (mrcal's projection uncertainty). Errors of the "
    "lens model add to it, and without observations the model extrapolates."
)


def projection_sections(known: Sequence[ProjectionUncertainty]) -> list[Section]:
    """Return the figures of each camera; all but those of the first camera are details."""
    sections = []
    for index, one in enumerate(known):
        figures = [
            sigma_figure(one),
            sigma_figure(one, one.distance, "the median distance of its points"),
            distance_figure(one),
        ]
        title = f"Projection uncertainty of camera {one.camera_id}, {one.model}"
        sections.append(
            Section(
                title=title,
                text=[] if index else [WORDS],
                figures=figures,
                is_joined=True,
                is_detail=index > 0,
            )
        )
    return sections


def projection_data(known: Sequence[ProjectionUncertainty]) -> list[dict[str, Any]]:
    """Return the numbers of the figures."""
    return [
        {
            "camera_id": one.camera_id,
            "box": one.box.tolist(),
            "rows": one.count.shape[0],
            "columns": one.count.shape[1],
            "count": one.count.ravel().tolist(),
            "top": top_sigma(one),
            "distance": one.distance,
            "infinity": rounded(one.sigma()),
            "at_distance": rounded(one.sigma(one.distance)),
            "distances": rounded(one.distances),
            "curves": {name: rounded(values) for name, values in one.by_distance().items()},
        }
        for one in known
    ]
