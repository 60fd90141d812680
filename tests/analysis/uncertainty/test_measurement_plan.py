"""Plans against dense matrices with the candidates added, and reference numbers.

The oracle adds an observation, an image, a control point or a bar to the rows of ``Dense``, whose
derivatives are complex steps of formulas, and inverts the larger problem again.
"""

import dataclasses
import itertools
import pickle

import numpy as np
import pytest

import bundle
from bundle.analysis.uncertainty import joint_covariance
from bundle.analysis.uncertainty import measurement_plan as planning
from bundle.analysis.uncertainty.covariance_by_input import request_at
from bundle.analysis.uncertainty.influence import differentiate
from bundle.analysis.uncertainty.quantity import quantity_of
from bundle.georeference.gcp_list import read_gcp_list
from bundle.georeference.scale_bars import read_scale_bars
from bundle.model.rigid_motions import inverse_poses, rotation_matrices
from bundle.reports.terminal import analyses
from tests.analysis.uncertainty.dense import Dense
from tests.analysis.uncertainty.random_problems import random_case
from tests.analysis.uncertainty.test_influence import gradient_of
from tests.analysis.uncertainty.test_reliability import TARGETS, TIGHT
from tests.georeference.flights import flight
from tests.scenes import make_problem, with_observations

RATIO = "distance 3 9 / baseline 1 4"
KINDS = "image,tie,gcp,bar"


@pytest.fixture(scope="module")
def small():
    problem = make_problem(num_images=4, num_points=20, seed=3, perturbation=1e-3, shared=True)
    keep = np.random.default_rng(0).random(problem.num_observations) < 0.8
    return bundle.solve(with_observations(problem, keep), **TIGHT).problem


def planned(problem, text, add=KINDS, **given):
    """The scene of a plan, and its candidates."""
    names = ("factors", "priors", "align", "bounds", "constraints")
    parts = {name: given.pop(name, None if name in ("align", "bounds") else ()) for name in names}
    sigmas = [given.pop(name, 0.02) for name in ("gcp_sigma", "bar_sigma")]
    poses = given.pop("poses", None)
    prepared, quantity, out = differentiate(request_at(problem, None, given, "x", **parts), text)
    found = planning.Scene.of(prepared, quantity, out)
    sigma = planning.parse_sigma("gcp_sigma", sigmas[0])
    return found, list(found.candidates(add.split(","), poses, sigma, sigmas[1]))


def rows_of(scene, candidate, dense):
    """Rows of a candidate by the columns of a dense form without rigs."""
    rows = np.zeros((len(candidate.rows.jacobian), len(dense.names)))
    places = {}
    for kind, starts, size in (
        ("image", scene.joint.images, 6),
        ("camera", scene.joint.cameras, scene.start.camera_params.shape[1]),
        ("point", scene.joint.points, 3),
    ):
        for row, first in starts.items():
            places |= {first + k: dense.column[kind, row, k] for k in range(size)}
    rows[:, [places[column] for column in candidate.rows.columns]] = candidate.rows.jacobian
    return rows


def variance(rows, g):
    """g^T (A^T A)^+ g of rows in comparable columns; checks that the rows determine g."""
    scale = np.linalg.norm(rows, axis=0)
    kept = scale > 0
    scaled, b = rows[:, kept] / scale[kept], g[kept] / scale[kept]
    _, sizes, vectors = np.linalg.svd(scaled, full_matrices=False)
    along = vectors[sizes > 1e-9 * sizes[0]] @ b
    assert along @ along == pytest.approx(b @ b, rel=1e-9)
    return ((along / sizes[sizes > 1e-9 * sizes[0]]) ** 2).sum()


def free_columns(dense):
    return [j for j, n in enumerate(dense.names) if n[0] != "camera" or n[2] not in (1, 2)]


def added_image(problem, pose, view, camera=None):
    """The problem with an image that sees the points of a view where the model says."""
    camera = problem.image_camera[0] if camera is None else camera
    count = len(view.points)
    return problem.replace(
        cam_from_world=np.vstack([problem.cam_from_world, pose]),
        image_camera=np.append(problem.image_camera, camera),
        image_ids=np.append(problem.image_ids, 99),
        image_names=(*problem.image_names, "new.jpg"),
        observation_image=np.append(problem.observation_image, np.full(count, problem.num_images)),
        observation_point=np.append(problem.observation_point, view.points),
        observation_xy=np.vstack([problem.observation_xy, view.xy]),
        observation_keypoint=None,
    )


