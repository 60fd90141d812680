"""Rigs made out of images by a rig_config.json, held against pycolmap.apply_rig_config."""

import json

import numpy as np
import pycolmap
import pytest

from bundle import InputError, apply_rig_config
from tests.rig_scenes import FIVE, STEREO, rig_problem

PREFIXES = ("a/", "b/", "c/", "d/", "e/")


def scattered(problem, seed=0, noise=1e-2):
    """Images with poses of their own about those of rigs, named prefix and frame."""
    rng = np.random.default_rng(seed)
    poses = problem.cam_from_world + rng.normal(0, noise, problem.cam_from_world.shape)
    poses[:, :4] /= np.linalg.norm(poses[:, :4], axis=1, keepdims=True)
    poses[::3, :4] *= -1
    names = [
        f"{PREFIXES[sensor + 1]}{frame:02d}.jpg" if frame >= 0 else f"alone{image}.jpg"
        for image, (frame, sensor) in enumerate(
            zip(problem.image_frame, problem.image_sensor, strict=True)
        )
    ]
    return problem.without_rigs().replace(cam_from_world=poses, image_names=names)


def config(num_sensors, *, reference=0, **more):
    """A rig of the first prefixes; `more` has further keys of the cameras by prefix."""
    cameras = [{"image_prefix": prefix} for prefix in PREFIXES[:num_sensors]]
    cameras[reference]["ref_sensor"] = True
    for camera in cameras:
        camera.update(more.get(camera["image_prefix"].rstrip("/"), {}))
    return [{"cameras": cameras}]


def by_pycolmap(problem, content, tmp_path):
    source = problem.to_pycolmap()
    # pycolmap wants the reference sensor first; the order means nothing.
    ordered = sorted(content[0]["cameras"], key=lambda camera: "ref_sensor" not in camera)
    content = [{"cameras": ordered}]
    (tmp_path / "oracle.json").write_text(json.dumps(content))
    database = pycolmap.Database.open(tmp_path / "database.db")
    for camera in source.cameras.values():
        database.write_camera(camera, use_camera_id=True)
    for rig in source.rigs.values():
        database.write_rig(rig, use_rig_id=True)
    for image in source.images.values():
        database.write_image(
            pycolmap.Image(image.name, np.zeros((0, 2)), image.camera_id, image.image_id),
            use_image_id=True,
        )
    for frame in source.frames.values():
        database.write_frame(frame, use_frame_id=True)
    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = 2
    configs = pycolmap.read_rig_config(tmp_path / "oracle.json")
    pycolmap.apply_rig_config(configs, database, source)
    pycolmap.logging.minloglevel = level
    database.close()
    return source


def write(tmp_path, content):
    path = tmp_path / "rig_config.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


