"""BAL files: conversion against independent formulas, round trips, legal variations."""

import bz2
import gzip
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

import bundle
from tests.io.bal_files import (
    bal_text,
    colmap_residuals,
    gzip_bytes,
    load_bytes,
    make_bal,
    parse_bal,
    project_bal,
)

INITIAL_COSTS = {
    "problem-16-22106-pre.txt.bz2": 4.185659518e6,
    "problem-21-11315-pre.txt.bz2": 4.413239314e6,
    "problem-49-7776-pre.txt.bz2": 8.509124607e5,
}


def test_arrays_of_a_loaded_file(tmp_path: Path) -> None:
    observations, cameras, points = make_bal(1)
    problem = load_bytes(tmp_path, bal_text(observations, cameras, points))
    assert problem.format == "bal"
    np.testing.assert_array_equal(problem.source.rotations, cameras[:, :3])
    assert problem.camera_models == ("RADIAL",) * 4
    assert problem.image_names == ("",) * 4
    for ids in (problem.image_ids, problem.camera_ids, problem.image_camera):
        np.testing.assert_array_equal(ids, range(4))
    np.testing.assert_array_equal(problem.point_ids, range(9))
    np.testing.assert_array_equal(problem.camera_sizes, np.zeros((4, 2)))
    np.testing.assert_array_equal(problem.camera_params[:, [0, 3, 4]], cameras[:, 6:])
    np.testing.assert_array_equal(problem.camera_params[:, 1:3], 0.0)
    np.testing.assert_array_equal(problem.points, points)
    expected = np.array(observations)
    np.testing.assert_array_equal(problem.observation_image, expected[:, 0])
    np.testing.assert_array_equal(problem.observation_point, expected[:, 1])
    np.testing.assert_array_equal(problem.observation_xy, expected[:, 2:] * (1, -1))
    np.testing.assert_array_equal(problem.observation_keypoint, -1)


def test_projection_equals_pycolmaps_of_the_converted_camera(tmp_path: Path) -> None:
    _, cameras, points = make_bal(2, num_cameras=40, num_points=40, max_angle=2 * np.pi)
    problem = load_bytes(tmp_path, bal_text([], cameras, points))
    in_bal = project_bal(cameras, points)
    checked = 0
    for i in range(40):
        rotation = pycolmap.Rotation3d(problem.cam_from_world[i, :4])
        cam_from_world = pycolmap.Rigid3d(rotation, problem.cam_from_world[i, 4:])
        camera = pycolmap.Camera(
            model=problem.camera_models[i], width=1, height=1, params=problem.camera_params[i]
        )
        in_camera = cam_from_world * problem.points[i]
        if in_camera[2] > 0:  # pycolmap projects nothing else
            np.testing.assert_allclose(
                camera.img_from_cam(in_camera), in_bal[i] * (1, -1), rtol=1e-9, atol=1e-9
            )
            checked += 1
    assert checked > 10


@pytest.mark.parametrize(
    "angle", [0.0, 1e-300, 1e-30, 1e-9, 9.9e-4, 1.1e-3, 1.0, 3.14159, 4.0, 6.28, 50.0]
)
def test_rotation_equals_scipys(tmp_path: Path, angle: float) -> None:
    _, cameras, points = make_bal(3, num_cameras=20)
    axes = cameras[:, :3] / np.linalg.norm(cameras[:, :3], axis=1, keepdims=True)
    cameras[:, :3] = axes * angle
    problem = load_bytes(tmp_path, bal_text([], cameras, points))
    np.testing.assert_allclose(np.linalg.norm(problem.cam_from_world[:, :4], axis=1), 1, rtol=1e-15)
    turned = np.diag([1.0, -1.0, -1.0]) @ Rotation.from_rotvec(cameras[:, :3]).as_matrix()
    ours = Rotation.from_quat(problem.cam_from_world[:, :4]).as_matrix()
    np.testing.assert_allclose(ours, turned, atol=2e-15)


@pytest.mark.parametrize(("name", "cost"), INITIAL_COSTS.items())
def test_initial_cost_of_real_data(bundle_data: Path, name: str, cost: float) -> None:
    problem = bundle.load(bundle_data / "bal" / name)
    residuals = colmap_residuals(problem)
    assert 0.5 * (residuals**2).sum() == pytest.approx(cost, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "suffix"), [*zip(INITIAL_COSTS, [".txt", ".txt.gz", ".txt.bz2"], strict=True)]
)
def test_real_data_comes_back(bundle_data: Path, tmp_path: Path, name: str, suffix: str) -> None:
    original = bundle_data / "bal" / name
    written = tmp_path / f"out{suffix}"
    assert bundle.save(bundle.load(original), written) == ()
    opener = {".txt": open, ".txt.gz": gzip.open, ".txt.bz2": bz2.open}[suffix]
    with opener(written, "rb") as file:
        header, observations, cameras, points = parse_bal(file.read())
    expected = parse_bal(bz2.decompress(original.read_bytes()))
    assert header == expected[0]
    for found, before in zip((observations, cameras, points), expected[1:], strict=True):
        np.testing.assert_array_equal(found.view(np.int64), before.view(np.int64))


