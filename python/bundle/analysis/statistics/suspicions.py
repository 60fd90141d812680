"""Possible errors of a problem: one function per check, one sentence per finding.

The radial part of SIMPLE_RADIAL, RADIAL and OPENCV maps the undistorted radius r to ``r (1 + k1 r^2
+ k2 r^4)``. It folds at the first zero of its derivative ``1 + 3 k1 s + 5 k2 s^2``, s = r^2: ``s =
2 / (-3 k1 + sqrt(9 k1^2 - 20 k2))`` if that is a positive number. No image point lies beyond the
distorted radius reached there. Folds of other models are not computed.

A lens that does not fold before the farthest observation, at the distorted radius R, stretches its
radius by more than t if R / t is already distorted beyond R: ``k1 s + k2 s^2 > t - 1``, s = (R /
t)^2.

Depths of observed points in their cameras, and points collapsed onto a camera.

A rotation that its observations leave open. Let all other images and the lenses be known; then the
standard deviation of a pose is a lower bound. With the derivatives J of an observation w.r.t. the
pose, K w.r.t. its point, and V the sum of K^T K over all observations of the point, the pose has

    S = sum J^T J - J^T K V^-1 K^T J,

and its rotation, with the translation free, the Schur complement of that block of S. For noise of
one pixel the finding needs 0.3 rad: angles of this size are not linear any more. It is computed for
images whose observations are fewer than 15, or so close together that a rotation and a movement
differ by little: with the standard deviation s of their narrower direction, the difference is about
s^2 / f pixels per radian, and must be below 20 / sqrt(n).

A depth is the third coordinate of R X + t, in the reconstruction's length unit. A solve can pull
points onto a projection centre, where any direction fits. Their depths are then many orders of
magnitude smaller than others, and their derivatives larger by the same factor.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.track_table import Covisibility
from bundle.base.arrays import median
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.interface.finding import Finding
from bundle.model.cameras import camera_models, param_kinds
from bundle.model.problem import Problem
from bundle.model.residuals import linearize
from bundle.model.unobserved import unobserved

FEW_OBSERVATIONS = 10
"""Number of observations below which the pose of an image is poorly determined."""
GROSS_ERROR_PIXELS, GROSS_ERROR_MEDIANS = 10.0, 20.0
"""Limits in pixels and in multiples of the median error; gross errors exceed both."""
FAR_POINT = 1000.0
"""Multiple of the median distance from the middle of the scene, beyond which a point is far."""
FAR_SCENE = 1e5  # multiple of the size of a scene, beyond which it is far from the origin
FOCAL_RATIO = 0.1, 10.0
"""Plausible focal lengths in image sizes: COLMAP's min_ and max_focal_length_ratio."""
QUATERNION_TOLERANCE = 1e-6
PROBLEMS = ("collapsed_points", "unsupported_camera_models")
"""Kinds with which a model is not a reconstruction."""
FEW_FOR_POSE, SMALL_DIFFERENCE, MOST_LOOSE = 15, 20.0, 20
LARGEST = 1e50  # derivatives beyond this limit, whose products would overflow, are ignored
OPEN_ROTATION = 0.3
"""Standard deviation [rad], for noise of 1 px, above which a rotation counts as undetermined."""
UNUSABLE = 0.01
"""Share of observations with collapsed points above which a refined model is unusable."""
NAMED = 5  # number of ids in a sentence


def suspicions(
    problem: Problem,
    graph: Covisibility,
    errors: NDArray[np.float64] | None,
    behind: NDArray[np.bool_],
    depths: NDArray[np.float64],
) -> tuple[Finding, ...]:
    """Return the possible errors, most severe first.

    ``errors``: (num_observations,) reprojection errors in pixels; None if unavailable. ``behind``:
    (num_observations,) mask of points behind the camera. ``depths``: (num_observations,) depths of
    the points in their cameras.
    """
    return (
        *_empty(problem),
        *_models(problem),
        *_images(problem, graph),
        *_lenses(problem, lenses(problem)),
        *_quaternions(problem),
        *_collapsed(problem, depths),
        *_observations(problem, errors, behind),
        *_points(problem),
        *_positions(problem),
        *_unused_cameras(problem),
    )


def broken_parts(problem: Problem, held: Container[int | str] = ()) -> tuple[Finding, ...]:
    """Return parts with which a refined model is unusable, whatever its residuals.

    ``held``: ids or names of images whose poses are not determined by observations alone.
    """
    lens = lenses(problem)
    return (
        *_lenses(problem, lens),
        *_collapsed(problem, depths_of_observations(problem), UNUSABLE),
        *_rotations(problem, lens, held),
    )


