r"""Focal lengths of many cameras: equal, drifting, or not determined.

Given the covariance of the intrinsics with the scale sigma0, camera i has the mean focal length
f_i and its standard deviation s_i. Cameras of one model and size belong to a group.

Not determined. A focal length with s_i > 0.05 f_i (the worse of fx and fy), for the noise of the
inliers, changes the shape of a scene without changing the residuals much. For a group of several
cameras, the command shares the lens, because all views together determine it. For a single camera,
or if the lenses are known to differ (T below), it adds a prior of 2 % if the start is near.

Free twists. The rotation (a, 0, 0) per image height moves the row y by f a y, as a focal length fy
(1 + a) does, so that a rolling shutter determines lenses by higher terms only, in a long, curved
valley. The command that adds a shutter also adds the prior where images then say less than it
does, s_i > 0.02 f_i, and where all focal lengths of a group are within two standard deviations of
those at the start, that of the prior included: a prior must not hold a wrong start.

Shared. All focal lengths and distortion parameters theta of a group of m cameras are tested
together. With the covariance C of all of them, the contrasts D theta to the first camera have

    T = (D theta)^T (D C D^T)^-1 (D theta),

chi^2 of d = (m - 1) q degrees of freedom if the cameras have one lens with q parameters. Blocks of
C are not sufficient: neighbours see the same points, so their errors are correlated, and f absorbs
a difference of distortion. Significance alone does not decide: one lens for lenses that differ a
little costs less accuracy than a lens per image. On 1000 seeded flights and orbits, one lens gave
the smaller error of positions where T < 4 d, a lens per image where T > 4 d. Below 2 d the finding
advises to share the lens; up to 4 d it reports a difference and advises held-out observations.
Undetermined focal lengths, and those that drift by half of the limit below, are not compared.
If distortion is a ratio of polynomials, many coefficients make nearly the same lens, along curves
that leave their ellipsoids C (T / d of 6 and 12 for equal lenses). There T is the ratio of
likelihoods, twice the cost that a solve with one lens adds, over the variance (0.9 and 1.2).

Drift. In the weighted regression f_i = a + b t_i on the order t of the images, from -1 to 1, the
gain b^2 / var b must exceed 30, and 30 times the Q / d that is left, and the change 2 b must be 2 %
of f. If the model has a weak joint, whose parts have errors of their own, all limits of Q are 3
times as high, except that of the advice to share: lenses that drift would bend the parts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import distinct, median, rows_among
from bundle.base.records import dataclass
from bundle.base.tails import chi2_tail
from bundle.base.words import named, noun, number, plural
from bundle.errors import InputError
from bundle.interface.finding import Finding
from bundle.judging.findings.measured import Measured, newton_step
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.repaired import MOST_STEPS, TOLERANCE, is_affordable, solved
from bundle.model.cameras import camera_models, param_kinds
from bundle.model.problem import Problem
from bundle.model.residuals import errors_or_nan, summarize_clipped

if TYPE_CHECKING:
    from bundle.solving.result import Result

UNDETERMINED, PRIOR = 0.05, 0.02
EQUAL, PAYS = 2.0, 4.0
RATIOS = ("FULL_OPENCV",)  # models whose distortion is a ratio of polynomials
MOST_FUNCTIONS = 600
"""Parameters of a group whose joint covariance takes at most as long as a few steps."""
DRIFT, DRIFT_STATISTIC = 0.02, 30.0
JOINTED = 3.0
FEWEST_CAMERAS = 2
FEWEST_IN_ORDER = 6
WORSE = 1.01  # rise of the errors of other images by a lens of some

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FocalLengths:
    """Focal lengths of the cameras of one model and size, in the order of their images."""

    cameras: NDArray[np.int64]  # (m,) indices of the cameras
    focal: Floats  # (m,) focal lengths [px], means over x and y
    sigma: Floats  # (m,) their standard deviations
    distortion: float  # largest Q / d over the distortion parameters; 0 without any
    relative_sigma: Floats  # (m,) those of f, fx or fy, over it: the largest, for inliers' noise
    order: Floats  # (m,) order of the images of the cameras, from -1 to 1
    is_covered: bool  # True if the group has all observed cameras of the model

    @property
    def is_determined(self) -> bool:
        """True if the focal lengths of all cameras are determined."""
        return bool((self.relative_sigma <= UNDETERMINED).all())

    @property
    def statistic(self) -> float:
        """Q, the weighted sum of squares about the weighted mean."""
        return _statistic(self.focal, self.sigma)


Groups = Sequence[FocalLengths]


def undetermined_intrinsics(
    measured: Measured, groups: Groups, limit: float = UNDETERMINED
) -> Finding | None:
    """Return the finding about focal lengths that are not determined, or None."""
    worst = max(groups, key=lambda one: int((one.relative_sigma > limit).sum()), default=None)
    if worst is None or not (worst.relative_sigma > limit).any():
        return None
    rows = np.flatnonzero(worst.relative_sigma > limit)
    cameras = measured.whole.camera_ids[worst.cameras[rows]]
    relative = worst.relative_sigma[rows]
    joint = joint_statistic(measured, worst) if len(worst.cameras) > 1 else None
    shares = len(worst.cameras) > 1 and (joint is None or joint[0] < PAYS * joint[1])
    flags = _sharing(measured.whole, worst)
    if not shares:
        chosen = noun(len(rows), "camera", "cameras") + " " + ",".join(map(str, cameras.tolist()))
        flags = ("--set", f"{chosen}: f prior {100 * PRIOR:g} %")
    is_held = shares or is_near(measured, worst)
    return Finding(
        kind="undetermined_intrinsics",
        sentence=f"The focal length is not determined in {plural(len(rows), 'camera')} "
        f"({named('camera', cameras.tolist())}): its standard deviation is "
        f"{100 * median(relative):.0f} % of it. "
        f"{'Share the lens' if shares else 'Add a prior'}, or fix it.",
        command=measured.command.refine(*flags) if is_held else "",
        evidence={
            "camera_ids": cameras.tolist(),
            "relative_sigma": relative.tolist(),
            "spread": float(np.std(worst.focal) / np.mean(worst.focal)),
        },
    )


def is_near(measured: Measured, group: FocalLengths) -> bool:
    """Return True if priors at the start agree with the focal lengths of a group."""
    models = measured.whole, measured.start or measured.whole
    columns = _columns(models[0].camera_models[int(group.cameras[0])], ("focal",))
    found, given = (one.camera_params[group.cameras][:, columns] for one in models)
    moved = np.abs(found / given - 1.0).max(axis=1)
    return bool((moved <= 2.0 * np.hypot(PRIOR, group.relative_sigma)).all())


def shared_lens(measured: Measured, groups: Groups, *, is_jointed: bool = False) -> Finding | None:
    """Return the finding about cameras that have one lens, or None."""
    factor = JOINTED if is_jointed else 1.0
    for group in sorted(groups, key=lambda one: -len(one.cameras)):
        if not (
            len(group.cameras) >= FEWEST_CAMERAS
            and group.is_determined
            and _drift(group, DRIFT_STATISTIC / 2 * factor) is None
        ):
            continue
        joint = joint_statistic(measured, group)
        if joint is not None and joint[0] < PAYS * factor * joint[1]:
            return _shared(measured, group, joint, is_equal=joint[0] < EQUAL * joint[1])
    return None


def _shared(
    measured: Measured, group: FocalLengths, joint: tuple[float, int], *, is_equal: bool
) -> Finding | None:
    problem = measured.whole
    ids = problem.camera_ids[group.cameras].tolist()
    mean, (statistic, degrees) = _mean(group.focal, group.sigma), joint
    p = chi2_tail(statistic, degrees)
    lens = f"{plural(len(ids), 'camera')} of one model and size"
    test = f"chi2 / dof {statistic / degrees:.2f} over focal lengths and distortion"
    if is_equal:
        sentence = (
            f"{lens} have the same lens within their standard deviations ({test}; focal length "
            f"{number(mean)} px, median standard deviation {number(median(group.sigma))} px): "
            "share the lens."
        )
        command = measured.command.refine(*_sharing(problem, group))
    elif _is_on_rig(problem, group):
        return None  # validate does not share sensors
    else:
        sentence = (
            f"The lenses of {lens} differ ({test}; p = {p:.1g}), but perhaps too little for "
            "separate lenses: compare them by held-out observations."
        )
        command = measured.command.other("validate")
    return Finding(
        kind="shared_lens",
        sentence=sentence,
        command=command,
        evidence={
            "camera_ids": ids,
            "focal": mean,
            "chi2": group.statistic,
            "dof": len(ids) - 1,
            "median_sigma": median(group.sigma),
            "distortion_chi2_per_dof": group.distortion,
            "joint_chi2": statistic,
            "joint_dof": degrees,
            "p": p,
        },
    )


def _sharing(problem: Problem, group: FocalLengths) -> tuple[str, str]:
    """Return the flag that shares the lens; the sensors of a rig stay cameras with tied values."""
    ids = ",".join(map(str, problem.camera_ids[group.cameras].tolist()))
    if not _is_on_rig(problem, group):
        return "--share-cameras", "all" if group.is_covered else ids
    model = problem.camera_models[int(group.cameras[0])]
    names = [camera_models()[model][column] for column in _columns(model, ("focal", "extra"))]
    return "--set", f"cameras {ids}: share {','.join(names)}"


def _is_on_rig(problem: Problem, group: FocalLengths) -> bool:
    own = np.isin(problem.image_camera, group.cameras)
    return bool(problem.num_frames and (problem.image_frame[own] >= 0).any())


def _columns(model: str, kinds: Sequence[str]) -> list[int]:
    return [k for k, kind in enumerate(param_kinds(model)) if kind in kinds]


def joint_statistic(measured: Measured, group: FocalLengths) -> tuple[float, int] | None:
    """Return T of the lenses of a group and its degrees of freedom; None if it is not computed."""
    problem = measured.whole
    free_kinds = {"focal", "extra"} & set(measured.options.refine)
    columns = _columns(problem.camera_models[int(group.cameras[0])], tuple(free_kinds))
    count, width = len(group.cameras), len(columns)
    if count * width > MOST_FUNCTIONS:
        return None
    seen = distinct(problem.observation_image)
    functions = np.zeros((count, width, problem.num_images, 6 + problem.camera_params.shape[1]))
    for row, camera in enumerate(group.cameras.tolist()):
        image = int(seen[problem.image_camera[seen] == camera][0])
        for place, column in enumerate(columns):
            functions[row, place, image, 6 + column] = 1.0
    contrasts = (functions[1:] - functions[:1]).reshape(-1, *functions.shape[2:])
    try:
        found = newton_step(problem, measured.options, contrasts)
    except InputError:  # something is not determined
        return None
    free = found["num_parameters"] - found["gauge_degrees"]
    dof = found["num_residuals"] - free
    if dof < 1 or not found["weighted_squares"] > 0:
        return None
    params = problem.camera_params[group.cameras][:, columns]
    difference = (params[1:] - params[:1]).reshape(-1)
    sigma = np.sqrt(np.diag(found["functions"]))
    if not (sigma > 0).all():  # held
        return None
    scaled = found["functions"] / np.outer(sigma, sigma)
    whitened = np.linalg.solve(scaled, difference / sigma)
    variance = found["weighted_squares"] / dof
    statistic = float(whitened @ (difference / sigma)) / variance
    is_ratio = problem.camera_models[int(group.cameras[0])] in RATIOS and is_affordable(measured)
    if is_ratio and statistic >= EQUAL * len(difference):
        with suppress(InputError):  # sensors of a rig, or a rule about one of the cameras
            statistic = min(statistic, 2.0 * _cost_of_one_lens(measured, group) / variance)
    return (statistic, len(difference)) if statistic >= 0 else None


def _cost_of_one_lens(measured: Measured, group: FocalLengths) -> float:
    """Return by how much a solve with one lens for a group ends above the cost of the model."""
    from bundle.editing.camera_sharing import share_cameras  # few models need it

    whole, priors = measured.whole, measured.priors
    options = measured.options.replace(max_num_iterations=MOST_STEPS, function_tolerance=TOLERANCE)
    shared = share_cameras(whole, whole.camera_ids[group.cameras].tolist(), keep_scale=True)
    one = solved(measured, shared, options, priors).summary.final_cost
    own = solved(measured, whole, options.replace(max_num_iterations=0), priors).summary
    return max(one - own.initial_cost, 0.0)


def local_lens(result: Result, command: NextCommand) -> tuple[Finding, ...]:
    """Return the finding about a local adjustment whose lenses other images have, too.

    Such a lens fits the named images alone. Errors of the others at constant points show it.
    """
    part, start, end = result.part, result.initial_problem, result.problem
    if part is None or part.rest is not None:
        return ()
    ids = sorted(set(part.shared_camera_ids).difference(result.options.fixed_camera_ids))
    if not ids:
        return ()
    before = rows_among(end.image_ids, start.image_ids)
    moves = (end.cam_from_world != start.cam_from_world[before]).any(axis=1)
    is_moved = np.zeros(end.num_points, bool)
    is_moved[end.observation_point[moves[end.observation_image]]] = True
    others = ~moves & np.isin(end.camera_ids[end.image_camera], ids)
    rows = others[end.observation_image] & ~is_moved[end.observation_point]
    given = end.replace(camera_params=start.camera_params)
    old, new = (summarize_clipped(errors_or_nan(one)[rows]).rmse for one in (given, end))
    if not new > WORSE * old:
        return ()
    cameras, count = named("camera", ids), int(others.sum())
    found = Finding(
        kind="local_lens",
        sentence=f"The lens of {cameras} fits the refined images alone: errors of "
        f"{plural(count, 'other image')} rose from {old:.4f} to {new:.4f} px (RMSE).",
        command=command.refine("--fix-cameras", ",".join(map(str, ids))),
        evidence={"camera_ids": ids, "num_images": count, "rmse_before": old, "rmse": new},
    )
    return (found,)


def focal_drift(measured: Measured, groups: Groups, *, is_jointed: bool = False) -> Finding | None:
    """Return the finding about focal lengths that change with the order of the images, or None."""
    for group in groups:
        drift = _drift(group, DRIFT_STATISTIC * (JOINTED if is_jointed else 1.0))
        if drift is not None and group.is_determined:
            change, gain, left = drift
            ids = measured.whole.camera_ids[group.cameras].tolist()
            return Finding(
                kind="focal_drift",
                sentence=f"The focal length drifts by {100 * change:+.1f} % over the images of "
                f"{named('camera', ids)} (zoom, focus or temperature): keep a lens per image.",
                evidence={
                    "camera_ids": ids, "change": change, "chi2": gain, "chi2_left_per_dof": left,
                },
            )  # fmt: skip
    return None


def _drift(group: FocalLengths, least: float) -> tuple[float, float, float] | None:
    """Return the relative change over the images, its chi^2, and the remaining Q / d, or None."""
    if len(group.cameras) < FEWEST_IN_ORDER:
        return None
    weight, mean = 1.0 / group.sigma**2, _mean(group.focal, group.sigma)
    time = group.order - _mean(group.order, group.sigma)
    spread = max(float((weight * time**2).sum()), 1e-300)
    slope = float((weight * time * (group.focal - mean)).sum()) / spread
    change, gain = 2.0 * slope / mean, slope**2 * spread
    left = (group.statistic - gain) / (len(group.cameras) - 2)
    return (change, gain, left) if gain > least * max(left, 1.0) and abs(change) > DRIFT else None


def focal_lengths(measured: Measured) -> Iterator[FocalLengths]:
    """Yield the groups of cameras with a covariance, the largest first."""
    if measured.known_lens_sigmas is None:
        return
    known, sigma0 = measured.known_lens_sigmas
    problem = measured.whole
    used = distinct(problem.image_camera[distinct(problem.observation_image)])
    groups: dict[tuple[str, int, int], list[int]] = {}
    for camera in used.tolist():
        width, height = problem.camera_sizes[camera].tolist()
        groups.setdefault((problem.camera_models[camera], width, height), []).append(camera)
    first = np.full(problem.num_cameras, problem.num_images)
    np.minimum.at(first, problem.image_camera, np.argsort(np.argsort(problem.image_ids)))
    for (model, _, _), cameras in sorted(groups.items(), key=lambda item: -len(item[1])):
        kinds = param_kinds(model)
        focal = [k for k, kind in enumerate(kinds) if kind == "focal"]
        rows = np.array(cameras)[np.argsort(first[cameras], kind="stable")]
        values = problem.camera_params[rows]
        sigmas = known[rows][:, : len(kinds)]
        if not focal or not (sigmas[:, focal] > 0).all():
            continue
        extra = [
            _statistic(values[:, k], sigmas[:, k]) / max(len(rows) - 1, 1)
            for k, kind in enumerate(kinds)
            if kind == "extra" and (sigmas[:, k] > 0).all()
        ]
        inliers = min(measured.scale / sigma0, 1.0) if sigma0 > 0 else 1.0
        yield FocalLengths(
            cameras=rows,
            focal=values[:, focal].mean(axis=1),
            sigma=sigmas[:, focal].mean(axis=1),
            distortion=max(extra, default=0.0),
            relative_sigma=inliers * np.abs(sigmas[:, focal] / values[:, focal]).max(axis=1),
            order=np.linspace(-1.0, 1.0, len(rows)) if len(rows) > 1 else np.zeros(1),
            is_covered=len(groups) == 1,
        )


def _mean(values: Floats, sigma: Floats) -> float:
    weight = 1.0 / sigma**2
    return float((weight * values).sum() / weight.sum())


def _statistic(values: Floats, sigma: Floats) -> float:
    return float((((values - _mean(values, sigma)) / sigma) ** 2).sum())
