"""Whatever is edited in a problem is in the files afterwards, or refused by its name.

What should be in the files is worked out here from the arrays of the problem, what is in them is
read by pycolmap.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest

import bundle
from bundle import InputError, Problem
from bundle.model import rig_arrays
from tests.io.bal_files import bal_text, make_bal
from tests.io.colmap_models import pose_of, synthesize, write_model
from tests.scenes import make_problem

Edit = Callable[[Problem], dict[str, Any]]
OBSERVATIONS = (
    "observation_image",
    "observation_point",
    "observation_xy",
    "observation_keypoint",
)


def with_ids_of_their_own(source: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    """Give rigs and frames other ids than cameras and images have."""
    result = pycolmap.Reconstruction()
    for camera_id, camera in source.cameras.items():
        result.add_camera(camera)
        rig = pycolmap.Rig()
        rig.rig_id = camera_id % 2 + 1  # the rig of camera 1 has the id of camera 2
        rig.add_ref_sensor(camera.sensor_id)
        result.add_rig(rig)
    for image_id, image in source.images.items():
        frame = pycolmap.Frame()
        frame.frame_id = 1 + image_id % 10 if image_id < 5 else image_id + 100
        frame.rig_id = image.camera_id % 2 + 1
        frame.add_data_id(image.data_id)
        frame.rig_from_world = image.cam_from_world()
        result.add_frame(frame)
        copy = pycolmap.Image(image.name, image.points2D, image.camera_id, image_id)
        copy.frame_id = frame.frame_id
        result.add_image(copy)
    for point_id, point in source.points3D.items():
        result.add_point3D_with_id(point_id, point)
    return result


def model(folder: Path, *, binary: bool) -> Problem:
    """A COLMAP model with two cameras of different models, and an image without a pose."""
    source = with_ids_of_their_own(synthesize(1))
    camera = source.camera(2)
    camera.model = pycolmap.CameraModelId.OPENCV
    camera.params = [900, 910, 512, 384, 0.01, -0.002, 1e-4, 2e-4]
    return bundle.load(write_model(source, folder / "in", binary=binary))


def bal(folder: Path) -> Problem:
    (folder / "in.txt").write_bytes(bal_text(*make_bal(3, num_cameras=5)))
    return bundle.load(folder / "in.txt")


def replaced(folder: Path) -> Problem:
    problem = model(folder, binary=True)
    kept = np.arange(problem.num_observations) % 7 != 0
    return dataclasses.replace(problem, **rows(problem, kept), points=problem.points + 1)


def solved(folder: Path) -> Problem:
    problem = model(folder, binary=True)
    return bundle.solve(problem, max_num_iterations=2, num_threads=1).problem


SOURCES: dict[str, Callable[[Path], Problem]] = {
    "binary": lambda folder: model(folder, binary=True),
    "text": lambda folder: model(folder, binary=False),
    "bal": bal,
    "none": lambda _: make_problem(track=4),
    "replaced": replaced,
    "solved": solved,
}


def rows(problem: Problem, kept: np.ndarray) -> dict[str, Any]:
    """Return some of the observations."""
    return {name: getattr(problem, name)[kept] for name in OBSERVATIONS}


def without_images(problem: Problem, gone: list[int]) -> dict[str, Any]:
    kept = np.setdiff1d(np.arange(problem.num_images), gone)
    new = np.full(problem.num_images, -1)
    new[kept] = np.arange(len(kept))
    image = new[problem.observation_image]
    return {
        "cam_from_world": problem.cam_from_world[kept],
        "image_ids": problem.image_ids[kept],
        "image_names": [problem.image_names[i] for i in kept],
        "image_camera": problem.image_camera[kept],
        **rows(problem, image >= 0),
        "observation_image": image[image >= 0],
    }


def without_points(problem: Problem, gone: np.ndarray) -> dict[str, Any]:
    new = np.where(gone, -1, np.cumsum(~gone) - 1)
    point = new[problem.observation_point]
    return {
        "points": problem.points[~gone],
        "point_ids": problem.point_ids[~gone],
        **rows(problem, point >= 0),
        "observation_point": point[point >= 0],
    }


def without_cameras_but_one(problem: Problem) -> dict[str, Any]:
    return {
        "image_camera": np.zeros(problem.num_images, int),
        **{
            name: getattr(problem, name)[:1]
            for name in ("camera_ids", "camera_models", "camera_params", "camera_sizes")
        },
    }


def one_more(problem: Problem) -> dict[str, Any]:
    """An image with a camera and a point of its own, and an old image that sees the point."""
    width = problem.camera_params.shape[1]
    camera = np.pad([700.0, 320.0, 240.0], (0, width - 3))
    return {
        "cam_from_world": np.vstack([problem.cam_from_world, [0, 0, 0, 1, 0.1, 0.2, 5]]),
        "image_ids": np.append(problem.image_ids, 4711),
        "image_names": [*problem.image_names, "new.jpg"],
        "image_camera": np.append(problem.image_camera, problem.num_cameras),
        "camera_ids": np.append(problem.camera_ids, 4712),
        "camera_models": [*problem.camera_models, "SIMPLE_PINHOLE"],
        "camera_params": np.vstack([problem.camera_params, camera]),
        "camera_sizes": np.vstack([problem.camera_sizes, [640, 480]]),
        "points": np.vstack([problem.points, [1, 2, 3]]),
        "point_ids": np.append(problem.point_ids, 4713),
        "observation_image": np.append(problem.observation_image, [problem.num_images, 1]),
        "observation_point": np.append(problem.observation_point, [problem.num_points] * 2),
        "observation_xy": np.vstack([problem.observation_xy, [[5, 6], [7, 8]]]),
        "observation_keypoint": np.append(problem.observation_keypoint, [-1, -1]),
    }


def changed(name: str, index: Any, value: Any) -> Edit:
    def edit(problem: Problem) -> dict[str, Any]:
        array = getattr(problem, name).copy()
        array[index] = value
        return {name: array}

    return edit


# By field: what may be done to it alone or with others, under any source.
EDITS: dict[str, dict[str, Edit]] = {
    "cam_from_world": {
        "moved": lambda p: {"cam_from_world": p.cam_from_world + 1e-3},
        "turned": lambda p: {"cam_from_world": p.cam_from_world[:, [1, 0, 3, 2, 4, 5, 6]]},
    },
    "image_ids": {
        "new": lambda p: {
            "image_ids": p.image_ids + 1000,
            "observation_keypoint": np.full(p.num_observations, -1),
        },
        "two gone": lambda p: without_images(p, [0, 2]),
        "one more": one_more,
    },
    "image_names": {
        "renamed": lambda p: {"image_names": [f"new/{i}.png" for i in range(p.num_images)]},
        "one renamed": lambda p: {"image_names": ["äöü 1.png", *p.image_names[1:]]},
    },
    "image_camera": {
        "shared": lambda p: {"image_camera": np.zeros(p.num_images)},
        "others": lambda p: {"image_camera": (p.image_camera + 1) % p.num_cameras},
    },
    "camera_ids": {
        "new": lambda p: {"camera_ids": p.camera_ids + 50},
        "swapped": lambda p: {"camera_ids": p.camera_ids[::-1]},
        "one left": without_cameras_but_one,
    },
    "camera_models": {
        "as long": lambda p: {
            "camera_models": [
                {"OPENCV": "OPENCV_FISHEYE", "SIMPLE_RADIAL": "SIMPLE_RADIAL_FISHEYE"}.get(m, m)
                for m in p.camera_models
            ]
        },
        "longer": lambda p: {
            "camera_models": ["FULL_OPENCV"] * p.num_cameras,
            "camera_params": np.tile(np.arange(1.0, 13), (p.num_cameras, 1)),
        },
        "shorter": lambda p: {
            "camera_models": ["SIMPLE_PINHOLE"] * p.num_cameras,
            "camera_params": p.camera_params * (np.arange(p.camera_params.shape[1]) < 3),
        },
    },
    "camera_params": {
        "scaled": lambda p: {"camera_params": p.camera_params * 1.01},
        "wider": lambda p: {"camera_params": np.pad(p.camera_params, ((0, 0), (0, 3)))},
    },
    "camera_sizes": {"doubled": lambda p: {"camera_sizes": 2 * p.camera_sizes + 1}},
    "points": {"moved": lambda p: {"points": p.points + 0.1}},
    "point_ids": {
        "new": lambda p: {"point_ids": p.point_ids + 500},
        "swapped": lambda p: {"point_ids": p.point_ids[::-1]},
        "some gone": lambda p: without_points(p, np.arange(p.num_points) % 3 == 1),
        "all gone": lambda p: without_points(p, np.full(p.num_points, True)),
    },
    "observation_image": {
        "another image": lambda p: {
            **changed("observation_image", [4, 9], 0)(p),
            **changed("observation_keypoint", [4, 9], -1)(p),
        },
        "half": lambda p: rows(p, np.arange(p.num_observations) % 2 == 0),
        "none": lambda p: rows(p, np.zeros(p.num_observations, bool)),
        "shuffled": lambda p: rows(p, np.random.default_rng(0).permutation(p.num_observations)),
    },
    "observation_point": {
        "another point": lambda p: {
            "observation_point": np.where(
                np.arange(p.num_observations) % 5 == 0,
                (p.observation_point + 3) % p.num_points,
                p.observation_point,
            )
        },
        "a point without observations": lambda p: rows(p, p.observation_point != 5),
    },
    "observation_xy": {
        "moved": lambda p: {"observation_xy": p.observation_xy + 0.5},
        "one moved": changed("observation_xy", 3, [1, 2]),
    },
    "observation_keypoint": {
        "new": lambda p: {"observation_keypoint": np.full(p.num_observations, -1)},
        "one new": changed("observation_keypoint", 3, -1),
    },
    "observation_sigma": {
        "two pixels": lambda p: {"observation_sigma": np.full(p.num_observations, 2.0)},
    },
    "format": {
        "bal": lambda _: {"format": "bal"},
        "colmap": lambda _: {"format": "colmap"},
        "memory": lambda _: {"format": "memory"},
    },
    "source": {"none": lambda _: {"source": None}},
}
CASES = [(source, field, name) for source in SOURCES for field in EDITS for name in EDITS[field]]


def test_every_field_is_edited() -> None:
    fields = {field.name for field in dataclasses.fields(Problem)}
    # Those of rigs are edited in test_rig_models.py: one alone contradicts the others.
    # Rolling shutters: test_rolling_shutter_file.py.
    assert set(EDITS) == fields - set(rig_arrays.ARRAYS) - {"rolling_shutter"}


def content_of_problem(problem: Problem) -> dict[str, Any]:
    num_params = {name: len(params) for name, params in bundle.camera_models().items()}
    return {
        "cameras": {
            camera_id: (model, params[: num_params[model]], size)
            for camera_id, model, params, size in zip(
                problem.camera_ids.tolist(),
                problem.camera_models,
                problem.camera_params.tolist(),
                problem.camera_sizes.tolist(),
                strict=True,
            )
        },
        "images": {
            image_id: (int(problem.camera_ids[camera]), pose)
            for image_id, camera, pose in zip(
                problem.image_ids.tolist(),
                problem.image_camera,
                problem.cam_from_world.tolist(),
                strict=True,
            )
        },
        "points": dict(zip(problem.point_ids.tolist(), problem.points.tolist(), strict=True)),
        "observations": sorted(
            (int(problem.image_ids[image]), int(problem.point_ids[point]), *xy)
            for image, point, xy in zip(
                problem.observation_image,
                problem.observation_point,
                problem.observation_xy.tolist(),
                strict=True,
            )
        ),
    }


def content_of_reconstruction(reconstruction: pycolmap.Reconstruction) -> dict[str, Any]:
    assert reconstruction.is_valid()
    images = {i: reconstruction.image(i) for i in reconstruction.reg_image_ids()}
    return {
        "cameras": {
            camera_id: (camera.model.name, camera.params.tolist(), [camera.width, camera.height])
            for camera_id, camera in reconstruction.cameras.items()
        },
        "images": {
            image_id: (image.camera_id, pose_of(image.cam_from_world()))
            for image_id, image in images.items()
        },
        "points": {i: point.xyz.tolist() for i, point in reconstruction.points3D.items()},
        "observations": sorted(
            (element.image_id, point_id, *images[element.image_id].points2D[element.point2D_idx].xy)
            for point_id, point in reconstruction.points3D.items()
            for element in point.track.elements
        ),
    }


def keypoints(problem: Problem) -> set[tuple[int, int, int]]:
    """Return image, keypoint and point of the observations that have a keypoint."""
    given = problem.observation_keypoint >= 0
    return set(
        zip(
            problem.image_ids[problem.observation_image[given]].tolist(),
            problem.observation_keypoint[given].tolist(),
            problem.point_ids[problem.observation_point[given]].tolist(),
            strict=True,
        )
    )


def expect_same(problem: Problem, found: pycolmap.Reconstruction, losses: tuple[str, ...]) -> None:
    assert content_of_reconstruction(found) == content_of_problem(problem)
    for image_id, name in zip(problem.image_ids.tolist(), problem.image_names, strict=True):
        assert found.image(image_id).name == (name or f"image_{image_id:06d}")
    refers = {
        (image_id, index, point.point3D_id)
        for image_id, image in found.images.items()
        for index, point in enumerate(image.points2D)
        if point.has_point3D()
    }
    is_kept = keypoints(problem) <= refers
    assert is_kept != any("get new indices" in sentence for sentence in losses)


@pytest.fixture(scope="module")
def problems(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Problem]:
    """A problem from each source."""
    return {name: make(tmp_path_factory.mktemp(name)) for name, make in SOURCES.items()}


@pytest.mark.parametrize(("source", "field", "name"), CASES)
def test_an_edit_is_in_the_files(
    tmp_path: Path, problems: dict[str, Problem], source: str, field: str, name: str
) -> None:
    problem = problems[source]
    edited = dataclasses.replace(problem, **EDITS[field][name](problem))
    losses = bundle.save(edited, tmp_path / "out", format="colmap")
    expect_same(edited, pycolmap.Reconstruction(tmp_path / "out"), losses)
    if len(edited.image_ids) and problem.num_observations:
        again = bundle.load(tmp_path / "out")
        assert content_of_problem(again) == content_of_problem(edited)


@pytest.mark.parametrize("field", EDITS)
def test_an_edit_is_in_text_files(tmp_path: Path, problems: dict[str, Problem], field: str) -> None:
    problem = problems["binary"]
    for name, edit in EDITS[field].items():
        edited = dataclasses.replace(problem, **edit(problem))
        bundle.save(edited, tmp_path / name, format="colmap-text")
        found = pycolmap.Reconstruction(tmp_path / name)
        assert content_of_reconstruction(found) == content_of_problem(edited)


@pytest.mark.parametrize(
    ("source", "field", "name"), [case for case in CASES if case[0] in ("binary", "bal")]
)
def test_an_edit_is_in_a_bal_file_or_named(
    tmp_path: Path, problems: dict[str, Problem], source: str, field: str, name: str
) -> None:
    problem = problems[source]
    edited = dataclasses.replace(problem, **EDITS[field][name](problem))
    edited = edited.replace(
        camera_models=["RADIAL"] * edited.num_cameras,
        camera_params=np.tile([500.0, 0, 0, 0.01, 0.001], (edited.num_cameras, 1)),
    )
    losses = bundle.save(edited, tmp_path / "out.txt", format="bal")
    again = bundle.load(tmp_path / "out.txt")
    for array in ("points", "observation_image", "observation_point", "observation_xy"):
        np.testing.assert_array_equal(getattr(again, array), getattr(edited, array))
    np.testing.assert_array_equal(again.cam_from_world[:, 4:], edited.cam_from_world[:, 4:])
    norms = np.linalg.norm(edited.cam_from_world[:, :4], axis=1, keepdims=True)
    np.testing.assert_allclose(
        again.cam_from_world[:, :4], edited.cam_from_world[:, :4] / norms, atol=1e-12
    )
    ids = edited.point_ids, edited.image_ids, edited.camera_ids[edited.image_camera]
    expected = {
        "Names": any(edited.image_names),
        "Sizes": bool(edited.camera_sizes[edited.image_camera].any()),
        "Keypoint": bool((edited.observation_keypoint >= 0).any()),
        "Ids": any(i.tolist() != list(range(len(i))) for i in ids),
        "colours": isinstance(edited.source, pycolmap.Reconstruction),
    }
    assert {word: word in " ".join(losses) for word in expected} == expected


def refused(problem: Problem, **changes: Any) -> str:
    """Return the message with which saving is refused."""
    with pytest.raises(InputError) as error:
        dataclasses.replace(problem, **changes).to_pycolmap()
    assert len(str(error.value).splitlines()) == 1
    return str(error.value)


@pytest.mark.parametrize("source", ["binary", "bal", "none"])
def test_what_cannot_be_written_is_refused_by_its_field(
    problems: dict[str, Problem], source: str
) -> None:
    problem = problems[source]
    for name in ("image_ids", "camera_ids", "point_ids"):
        ids = getattr(problem, name).copy()
        ids[1] = -7
        assert refused(problem, **{name: ids}).startswith(f"{name}: expected ")
    twice = np.where(problem.observation_image == problem.observation_image[0], 3, -1)
    message = refused(problem, observation_keypoint=twice)
    image_id = problem.image_ids[problem.observation_image[0]]
    assert message.startswith("observation_keypoint: observations 0 and ")
    assert f"keypoint 3 of image {image_id} twice" in message
    wider = np.pad(problem.camera_params, ((0, 0), (0, 1)))
    wider[1, -1] = 0.25
    camera_id = problem.camera_ids[1]
    message = refused(problem, camera_params=wider)
    assert message.startswith(f"camera_params: camera {camera_id}: expected zeros")
    assert message.endswith("found 0.25")
    assert refused(problem, source=[]).startswith("source: expected ")


def test_a_keypoint_that_the_image_has_not_is_refused(problems: dict[str, Problem]) -> None:
    problem = problems["binary"]
    image_id = int(problem.image_ids[problem.observation_image[6]])
    size = problem.source.image(image_id).num_points2D()
    edit = changed("observation_keypoint", 6, size)
    message = refused(problem, **edit(problem))
    assert message.startswith(f"observation_keypoint: observation 6: expected one of the {size} ")
    assert message.endswith(f"found {size}")
