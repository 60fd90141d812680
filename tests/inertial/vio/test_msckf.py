"""The MSCKF update against Schur's complement, dense least squares and statistics."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import InputError

SIGMA = 1 / 460
EXTRINSICS = np.r_[Rotation.from_rotvec([0.1, -1.5, 0.2]).as_quat(), 0.05, -0.02, 0.1]


def scene(seed=0, views=6, landmarks=20, noise=1.0):
    """Poses that look at landmarks, and their tracks; n = 6 views coordinates."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-2, -2, 4], [2, 2, 9], (landmarks, 3))
    turn = Rotation.from_quat(EXTRINSICS[:4])
    poses = []
    for k in range(views):
        cam_from_world = Rotation.from_rotvec(0.05 * rng.standard_normal(3))
        centre = np.array([0.3 * k, 0.1 * rng.standard_normal(), 0])
        imu_from_world = turn.inv() * cam_from_world
        offset = turn.inv().apply(-cam_from_world.apply(centre) - EXTRINSICS[4:])
        world_from_imu = imu_from_world.inv()
        poses.append(np.r_[world_from_imu.as_quat(), -world_from_imu.apply(offset)])
    poses = np.array(poses)
    tracks = [
        project(poses, point) + noise * SIGMA * rng.standard_normal((views, 2)) for point in points
    ]
    return poses, points, tracks


def project(poses, point):
    in_imu = Rotation.from_quat(poses[:, :4]).inv().apply(point - poses[:, 4:])
    in_camera = Rotation.from_quat(EXTRINSICS[:4]).apply(in_imu) + EXTRINSICS[4:]
    return in_camera[:, :2] / in_camera[:, 2:]


def rows_of(poses, xy, **more):
    columns = 6 * np.arange(len(poses))
    settings = {"camera_from_imu": EXTRINSICS, "sigma": SIGMA} | more
    return bundle.track_rows(poses, xy, columns, 6 * len(poses), **settings)


def moved(poses, step):
    step = step.reshape(-1, 6)
    turned = Rotation.from_quat(poses[:, :4]) * Rotation.from_rotvec(step[:, :3])
    return np.hstack([turned.as_quat(), poses[:, 4:] + step[:, 3:]])


def spd(rng, n, scale):
    root = scale * (np.eye(n) + 0.2 * rng.standard_normal((n, n)))
    return root @ root.T


def test_rows_are_derivatives():
    poses, points, tracks = scene()
    rows = rows_of(poses, tracks[0], point=points[0])
    h = 1e-6
    for column in range(36):
        step = h * np.eye(36)[column]
        ends = [project(moved(poses, s), points[0]).ravel() for s in (step, -step)]
        numeric = (ends[0] - ends[1]) / (2 * h * SIGMA)
        assert np.abs(rows.by_state[:, column] - numeric).max() < 1e-4
    for axis in range(3):
        step = h * np.eye(3)[axis]
        ends = [project(poses, points[0] + s).ravel() for s in (step, -step)]
        assert np.abs(rows.by_point[:, axis] - (ends[0] - ends[1]) / (2 * h * SIGMA)).max() < 1e-4
    expected = (tracks[0] - project(poses, points[0])).ravel() / SIGMA
    assert rows.innovation == pytest.approx(expected, abs=1e-9)