@pytest.mark.parametrize("max_angle", [0.0, 1e-200, 1e-10, 1e-3, 3.2, 2 * np.pi])
def test_round_trip_keeps_the_rotation_vector(tmp_path: Path, max_angle: float) -> None:
    observations, cameras, points = make_bal(4, num_cameras=200, num_points=3, max_angle=max_angle)
    cameras[:20, :2] *= 1e-12  # a small component beside a large one
    problem = load_bytes(tmp_path, bal_text(observations, cameras, points))
    bundle.save(problem, tmp_path / "out.txt")
    _, _, written, _ = parse_bal((tmp_path / "out.txt").read_bytes())
    np.testing.assert_array_equal(written, cameras)
    bundle.save(problem.replace(source=None), tmp_path / "out.txt")
    _, _, written, _ = parse_bal((tmp_path / "out.txt").read_bytes())
    np.testing.assert_allclose(written[:, :3], cameras[:, :3], rtol=1e-12)
    np.testing.assert_array_equal(written[:, 3:], cameras[:, 3:])


def test_angles_of_a_turn_and_more_come_back_reduced(tmp_path: Path) -> None:
    observations, cameras, points = make_bal(5, num_cameras=50)
    axes = cameras[:, :3] / np.linalg.norm(cameras[:, :3], axis=1, keepdims=True)
    cameras[:, :3] = axes * np.linspace(2 * np.pi, 40.0, 50)[:, None]
    problem = load_bytes(tmp_path, bal_text(observations, cameras, points))
    bundle.save(problem.replace(source=None), tmp_path / "out.txt")
    _, _, written, _ = parse_bal((tmp_path / "out.txt").read_bytes())
    assert np.linalg.norm(written[:, :3], axis=1).max() < 2 * np.pi + 1e-12
    before = Rotation.from_rotvec(cameras[:, :3]).as_matrix()
    after = Rotation.from_rotvec(written[:, :3]).as_matrix()
    np.testing.assert_allclose(after, before, atol=1e-14)


def test_extreme_doubles_come_back_bit_by_bit(tmp_path: Path) -> None:
    values = np.array(
        [0.0, -0.0, 5e-324, -2.2e-308, 1.7976931348623157e308, 0.1, 1 / 3, 1e22, -1e23]
    )
    cameras = np.array([[0.0, -0.0, 0.0, -0.0, 0.0, -0.0, 5e-324, -0.0, 1e308]])
    observations = [(0, i % 3, x, -x) for i, x in enumerate(values.tolist())]
    text = bal_text(observations, cameras, values.reshape(3, 3))
    bundle.save(load_bytes(tmp_path, text), tmp_path / "out.txt")
    for written, expected in zip(
        parse_bal((tmp_path / "out.txt").read_bytes())[1:], parse_bal(text)[1:], strict=True
    ):
        np.testing.assert_array_equal(written.view(np.int64), expected.view(np.int64))


def test_only_rotations_that_did_not_change_are_the_files_own(tmp_path: Path) -> None:
    """Each row by itself, told by the id of its image, also where images are gone or turned."""
    _, cameras, points = make_bal(6, num_cameras=30, max_angle=2 * np.pi)
    problem = load_bytes(tmp_path, bal_text([], cameras, points))
    kept = np.arange(30) % 3 != 0
    poses = problem.cam_from_world[kept].copy()
    turned = np.arange(len(poses)) % 2 == 0
    poses[turned, :4] = poses[turned][:, [3, 2, 1, 0]]
    columns = ("image_ids", "image_camera", "image_names")
    edited = problem.replace(
        cam_from_world=poses, **{name: np.array(getattr(problem, name))[kept] for name in columns}
    )
    bundle.save(edited, tmp_path / "out.txt")
    _, _, written, _ = parse_bal((tmp_path / "out.txt").read_bytes())
    np.testing.assert_array_equal(written[~turned, :3], cameras[kept][~turned, :3])
    before = np.diag([1.0, -1.0, -1.0]) @ Rotation.from_quat(poses[turned, :4]).as_matrix()
    after = Rotation.from_rotvec(written[turned, :3]).as_matrix()
    np.testing.assert_allclose(after, before, atol=1e-14)