@pytest.mark.parametrize("text", [RATIO, "f 1", "angle 3 5 7", "baseline 1 2 / baseline 1 4"])
def test_every_candidate_agrees_with_the_larger_dense_problem(small, text):
    dense = Dense(small)
    free = free_columns(dense)
    g = gradient_of(dense, quantity_of(text, small, {}))[free]
    scene, found = planned(small, text)
    before = variance(dense.jacobian[:, free], g)
    assert scene.joint.variance == pytest.approx(before, rel=1e-8)
    kinds = {one.kind for one in found}
    assert kinds == {"image", "tie", "gcp", "bar"}
    for kind in kinds:
        group = [one for one in found if one.kind == kind]
        for one in group[:: 1 + len(group) // 12]:
            if kind == "image":
                continue
            larger = np.vstack([dense.jacobian, rows_of(scene, one, dense)])[:, free]
            after = variance(larger, g)
            assert scene.joint.variance - scene.joint.gain(one.rows) == pytest.approx(
                after, rel=1e-8
            )
            assert scene.joint.measured(one.rows).variance == pytest.approx(after, rel=1e-8)
            assert scene.joint.gain(one.rows) <= scene.joint.most(one.rows) * (1 + 1e-9)
            if kind in ("gcp", "bar"):  # rows that see the gauge
                assert scene.joint.gain(one.rows) == 0


@pytest.mark.parametrize("held", [(), (1, 2, 7)])
def test_new_images_agree_with_problems_that_have_them(small, held):
    """The pose of the new image is one of the unknowns there; also rows of ties by formulas.

    Without a datum the free similarities hide the pose: rows of points see both alike.
    """
    scene, found = planned(small, RATIO, "image,tie", fixed_point_ids=held)
    g = quantity_of(RATIO, small, {})
    points = np.array(list(scene.joint.points))
    images = [one for one in found if one.kind == "image"]
    assert len(images) >= 8
    for one in images[::3]:
        qw, qx, qy, qz, *t = map(float, one.lines()[0].split()[1:])
        pose = np.array([qx, qy, qz, qw, *t])
        view = joint_covariance.view(small, pose, 0, points)
        dense = Dense(added_image(small, pose, view))
        fixed = {("point", row) for row in range(small.num_points) if row + 1 in held}
        free = [j for j in free_columns(dense) if dense.names[j][:2] not in fixed]
        larger = np.zeros(len(dense.names))
        for (kind, i, k), j in dense.column.items():
            part = {"image": g.images, "camera": g.cameras, "point": g.points}[kind]
            larger[j] = part[i, k] if i < len(part) else 0
        after = variance(dense.jacobian[:, free], larger[free])
        assert scene.joint.variance - scene.joint.gain(one.rows) == pytest.approx(after, rel=1e-7)
    whole = Dense(small)
    for one in [one for one in found if one.kind == "tie"][:10]:
        at = dict(zip(one.rows.columns.tolist(), one.rows.jacobian.T, strict=True))
        image, point = (
            next(row for row, first in starts.items() if first in at)
            for starts in (scene.joint.images, scene.joint.points)
        )
        view = joint_covariance.view(small, small.cam_from_world[image], 0, np.array([point]))
        more = Dense(
            small.replace(
                observation_image=np.append(small.observation_image, image),
                observation_point=np.append(small.observation_point, point),
                observation_xy=np.vstack([small.observation_xy, view.xy]),
                observation_keypoint=None,
            )
        )
        np.testing.assert_allclose(
            more.jacobian[-2:], rows_of(scene, one, whole), rtol=1e-9, atol=1e-8
        )
        np.testing.assert_allclose(more.residual[-2:], 0, atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_random_problems_agree_with_dense_matrices(seed):
    """Rigs, ties, constant parameters, several cameras, sigmas, losses and priors."""
    case = random_case(seed)
    problem = case.problem
    text = "angle " + " ".join(map(str, problem.point_ids[[3, 5, 8]]))
    quantity = quantity_of(text, problem, {})
    given = {"factors": case.factors, "align": False, **case.settings}
    g = np.zeros(len(case.dense.names))
    for p in range(problem.num_points):
        g[case.dense.column["point", p, 0] :][:3] = quantity.points[p]
    try:
        scene, found = planned(problem, text, "gcp,bar", **given)
    except bundle.InputError as refused:
        assert "a constant" in str(refused)
        return
    assert scene.joint.variance == pytest.approx(
        g @ case.dense.covariance(case.basis) @ g, rel=1e-6
    )
    rng = np.random.default_rng(seed)
    group = [one for one in found if one.kind == "gcp"]
    chosen = [group[k] for k in rng.choice(len(group), 4, replace=False)]
    by_place = {first: row for row, first in scene.joint.points.items()}
    joint, dense = scene.joint, case.dense
    for one in chosen:  # also several together, which fix what is free
        rows = {}
        for k, column in enumerate(one.rows.columns):
            row = by_place[column - k]
            rows["point", row, k] = one.rows.jacobian[:, k]
        dense.add(np.zeros(3), rows)
        joint = joint.measured(one.rows)
        after = g @ dense.covariance(case.basis) @ g
        assert joint.variance == pytest.approx(after, rel=1e-5)


@pytest.mark.parametrize("seed", [0, 2, 3, 4, 6, 9, 13, 15])
def test_ties_of_rigs_and_robust_losses_agree_with_dense_matrices(seed):
    case = random_case(seed)
    problem = case.problem
    rng = np.random.default_rng(seed)
    keep = rng.random(problem.num_observations) < 0.85
    counts = np.bincount(problem.observation_point[keep], minlength=problem.num_points)
    keep |= counts[problem.observation_point] < 4
    fewer = with_observations(problem.replace(observation_sigma=None), keep)
    if problem.observation_sigma is not None:
        fewer = fewer.replace(observation_sigma=problem.observation_sigma[keep])
    settings = {name: one for name, one in case.settings.items() if name != "fixed_point_ids"}
    loss = {name: settings[name] for name in ("loss", "loss_scale") if name in settings}
    dense = Dense(fewer, **loss)
    basis = case.basis
    if "fixed_point_ids" in case.settings:
        column = [j for j, n in enumerate(dense.names) if n[0] == "point"]
        held = [j for j in column if not basis[j].any()]
        basis = np.hstack([basis, np.eye(len(dense.names))[:, held]])
    text = "angle " + " ".join(map(str, problem.point_ids[[3, 5, 8]]))
    quantity = quantity_of(text, fewer, {})
    g = np.zeros(len(dense.names))
    for p in range(problem.num_points):
        g[dense.column["point", p, 0] :][:3] = quantity.points[p]
    scene, found = planned(fewer, text, "tie", **settings)
    assert scene.joint.variance == pytest.approx(g @ dense.covariance(basis) @ g, rel=1e-6)
    spread = 1.0 if fewer.observation_sigma is None else fewer.observation_sigma
    weights = dense.rho_prime[dense.rho_prime > 0]
    spread = np.broadcast_to(spread, len(dense.rho_prime))[dense.rho_prime > 0]
    assert scene.sigma == pytest.approx(np.median(spread / np.sqrt(weights)), rel=1e-9)
    assert found
    for one in found[:: 1 + len(found) // 4]:
        at = set(one.rows.columns.tolist())
        image, point = (
            next(row for row, first in starts.items() if first in at)
            for starts in (scene.joint.images, scene.joint.points)
        )
        view = joint_covariance.view(
            fewer, fewer.cam_from_world[image], fewer.image_camera[image], np.array([point])
        )
        sigmas = None if fewer.observation_sigma is None else np.append(fewer.observation_sigma, 1)
        more = Dense(
            fewer.replace(
                observation_image=np.append(fewer.observation_image, image),
                observation_point=np.append(fewer.observation_point, point),
                observation_xy=np.vstack([fewer.observation_xy, view.xy]),
                observation_sigma=sigmas,
                observation_keypoint=None,
            )
        )
        larger = Dense(fewer, **loss)
        larger.jacobian = np.vstack([larger.jacobian, more.jacobian[-2:] / scene.sigma])
        larger.residual = np.append(larger.residual, [0, 0])
        after = g @ larger.covariance(basis) @ g
        assert scene.joint.variance - scene.joint.gain(one.rows) == pytest.approx(after, rel=1e-5)


# Numbers of another program: the ratio of a distance to the longest baseline; the best of 32 poses,
# the best tie, and three ties chosen one by one. Its images see points from all directions.
REFERENCE = {
    "street": (0.00754459474, 0.00274181648, 0.007413368464, 0.007328510178, 64),
    "crane": (0.000777317076, 0.0003664446336, 0.0004698564086, 0.0003951497311, 249),
}


@pytest.mark.parametrize("name", REFERENCE)
def test_reference_numbers(name, request, monkeypatch):
    monkeypatch.setattr(joint_covariance, "LEAST_COSINE", -2)
    if name == "street":
        start = bundle.synthesize(scene="street", num_images=8, num_points=60, seed=7).problem
        ids = start.point_ids
    else:
        folder = request.getfixturevalue("bundle_data") / "colmap" / "crane_mast"
        whole = bundle.load(folder)
        lines = (folder / "points3D.txt").read_text().splitlines()
        ids = [int(line.split()[0]) for line in lines if line[0] != "#"][::35]
        start = whole.select(points=np.isin(whole.point_ids, ids)).problem
    result = bundle.solve(start, **TIGHT, max_num_iterations=200)
    problem = result.problem
    counts = dict(zip(problem.point_ids, np.bincount(problem.observation_point), strict=True))
    longest = sorted(ids, key=lambda key: -counts[key])[:2]
    text = f"distance {longest[0]} {longest[1]} / baseline "
    text += f"{problem.image_ids[0]} {problem.image_ids[7]}"
    centers = problem.projection_centers
    span = np.linalg.norm(centers[0] - centers[7])
    poses = []
    for image, offset in itertools.product(range(8), ((0.3, 0), (-0.3, 0), (0, 0.3), (0, -0.3))):
        pose = problem.cam_from_world[image].copy()
        pose[4:6] -= span * np.array(offset)
        poses.append(pose)
    table = bundle.PoseTable(inverse_poses(np.array(poses)))
    sigma, best_image, best_tie, three_ties, num_ties = REFERENCE[name]
    found = bundle.plan(result, text, add="image,tie", count=1, candidates=table)
    after = {one.kind: one.sigma_after for one in found.proposals}
    assert found.sigma == pytest.approx(sigma, rel=2e-7)  # minima of two programs
    assert after == pytest.approx({"image": best_image, "tie": best_tie}, rel=2e-7)
    kinds = [one.kind for one in planned(problem, text, "image,tie", poses=table)[1]]
    assert (kinds.count("image"), kinds.count("tie")) == (32, num_ties)
    ties = bundle.plan(result, text, add="tie").together
    assert len(ties) == 3 and ties[-1].sigma_after == pytest.approx(three_ties, rel=2e-7)
    length = np.linalg.norm(np.diff(problem.points[np.isin(problem.point_ids, longest)], axis=0))
    with pytest.raises(bundle.InputError, match=r"^add: .*without a datum"):  # no false promise
        bundle.plan(result, text, add="bar", bar_sigma=1e-3 * length)


def test_three_control_points_fix_the_world_and_then_help(small):
    """Rows that see the gauge, one after the other, against the larger dense problem."""
    dense = Dense(small)
    free = free_columns(dense)
    g = gradient_of(dense, quantity_of(RATIO, small, {}))[free]
    scene, found = planned(small, RATIO, "gcp,bar", gcp_sigma=0.01)
    points, bars = ([one for one in found if one.kind == kind] for kind in ("gcp", "bar"))
    joint, rows = scene.joint, dense.jacobian
    for one in (bars[0], points[0], points[5], bars[7], points[9], points[12]):
        rows = np.vstack([rows, rows_of(scene, one, dense)])
        joint = joint.measured(one.rows)
        assert joint.variance == pytest.approx(variance(rows[:, free], g), rel=1e-7)
    assert joint.free.shape[1] == 0 and joint.variance < 0.99 * scene.joint.variance


def test_chosen_one_by_one_against_all_pairs():
    scene = flight(TARGETS, seed=1)
    given = {"priors": scene.gcps, "align": False}
    text = "height 12 30"
    found = bundle.plan(scene.problem, text, add="gcp", count=2, **given)
    whole, candidates = planned(scene.problem, text, "gcp", **given)
    first = max(candidates, key=lambda one: whole.joint.gain(one.rows))
    after = whole.joint.measured(first.rows)
    second = max(candidates, key=lambda one: after.gain(one.rows))
    assert [one.what for one in found.together] == [first.what, second.what]
    assert f": {first.what} (control point); {second.what} (control point): " in found.sentences[-1]
    pairs = min(
        whole.joint.measured(a.rows).variance - whole.joint.measured(a.rows).gain(b.rows)
        for a, b in itertools.combinations([*candidates[::3], first, second], 2)
    )
    last = found.together[-1].sigma_after
    assert last**2 <= pairs * 1.2 and last < found.together[0].sigma_after
    assert found.together[1].sigma_before == pytest.approx(found.together[0].sigma_after)
    singles = sorted(candidates, key=lambda one: -whole.joint.gain(one.rows))[:2]
    best_singles = whole.joint.measured(singles[0].rows).measured(singles[1].rows)
    assert last**2 <= best_singles.variance * (1 + 1e-9)


def test_points_of_the_quantity_and_with_priors_are_no_control_points():
    scene = flight(TARGETS, seed=1)
    given = {"priors": scene.gcps, "align": False}
    whole, found = planned(scene.problem, "height 12 30", "gcp,bar", **given)
    named = {one.what for one in found}
    assert not any(f"point {key} " in what for key in (12, 30) for what in named)
    assert not any(f"{marker.name} " in what for marker in scene.gcps for what in named)
    assert len(whole.free) > 10


def test_a_plan_does_not_depend_on_the_frame_or_the_order(small):
    found = bundle.plan(small, RATIO, add="image,tie")
    turned = bundle.plan(moved(small), RATIO, add="image,tie")
    order = np.random.default_rng(4).permutation(small.num_observations)
    mixed = bundle.plan(with_observations(small, order), RATIO, add="image,tie")
    for other in (turned, mixed):
        np.testing.assert_allclose(
            [one.sigma_after for one in other.together],
            [one.sigma_after for one in found.together],
            rtol=1e-7,
        )
        assert [one.kind for one in other.together] == [one.kind for one in found.together]
    for gauge in ("none", "three_points"):
        again = bundle.plan(small, RATIO, add="image,tie", gauge=gauge)
        assert again.together == found.together


def moved(problem):
    """The problem turned, scaled and far away."""
    from scipy.spatial.transform import Rotation

    turn, scale, shift = Rotation.from_rotvec([0.3, -1.1, 0.6]), 17.0, np.array([500.0, -80, 9])
    poses = problem.cam_from_world.copy()
    rotation = Rotation.from_quat(poses[:, :4]) * turn.inv()
    poses[:, 4:] = scale * poses[:, 4:] - rotation.apply(shift)
    poses[:, :4] = rotation.as_quat()
    return problem.replace(
        points=scale * turn.apply(problem.points.copy()) + shift, cam_from_world=poses
    )


def test_an_image_of_a_camera_of_its_own_has_its_own_parameters():
    problem = make_problem(num_images=4, num_points=20, seed=3, perturbation=1e-3)
    problem = bundle.solve(problem, **TIGHT).problem
    assert problem.num_cameras == 4
    scene, found = planned(problem, RATIO, "image")
    quantity = quantity_of(RATIO, problem, {})
    points = np.array(list(scene.joint.points))
    for one in found[::5]:
        qw, qx, qy, qz, *t = map(float, one.lines()[0].split()[1:])
        pose = np.array([qx, qy, qz, qw, *t])
        near = int(np.abs(problem.cam_from_world[:, :4] - pose[:4]).sum(axis=1).argmin())
        view = joint_covariance.view(problem, pose, near, points)
        larger = problem.replace(
            camera_ids=np.append(problem.camera_ids, 77),
            camera_models=(*problem.camera_models, problem.camera_models[near]),
            camera_params=np.vstack([problem.camera_params, problem.camera_params[near]]),
            camera_sizes=np.vstack([problem.camera_sizes, problem.camera_sizes[near]]),
        )
        dense = Dense(added_image(larger, pose, view, camera=4))
        free = free_columns(dense)
        g = np.zeros(len(dense.names))
        for (kind, i, k), j in dense.column.items():
            part = {"image": quantity.images, "camera": quantity.cameras, "point": quantity.points}
            g[j] = part[kind][i, k] if i < len(part[kind]) else 0
        after = variance(dense.jacobian[:, free], g[free])
        assert scene.joint.variance - scene.joint.gain(one.rows) == pytest.approx(after, rel=1e-6)


def test_many_points_and_images_are_thinned_out(monkeypatch):
    problem = bundle.solve(
        bundle.synthesize(num_images=8, num_points=120, seed=2).problem, **TIGHT
    ).problem
    text = "distance 5 60 / baseline 1 8"
    whole = bundle.plan(problem, text)
    monkeypatch.setattr(planning, "MOST_POINTS", 40)
    monkeypatch.setattr(planning, "MOST_IMAGES", 5)
    scene, _ = planned(problem, text)
    assert 40 <= len(scene.joint.points) <= 42 and len(scene.images) == 5
    of_these = np.isin(problem.observation_point, list(scene.joint.points))
    counts = np.bincount(problem.observation_image[of_these], minlength=8)
    assert counts[scene.images].min() >= np.delete(counts, scene.images).max() - 2
    rows = {int(problem.point_ids[row]) for row in scene.joint.points}
    assert {5, 60} <= rows
    assert scene.joint.variance == pytest.approx(whole.sigma**2, rel=1e-8)
    fewer = bundle.plan(problem, text)
    best = {one.kind: one.sigma_after for one in fewer.proposals}
    for one in whole.proposals:
        assert one.sigma_after <= best[one.kind] * (1 + 1e-9)


def test_lines_are_those_of_a_list_of_control_points(tmp_path, small):
    rules = ("point 1: position fixed", "point 2: position fixed", "point 4: position fixed")
    found = bundle.plan(small, "distance 3 9", add="gcp,bar", constraints=rules, gcp_sigma=0.05)
    lines = {one.kind: one.lines for one in found.proposals}
    position = " ".join(map(str, small.points[0]))
    text = "\n".join(line.replace("X Y Z", position) for line in lines["gcp"])
    (tmp_path / "gcp_list.txt").write_text("\n".join(("LOCAL", text, *lines["bar"][:-1], "")))
    (tmp_path / "bars.txt").write_text(lines["bar"][-1].replace("LENGTH", "1.5") + "\n")
    points = read_gcp_list(tmp_path / "gcp_list.txt")
    assert len(points) == 3
    for one in points:
        row = list(small.point_ids.astype(str)).index(one.name.removeprefix("point_"))
        for mark in one.measurements:
            image = small.image_names.index(mark.image)
            at = (small.observation_image == image) & (small.observation_point == row)
            np.testing.assert_allclose(small.observation_xy[at][0], (mark.x, mark.y), atol=0.006)
    files = {"scale_bars": tmp_path / "bars.txt", "gcp": tmp_path / "gcp_list.txt"}
    (bar,) = read_scale_bars(small, **files).priors
    assert {bar.a, bar.b} <= {one.name for one in points} and bar.distance == 1.5


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"count": 0}, "count: expected at least 1, found 0"),
        ({"count": -2}, "count: expected at least 1, found -2"),
        ({"count": 1.5}, "count: "),
        ({"add": "photo"}, "add: expected one of image, tie, gcp, bar"),
        ({"add": ""}, "add: "),
        ({"gcp_sigma": 0}, "gcp_sigma: "),
        ({"gcp_sigma": "wide"}, "gcp_sigma: "),
        ({"bar_sigma": -1}, "bar_sigma: "),
        ({"on": "distance 1 999"}, "on: expected the id of a point"),
        ({"on": "distance 1 2"}, "on: .*changes with the scale of the world"),
        ({"add": "gcp,bar"}, "add: .*found none among [0-9]+ candidates"),
        ({"add": "tie", "candidates": "poses.txt"}, "candidates: expected image in add"),
    ],
)
def test_bad_input_is_one_line(small, given, words):
    with pytest.raises(bundle.InputError, match=rf"^{words}") as error:
        bundle.plan(small, **{"on": RATIO, **given})
    assert "\n" not in str(error.value)