def test_triangulated_landmark_is_that_of_least_squares():
    poses, points, tracks = scene()
    rows = rows_of(poses, tracks[3])
    assert np.abs(rows.by_point.T @ rows.innovation).max() < 1e-6 * np.abs(rows.by_point).max()
    exact = rows_of(poses, project(poses, points[3]))
    assert np.abs(exact.innovation).max() < 1e-6
    given = rows_of(poses, project(poses, points[3]), point=points[3])
    assert exact.by_state == pytest.approx(given.by_state, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("landmarks", [1, 3, 20])  # without, and with compression
def test_equals_the_update_by_schurs_complement(landmarks):
    poses, _, tracks = scene(landmarks=landmarks)
    rng = np.random.default_rng(1)
    poses = moved(poses, 0.003 * rng.standard_normal(36))
    before = spd(rng, 36, 0.02)
    rows = [rows_of(poses, xy) for xy in tracks]
    update = bundle.msckf_update(before, rows)
    information, right = np.linalg.inv(before), np.zeros(36)
    for track in rows:
        h, f, r = track.by_state, track.by_point, track.innovation
        eliminated = np.linalg.solve(f.T @ f, f.T)
        information += h.T @ h - h.T @ f @ eliminated @ h
        right += h.T @ (r - f @ eliminated @ r)
    after = np.linalg.inv(information)
    sigmas = np.sqrt(np.diag(after))
    assert (np.abs(update.covariance - after) / np.outer(sigmas, sigmas)).max() < 1e-8
    assert (np.abs(update.step - after @ right) / sigmas).max() < 1e-8
    assert update.num_rows == 9 * landmarks
    assert update.num_compressed_rows == min(9 * landmarks, 36)
    assert update.rejected == ()
    assert (update.covariance == update.covariance.T).all()


def test_equals_the_joint_update_with_the_landmarks_as_states():
    """A prior so wide on the landmarks that it says nothing of them."""
    poses, _, tracks = scene(landmarks=4)
    before = spd(np.random.default_rng(2), 36, 0.02)
    rows = [rows_of(poses, xy) for xy in tracks]
    joint = np.zeros((48, 36 + 12))
    for k, track in enumerate(rows):
        joint[12 * k : 12 * k + 12, :36] = track.by_state
        joint[12 * k : 12 * k + 12, 36 + 3 * k : 39 + 3 * k] = track.by_point
    information = joint.T @ joint
    information[:36, :36] += np.linalg.inv(before)
    step = np.linalg.solve(information, joint.T @ np.concatenate([t.innovation for t in rows]))
    update = bundle.msckf_update(before, rows)
    assert update.step == pytest.approx(step[:36], rel=1e-6, abs=1e-9)


def test_errors_are_as_large_as_the_covariance_says():
    rng = np.random.default_rng(3)
    before = spd(rng, 36, 0.004)
    root = np.linalg.cholesky(before)
    nees, nis = [], []
    for seed in range(60):
        poses, _, tracks = scene(seed=seed, landmarks=8)
        error = root @ rng.standard_normal(36)
        update = bundle.msckf_update(before, [rows_of(moved(poses, -error), xy) for xy in tracks])
        left = error - update.step
        nees.append(left @ np.linalg.solve(update.covariance, left) / 36)
        nis.extend(update.nis)
    assert np.mean(nees) == pytest.approx(1, abs=0.15)
    assert np.mean(nis) == pytest.approx(1, abs=0.15)


def test_tracks_that_do_not_belong_are_left_out_and_named():
    poses, _, tracks = scene(landmarks=6)
    before = 1e-6 * np.eye(36)
    tracks[2] = tracks[2] + 20 * SIGMA * np.random.default_rng(4).standard_normal((6, 2))
    rows = [rows_of(poses, xy) for xy in tracks]
    update = bundle.msckf_update(before, rows, max_nis=4)
    assert [place for place, _ in update.rejected] == [2]
    without = bundle.msckf_update(before, rows[:2] + rows[3:])
    assert update.step == pytest.approx(without.step)
    assert "track 2" in repr(update)
    nothing = bundle.msckf_update(before, [rows[2]], max_nis=4)
    assert not nothing.step.any()
    assert (nothing.covariance == before).all()
    assert nothing.num_rows == 0


def test_tracks_without_parallax_tell_nothing():
    poses, points, _ = scene(views=4)
    poses = np.repeat(poses[:1], 4, axis=0)
    rows = rows_of(poses, project(poses, points[0]), point=points[0])
    update = bundle.msckf_update(np.eye(24), [rows])
    assert [place for place, _ in update.rejected] == [0]
    assert np.isnan(update.nis).all()
    noise = SIGMA * np.random.default_rng(0).standard_normal((30, 4, 2))
    behind = 0
    for shake in noise:  # at rest a landmark of least squares may be anywhere
        try:
            rows_of(poses, project(poses, points[0]) + shake)
        except InputError as error:
            behind += "parallax" in str(error)
    assert behind > 0
    one = rows_of(poses[:1], project(poses[:1], points[0]), point=points[0])
    assert bundle.msckf_update(np.eye(6), [one]).rejected


def refused(function, *words):
    with pytest.raises(InputError) as caught:
        function()
    for word in words:
        assert word in str(caught.value), caught.value


def test_misuse():
    poses, points, tracks = scene()
    rows = rows_of(poses, tracks[0])
    refused(lambda: bundle.msckf_update(np.eye(12), [rows]), "tracks[0]", "12", "36")
    refused(lambda: bundle.msckf_update(np.eye(36)[:5], [rows]), "covariance")
    refused(lambda: bundle.msckf_update(np.triu(np.ones((36, 36))), [rows]), "symmetric")
    refused(lambda: bundle.msckf_update(np.full((36, 36), np.nan), [rows]), "covariance")
    refused(lambda: bundle.msckf_update(np.eye(36), [1]), "tracks[0]", "TrackRows")
    refused(lambda: bundle.msckf_update(np.eye(36), [rows], max_nis=0), "max_nis")
    refused(lambda: rows_of(poses, tracks[0][:3]), "the same number of rows")
    refused(lambda: rows_of(poses[:, :6], tracks[0]), "poses", "(k, 7)")
    refused(lambda: rows_of(poses, tracks[0] * np.nan), "xy", "finite")
    refused(lambda: rows_of(poses, tracks[0], sigma=0), "sigma")
    refused(lambda: rows_of(poses, tracks[0], point=points[0] - [0, 0, 50]), "depth")
    refused(lambda: bundle.track_rows(poses, tracks[0], [0, 6, 12, 18, 24, 31], 36, sigma=1), "col")
    refused(lambda: bundle.TrackRows([1, 2], np.ones((3, 6)), np.ones((2, 3))), "by_state")
    refused(lambda: bundle.TrackRows([1, 2], np.ones((2, 6)), np.ones((2, 2))), "by_point")
    refused(lambda: bundle.TrackRows([1, np.inf], np.ones((2, 6)), np.ones((2, 3))), "innovation")