def _empty(problem: Problem) -> Iterator[Finding]:
    sentence = unobserved(problem)
    if sentence:
        yield Finding(kind="no_observations", sentence=sentence, is_problem=True)


def _models(problem: Problem) -> Iterator[Finding]:
    unknown = np.array([model not in camera_models() for model in problem.camera_models], bool)
    names = ", ".join(sorted({problem.camera_models[i] for i in np.flatnonzero(unknown)}))
    what = f"a model that cannot be refined yet ({names})"
    yield from _where(problem, ("unsupported_camera_models", "camera", unknown, "has", what))


def _images(problem: Problem, graph: Covisibility) -> Iterator[Finding]:
    observations = np.bincount(problem.observation_image, minlength=problem.num_images)
    empty = observations == 0
    few = ~empty & (observations < FEW_OBSERVATIONS)
    names = Counter(name for name in problem.image_names if name)
    twice = np.array([names[name] > 1 for name in problem.image_names], bool)
    poor = f"fewer than {FEW_OBSERVATIONS} observations"
    none = "no observation: the pose is undetermined"
    same = "the name of another image: names do not identify images"
    yield from _where(
        problem,
        ("images_without_observations", "image", empty, "has", none),
        ("images_with_few_observations", "image", few, "has", poor),
        ("images_of_one_name", "image", twice, "has", same),
    )
    if len(graph.component_sizes) > 1:
        sizes = ", ".join(map(str, graph.component_sizes[:NAMED]))
        more = ", ..." if len(graph.component_sizes) > NAMED else ""
        apart = problem.image_ids[graph.component > 0]
        yield Finding(
            kind="disconnected",
            evidence=_evidence(len(graph.component_sizes), "image", apart),
            sentence=(
                f"The images form {len(graph.component_sizes)} components without common points "
                f"(of {sizes}{more} images): their relative position and scale are arbitrary."
            ),
        )


def _lenses(problem: Problem, lens: Lens) -> Iterator[Finding]:
    low, high = FOCAL_RATIO
    with np.errstate(invalid="ignore", divide="ignore"):
        absurd = (lens.focal < low * lens.size) | (lens.focal > high * lens.size)
        folded = lens.farthest > lens.fold
    size = f"a focal length below {low:g} or above {high:g} image sizes"
    fold = (
        "a radial distortion that folds back inside the image: no point projects to its outer "
        "observations"
    )
    stretch = "a radial distortion that moves its outer observations by more than half their radius"
    yield from _where(
        problem,
        ("absurd_focal_lengths", "camera", absurd, "has", size),
        ("folding_distortion", "camera", folded, "has", fold),
        ("absurd_distortion", "camera", lens.stretched, "has", stretch),
    )


def _rotations(problem: Problem, lens: Lens, held: Container[int | str]) -> Iterator[Finding]:
    image, xy = problem.observation_image, problem.observation_xy
    count = np.bincount(image, minlength=problem.num_images)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        sums = [np.bincount(image, one, problem.num_images) / count for one in (*xy.T, *(xy.T**2))]
        x, y, xx, yy = sums
        mixed = np.bincount(image, xy[:, 0] * xy[:, 1], problem.num_images) / count - x * y
        a, b = xx - x * x, yy - y * y
        narrow = (a + b) / 2 - np.hypot((a - b) / 2, mixed)
        difference = narrow / lens.focal[problem.image_camera] * np.sqrt(count)
    loose = (count > 0) & ((count < FEW_FOR_POSE) | (difference < SMALL_DIFFERENCE))
    if problem.num_frames:
        loose &= problem.image_frame < 0
    names = zip(problem.image_ids.tolist(), problem.image_names, strict=True)
    loose &= [one not in held and name not in held for one, name in names]
    chosen = np.flatnonzero(loose)
    chosen = chosen[np.argsort(difference[chosen], kind="stable")][:MOST_LOOSE]
    if not len(chosen):
        return
    seen = np.zeros(problem.num_points, bool)
    seen[problem.observation_point[np.isin(image, chosen)]] = True
    part = problem.select(points=seen, observations=seen[problem.observation_point]).problem
    found = linearize(part)
    k, point = np.where(abs(found.d_point) < LARGEST, found.d_point, 0), part.observation_point
    inverse = _sums(np.einsum("nai,naj->nij", k, k), point, part.num_points)
    inverse += (1e-12 * np.trace(inverse, axis1=1, axis2=2) + 1e-300)[:, None, None] * np.eye(3)
    own = np.flatnonzero(np.isin(part.observation_image, chosen))
    j, k = np.where(abs(found.d_pose[own]) < LARGEST, found.d_pose[own], 0), k[own]
    left = np.eye(2) - k @ np.linalg.inv(inverse)[point[own]] @ np.swapaxes(k, 1, 2)
    normal = np.swapaxes(j, 1, 2) @ left @ j
    pose = _sums(normal, part.observation_image[own], problem.num_images)
    w, wt, tt = pose[chosen, :3, :3], pose[chosen, :3, 3:], pose[chosen, 3:, 3:]
    rotation = w - wt @ np.linalg.pinv(tt, 1e-9, hermitian=True) @ np.swapaxes(wt, 1, 2)
    is_open = np.zeros(problem.num_images, bool)
    is_open[chosen] = np.linalg.eigvalsh(rotation)[:, 0] < OPEN_ROTATION**-2
    what = f"a rotation with a standard deviation above {OPEN_ROTATION:g} rad for noise of 1 px"
    yield from _where(problem, ("undetermined_poses", "image", is_open, "has", what))


