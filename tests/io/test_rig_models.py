"""COLMAP models with rigs of several sensors: read, moved, written, held against pycolmap."""

import os
import pickle
import struct
from pathlib import Path

import numpy as np
import pycolmap
import pytest

import bundle
from bundle import InputError, Problem
from bundle.io.colmap import can_rewrite
from bundle.model.rig_arrays import ARRAYS as RIG_ARRAYS
from tests.io.colmap_models import ARRAYS, fields, pose_of, synthesize, write_model
from tests.rig_scenes import FIVE, STEREO, rig_problem

BOTH = pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
CAMERA, IMU = pycolmap.SensorType.CAMERA, pycolmap.SensorType.IMU


def rigid(*pose: float) -> pycolmap.Rigid3d:
    return pycolmap.Rigid3d(pycolmap.Rotation3d(np.array(pose[:4])), np.array(pose[4:]))


def extended() -> pycolmap.Reconstruction:
    """Three cameras a rig, an IMU, a camera that took nothing, and one without a pose."""
    source = synthesize(9, num_cameras_per_rig=3)
    camera = source.camera(1)
    for camera_id in (50, 51):
        more = pycolmap.Camera.create_from_model_id(
            camera_id, camera.model, 900.0, camera.width, camera.height
        )
        source.add_camera(more)
    rig = source.rigs[1]
    rig.add_sensor(pycolmap.sensor_t(IMU, 7), rigid(0, 0, 0, 1, 0.1, 0.2, 0.3))
    rig.add_sensor(pycolmap.sensor_t(CAMERA, 50), rigid(0, 0.6, 0, 0.8, 1, 2, 3))
    rig.add_sensor(pycolmap.sensor_t(CAMERA, 51), None)
    return source