@pytest.mark.parametrize("name", INITIAL_COSTS)
def test_no_iterations_keep_every_bit(bundle_data: Path, tmp_path: Path, name: str) -> None:
    original = bundle_data / "bal" / name
    result = bundle.solve(bundle.load(original), max_num_iterations=0)
    bundle.save(result.problem, tmp_path / "out.txt")
    written = parse_bal((tmp_path / "out.txt").read_bytes())
    expected = parse_bal(bz2.decompress(original.read_bytes()))
    for found, before in zip(written[1:], expected[1:], strict=True):
        np.testing.assert_array_equal(found.view(np.int64), before.view(np.int64))


@pytest.mark.parametrize("separator", [b" ", b"\t", b"\r\n", b"\n\n\n", b"\v\f", b" \r "])
def test_any_white_space_separates(tmp_path: Path, separator: bytes) -> None:
    text = bal_text(*make_bal(6))
    plain = load_bytes(tmp_path, text)
    for data in (
        separator.join(text.split()),
        separator + separator.join(text.split()) + separator,
    ):
        problem = load_bytes(tmp_path, data)
        np.testing.assert_array_equal(problem.points, plain.points)
        np.testing.assert_array_equal(problem.observation_xy, plain.observation_xy)


def test_number_formats(tmp_path: Path) -> None:
    text = b"+1 1 +1\n0 0 +1.5E+01 -.5\n" + b"0\n" * 6 + b"1e2 00.5 5.\n1 2 003"
    problem = load_bytes(tmp_path, text)
    np.testing.assert_array_equal(problem.observation_xy, [[15.0, 0.5]])
    np.testing.assert_array_equal(problem.camera_params, [[100.0, 0.0, 0.0, 0.5, 5.0]])
    np.testing.assert_array_equal(problem.points, [[1.0, 2.0, 3.0]])


def test_numbers_across_the_ends_of_the_buffer(tmp_path: Path) -> None:
    """Several megabytes, so that the reader's buffer ends in numbers, spaces and line ends."""
    rng = np.random.default_rng(7)
    values = rng.normal(size=(120_000, 3)) * 10.0 ** rng.integers(-20, 20, (120_000, 1))
    problem = load_bytes(tmp_path, bal_text([], np.zeros((0, 9)), values))
    np.testing.assert_array_equal(problem.points, values)


def test_repeated_observations_and_lonely_points_are_kept(tmp_path: Path) -> None:
    observations, cameras, points = make_bal(8)
    repeated = [*observations, observations[0], observations[0]]
    problem = load_bytes(tmp_path, bal_text(repeated, cameras, np.vstack([points, [[1, 2, 3]]])))
    pairs = np.stack([problem.observation_image, problem.observation_point], axis=1)
    assert len(pairs) - len(np.unique(pairs, axis=0)) == 2
    assert np.bincount(problem.observation_point, minlength=10)[9] == 0


@pytest.mark.parametrize("compress", [gzip_bytes, bz2.compress])
@pytest.mark.parametrize("name", ["problem.txt", "problem", "problem.bz2", "problem.gz"])
def test_compression_is_told_from_content(tmp_path: Path, compress, name: str) -> None:
    text = bal_text(*make_bal(9))
    plain = load_bytes(tmp_path, text)
    third = len(text) // 3
    parts = [text[:third], b"", text[third : third + 1], text[third + 1 :]]
    for data in (compress(text), b"".join(map(compress, parts))):
        problem = load_bytes(tmp_path, data, name)
        np.testing.assert_array_equal(problem.points, plain.points)
        np.testing.assert_array_equal(problem.observation_xy, plain.observation_xy)


@pytest.mark.parametrize("text", ["0 0 0", "0 2 0\n1 2 3 4 5 6"])
def test_problems_without_cameras_load_and_come_back(tmp_path: Path, text: str) -> None:
    problem = load_bytes(tmp_path, text.encode())
    assert problem.num_images == 0
    assert bundle.save(problem, tmp_path / "out.txt") == ()
    assert (tmp_path / "out.txt").read_text().split() == text.split()


def test_progress_of_long_files(tmp_path: Path) -> None:
    scene = bundle.synthesize(num_images=20, num_points=10_000, mean_track_length=5, seed=1)
    path, other = tmp_path / "a.txt", tmp_path / "b.txt"
    written: list[int] = []
    read: list[int] = []
    bundle.io.open.save(scene.problem, path, progress=written.append)
    loaded = bundle.io.open.load(path, read.append)
    size = path.stat().st_size
    for seen in (written, read):
        assert len(seen) >= 3
        assert (np.diff(seen) > 0).all()
        assert abs(seen[-1] - size) < 2.2e6  # a block, and a call at the end
    assert loaded.num_observations == scene.problem.num_observations

    def stop(num_bytes: int) -> None:
        if num_bytes > 1_500_000:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bundle.io.open.load(path, stop)
    with pytest.raises(KeyboardInterrupt):
        bundle.io.open.save(scene.problem, other, progress=stop)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]
