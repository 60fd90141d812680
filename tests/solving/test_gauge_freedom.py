"""Degrees of freedom: counted from the structure, held against the nullity of dense Jacobians."""

import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import PositionPrior, SolveOptions, _core
from bundle.solving.gauge_freedom import _nullity
from tests.rig_scenes import FIVE, STEREO, rig_problem
from tests.scenes import make_problem

PURE = ((0.1, 0.5, -0.05, 0, 0, 0), (-0.1, -0.4, 0.02, 0, 0, 0))
STEP = 1e-6


def moved(problem, frames, arms):
    """cam_from_world after left perturbations of frames (or images) and sensors, by SciPy."""
    rows = []
    for image, pose in enumerate(problem.cam_from_world):
        frame = problem.image_frame[image] if problem.num_frames else -1
        own = problem.rig_from_world[frame] if frame >= 0 else pose
        delta = frames[frame] if frame >= 0 else frames[problem.num_frames + image]
        turned = Rotation.from_rotvec(delta[:3]) * Rotation.from_quat(own[:4])
        shift = own[4:] + delta[3:]
        if frame >= 0 and problem.image_sensor[image] >= 0:
            sensor = problem.image_sensor[image]
            arm = problem.sensor_from_rig[sensor].copy()
            turn = Rotation.from_rotvec(arms[sensor][:3]) * Rotation.from_quat(arm[:4])
            turned, shift = turn * turned, turn.apply(shift) + arm[4:] + arms[sensor][3:]
        rows.append((turned, shift))
    return rows


def image_derivatives(problem):
    """(num_images, 6, unknowns of frames, images and sensors) by central differences."""
    count = problem.num_frames + problem.num_images
    blocks = count + problem.num_sensors
    result = np.zeros((problem.num_images, 6, blocks, 6))
    start = moved(problem, *np.split(np.zeros((blocks, 6)), [count]))
    frame = problem.image_frame if problem.num_frames else np.full(problem.num_images, -1)
    own = np.where(frame >= 0, frame, problem.num_frames + np.arange(problem.num_images))
    arm = np.where(frame >= 0, problem.image_sensor, -1) if problem.num_frames else frame
    # An image depends on one frame, or on itself, and on one sensor: all of them move at once.
    for moving, block in ((slice(count), own), (slice(count, None), count + arm)):
        for k in range(6):
            sides = []
            for step in (STEP, -STEP):
                delta = np.zeros((blocks, 6))
                delta[moving, k] = step
                sides.append(moved(problem, *np.split(delta, [count])))
            for image, ((r0, _), (ra, ta), (rb, tb)) in enumerate(zip(start, *sides, strict=True)):
                if moving.start is not None and arm[image] < 0:
                    continue
                back = r0.inv()
                turn = (ra * back).as_rotvec() - (rb * back).as_rotvec()
                result[image, :, block[image], k] = np.hstack([turn, ta - tb]) / (2 * STEP)
    return result.reshape(problem.num_images, 6, 6 * blocks)


