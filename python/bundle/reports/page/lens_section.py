"""Lenses and rolling shutters: distortion, focal lengths, parameters, readout, motions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.uncertainty.covariance_result import Covariance
from bundle.base.words import number, plural
from bundle.figures.drawing import Figure
from bundle.figures.lens_figures import LensCurve, focal_figure, lens_figure, most_observed_cameras
from bundle.figures.residual_field import twist_figures
from bundle.model.cameras import camera_models, param_kinds
from bundle.model.problem import Problem
from bundle.reports.sections import Section, Table
from bundle.reports.terminal.camera_tables import (
    about_shutter,
    shutter_fact,
    solved_data,
    solved_sentences,
)
from bundle.solving.result import Result

MOST_LENSES = 200
"""Number of cameras whose curves and focal lengths are drawn."""

Sigmas = Mapping[int, NDArray[np.float64]]


def lens_sections(
    problem: Problem,
    curves: Sequence[LensCurve],
    initial: Problem | None,
    before: Sequence[LensCurve],
    sigmas: Sigmas | None,
) -> list[Section]:
    """Return the figures of each kind of camera, and the parameters.

    Args:
        problem: problem with the cameras.
        curves: current curves, at most ``MOST_LENSES``, most observations first.
        initial: the problem before a solve; None without a solve.
        before: curves of the initial problem; drawn for single cameras, only where they differ.
        sigmas: standard deviations by index, NaN for constant parameters; None if unknown.
    """
    words = (
        "Distortion: outward shift of the image of a ray. Dashed: outermost observation, corner."
    )
    index = {int(camera_id): k for k, camera_id in enumerate(problem.camera_ids.tolist())}
    kinds: dict[tuple[str, int, int], list[LensCurve]] = {}
    for curve in curves:
        width, height = problem.camera_sizes[index[curve.camera_id]].tolist()
        kinds.setdefault((curve.model, width, height), []).append(curve)
    figures: list[Figure] = []
    earlier = {curve.camera_id: curve for curve in before}
    for (model, width, height), group in kinds.items():
        if len(group) == 1:
            figures.append(_single(group[0], earlier.get(group[0].camera_id)))
            continue
        size = f", {width} x {height}" if width > 0 else ""
        name = f"{plural(len(group), 'camera', grouped=True)}, {model}{size}"
        named = {f"camera {curve.camera_id}": curve for curve in group}
        figures.append(lens_figure(named, name))
        figures += _focal(problem, sorted(index[curve.camera_id] for curve in group), sigmas)
    cameras = most_observed_cameras(problem)
    title = "Parameters"
    if len(cameras) < problem.num_cameras:
        title += f" of the {plural(len(cameras), 'camera')} with most observations"
    table = _parameters(problem, initial, cameras, sigmas)
    if len(cameras) == 1:
        return [Section(title="Lenses", text=[words], figures=figures, tables=[table])]
    return [
        Section(title="Lenses", text=[words], figures=figures),
        Section(title=title, tables=[table], is_detail=True),
    ]


def _focal(problem: Problem, cameras: Sequence[int], sigmas: Sigmas | None) -> list[Figure]:
    model = problem.camera_models[cameras[0]]
    names = camera_models()[model]
    chosen = [k for k, kind in enumerate(param_kinds(model)) if kind == "focal"]
    unknown = np.full(len(names), math.nan)
    known = np.array([unknown if sigmas is None else sigmas.get(k, unknown) for k in cameras])
    return [
        focal_figure(
            problem.camera_ids[list(cameras)].astype(float),
            {names[k]: problem.camera_params[list(cameras), k] for k in chosen},
            {names[k]: known[:, k] for k in chosen},
            "Focal lengths",
        )
    ]


def _parameters(
    problem: Problem, initial: Problem | None, cameras: Sequence[int], sigmas: Sigmas | None
) -> Table:
    """Return the parameters of some cameras, one parameter per row."""
    head = ["camera", "model", "parameter", *(["before"] if initial else []), "value"]
    head += ["sigma"] if sigmas is not None else []
    earlier = {} if initial is None else {int(k): i for i, k in enumerate(initial.camera_ids)}
    rows = []
    for camera in cameras:
        model, camera_id = problem.camera_models[camera], int(problem.camera_ids[camera])
        for index, name in enumerate(camera_models()[model]):
            row = [f"{camera_id}", model, name]
            if initial is not None:
                first = earlier.get(camera_id, -1)
                same = first >= 0 and initial.camera_models[first] == model
                row.append(f"{initial.camera_params[first, index]:.7g}" if same else "-")
            row.append(f"{problem.camera_params[camera, index]:.7g}")
            if sigmas is not None:
                value = float(sigmas[camera][index]) if camera in sigmas else math.nan
                row.append(number(value) if math.isfinite(value) else "held")
            rows.append(row)
    return Table.of(head, rows, left=3, most=40)


def _single(curve: LensCurve, before: LensCurve | None) -> Figure:
    curves = {"now": curve}
    if before is not None and not (
        len(before.radius) == len(curve.radius)
        and np.allclose(before.radius, curve.radius)
        and np.allclose(before.distortion, curve.distortion)
    ):
        curves = {"before": before, "after": curve}
    words = ["Shaded: one standard deviation."] if len(curve.sigma) else []
    if math.isfinite(curve.fold_radius):
        words.append(
            f"The lens folds at {curve.fold_radius:.0f} px: nothing is imaged farther out."
        )
    return lens_figure(curves, f"Camera {curve.camera_id}, {curve.model}", " ".join(words))


def shutter_section(
    problem: Problem, result: Result | None, covariance: Covariance | None
) -> list[Section]:
    """Return the rolling shutters of a problem, or of a solve; empty without any.

    Args:
        problem: the problem, that of the result if there is one.
        result: the solve.
        covariance: covariance of the problem, for sigmas of refined readouts.
    """
    facts = shutter_fact(problem)
    if not facts:
        return []
    sigmas = {} if covariance is None else covariance.readout_sigmas
    words = [] if result is None else solved_sentences(result, sigmas)
    return [
        Section(
            title="Rolling shutter",
            text=[
                *words,
                "Each image moves while it is read. Its pose is that of the middle row. "
                "Residuals by row are among the residuals over the image.",
            ],
            facts=facts,
            figures=twist_figures(problem),
        )
    ]


def shutter_data(
    problem: Problem, result: Result | None, covariance: Covariance | None
) -> dict[str, Any]:
    """Return the same for programs; empty without rolling shutters."""
    if result is None or not about_shutter(problem):
        return about_shutter(problem)
    return solved_data(result, {} if covariance is None else covariance.readout_sigmas)