def _sums(blocks: NDArray[np.float64], group: NDArray[np.int32], size: int) -> NDArray[np.float64]:
    """Return the sums of blocks (n, k, k) by group."""
    sums = np.empty((size, *blocks.shape[1:]))
    for place in np.ndindex(*blocks.shape[1:]):
        sums[:, place[0], place[1]] = np.bincount(group, blocks[:, place[0], place[1]], size)
    return sums


def _quaternions(problem: Problem) -> Iterator[Finding]:
    norm = np.linalg.norm(problem.cam_from_world[:, :4], axis=1)
    off = np.abs(norm - 1.0) > QUATERNION_TOLERANCE
    what = "a rotation quaternion that is not normalised"
    yield from _where(problem, ("quaternions_not_normalised", "image", off, "has", what))


def _observations(
    problem: Problem, errors: NDArray[np.float64] | None, behind: NDArray[np.bool_]
) -> Iterator[Finding]:
    lies = ("observation lies", "observations lie")
    has = ("observation has", "observations have")
    checks = [("observations_behind_camera", behind, lies, "behind the camera")]
    if errors is not None:
        undefined = np.isnan(errors)
        checks.append(("projections_undefined", undefined, has, "a point without a projection"))
        limit, gross = _gross(np.where(behind, np.nan, errors))
        off = f"an error of more than {limit:.0f} px"
        checks.append(("gross_errors", gross, has, off))
    size = problem.camera_sizes[problem.image_camera[problem.observation_image]]
    xy = problem.observation_xy
    outside = np.any(((xy < 0) | (xy > size)) & (size > 0), axis=1)
    checks.append(("observations_outside_image", np.asarray(outside), lies, "outside the image"))
    for kind, mask, verbs, what in checks:
        if mask.any():
            images = problem.image_ids[np.unique(problem.observation_image[mask])]
            yield _suspicion(kind, "image", images, verbs, what, count=int(mask.sum()))


def _gross(errors: NDArray[np.float64]) -> tuple[float, NDArray[np.bool_]]:
    """Return the limit and the mask of gross errors.

    NaN is not a gross error. Infinite errors are gross; the median excludes them.
    """
    known = errors[np.isfinite(errors)]
    median = float(np.median(known)) if len(known) else 0.0
    limit = max(GROSS_ERROR_PIXELS, GROSS_ERROR_MEDIANS * median)
    return limit, errors > limit


def count_repeated(problem: Problem) -> int:
    """Return the number of observations with the image and point of an earlier one."""
    size = max(problem.num_images, 1)
    code = problem.observation_point.astype(np.int64) * size + problem.observation_image
    return len(code) - len(np.unique(code))


def _collapsed(
    problem: Problem, depths: NDArray[np.float64], share: float = 0.0
) -> Iterator[Finding]:
    mask = collapsed_observations(problem, depths)
    if mask.any() and mask.mean() > share:
        points = problem.point_ids[np.unique(problem.observation_point[mask])]
        images = len(np.unique(problem.observation_image[mask]))
        yield _suspicion(
            "collapsed_points",
            "point",
            points,
            ("point has", "points have"),
            f"collapsed onto cameras: {plural(int(mask.sum()), 'observation')} in "
            f"{plural(images, 'image')} with a depth below {COLLAPSED:g} of the median",
        )