def nullity(
    problem, *, fixed=(), points=(), arms=False, focal=False, priors=(), attitudes=(), distances=()
):
    """The number of singular values of the scaled Jacobian that are zero; the next one is not.

    Args:
        fixed: indices of images whose frames are held.
        points: indices of points that are held.
        arms: True, or rows of the sensors that are free.
        focal: whether the cameras' focal lengths are free.
        priors: indices of images whose position is measured.
        attitudes: (index of an image, (k, 6) rows by its left perturbation) of other priors.
        distances: (indices of points, function of their coordinates) of other priors; with points.
    """
    _, d_pose, d_params, d_point, _ = _core.linearize(
        problem, "algebraic", np.zeros((problem.num_images, 3))
    )
    through = image_derivatives(problem)
    image, point = problem.observation_image, problem.observation_point
    n = problem.num_observations
    by_pose = np.einsum("nij,njk->nik", d_pose, through[image]).reshape(2 * n, -1)
    by_point = np.zeros((n, 2, problem.num_points, 3))
    by_point[np.arange(n), :, point] = d_point
    by_point = np.delete(by_point, list(points), axis=2).reshape(2 * n, -1)
    count = problem.num_frames + problem.num_images
    held = [
        problem.image_frame[i] if problem.num_frames and problem.image_frame[i] >= 0
        else problem.num_frames + i
        for i in fixed
    ]  # fmt: skip
    free_arms = range(problem.num_sensors) if arms is True else arms or ()
    blocks = [b for b in range(count) if b not in held] + [count + s for s in free_arms]
    columns = np.concatenate([6 * b + np.arange(6) for b in blocks])
    parts = [by_pose[:, columns], by_point]
    if focal:
        by_focal = np.zeros((n, 2, problem.num_cameras))
        by_focal[np.arange(n), :, problem.image_camera[image]] = d_params[:, :, 0]
        parts.append(by_focal.reshape(2 * n, -1))
    jacobian = np.hstack(parts)
    for i in priors:  # C = -R^T t: the rows are R^T (tau + t x phi), up to the sign
        rotation = Rotation.from_quat(problem.cam_from_world[i, :4]).as_matrix()
        t = problem.cam_from_world[i, 4:]
        local = np.hstack([np.cross(t, np.eye(3)).T, np.eye(3)])
        rows = np.zeros((3, jacobian.shape[1]))
        rows[:, : len(columns)] = (rotation.T @ local @ through[i])[:, columns] * 500
        jacobian = np.vstack([jacobian, rows])
    for i, by_local in attitudes:
        rows = np.zeros((len(by_local), jacobian.shape[1]))
        rows[:, : len(columns)] = (by_local @ through[i])[:, columns] * 500
        jacobian = np.vstack([jacobian, rows])
    for of, function in distances:
        shifts = STEP * np.eye(3 * len(of)).reshape(-1, len(of), 3)
        there = problem.points[list(of)]
        columns = [(function(there + d) - function(there - d)) / (2 * STEP) for d in shifts]
        rows = np.zeros((len(columns[0]), jacobian.shape[1]))
        first = jacobian.shape[1] - by_point.shape[1]
        rows[:, first + (3 * np.array(of)[:, None] + np.arange(3)).ravel()] = np.transpose(columns)
        jacobian = np.vstack([jacobian, 500 * rows])
    norms = np.linalg.norm(jacobian, axis=0)
    used = norms > 1e-6 * norms.max()  # unknowns that no observation touches are no unknowns
    values = np.linalg.svd(jacobian[:, used] / norms[used], compute_uv=False)
    values = np.pad(values, (0, int(used.sum()) - len(values)))
    zero = values < 1e-8
    assert values[~zero].min() > 1e-6, values[-14:]
    return int(zero.sum())


def only(problem, keep):
    """The problem with the observations for which `keep(image, point)` holds."""
    kept = np.array(
        [
            keep(i, p)
            for i, p in zip(problem.observation_image, problem.observation_point, strict=True)
        ]
    )
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    return problem.replace(**{name: getattr(problem, name)[kept] for name in names})


def two_halves(problem):
    """Images of the second half of the frames see the second half of the points alone."""
    half = problem.num_points // 2
    frame = problem.image_frame
    return only(problem, lambda i, p: (p < half) == (frame[i] < problem.num_frames / 2))


def sensors_apart(problem):
    """Each sensor sees points of its own."""
    third = problem.num_points // 2
    return only(problem, lambda i, p: (p < third) == (problem.image_sensor[i] < 0))


def flat(problem):
    points = problem.points.copy()
    points[:, 2] = 0
    return problem.replace(points=points)


def in_a_row(problem, count):
    """Images of which the first `count` stand on a line."""
    poses = problem.cam_from_world.copy()
    for k in range(count):
        rotation = Rotation.from_quat(poses[k, :4])
        poses[k, 4:] = -rotation.apply([0.5 * k, 0.2 * k, -4 + 0.1 * k])
    return problem.replace(cam_from_world=poses)