def test_a_pose_that_sees_nothing_is_named(small):
    away = np.array([[0.0, 0, 0, 1, 1e3, 1e3, 1e3]])
    table = bundle.PoseTable(away, ("far.jpg",))
    with pytest.raises(bundle.InputError, match=r"^candidates: .*found far\.jpg with 0"):
        bundle.plan(small, RATIO, candidates=table)


def test_rolling_shutters_are_refused():
    problem = bundle.synthesize(num_images=5, num_points=40, seed=1, rolling_shutter=0.5).problem
    with pytest.raises(bundle.InputError, match=r"^problem: expected global shutters"):
        bundle.plan(problem, "f 1")


def test_the_result_is_sorted_and_pickles(small):
    found = bundle.plan(small, RATIO)
    afters = [one.sigma_after for one in found.proposals]
    assert afters == sorted(afters) and len(found.sentences) <= 6
    assert all(one.sigma_before == pytest.approx(found.sigma) for one in found.proposals)
    assert found.together[0] == found.proposals[0] and len(found.together) == 3
    again = pickle.loads(pickle.dumps(found))
    assert again.together == found.together and again.proposals == found.proposals
    assert repr(found).startswith("Plan: distance 3 9")
    assert [one["kind"] for one in map(dataclasses.asdict, found.together)]


