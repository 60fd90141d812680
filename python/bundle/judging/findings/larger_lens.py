r"""Lens model too small, although poses and points have absorbed the residuals that show it.

If all cameras have one direction, as in a flight over flat ground, poses and points can imitate a
missing term of the lens: the block bends, and hardly any residual is left (lens_terms.py).

Test. Convert the cameras to a larger model, its added terms at zero. There, one step of Newton
with all poses, points and lenses free would lower twice the cost by lambda^2 = g^T H^- g, and one
in the present model by lambda_0^2, which is zero at a minimum. With the noise s^2 that is left,

    T = (lambda^2 - lambda_0^2) / s^2,      s^2 = (r^T W r - lambda^2) / dof,

is chi^2 with as many degrees of freedom as terms were added if the present model is right: it is
the score test (C. R. Rao, 1948). Because T is a difference, the start need not be the minimum of
the pixels: it may be the minimum with measured positions, which the test leaves out, as their
sigmas may not agree with those of pixels. W are the weights of the loss.

Relevance. Even a field of 1 % of the residuals may move the cameras by many standard deviations.
The difference of the two steps moves the centre of image i by d_i, without the similarity that is
free. The finding needs p below 1e-4, T above 4 per term (below, more terms increase the position
errors, as in focal_lengths.py), and rms d above the rms standard deviation of the centres in the
larger model. On 1200 seeded scenes whose lens was right, p was below 1e-3 in one. A single step is
a lower bound of the movement.

Model. The smallest extension that passes, beginning with a single term, because unneeded terms make
the positions of flights up to nine times less accurate. T of any extension is at most that of the
largest, so that one step decides for nearly all right models.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import distinct
from bundle.base.tails import chi2_tail
from bundle.base.words import named, number, plural
from bundle.errors import InputError
from bundle.interface.finding import Finding
from bundle.interface.options import SolveOptions
from bundle.judging.findings.lens_terms import larger_models
from bundle.judging.findings.measured import SMALLEST_SCALE, Measured, newton_step
from bundle.model.cameras import camera_models
from bundle.model.lenses.exact_image import exact_params
from bundle.model.problem import Problem
from bundle.model.rigid_motions import center_jacobians, cross_matrices

SIGNIFICANT = 1e-4  # probability of so large a T if the lens model is right
LARGEST_MODELS = ("OPENCV", "OPENCV_FISHEYE")
"""Models beyond these have terms that are not determined beside each other."""
BY_TERM = 4.0
MOST_LENSES = 4
MOST_WORK = 150_000  # work (``Measured.work``) up to which a step takes milliseconds

Floats = NDArray[np.float64]


def absorbed_lens(measured: Measured, *, has_hint: bool = False) -> Finding | None:
    """Return the finding about a lens model whose missing term moved the cameras, or None.

    Many lenses are tested only with a hint: residuals that vary as motion does, or a field that is
    small, but significant.
    """
    problem = measured.whole
    names = _extensions(measured)
    has_many = len(distinct(problem.image_camera)) > MOST_LENSES
    is_exact = not measured.scale > SMALLEST_SCALE
    if is_exact or measured.work > MOST_WORK or not names or (has_many and not has_hint):
        return None
    try:
        return _found(measured, names)
    except InputError:  # something is not determined, or the sums overflow
        return None


def _extensions(measured: Measured) -> list[str]:
    """Return the larger lens models to try, the smallest first; the lenses have one model."""
    problem = measured.whole
    used = {problem.camera_models[camera] for camera in distinct(problem.image_camera).tolist()}
    names = [name for name, _ in larger_models(next(iter(used)))] if len(used) == 1 else []
    last = [k for k, name in enumerate(names) if name in LARGEST_MODELS]
    if not last or not {"poses", "extra"} <= set(measured.options.refine):
        return []
    return names[: last[0] + 1]


def explains_more(measured: Measured, other: Step) -> bool:
    """Return True if the largest lens explains the residuals better than another extension.

    By Akaike's criterion (1974): lambda^2 / s^2 minus twice the number of parameters.
    """
    names = _extensions(measured)
    step = _extended(measured, names[-1]) if names else None
    if step is None or not other.variance > 0:
        return False
    gains = [one.squared_distance - 2.0 * one.num_parameters for one in (step, other)]
    return gains[0] >= gains[1]


def _found(measured: Measured, names: list[str]) -> Finding | None:
    whole = measured.whole
    largest = _extended(measured, names[-1])
    if largest is None or not chi2_tail(largest.squared_distance, 1) < SIGNIFICANT:
        return None
    present = Step(whole, measured.options)
    for name in names:
        step = largest if name == names[-1] else _extended(measured, name)
        if step is None or step.num_parameters <= present.num_parameters:
            continue
        count = step.num_parameters - present.num_parameters
        statistic = step.squared_distance - present.decrease / step.variance
        p = chi2_tail(statistic, count)
        if not (p < SIGNIFICANT and statistic > BY_TERM * count):
            continue
        moved = math.sqrt((step.moves_beyond(present) ** 2).sum(axis=1).mean())
        sigma = step.position_sigma()
        if not moved > sigma:
            continue
        cameras = distinct(whole.image_camera)
        ids = whole.camera_ids[cameras].tolist()
        model = whole.camera_models[int(cameras[0])]
        return Finding(
            kind="lens_model",
            sentence=f"The lens model {model} of {named('camera', ids)} is too small: poses and "
            f"points have absorbed the missing terms of {name} (chi2 {number(statistic)} for "
            f"{plural(count, 'term')}). A step with {name} moves the cameras by {number(moved)} "
            f"units (rms), {number(moved / sigma)} times their standard deviation.",
            command=measured.command.refine("--camera-model", name),
            evidence={
                "camera_ids": ids,
                "model": model,
                "larger_model": name,
                "size": math.sqrt(statistic / step.num_residuals),
                "chi2": statistic,
                "dof": count,
                "p": p,
                "camera_movement": moved,
                "camera_sigma": sigma,
            },
        )
    return None


def _extended(measured: Measured, model: str) -> Step | None:
    problem = measured.whole
    width = max(problem.camera_params.shape[1], len(camera_models()[model]))
    params = np.zeros((problem.num_cameras, width))
    for camera, old in enumerate(problem.camera_models):
        given = problem.camera_params[camera, : len(camera_models()[old])]
        exact = exact_params(old, given, model)
        if exact is None:
            return None
        params[camera, : len(exact)] = exact
    models = (model,) * problem.num_cameras
    larger = problem.replace(camera_models=models, camera_params=params)
    step = Step(larger, measured.options)
    return step if step.variance > 0 else None


class Step:
    """Newton step of a model at its present values."""

    def __init__(self, problem: Problem, options: SolveOptions) -> None:
        self._given = (problem, options)
        found = newton_step(*self._given)
        self._has_gauge = found["gauge_degrees"] > 0
        self.decrease: float = 2.0 * found["predicted_decrease"]  # g^T H^- g
        self.num_residuals: int = found["num_residuals"]
        # number of free parameters, without the gauge
        self.num_parameters: int = found["num_parameters"] - found["gauge_degrees"]
        dof = self.num_residuals - self.num_parameters
        left = found["weighted_squares"] - self.decrease
        # s^2, the weighted squares per degree of freedom after the step; 0 without any
        self.variance: float = left / dof if dof > 0 and left > 0 else 0.0
        self._center_by_pose = center_jacobians(problem.cam_from_world)
        # (num_images, 3) movement of the projection centres
        self.moves: Floats = np.einsum("nij,nj->ni", self._center_by_pose, found["steps"])

    @property
    def squared_distance(self) -> float:
        """lambda^2 / s^2, the squared distance to the minimum in standard deviations."""
        return self.decrease / self.variance

    @cached_property
    def _similarities(self) -> Floats:
        """(num_images, 3, k) orthonormal movements of the centres by the free similarities."""
        centers = self._given[0].projection_centers
        offset = centers - centers.mean(axis=0)
        offset /= max(float(np.abs(offset).max(initial=0.0)), 1e-300)
        turns = cross_matrices(offset)
        ones = np.broadcast_to(np.eye(3), turns.shape)
        columns = np.concatenate([ones, turns, offset[:, :, None]], axis=2)
        basis, values, _ = np.linalg.svd(columns.reshape(-1, 7), full_matrices=False)
        kept = basis[:, (values > 1e-9 * values[0]) & self._has_gauge]
        found: Floats = kept.reshape(len(centers), 3, -1)
        return found

    def moves_beyond(self, other: Step) -> Floats:
        """Return the movement (num_images, 3) beyond that of another step, similarity removed."""
        moves, basis = self.moves - other.moves, self._similarities
        left: Floats = moves - basis @ np.einsum("nik,ni->k", basis, moves)
        return left

    def position_covariance(self) -> Floats:
        """Return the covariance (3 n, 3 n) of the centres, as position_sigma, for noise of 1."""
        size = self.moves.size
        basis = self._similarities.reshape(size, -1)
        moves = (np.eye(size) - basis @ basis.T).reshape(size, -1, 3)
        found: Floats = newton_step(*self._given, self._functions(moves))["functions"]
        return found

    def position_sigma(self) -> float:
        """Return the rms standard deviation of the centres without the free similarity.

        With P = I - U U^T, the trace of P C P is that of C minus the variances of U^T c.
        """
        by_pose, similarities = self._center_by_pose, np.moveaxis(self._similarities, 2, 0)
        found = newton_step(*self._given, self._functions(similarities), of_poses=True)
        trace = np.einsum("nij,njk,nik->", by_pose, found["poses"], by_pose)
        trace -= np.trace(found["functions"])
        return math.sqrt(max(float(trace), 0.0) / len(by_pose) * self.variance)

    def _functions(self, moves: Floats) -> Floats:
        """Return functions (m, num_images, 3) of the centres as those of poses and lenses."""
        lenses = np.zeros((*moves.shape[:2], self._given[0].camera_params.shape[1]))
        by_pose = np.einsum("kni,nij->knj", moves, self._center_by_pose)
        return np.concatenate([by_pose, lenses], axis=2)