def mono(**settings):
    return make_problem(num_images=5, num_points=24, model="PINHOLE", noise=0, **settings)


def rigs(*kinds, **settings):
    return rig_problem(rigs=kinds, **{"num_frames": 3, "num_points": 16, "noise": 0} | settings)


def alternating():
    """A sensor each frame: no frame has two images."""
    missing = {(0, f, s) for f in range(6) for s in (0, 1) if f % 2 == s}
    return rig_problem(num_frames=6, num_points=16, noise=0, missing=missing)


def without_reference(arms):
    return rigs(arms, missing={(0, f, 0) for f in range(3)})


# Problem, what is free beside poses and points, the number of degrees.
CASES = {
    "monocular": (mono(), {}, 7),
    "monocular, shared focal length": (mono(shared=True), {"focal": True}, 7),
    "one image fixed": (mono(), {"fixed": (1,)}, 1),
    "two images fixed": (mono(), {"fixed": (1, 3)}, 0),
    "one point fixed": (mono(), {"points": (3,)}, 4),
    "two points fixed": (mono(), {"points": (3, 5)}, 1),
    "three points fixed": (mono(), {"points": (3, 5, 6)}, 0),
    "image and point fixed": (mono(), {"points": (3,), "fixed": (0,)}, 0),
    "plane": (flat(mono()), {}, 7),
    "one position": (mono(), {"priors": (2,)}, 4),
    "two positions": (mono(), {"priors": (0, 3)}, 1),
    "three positions": (mono(), {"priors": (0, 2, 4)}, 0),
    "three positions in a row": (in_a_row(mono(), 3), {"priors": (0, 1, 2)}, 1),
    "stereo": (rigs(STEREO), {}, 6),
    "stereo refined": (rigs(STEREO), {"arms": True}, 7),
    "stereo, shared focal length": (
        rigs(STEREO, num_alone=1).replace(),
        {"focal": True},
        6,
    ),
    "stereo, one frame fixed": (rigs(STEREO), {"fixed": (2,)}, 0),
    "stereo refined, one frame fixed": (rigs(STEREO), {"fixed": (2,), "arms": True}, 1),
    "stereo, one position": (rigs(STEREO), {"priors": (0,)}, 3),
    "stereo, two positions of a frame": (rigs(STEREO), {"priors": (2, 3)}, 1),
    "stereo refined, three positions": (rigs(STEREO), {"priors": (0, 3, 4), "arms": True}, 0),
    "stereo, plane": (flat(rigs(STEREO)), {}, 6),
    "five sensors": (rigs(FIVE), {}, 6),
    "five sensors, one held": (rigs(FIVE), {"arms": (0, 1, 3)}, 6),
    "pure rotation": (rigs(PURE), {}, 7),
    "pure rotation refined": (rigs(PURE), {"arms": True}, 7),
    "two rigs": (rigs(STEREO, FIVE[:2]), {}, 6),
    "two rigs, one refined": (rigs(STEREO, FIVE[:2]), {"arms": (1, 2)}, 6),
    "two rigs refined": (rigs(STEREO, FIVE[:2]), {"arms": True}, 7),
    "a rig and images alone": (rigs(STEREO, num_alone=2), {}, 6),
    "a rig of pure rotation and images alone": (rigs(PURE, num_alone=2), {}, 7),
    "two pieces": (two_halves(rigs(STEREO, num_points=32)), {}, 12),
    "two pieces, refined": (two_halves(rigs(STEREO, num_points=32)), {"arms": True}, 13),
    "sensors without common points": (sensors_apart(rigs(STEREO, num_points=32)), {}, 6),
    "the same, refined": (sensors_apart(rigs(STEREO, num_points=32)), {"arms": True}, 7),
    "no frame with two images": (alternating(), {}, 7),
    "the same, sensors refined": (alternating(), {"arms": True}, 13),
    "the same, three positions on sensors": (alternating(), {"arms": True, "priors": (0, 2, 4)}, 6),
    "no reference images": (without_reference(FIVE[:2]), {}, 6),
    "no reference images, one sensor": (without_reference(STEREO), {}, 7),
}  # fmt: skip