@pytest.mark.parametrize(("share", "is_shown"), [(1e-6, False), (1e-2, True)])
def test_a_sigma_that_keeps_its_digits_stays(small, share, is_shown):
    found = bundle.plan(small, RATIO)
    (first, *_) = found.proposals
    sigma = (1 - share) * first.sigma_before
    less = dataclasses.replace(first, sigma_after=sigma, then=planning.GCP)
    one = dataclasses.replace(found, sigma=first.sigma_before, proposals=(less,))
    assert less.is_shown is is_shown
    assert ("->" in one.sentences[1]) is is_shown and ("stays" in one.sentences[1]) is not is_shown
    shown = analyses.planned("model", small, one, {}, "", 0.0).headline[1]
    assert ("bundle refine" in shown) is is_shown


def test_images_without_a_known_size_end_where_their_observations_do(small):
    """Pixels of BAL begin in the middle of the image."""
    pose, points = small.cam_from_world[1], np.arange(small.num_points)
    own = small.observation_xy
    params = small.camera_params.copy()
    params[:, 1:3] -= own.mean(axis=0)
    unknown = small.replace(
        camera_params=params,
        observation_xy=own - own.mean(axis=0),
        camera_sizes=np.zeros_like(small.camera_sizes),
    )
    seen = joint_covariance.view(unknown, pose, 0, points)
    inside = (seen.xy > unknown.observation_xy.min(axis=0)) & (
        seen.xy < unknown.observation_xy.max(axis=0)
    )
    assert len(seen.points) > 10 and inside.all()
    assert set(seen.points) <= set(joint_covariance.view(small, pose, 0, points).points)
    assert (seen.xy < 0).any()