ARM = {
    "cam_from_rig_rotation": [0.9, 0.1, -0.1, 0.17**0.5],
    "cam_from_rig_translation": [0.5, 0.25, -1],
}
CASES = {
    "stereo": ((STEREO,), (), config(2)),
    "five": ((FIVE,), (), config(5)),
    "reference last": ((FIVE,), (), config(5, reference=3)),
    "given arm": ((FIVE[:2],), (), config(3, b=ARM)),
    "frames without images": ((FIVE[:2],), {(0, 1, 0), (0, 2, 1)}, config(3)),
    "intrinsics": (
        (STEREO,),
        (),
        config(
            2,
            a={"camera_model_name": "OPENCV", "camera_params": [700, 701, 400, 300, 0.1, 0, 0, 0]},
        ),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_against_pycolmap(case, tmp_path):
    rigs, missing, content = CASES[case]
    problem = scattered(rig_problem(rigs=rigs, missing=missing, num_alone=1))
    expected = by_pycolmap(problem, content, tmp_path)
    found = apply_rig_config(problem, write(tmp_path, content))
    assert found.num_rigs == 1
    assert found.num_sensors == len(rigs[0])
    for index, image_id in enumerate(found.image_ids.tolist()):
        pose = expected.image(image_id).cam_from_world()
        quaternion = found.cam_from_world[index, :4]
        assert abs(quaternion @ pose.rotation.quat) == pytest.approx(1, abs=1e-12)
        np.testing.assert_allclose(found.cam_from_world[index, 4:], pose.translation, atol=1e-9)
    for camera_id, params, model in zip(
        found.camera_ids.tolist(), found.camera_params, found.camera_models, strict=True
    ):
        camera = expected.camera(camera_id)
        assert camera.model.name == model
        np.testing.assert_array_equal(params[: len(camera.params)], camera.params)
    written = found.to_pycolmap()
    assert sorted(len(frame.data_ids) for frame in written.frames.values()) == sorted(
        len(frame.data_ids) for frame in expected.frames.values()
    )


def test_rigs_come_back_from_names(tmp_path):
    problem = rig_problem(rigs=(FIVE,), num_alone=1)
    again = apply_rig_config(scattered(problem, noise=0), write(tmp_path, config(5)))
    np.testing.assert_allclose(
        again.cam_from_world[:, 4:], problem.cam_from_world[:, 4:], atol=1e-9
    )
    np.testing.assert_array_equal(again.image_frame, problem.image_frame)


def test_two_rigs(tmp_path):
    problem = rig_problem(rigs=(STEREO, STEREO))
    names = [
        f"{'ab'[rig - 1]}/{'right' if sensor >= 0 else 'left'}/{frame}"
        for rig, frame, sensor in zip(
            problem.frame_rig_ids[problem.image_frame],
            problem.image_frame,
            problem.image_sensor,
            strict=True,
        )
    ]
    content = [
        {
            "cameras": [
                {"image_prefix": f"{r}/left/", "ref_sensor": True},
                {"image_prefix": f"{r}/right/"},
            ]
        }
        for r in "ab"
    ]
    found = apply_rig_config(
        problem.without_rigs().replace(image_names=names), write(tmp_path, content)
    )
    assert (found.num_rigs, found.num_frames, found.num_sensors) == (2, 8, 2)
    np.testing.assert_allclose(
        found.sensor_from_rig[:, 4:], problem.sensor_from_rig[:, 4:], atol=1e-9
    )


# Content, and what the message has after the path.
BAD_FILES = {
    "no JSON": ("[\n{", ":2: expected JSON, found an error in column 2"),
    "deep": ("[" * 100_000, ": expected JSON, found nesting that is too deep"),
    "not text": ("[1e999]", ": rig 1: expected an object"),
    "no list": ({"cameras": []}, ": expected a list of rigs"),
    "empty": ([], ": expected a list of rigs"),
    "no cameras": ([{}], ": rig 1: expected an object with a list 'cameras'"),
    "no reference": ([{"cameras": [{"image_prefix": "a/"}]}], ": rig 1: expected one camera with"),
    "two references": (
        [{"cameras": [{"image_prefix": p, "ref_sensor": True} for p in "ab"]}],
        ": rig 1: expected one camera with ref_sensor true, found 2",
    ),
    "no prefix": ([{"cameras": [{"ref_sensor": True}]}], ": rig 1, camera 1: image_prefix"),
    "prefix twice": (
        [{"cameras": [{"image_prefix": "a", "ref_sensor": True}, {"image_prefix": "a"}]}],
        ": rig 1: expected each image_prefix once",
    ),
    "half an arm": (
        config(2, b={"cam_from_rig_rotation": [1, 0, 0, 0]}),
        ": rig 1, camera 2: expect",
    ),
    "no rotation": (
        config(2, b=ARM | {"cam_from_rig_rotation": [0, 0, 0, 0]}),
        ": rig 1, camera 2: cam_from_rig_rotation: expected a finite norm",
    ),
    "short arm": (
        config(2, b=ARM | {"cam_from_rig_translation": [0, 0]}),
        ": rig 1, camera 2: cam_from_rig_translation: expected 3 numbers",
    ),
    "arm of the reference": (config(2, a=ARM), ": rig 1, camera 1: expected no cam_from_rig"),
    "no such model": (config(2, a={"camera_model_name": "X"}), ": rig 1, camera 1: camera_model_n"),
    "few parameters": (
        config(2, a={"camera_model_name": "PINHOLE", "camera_params": [1, 2]}),
        ": rig 1, camera 1: camera_params: expected 4 numbers",
    ),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_files_that_are_none(case, tmp_path):
    content, message = BAD_FILES[case]
    path = write(tmp_path, content)
    with pytest.raises(InputError) as error:
        apply_rig_config(scattered(rig_problem()), path)
    assert str(error.value).startswith(f"{path}{message}")
    assert "\n" not in str(error.value)


def test_models_that_do_not_fit(tmp_path):
    path = write(tmp_path, config(2))
    problem = scattered(rig_problem())
    with pytest.raises(InputError, match=r"^rig 1: expected images whose names begin"):
        apply_rig_config(problem.replace(image_names=["x"] * problem.num_images), path)
    cameras = problem.image_camera.copy()
    cameras[0] = 1
    with pytest.raises(InputError, match=r"^rig 1: expected one camera for the images of prefix"):
        apply_rig_config(problem.replace(image_camera=cameras), path)
    with pytest.raises(InputError, match=r"^rig 1: expected a camera for each sensor"):
        apply_rig_config(problem.replace(image_camera=np.zeros(problem.num_images)), path)
    apart = scattered(rig_problem(missing={(0, 0, 0), (0, 1, 0), (0, 2, 1), (0, 3, 1)}))
    with pytest.raises(
        InputError, match=r"^rig 1: the pose of the sensor with prefix .* is undetermined"
    ):
        apply_rig_config(apart, path)
    both = config(2)
    both[0]["cameras"][1]["image_prefix"] = "a/0"
    with pytest.raises(InputError, match=r"^rig 1: expected one image_prefix for a/0"):
        apply_rig_config(problem, write(tmp_path, both))