def options(problem, what):
    refine = ("poses", "points", *(("focal",) if what.get("focal") else ()))
    arms = what.get("arms", False)
    pairs = list(zip(problem.sensor_rig_ids, problem.sensor_camera_ids, strict=True))
    held = () if arms is True or not arms else [p for s, p in enumerate(pairs) if s not in arms]
    return SolveOptions(
        refine=refine,
        fixed_image_ids=problem.image_ids[list(what.get("fixed", ()))],
        fixed_point_ids=problem.point_ids[list(what.get("points", ()))],
        refine_sensor_from_rig=bool(arms),
        fixed_sensors=held,
    )


@pytest.mark.parametrize("case", CASES)
def test_counts_are_nullities(case):
    problem, what, degrees = CASES[case]
    found = nullity(problem, **what)
    priors = [
        PositionPrior(int(problem.image_ids[i]), problem.projection_centers[i] + 0.1, 0.01)
        for i in what.get("priors", ())
    ]
    counted = bundle.gauge_freedom(problem, options(problem, what), priors=priors)
    assert counted.degrees == found
    assert counted.degrees == degrees


def from_plane(normal):
    """Distances of points from a plane through the origin."""
    return lambda points: points @ np.array(normal, float) / np.linalg.norm(normal)


def from_best_plane(points):
    """Distances from the plane with the least sum of squares, by its normal equations."""
    moved = points - points.mean(axis=0)
    return moved @ np.linalg.eigh(moved.T @ moved)[1][:, 0] * np.sign(moved[0, 0] - moved[1, 0])


def from_mean_height(points):
    return points[:, 2] - points[:, 2].mean()


BY_ROTATION = np.hstack([np.eye(3), np.zeros((3, 3))])
# Rules of a scene whose points have z = 0, and what they hold: (rules, of nullity, degrees).
RULES = {
    "focal length": (["cameras *: f prior 2 %"], {}, 7),
    "positions": (["images 1,3,4: position prior sigma 0.1"], {"priors": (0, 2, 3)}, 0),
    "one position and a rotation": (
        ["image 2: position prior sigma 9", "image 3: rotation prior sigma 0.1"],
        {"priors": (1,), "attitudes": [(2, BY_ROTATION)]},
        1,
    ),
    "constant rotation": (["image 2: rotation fixed"], {"attitudes": [(1, BY_ROTATION)]}, 4),
    "constant position": (["image 2: position fixed"], {"priors": (1,)}, 4),
    "constant pose": (["image 2: rotation,position fixed"], {"fixed": (1,)}, 1),
    "points": (
        ["points 2,5: position prior sigma 0.1"],
        {"distances": [((k,), np.ravel) for k in (1, 4)]},
        1,
    ),
    "constant points": (["points 4,6,7: position fixed"], {"points": (3, 5, 6)}, 0),
    "plane": (
        ["points 1-9: on plane 0 0 2 0 sigma 0.1"],
        {"distances": [(range(9), from_plane([0, 0, 1]))]},
        4,
    ),
    "two planes and a point": (
        [
            "points 1-9: on plane 0 0 2 0 sigma 0.1",
            "points 1,2: on plane 1 0 0 0 sigma 0.1",
            "point 1: position prior sigma 1",
        ],
        {
            "distances": [
                (range(9), from_plane([0, 0, 1])),
                ((0, 1), from_plane([1, 0, 0])),
                ((0,), np.ravel),
            ]
        },
        1,
    ),
    "unknown plane": (
        ["points 1-9: on plane sigma 0.1"],
        {"distances": [(range(9), from_best_plane)]},
        7,
    ),
    "level plane": (
        ["points 1-9: on level plane sigma 0.1"],
        {"distances": [(range(9), from_mean_height)]},
        5,
    ),
    "level plane and positions": (
        ["points 1-9: on level plane sigma 0.1", "images 1,2: position prior sigma 0.1"],
        {"distances": [(range(9), from_mean_height)], "priors": (0, 1)},
        0,
    ),
}


