"""Sections on images: residuals over the plane, worst images, photographs, covariances."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.uncertainty.covariance_result import Certainty
from bundle.base.words import few, number, pixels, plural
from bundle.errors import shown
from bundle.figures.lens_figures import correlation_figure, distance_figure, sigma_figure, top_sigma
from bundle.figures.marks import round_down
from bundle.figures.projection_uncertainty import ProjectionUncertainty
from bundle.figures.residual_field import SIGNIFICANT, ResidualField, RowResiduals, row_figure
from bundle.figures.residual_figures import (
    ImageResiduals,
    field_figures,
    image_figure,
    image_frame,
    image_name,
)
from bundle.figures.scene_view import SceneView
from bundle.model.problem import Problem
from bundle.reports.page.page import Photograph, photograph
from bundle.reports.page.scene_section import packed
from bundle.reports.page.table import rounded
from bundle.reports.sections import Section, Table

FEW_IDS = 4


def field_sections(
    fields: Sequence[ResidualField], num_cameras: int, rows: Mapping[str, RowResiduals]
) -> list[Section]:
    """Return the figures of all fields; those of the first one are not details.

    ``num_cameras`` counts cameras with observations; ``rows`` are residuals by row, by label.
    """
    words = (
        "Residuals are projection minus measurement. A lens model that fits leaves no pattern. "
        f"Bold lines: the mean of a cell exceeds {SIGNIFICANT:g} standard errors, as 1 % of the "
        "cells do by chance."
    )
    shown = {key for field in fields for key in field.camera_ids if len(field.camera_ids) == 1}
    if num_cameras > len(shown):
        words += f" Of {plural(num_cameras, 'camera')}, those with most observations are shown"
        pooled = any(len(field.camera_ids) > 1 for field in fields)
        words += ", after those of the commonest model and image size together." if pooled else "."
    first, rest = fields[0], fields[1:]
    mean, direction, significance, magnitude, count, profile = field_figures(first)
    return [
        Section(
            title="Residuals over the image", text=[words, _facts(first)],
            figures=[mean, significance, profile, *([row_figure(rows)] if rows else [])],
        ),
        Section(
            title="Directions, magnitude and count", figures=[direction, magnitude, count],
            is_detail=True,
        ),
        *(
            Section(title=_facts(field), figures=field_figures(field), is_detail=True)
            for field in rest
        ),
    ]  # fmt: skip


def field_data(fields: Sequence[ResidualField]) -> list[dict[str, Any]]:
    """Return the numbers of all fields, cells row by row."""
    return [
        {
            "camera_ids": list(field.camera_ids) if len(field.camera_ids) <= FEW_IDS else None,
            "num_cameras": len(field.camera_ids),
            "box": field.box.tolist(),
            "center": field.center.tolist(),
            "rows": field.count.shape[0],
            "columns": field.count.shape[1],
            "vector_factor": field.vector_factor,
            "count": field.count.ravel().tolist(),
            "mean_x": rounded(field.mean[..., 0]),
            "mean_y": rounded(field.mean[..., 1]),
            "rms": rounded(field.rms),
            "standard_error": rounded(field.standard_error),
            "radius": rounded(field.profile.radius),
            "ring_count": field.profile.count.tolist(),
            "radial": rounded(field.profile.radial),
            "radial_error": rounded(field.profile.radial_error),
            "tangential": rounded(field.profile.tangential),
            "tangential_error": rounded(field.profile.tangential_error),
        }
        for field in fields
    ]


def _facts(field: ResidualField) -> str:
    many, cells = field.num_significant
    name = f"Camera {field.camera_ids[0]}"
    if len(field.camera_ids) > 1:
        name = f"{len(field.camera_ids):,} cameras together"
    facts = (
        f"{name}: {plural(field.num_images, 'image', grouped=True)}, "
        f"{plural(field.num_observations, 'observation', grouped=True)}, cells of "
        f"{field.cell_size[0]:.0f} x {field.cell_size[1]:.0f} px"
    )
    if cells:
        facts += f"; {many} of {cells} cells with a significant mean"
    if field.num_outside:
        facts += f"; {plural(field.num_outside, 'observation')} outside the grid left out"
    return facts + "."


SHAPE = 0.02  # relative difference up to which two aspect ratios count as equal

NUM_WORST = 6
MOST_CLICKED = 400  # number of images whose residuals a click on their camera shows
MOST_VECTORS = 16_000  # number of residuals in the data of all images, at most 120 of an image
WIDTHS = (520, 400, 320, 240, 180)
BYTES_PER_PIXEL = 0.35
"""Size of a photograph as a data: URI, roughly, per pixel of the square around it."""


class Photographs:
    """Photographs of images by id, at a size that lets all of them fit on a page.

    Args:
        images: images, the worst first; these have the largest photographs.
        folder: folder of the photographs; None for a page without photographs.
        room: size of all photographs together [bytes].

    Attributes:
        pictures: photograph by image id.
        notes: sentences about photographs that are missing or have another shape.
    """

    def __init__(
        self, images: Sequence[ImageResiduals], folder: str | os.PathLike[str] | None, room: float
    ) -> None:
        self.pictures: dict[int, Photograph] = {}
        self.notes: list[str] = []
        if folder is None:
            return
        most = room / (BYTES_PER_PIXEL * max(len(images), 1))
        width = next((width for width in WIDTHS if width**2 <= most), WIDTHS[-1])
        missing, misfits, size = [], [], 0
        for place, image in enumerate(images):
            if size > room:
                break
            found = photograph(folder, image.error.name, WIDTHS[0] if place < NUM_WORST else width)
            if found is None:
                missing.append(image_name(image))
            elif not _fits(found, image):
                misfits.append(f"{image_name(image)} ({found.size[0]} x {found.size[1]})")
            else:
                self.pictures[image.error.image_id] = found
                size += len(found.address)
        if missing:
            self.notes.append(f"No photograph in {shown(str(folder))} for {few(missing)}.")
        if misfits:
            self.notes.append(f"Photographs in another shape than their cameras: {few(misfits)}.")


def worst_section(images: Sequence[ImageResiduals], photographs: Photographs) -> list[Section]:
    """Return the figures of the worst images, and their table."""
    head = ["image", "camera", "observations", "RMSE [px]", "largest [px]"]
    rows = [
        [image_name(image), str(image.camera_id), f"{image.error.num_observations:,}",
         pixels(image.error.rmse), pixels(image.error.max)]
        for image in images
    ]  # fmt: skip
    figures = []
    for image in images[:NUM_WORST]:
        picture = photographs.pictures.get(image.error.image_id)
        figures.append(image_figure(image, picture=picture and picture.address))
    words = "Lines go from the measurement to the projection, enlarged by the given factor."
    table = Table.of(head, rows, most=20)
    return [
        Section(title="Worst images", text=[words], notes=photographs.notes, is_warning=True,
                figures=figures),
        Section(title="Images by RMSE", tables=[table], is_detail=True),
    ]  # fmt: skip


def image_data(
    images: Sequence[ImageResiduals], photographs: Photographs, sigmas: Mapping[int, float]
) -> list[dict[str, Any]]:
    """Return the largest residuals of images, the worst first, for the page's script.

    The photographs of the worst images are in their figures, which the data name. Sigmas are those
    of positions by image id.
    """
    most = min(max(MOST_VECTORS // max(len(images), 1), 20), 120)
    data = []
    for place, image in enumerate(images):
        picture = photographs.pictures.get(image.error.image_id)
        is_drawn = picture is not None and place < NUM_WORST
        box, factor = image_frame(image)
        vectors = np.concatenate([image.xy, image.residual], axis=1)[:most]
        data.append(
            {
                "id": image.error.image_id,
                "name": image_name(image),
                "box": box.tolist(),
                "factor": factor,
                "count": image.error.num_observations,
                "rmse": image.error.rmse,
                "sigma": sigmas.get(image.error.image_id),
                "vectors": rounded(np.round(vectors, 2)),
                "figure": f"residuals of {image_name(image)}" if is_drawn else None,
                "photograph": None if is_drawn or picture is None else picture.address,
            }
        )
    return data


def _fits(picture: Photograph, image: ImageResiduals) -> bool:
    """Tell whether a photograph has the aspect ratio of its camera's images."""
    if min(image.size) <= 0:
        return False
    ratio = picture.size[0] / picture.size[1] * image.size[1] / image.size[0]
    return abs(ratio - 1.0) < SHAPE


# Certainty of a reconstruction: sigmas of poses and points, correlations, projections.


MOST_ELLIPSOIDS = 400
LARGE = 0.02  # median half axis of the drawn ellipsoids, in units of the view


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
    unit = given.unit or "length unit"
    rows = [
        _row(f"position of a camera, worst direction [{unit}]", known.position_sigmas),
        _row("rotation of a camera, worst axis [degrees]", known.angles),
        _row(f"point, worst direction [{unit}]", known.point_sigmas),
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
    """Return the figures of each camera; those of the first one are not details."""
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