def _points(problem: Problem) -> Iterator[Finding]:
    length = np.bincount(problem.observation_point, minlength=problem.num_points)
    yield from _where(
        problem,
        ("points_not_seen", "point", length == 0, "is", "not observed by any registered image"),
        ("points_seen_once", "point", length == 1, "is", "seen only once: the depth is free"),
    )


def _positions(problem: Problem) -> Iterator[Finding]:
    if problem.num_points == 0:
        return
    middle = np.median(problem.points, axis=0)
    distance = np.linalg.norm(problem.points - middle, axis=1)
    size = float(np.median(distance))
    far = distance > FAR_POINT * size
    what = f"more than {FAR_POINT:g} times the size of the scene away from it"
    yield from _where(problem, ("far_points", "point", far & (size > 0), "lies", what))
    offset = float(np.linalg.norm(middle))
    if offset > FAR_SCENE * size > 0:
        yield Finding(
            kind="far_from_origin",
            evidence={"offset": offset, "size": size},
            sentence=f"The scene lies {offset:.3g} units from the origin but measures only "
            f"{size:.3g}: digits are lost; subtract an offset.",
        )


def _unused_cameras(problem: Problem) -> Iterator[Finding]:
    unused = np.bincount(problem.image_camera, minlength=problem.num_cameras) == 0
    what = "used by no registered image"
    yield from _where(problem, ("unused_cameras", "camera", unused, "is", what))


_PLURAL = {"has": "have", "is": "are", "lies": "lie"}


def _where(
    problem: Problem, *checks: tuple[str, str, NDArray[np.bool_], str, str]
) -> Iterator[Finding]:
    """Yield a finding for each check with a true flag: kind, entity, flags, verb, words."""
    for kind, of, flags, verb, what in checks:
        if flags.any():
            verbs = (f"{of} {verb}", f"{of}s {_PLURAL[verb]}")
            yield _suspicion(kind, of, getattr(problem, f"{of}_ids")[flags], verbs, what)


def _suspicion(
    kind: str,
    of: str,
    ids: NDArray[np.int64],
    verbs: tuple[str, str],
    what: str,
    *,
    count: int | None = None,
) -> Finding:
    """Return text such as "3 images have no observation (images 4, 7, 9)."; `ids` are all ids."""
    total = len(ids) if count is None else count
    named = ids[:NAMED].tolist()
    noun = of if len(ids) == 1 else f"{of}s"
    listed = ", ".join(map(str, named)) + (", ..." if len(ids) > len(named) else "")
    sentence = f"{total} {verbs[total != 1]} {what} ({noun} {listed})."
    return Finding(
        kind=kind, sentence=sentence, evidence=_evidence(total, of, ids),
        is_problem=kind in PROBLEMS,
    )  # fmt: skip


def _evidence(count: int, of: str, ids: NDArray[np.int64]) -> dict[str, Any]:
    """Return the number of occurrences, the noun of the ids, and the first ids."""
    return {"count": count, "of": of, "ids": ids[:NAMED].tolist()}


# Columns of k1 and of k2, if any, for models with this radial part.
_COEFFICIENTS = {"SIMPLE_RADIAL": (3, None), "RADIAL": (3, 4), "OPENCV": (4, 5)}