@pytest.mark.parametrize("case", RULES)
def test_rules_count(case):
    problem = flat(mono())
    there = problem.points.copy()
    there[:2, 0] = 0  # on the second plane
    problem = problem.replace(points=there)
    rules, what, degrees = RULES[case]
    assert nullity(problem, **what) == degrees
    # Distances from the planes would be lengths, by which a world cannot shrink.
    moved = there + np.random.default_rng(0).normal(size=there.shape) * 1e-2
    moved[:2] = there[:2]
    off = problem.replace(points=moved)
    for one in (problem, off):
        assert bundle.gauge_freedom(one, constraints=rules).degrees == degrees
    settings = {"gauge": "two_cameras", "max_num_iterations": 1}
    solved = bundle.solve(off, constraints=rules, **settings)
    assert solved.gauge_freedom.degrees == degrees
    assert pickle.loads(pickle.dumps(solved)).gauge_freedom.degrees == degrees


def test_priors_of_frames_sensors_and_points_count():
    problem = rigs(STEREO)
    shift = np.array([100.0, -50, 20])  # a world whose origin is elsewhere
    frames = problem.rig_from_world.copy()
    frames[:, 4:] -= Rotation.from_quat(frames[:, :4]).apply(shift)
    problem = problem.replace(rig_from_world=frames, points=problem.points + shift)
    frame = bundle.PriorFactor(("frame", 2), frames[1], np.eye(6))
    arm = bundle.PriorFactor(("sensor", (1, 2)), problem.sensor_from_rig[0], np.eye(6))
    points = [bundle.PriorFactor(("point", k), problem.points[k - 1], np.eye(3)) for k in (4, 9)]

    def degrees(*factors, **options):
        return bundle.gauge_freedom(problem, factors=factors, **options).degrees

    assert degrees(frame) == 0
    assert degrees(*points) == 1
    assert degrees(points[0]) == 3
    assert degrees(arm) == 6
    assert degrees(refine_sensor_from_rig=True) == 7
    assert degrees(arm, refine_sensor_from_rig=True) == 6
    assert degrees(frame, refine_sensor_from_rig=True) == 1
    assert degrees(frame, arm, refine_sensor_from_rig=True) == 0


@pytest.mark.parametrize(("least", "degrees"), [(0.99e-9, 1), (1.01e-9, 0)])
def test_singular_values_on_both_sides_of_the_threshold(least, degrees):
    """Columns have norm 1 before the projection: their sizes say nothing about their rank."""
    rng = np.random.default_rng(0)
    left, right = (np.linalg.qr(rng.normal(size=(n, 3)))[0] for n in (6, 3))
    rows = left @ np.diag([1.0, 0.5, least]) @ right.T
    sizes = np.array([1e-6, 1.0, 1e6])
    assert _nullity(rows * sizes, sizes**2) == degrees
    assert _nullity(rows * 0, sizes**2) == 3
    assert _nullity(np.zeros((4, 0)), np.zeros(0)) == 0


@pytest.mark.parametrize(("height", "degrees"), [(0.0, 1), (1e-7, 0)])
def test_positions_near_a_line_leave_a_turn_about_it(height, degrees):
    """Three positions, the middle one beside the line of the others."""
    problem = make_problem(num_images=3)
    there = np.array([[0.0, 0, 0], [1, 1, 1], [3, 3, 3]])
    there[1] += height * np.array([1, -1, 0])
    poses = problem.cam_from_world.copy()
    for pose, place in zip(poses, there, strict=True):
        pose[4:] = -Rotation.from_quat(pose[:4]).apply(place)
    moved = problem.replace(cam_from_world=poses)
    priors = [
        PositionPrior(int(key), place, sigma=1.0)
        for key, place in zip(problem.image_ids, there, strict=True)
    ]
    found = bundle.gauge_freedom(moved, priors=priors)
    assert found.degrees == degrees
