"""Not refined: one more step would lower the cost considerably.

Test. At a minimum the gradient w.r.t. each free point and each free pose vanishes, whatever else
was held constant. With g = J^T W r and H = J^T W J of one point (or one pose), its own Newton step
lowers the cost 1/2 sum w e^2 by 1/2 g^T H^-1 g. The sum over the points (poses), relative to the
cost, approximates the decrease by a common step. W are the weights rho'(e^2) of the loss of the
solve. An unknown loss is tried: squares, soft_l1 and cauchy at 1 px; the smallest decrease is used.

Threshold. At the true values, too, k parameters absorb noise: a share e = k / (2 observations) of
the cost. The remainder, (1 - decrease) / (1 - e), must be below 0.8 for points or for poses. Nine
models refined by other programs have 0.98 or more before division by 1 - e. Starts of synthetic
scenes and a triangulated rig model: 0.5 or less. Poses of rigs, constant poses and poses with
priors are left out. All other findings assume a model at its minimum.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bundle.interface.finding import Finding
from bundle.judging.findings.measured import (
    SMALLEST_SCALE,
    Measured,
    median_by_group,
    principal_points,
)
from bundle.model.losses import evaluate_loss
from bundle.model.residuals import linearize

LEFT = 0.8
SMALLEST_SHIFT, ALIKE = 10.0, 0.9
MOST_OBSERVATIONS = 20_000

Floats = NDArray[np.float64]


def not_refined(measured: Measured) -> Finding | None:
    """Return the finding about a model that is not at a minimum, or None."""
    if measured.is_minimum or not measured.scale > SMALLEST_SCALE:
        return None
    left, what, decrease = min(_left(measured), default=(1.0, "", 0.0))
    if not left < LEFT:
        return None
    return Finding(
        kind="not_refined",
        sentence=f"The model is not refined: better {what} alone would lower the cost by "
        f"{100 * decrease:.0f} %. Judge it after a refinement.",
        command=measured.command.refine(),
        evidence={"decrease": decrease, "by": what},
    )


@np.errstate(over="ignore", invalid="ignore")
def shifted_pixels(measured: Measured) -> Finding | None:
    """Return the finding about a model whose pixels all have the same shift, or None.

    If pixels count from the corner but are read as if from the image centre, all residuals are
    equal: its mean m explains the mean square, |m|^2 >= 0.9 mean e^2 (RMSE equals median), and is
    10 px or longer. A refinement would bend the model to absorb it. If no photograph gave the size,
    the middle of the image is c - m, where the reader took it to be c (0 from the centre).
    """
    command = measured.command
    residual = measured.residuals[measured.counted]
    if not len(residual):
        return None
    shift = residual.mean(axis=0)
    length, square = float(np.hypot(*shift)), float((residual**2).sum(axis=1).mean())
    if not (length >= SMALLEST_SHIFT and length >= np.sqrt(ALIKE * square) and square < np.inf):
        return None
    flags: tuple[str, ...] = ()
    if command.source.lower().endswith(".nvm"):
        from_corner = command.value("--pixel-origin", "center") == "corner"
        if from_corner and (measured.problem.observation_xy.min(axis=0) < 0).all():
            flags = ("--pixel-origin", "center")
        elif measured.problem.camera_sizes.any():
            flags = ("--pixel-origin", "corner") if not from_corner and (shift < 0).all() else ()
        elif size := _image_size(measured, residual, from_corner=from_corner):
            flags = ("--pixel-origin", "corner", "--image-size", size)
    return Finding(
        kind="shifted_pixels",
        sentence=f"All pixels are shifted alike: projections are {shift[0]:+.1f} and "
        f"{shift[1]:+.1f} px (x, y) from the observations, RMSE {np.sqrt(square):.1f} px. The "
        "pixels have another origin than the principal point: correct it instead of refining.",
        command=command.refine(*flags) if flags else "",
        evidence={"shift": shift.tolist(), "rmse": float(np.sqrt(square))},
        is_problem=True,
    )


def _image_size(measured: Measured, residual: Floats, *, from_corner: bool) -> str:
    """Return the one size of all images, which is twice their middle; "" if they have several."""
    problem = measured.problem
    image = problem.observation_image[measured.counted]
    center = principal_points(problem, problem.image_camera[image])
    size = 2.0 * (center * from_corner - residual)
    own = np.stack([median_by_group(column, image, problem.num_images)[0] for column in size.T])
    low, high = np.nanmin(own, axis=1), np.nanmax(own, axis=1)
    is_one = (low > 0).all() and (high - low <= 2.0 * SMALLEST_SHIFT).all()
    return "{:.0f},{:.0f}".format(*np.nanmedian(own, axis=1)) if is_one else ""


def under_its_loss(measured: Measured) -> Measured:
    """Return a model under cauchy if its steps lower the cost half as much as under other losses.

    `info` does not know the loss of the solve, but the model is a minimum of it.
    """
    if measured.is_minimum or measured.options.loss != "trivial":
        return measured
    found = np.array([decreases for _, _, decreases in _steps(measured)])
    if not found.size or not 2 * found[:, 2].max() < found[:, :2].max(axis=0).min():
        return measured
    command = measured.command.after("--loss", "cauchy")
    return replace(measured, options=measured.options.replace(loss="cauchy"), command=command)


def _left(measured: Measured) -> Iterator[tuple[float, str, float]]:
    """Yield the cost that remains after a step of points, and of poses, and the decrease."""
    for what, absorbed, decreases in _steps(measured):
        yield (1.0 - min(decreases)) / (1.0 - absorbed), what, min(decreases)


def _steps(measured: Measured) -> Iterator[tuple[str, float, list[float]]]:
    """Yield what a step moves, the share that noise absorbs, and the decrease under each loss."""
    problem, options = measured.problem, measured.options
    step = -(-problem.num_observations // MOST_OBSERVATIONS)
    usable = measured.counted & (problem.observation_point % step == 0)
    part = problem.select(observations=usable).problem
    if not part.num_observations:
        return
    found = linearize(part, options.cheirality)
    sigma = np.ones(1) if part.observation_sigma is None else part.observation_sigma
    residual = found.residual / sigma[:, None]
    squares = (residual**2).sum(axis=1)
    if not np.isfinite(squares).all():
        return
    losses = [(options.loss, options.loss_scale)]
    if options.loss == "trivial":
        losses += [("soft_l1", 1.0), ("cauchy", 1.0)]
    held_points = np.isin(problem.point_ids, options.fixed_point_ids)
    held_images = np.isin(problem.image_ids, options.fixed_image_ids) | bool(measured.priors)
    if problem.num_frames:
        held_images |= problem.image_frame >= 0
    for what, jacobian, group, held in (
        ("points", found.d_point, part.observation_point, held_points),
        ("poses", found.d_pose, part.observation_image, held_images),
    ):
        rows = np.flatnonzero(~held[group])
        if what not in options.refine or not len(rows):
            continue
        rows = rows[np.argsort(group[rows], kind="stable")]
        starts = np.flatnonzero(np.diff(group[rows], prepend=-1))
        scaled = jacobian[rows] / (sigma if len(sigma) == 1 else sigma[rows])[:, None, None]
        decreases = [
            _decrease(residual[rows], scaled, starts, evaluate_loss(*loss, squares[rows])[:, 1])
            for loss in losses
        ]
        yield what, min(scaled.shape[2] * len(starts) / (2.0 * len(rows)), 0.99), decreases


def _decrease(
    residual: Floats, jacobian: Floats, starts: NDArray[np.int64], weight: Floats
) -> float:
    """Return the relative decrease of sum w ||r||^2 by one step of each group of rows."""
    total = float((weight * (residual**2).sum(axis=1)).sum())
    weighted = jacobian * weight[:, None, None]
    normal = np.add.reduceat(np.swapaxes(weighted, 1, 2) @ jacobian, starts)
    gradient = np.add.reduceat((weighted * residual[:, :, None]).sum(axis=1), starts)
    norm = np.sqrt(np.einsum("nii->ni", normal))
    norm[~(norm > 0)] = 1.0
    scaled = normal / norm[:, :, None] / norm[:, None, :]
    # Directions without effect, as depth without parallax, are removed from the step by damping.
    damped = scaled + 1e-9 * np.eye(scaled.shape[1])
    step = np.linalg.solve(damped, (gradient / norm)[:, :, None])[:, :, 0]
    decrease = float((step * gradient / norm).sum())
    return decrease / total if total > 0 else 0.0