def test_a_point_is_in_view_from_similar_directions_only(small, monkeypatch):
    pose, points = small.cam_from_world[0].copy(), np.arange(small.num_points)
    seen = set(joint_covariance.view(small, pose, 0, points).points)
    assert len(seen) > 10
    turned = pose.copy()  # the same picture from the other side of the scene
    turned[:4] = [pose[3], -pose[2], pose[1], -pose[0]]
    assert len(joint_covariance.view(small, turned, 0, points).points) == 0
    # Along its ray, just before it, a point would fill the image.
    turn = rotation_matrices(pose[None, :4])[0]
    row = next(iter(seen))
    near = small.points[row] + 0.003 * (small.projection_centers[0] - small.points[row])
    pose[4:] = -turn @ near
    assert row not in joint_covariance.view(small, pose, 0, points).points
    monkeypatch.setattr(joint_covariance, "NEAREST", 0)
    assert row in joint_covariance.view(small, pose, 0, points).points


def test_with_priors_of_every_kind_the_larger_problem_has_the_predicted_sigma():
    """Candidates added as observations and factors; `influence` has its own oracles."""
    rng = np.random.default_rng(8)
    problem = make_problem(num_images=6, num_points=25, seed=2, perturbation=0, track=4)
    turns = rotation_matrices(problem.cam_from_world[:, :4])
    robust = {"loss": "cauchy", "loss_scale": 0.7}
    gps = [
        bundle.PositionPrior(
            i + 1, center + rng.normal(0, 0.05, 3), (0.03, 0.08), lever_arm=(0.1, -0.2, 0.3),
            **robust,
        )
        for i, center in enumerate(problem.projection_centers[:4])
    ]  # fmt: skip
    marks = [
        (problem.image_names[i], *xy)
        for i, p, xy in zip(
            problem.observation_image,
            problem.observation_point,
            problem.observation_xy,
            strict=True,
        )
        if p == 0
    ]
    priors = [
        *gps,
        bundle.GravityPrior(2, turns[1] @ [0.02, 0, -1.0], 1.5, **robust),
        bundle.OrientationPrior(3, problem.cam_from_world[2, :4], (3.0, 1.0), **robust),
        bundle.HeadingPrior(4, 30.0, 20.0),
        bundle.GroundControlPoint(
            name="mark", position=tuple(problem.points[0]), measurements=marks, sigma=(0.02, 0.04)
        ),
    ]
    given = {
        "priors": priors, "align": False, "constraints": ("cameras *: f prior 2 %",),
        "refine": ("poses", "points", "focal", "extra"),
    }  # fmt: skip
    text = "height mark 9"
    scene, found = planned(problem, text, "tie,gcp", gcp_sigma=(0.02, 0.05), **given)
    before = bundle.influence(problem, text, **given).sigma
    assert scene.joint.variance == pytest.approx(before**2, rel=1e-9)
    assert not any("mark to" in one.what for one in found) and len(scene.joint.free.T) == 0
    places = {first: row for row, first in scene.joint.points.items()}
    checked = 0
    for one in found[:: 1 + len(found) // 14]:
        row = next(places[k] for k in one.rows.columns[::-1].tolist() if k in places)
        if one.kind == "gcp":
            point = ("point", int(problem.point_ids[row]))
            information = np.diag(np.array([0.02, 0.02, 0.05]) ** -2)
            factor = bundle.PriorFactor(point, problem.points[row], information)
            after = bundle.influence(problem, text, factors=[factor], **given).sigma
        elif row < problem.num_points:
            at = set(one.rows.columns.tolist())
            image = next(i for i, first in scene.joint.images.items() if first in at)
            pose, camera = problem.cam_from_world[image], problem.image_camera[image]
            view = joint_covariance.view(problem, pose, camera, np.array([row]))
            larger = problem.replace(
                observation_image=np.append(problem.observation_image, image),
                observation_point=np.append(problem.observation_point, row),
                observation_xy=np.vstack([problem.observation_xy, view.xy]),
                observation_keypoint=None,
            )
            after = bundle.influence(larger, text, **given).sigma
        else:
            continue
        checked += 1
        assert scene.joint.variance - scene.joint.gain(one.rows) == pytest.approx(
            after**2, rel=1e-7
        )
    assert checked >= 8


def test_new_images_lie_where_their_words_say(small):
    _, found = planned(small, RATIO, "image")
    sides = {"right of": (0, 1), "left of": (0, -1), "below": (1, 1), "above": (1, -1)}
    tried = set()
    for one in found:
        step, words = one.what.partition(" (")[0].split(" ", 1)
        side, name = words.rsplit(" ", 1)
        image = small.image_names.index(name)
        qw, qx, qy, qz, *t = map(float, one.lines()[0].split()[1:])
        pose = np.array([[qx, qy, qz, qw, *t]])
        center = -rotation_matrices(pose[:, :4])[0].T @ t
        seen = rotation_matrices(small.cam_from_world[image, None, :4])[0] @ center
        seen += small.cam_from_world[image, 4:]
        axis, sign = sides[side]
        expected = np.zeros(3)
        expected[axis] = sign * float(step)
        np.testing.assert_allclose(seen, expected, atol=1e-3 * float(step))
        tried.add(side)
    assert tried == set(sides)


def test_points_without_parallax_are_no_candidates(small):
    """A point so far away that its rays are parallel."""
    points = small.points.copy()
    points[6] = small.projection_centers[0] + 1e9 * (points[6] - small.projection_centers[0])
    far = small.replace(points=points)
    scene, found = planned(far, RATIO, "tie,gcp,bar")
    assert 6 not in scene.joint.points and found
    assert not any("point 7 " in one.what for one in found)