def moved(problem: Problem, seed: int = 0) -> Problem:
    """Return the problem as a solve might, with other frames, sensors, points and parameters."""
    rng = np.random.default_rng(seed)

    def near(poses: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
        poses = poses + rng.normal(0, 1e-3, poses.shape)
        poses[:, :4] /= np.linalg.norm(poses[:, :4], axis=1, keepdims=True)
        return poses

    return problem.replace(
        rig_from_world=near(problem.rig_from_world),
        sensor_from_rig=near(problem.sensor_from_rig),
        points=problem.points + rng.normal(0, 1e-3, problem.points.shape),
        camera_params=problem.camera_params * (1 + 1e-3),
    )


def assert_agrees(problem: Problem, reconstruction: pycolmap.Reconstruction) -> None:
    """Hold every image, frame and sensor of a problem against a reconstruction."""
    for index, image_id in enumerate(problem.image_ids.tolist()):
        image = reconstruction.image(image_id)
        expected = image.cam_from_world()
        pose = problem.cam_from_world[index]
        quaternion = pose[:4] / np.linalg.norm(pose[:4])
        assert abs(quaternion @ expected.rotation.quat) == pytest.approx(1, abs=1e-14)
        np.testing.assert_allclose(pose[4:], expected.translation, atol=1e-12)
        if problem.num_frames and problem.image_frame[index] >= 0:
            row = problem.image_frame[index]
            frame = reconstruction.frame(int(problem.frame_ids[row]))
            assert frame.frame_id == image.frame_id
            assert frame.rig_id == problem.frame_rig_ids[row]
            np.testing.assert_array_equal(
                frame.rig_from_world.translation, problem.rig_from_world[row, 4:]
            )
            is_reference = reconstruction.rigs[frame.rig_id].is_ref_sensor(image.data_id.sensor_id)
            assert is_reference == (problem.image_sensor[index] < 0)
    for rig_id, camera_id, pose in zip(
        problem.sensor_rig_ids.tolist(),
        problem.sensor_camera_ids.tolist(),
        problem.sensor_from_rig,
        strict=True,
    ):
        known = reconstruction.rigs[rig_id].sensor_from_rig(pycolmap.sensor_t(CAMERA, camera_id))
        np.testing.assert_array_equal(known.translation, pose[4:])


@BOTH
def test_a_model_is_read_as_pycolmap_reads_it(tmp_path: Path, binary: bool) -> None:
    source = extended()
    problem = bundle.load(write_model(source, tmp_path / "in", binary=binary))
    assert (problem.num_rigs, problem.num_frames, problem.num_sensors) == (2, 10, 5)
    assert list(zip(problem.sensor_rig_ids, problem.sensor_camera_ids, strict=True))[:3] == [
        (1, 2),
        (1, 3),
        (1, 50),
    ]
    assert_agrees(problem, source)
    again = Problem.from_pycolmap(source)
    for name in (*ARRAYS, *RIG_ARRAYS):
        np.testing.assert_allclose(getattr(again, name), getattr(problem, name), atol=1e-14)


@BOTH
def test_a_model_that_did_not_change_keeps_its_files(tmp_path: Path, binary: bool) -> None:
    source = extended()
    folder = write_model(source, tmp_path / "in", binary=binary)
    problem = bundle.load(folder)
    assert can_rewrite(problem, binary=binary)
    bundle.save(problem, tmp_path / "out", "colmap" if binary else "colmap-text")
    if binary:
        for name in ("rigs.bin", "frames.bin"):
            assert (tmp_path / "out" / name).read_bytes() == (folder / name).read_bytes()
    written = fields(pycolmap.Reconstruction(tmp_path / "out"))
    assert written == fields(pycolmap.Reconstruction(folder))


@BOTH
@pytest.mark.parametrize("by_pycolmap", [False, True])
def test_a_solution_is_written(tmp_path: Path, binary: bool, by_pycolmap: bool) -> None:
    folder = write_model(extended(), tmp_path / "in", binary=binary)
    problem = moved(bundle.load(folder))
    if by_pycolmap:
        problem = problem.replace(source=problem.source)
    assert can_rewrite(problem, binary=binary) != by_pycolmap
    bundle.save(problem, tmp_path / "out", "colmap" if binary else "colmap-text")
    written = pycolmap.Reconstruction(tmp_path / "out")
    assert_agrees(problem, written)
    before, after = fields(pycolmap.Reconstruction(folder)), fields(written)
    kept = "Sensor(IMU, 7)", "Sensor(CAMERA, 51)"
    rig_before, rig_after = before["rigs"][1][1], after["rigs"][1][1]  # type: ignore[index]
    assert set(rig_before) == set(rig_after)
    same = [name for name in rig_before if rig_before[name] == rig_after[name]]
    assert sorted(map(str, same)) == sorted(
        name for name in rig_before if "IMU" in name or "51" in name
    ), kept
    again = bundle.load(tmp_path / "out")
    for name in RIG_ARRAYS:
        np.testing.assert_array_equal(getattr(again, name), getattr(problem, name))


def test_the_source_stays_as_it_is() -> None:
    source = extended()
    before = fields(source)
    moved(Problem.from_pycolmap(source)).to_pycolmap()
    assert fields(source) == before


def test_it_pickles(tmp_path: Path) -> None:
    problem = bundle.load(write_model(extended(), tmp_path / "in", binary=True))
    again = pickle.loads(pickle.dumps(problem))
    assert fields(again.to_pycolmap()) == fields(problem.to_pycolmap())


def test_an_imu_beside_a_camera_is_no_rig_of_several_sensors(tmp_path: Path) -> None:
    source = synthesize(9)
    source.rigs[1].add_sensor(pycolmap.sensor_t(IMU, 7), rigid(0, 0, 0, 1, 0.1, 0.2, 0.3))
    problem = bundle.load(write_model(source, tmp_path / "in", binary=True))
    assert problem.num_frames == 0
    bundle.save(problem, tmp_path / "out")
    assert fields(pycolmap.Reconstruction(tmp_path / "out")) == fields(source)


@BOTH
def test_an_imu_may_be_the_reference_sensor(tmp_path: Path, binary: bool) -> None:
    problem = rig_problem(rigs=(STEREO,), missing={(0, f, 0) for f in range(4)})
    source = rig_problem(rigs=(STEREO,)).to_pycolmap()
    rig = pycolmap.Rig()
    rig.rig_id = 1
    rig.add_ref_sensor(pycolmap.sensor_t(IMU, 1))
    rig.add_sensor(pycolmap.sensor_t(CAMERA, 2), rigid(*problem.sensor_from_rig[0]))
    folder = write_model(source, tmp_path / "source", binary=True)
    other = _only_second_camera(pycolmap.Reconstruction(folder), rig)
    folder = write_model(other, tmp_path / "in", binary=binary)
    read = bundle.load(folder)
    assert (read.num_frames, read.num_images, read.num_sensors) == (4, 4, 1)
    assert_agrees(read, other)
    bundle.save(moved(read), tmp_path / "out", "colmap" if binary else "colmap-text")
    assert_agrees(moved(read), pycolmap.Reconstruction(tmp_path / "out"))


def _only_second_camera(
    source: pycolmap.Reconstruction, rig: pycolmap.Rig
) -> pycolmap.Reconstruction:
    result = pycolmap.Reconstruction()
    result.add_camera(source.camera(2))
    result.add_rig(rig)
    for frame_id, frame in sorted(source.frames.items()):
        image = next(
            image
            for image in source.images.values()
            if image.frame_id == frame_id and image.camera_id == 2
        )
        new = pycolmap.Frame()
        new.frame_id, new.rig_id = frame_id, rig.rig_id
        new.add_data_id(image.data_id)
        new.rig_from_world = frame.rig_from_world
        result.add_frame(new)
        copy = pycolmap.Image(image.name, np.zeros((0, 2)), 2, image.image_id)
        copy.frame_id = frame_id
        result.add_image(copy)
    return result


# What images are in the problem, and what of the frames is left.
def test_images_leave_their_frames(tmp_path: Path) -> None:
    problem = bundle.load(write_model(extended(), tmp_path / "in", binary=True))
    gone = [0, *np.flatnonzero(problem.image_frame == 1)]  # one of frame 0, all of frame 1
    result = without_images(problem, gone)
    written = result.to_pycolmap()
    assert written.is_valid()
    assert_agrees(result, written)
    assert set(written.images) == set(result.image_ids.tolist())
    assert len(list(written.frame(int(problem.frame_ids[0])).image_ids)) == 2
    assert int(problem.frame_ids[1]) not in written.frames
    assert len(written.rigs[1].non_ref_sensors) == 5


def without_images(problem: Problem, gone: list[int]) -> Problem:
    keep = np.setdiff1d(np.arange(problem.num_images), gone)
    row = np.full(problem.num_images, -1)
    row[keep] = np.arange(len(keep))
    seen = row[problem.observation_image] >= 0
    return problem.replace(
        cam_from_world=problem.cam_from_world[keep],
        image_ids=problem.image_ids[keep],
        image_names=[problem.image_names[i] for i in keep],
        image_camera=problem.image_camera[keep],
        image_frame=problem.image_frame[keep],
        image_sensor=problem.image_sensor[keep],
        observation_image=row[problem.observation_image[seen]],
        observation_point=problem.observation_point[seen],
        observation_xy=problem.observation_xy[seen],
        observation_keypoint=problem.observation_keypoint[seen],
    )


def test_rigs_are_taken_apart(tmp_path: Path) -> None:
    problem = bundle.load(
        write_model(synthesize(9, num_cameras_per_rig=3), tmp_path / "in", binary=True)
    )
    apart = problem.without_rigs()
    bundle.save(apart, tmp_path / "out")
    written = pycolmap.Reconstruction(tmp_path / "out")
    assert all(rig.num_sensors() == 1 for rig in written.rigs.values())
    assert len(written.frames) == problem.num_images
    assert_agrees(apart, written)
    assert fields(written)["points"] == fields(problem.source)["points"]
    again = bundle.load(tmp_path / "out")
    assert again.num_frames == 0
    np.testing.assert_array_equal(again.observation_keypoint, problem.observation_keypoint)


@pytest.mark.parametrize("rigs", [(STEREO,), (FIVE, STEREO)])
def test_rigs_from_memory(tmp_path: Path, rigs: tuple) -> None:  # type: ignore[type-arg]
    problem = rig_problem(
        rigs=rigs, num_alone=2, first_ids=(4, 2**31 + 9, 2**31 + 100, 11), missing={(0, 2, 0)}
    )
    bundle.save(problem, tmp_path / "out")
    written = pycolmap.Reconstruction(tmp_path / "out")
    assert_agrees(problem, written)
    again = bundle.load(tmp_path / "out")
    for name in (*RIG_ARRAYS, "cam_from_world"):
        np.testing.assert_allclose(getattr(again, name), getattr(problem, name), atol=1e-14)


def test_images_change_their_frames(tmp_path: Path) -> None:
    problem = bundle.load(
        write_model(synthesize(9, num_cameras_per_rig=3), tmp_path / "in", binary=True)
    )
    frame, sensor = problem.image_frame.copy(), problem.image_sensor.copy()
    frame[4] = sensor[4] = -1
    changed = problem.replace(image_frame=frame, image_sensor=sensor)
    written = changed.to_pycolmap()
    assert written.is_valid()
    assert_agrees(changed, written)
    assert fields(written)["points"] == fields(problem.source)["points"]
    assert (
        len(list(written.frame(written.image(int(problem.image_ids[4])).frame_id).image_ids)) == 1
    )


def test_ids_that_colmap_cannot_hold() -> None:
    with pytest.raises(InputError, match=r"^frame_ids: expected ids from 0 to 4294967294"):
        rig_problem(first_ids=(1, 2**32, 1, 1)).to_pycolmap()


def test_a_rig_from_memory_needs_a_reference_camera() -> None:
    problem = rig_problem(missing={(0, f, 0) for f in range(4)})
    with pytest.raises(InputError, match=r"^frame_rig_ids: rig 1: expected an image of its ref"):
        problem.to_pycolmap()


def test_a_bal_file_does_not_keep_rigs(tmp_path: Path) -> None:
    problem = rig_problem(model="SIMPLE_RADIAL")
    lost = bundle.save(problem, tmp_path / "out.txt")
    assert any(sentence.startswith("Rigs are taken apart") for sentence in lost)
    assert bundle.load(tmp_path / "out.txt").num_frames == 0


def text_model(tmp_path: Path) -> Path:
    return write_model(synthesize(9, num_cameras_per_rig=2), tmp_path / "in", binary=False)


def edited(folder: Path, name: str, old: str, new: str) -> None:
    text = (folder / name).read_text()
    assert old in text
    (folder / name).write_text(text.replace(old, new, 1))


def complaint(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        bundle.load(folder)
    message = str(caught.value)
    assert "\n" not in message
    return message.removeprefix(str(folder) + os.sep)


def rig_line(folder: Path) -> list[str]:
    lines = (folder / "rigs.txt").read_text().splitlines()
    return next(line for line in lines if not line.startswith("#")).split()


def with_rig_line(folder: Path, words: list[str]) -> None:
    edited(folder, "rigs.txt", " ".join(rig_line(folder)), " ".join(words))


def test_a_sensor_without_a_pose_that_took_images(tmp_path: Path) -> None:
    folder = text_model(tmp_path)
    words = rig_line(folder)
    with_rig_line(folder, [*words[:6], "0"])
    message = complaint(folder)
    assert message.startswith("rigs.txt:4: rig 1: expected the pose of camera 2 on the rig")
    # COLMAP reads it, and fails where the pose of such an image is asked for.
    source = pycolmap.Reconstruction(folder)
    with pytest.raises(InputError, match=r"^rig 1: expected the pose of camera 2 on the rig"):
        Problem.from_pycolmap(source)


@pytest.mark.parametrize("value", ["nan", "inf"])
def test_a_sensor_pose_that_is_not_finite(tmp_path: Path, value: str) -> None:
    folder = text_model(tmp_path)
    words = rig_line(folder)
    with_rig_line(folder, [*words[:-1], value])
    assert complaint(folder).startswith("rigs.txt:4: ")


def test_a_rig_that_lists_a_camera_twice(tmp_path: Path) -> None:
    folder = text_model(tmp_path)
    words = rig_line(folder)
    with_rig_line(folder, [words[0], "3", *words[2:], *words[4:]])
    assert complaint(folder).startswith("rigs.txt:4: rig 1: expected each sensor once")


def test_a_frame_of_an_unknown_rig(tmp_path: Path) -> None:
    folder = text_model(tmp_path)
    lines = (folder / "frames.txt").read_text().splitlines()
    first = next(line for line in lines if not line.startswith("#"))
    words = first.split()
    edited(folder, "frames.txt", first, " ".join([words[0], "77", *words[2:]]))
    assert "expected a rig of the model, found rig 77" in complaint(folder)


def test_an_image_that_its_frame_does_not_list(tmp_path: Path) -> None:
    folder = text_model(tmp_path)
    lines = (folder / "frames.txt").read_text().splitlines()
    first = next(line for line in lines if not line.startswith("#"))
    words = first.split()
    edited(folder, "frames.txt", first, " ".join([*words[:9], "1", *words[10:13]]))
    assert "expected a frame that holds it, found 0" in complaint(folder)


def test_frames_without_their_reference_image_are_read(tmp_path: Path) -> None:
    source = extended()
    problem = Problem.from_pycolmap(source)
    references = np.flatnonzero(problem.image_sensor < 0)
    bundle.save(without_images(problem, references.tolist()), tmp_path / "out")
    again = bundle.load(tmp_path / "out")
    assert again.num_frames == problem.num_frames
    assert (again.image_sensor >= 0).all()
    assert_agrees(again, pycolmap.Reconstruction(tmp_path / "out"))


def test_counts_of_a_binary_file_are_checked(tmp_path: Path) -> None:
    folder = write_model(extended(), tmp_path / "in", binary=True)
    content = bytearray((folder / "rigs.bin").read_bytes())
    content[12:16] = struct.pack("<I", 2**31)
    (folder / "rigs.bin").write_bytes(content)
    assert complaint(folder).startswith("rigs.bin: byte 12: expected at most")


def test_kitti(bundle_data: Path, tmp_path: Path) -> None:
    problem = bundle.load(bundle_data / "rigs" / "kitti26_stereo_rig")
    assert (problem.num_rigs, problem.num_frames, problem.num_sensors) == (1, 26, 1)
    assert problem.sensor_from_rig[0, 4] == pytest.approx(-0.537, abs=1e-3)
    for binary in (True, False):
        out = tmp_path / str(binary)
        bundle.save(moved(problem), out, "colmap" if binary else "colmap-text")
        assert_agrees(moved(problem), pycolmap.Reconstruction(out))


def without_second_rig(problem: Problem) -> Problem:
    """Return the images and frames of the first rig alone, with all sensors."""
    frames = problem.frame_rig_ids == problem.frame_rig_ids[0]
    kept = frames[problem.image_frame]
    left = without_images(problem, np.flatnonzero(~kept).tolist())
    row = np.cumsum(frames) - 1
    names = ("rig_from_world", "frame_ids", "frame_rig_ids")
    return left.replace(
        cam_from_world=left.cam_from_world,
        image_frame=row[left.image_frame],
        **{name: getattr(problem, name)[frames] for name in names},
    )


def test_a_rig_without_images_needs_a_source(tmp_path: Path) -> None:
    problem = rig_problem(rigs=(STEREO, FIVE))
    with pytest.raises(InputError, match=r"^sensor_rig_ids: rig 2: expected an image of its ref"):
        bundle.save(without_second_rig(problem), tmp_path / "none", "colmap")
    bundle.save(problem, tmp_path / "in")
    read = without_second_rig(bundle.load(tmp_path / "in"))
    moved_sensors = read.sensor_from_rig.copy()
    moved_sensors[-1, 4:] += 1
    bundle.save(read.replace(sensor_from_rig=moved_sensors), tmp_path / "out", "colmap")
    written = pycolmap.Reconstruction(tmp_path / "out")
    assert {frame.rig_id for frame in written.frames.values()} == {1}
    sensor = pycolmap.sensor_t(CAMERA, int(read.sensor_camera_ids[-1]))
    found = written.rigs[2].sensor_from_rig(sensor)
    assert pose_of(found) == moved_sensors[-1].tolist()