STRETCH = 2.0
"""Factor on the radius of the farthest observation, beyond which a distortion is absurd."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Lens:
    """Values per camera.

    Every array is (num_cameras,), NaN if unknown.
    """

    focal: NDArray[np.float64]  # focal length in pixels, the mean of two
    # longer side of the image in pixels; if not recorded, twice the distance of the farthest
    # observation from the principal point along an axis
    size: NDArray[np.float64]
    farthest: NDArray[np.float64]  # distorted radius of the farthest observation, in focal lengths
    # distorted radius at which the distortion folds, in focal lengths; infinite if never
    fold: NDArray[np.float64]
    # True if the distortion does not fold before the farthest observation, and more than doubles
    # its radius
    stretched: NDArray[np.bool_]


def lenses(problem: Problem) -> Lens:
    """Return the values of every camera of a problem."""
    focal, fold = np.full((2, problem.num_cameras), np.nan)
    radial = np.zeros((2, problem.num_cameras))
    centre = np.full((problem.num_cameras, 2), np.nan)
    models = np.array(problem.camera_models, dtype=str)
    for model in set(problem.camera_models) & set(camera_models()):
        members = models == model
        params = problem.camera_params[members]
        kinds = np.array(param_kinds(model) + ("",) * (params.shape[1] - len(param_kinds(model))))
        if "focal" in kinds:  # a panorama has no focal length and no principal point
            focal[members] = params[:, kinds == "focal"].mean(1)
            centre[members] = params[:, kinds == "principal_point"]
        fold[members] = np.inf
        if model in _COEFFICIENTS:
            first, second = _COEFFICIENTS[model]
            k2 = np.zeros(len(params)) if second is None else params[:, second]
            fold[members] = fold_radius(params[:, first], k2)
            radial[:, members] = params[:, first], k2

    camera = problem.image_camera[problem.observation_image]
    offset = np.abs(problem.observation_xy - centre[camera])
    reach = _largest(camera, offset.max(axis=1, initial=0.0), problem.num_cameras)
    radius = _largest(camera, np.hypot(offset[:, 0], offset[:, 1]), problem.num_cameras)
    recorded = problem.camera_sizes.max(axis=1, initial=0).astype(np.float64)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        square = (radius / focal / STRETCH) ** 2
        gain = (radial[0] + radial[1] * square) * square
        return Lens(
            focal=focal,
            size=np.where(recorded > 0, recorded, 2.0 * reach),
            farthest=radius / focal,
            fold=fold,
            stretched=~(radius / focal > fold) & (gain > STRETCH - 1.0),
        )


def fold_radius(k1: NDArray[np.float64], k2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the largest distorted radius in focal lengths; infinite without a fold."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        root = np.sqrt(9.0 * k1**2 - 20.0 * k2)
        # Both forms give the same number; the second loses no digits for k1 > 0.
        divisor = np.where(k1 > 0, -20.0 * k2 / (3.0 * k1 + root), root - 3.0 * k1)
        square = np.where(divisor > 0, 2.0 / divisor, np.inf)
        radius = np.sqrt(square) * (1.0 + k1 * square + k2 * square**2)
    return np.where(np.isfinite(square), radius, np.inf)


def _largest(
    group: NDArray[np.int32], values: NDArray[np.float64], size: int
) -> NDArray[np.float64]:
    """Return the largest value of each group, NaN for an empty one."""
    largest = np.full(size, -np.inf)
    known = ~np.isnan(values)
    np.maximum.at(largest, group[known], values[known])
    return np.where(np.isneginf(largest), np.nan, largest)


COLLAPSED = 1e-4  # share of the median below which a depth is not determined by images


@dataclass(frozen=True, kw_only=True)
class Depths:
    """Depths over all observations; every number is NaN without observations."""

    min: float  # smallest depth, negative for a point behind its camera
    p5: float  # 5th percentile
    median: float  # 50th percentile
    p95: float  # 95th percentile
    max: float  # largest depth
    num_behind: int  # observations with a depth of at most zero
    num_collapsed: int  # observations with an absolute depth below 1e-4 of the median


def depths_of_observations(problem: Problem) -> NDArray[np.float64]:
    """Return the depth of each observation's point, (num_observations,)."""
    x, y, z, w = problem.cam_from_world[:, :4].T
    # Third row of the rotation for a quaternion of any norm.
    row = np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), w * w + z * z - x * x - y * y])
    row /= (problem.cam_from_world[:, :4] ** 2).sum(axis=1, keepdims=True)
    image = problem.observation_image
    across = np.einsum("ij,ij->i", row[image], problem.points[problem.observation_point])
    depths: NDArray[np.float64] = across + problem.cam_from_world[image, 6]
    return depths


def summarize(depths: NDArray[np.float64]) -> Depths:
    """Return the statistics of depths."""
    if not len(depths):
        nan = float("nan")
        return Depths(min=nan, p5=nan, median=nan, p95=nan, max=nan, num_behind=0, num_collapsed=0)
    low, p5, median, p95, high = np.quantile(depths, [0, 0.05, 0.5, 0.95, 1])
    return Depths(
        min=float(low),
        p5=float(p5),
        median=float(median),
        p95=float(p95),
        max=float(high),
        num_behind=int((depths <= 0).sum()),
        num_collapsed=int((np.abs(depths) < COLLAPSED * median).sum()),
    )


def collapsed_observations(problem: Problem, depths: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the mask (num_observations,) of observations of points collapsed onto their camera.

    A wide lens also observes distant points at a depth of zero, so the distance must be as small.
    """
    near: NDArray[np.bool_] = np.zeros(len(depths), bool)
    if not len(depths):
        return near
    chosen = np.flatnonzero(np.abs(depths) < COLLAPSED * median(depths))
    centers = problem.projection_centers[problem.observation_image]
    distance = np.linalg.norm(problem.points[problem.observation_point] - centers, axis=1)
    near[chosen] = distance[chosen] < COLLAPSED * median(distance)
    return near
