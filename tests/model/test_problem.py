"""The problem: shapes, values, sharing of memory."""

import copy
import dataclasses
import pickle
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import InputError, Problem, _core
from bundle.base.arrays import immutable
from bundle.model.problem import ARRAYS
from tests import scenes

OPTIONS = bundle.SolveOptions(max_num_iterations=1, num_threads=1)


def arrays(problem):
    return {name: getattr(problem, name) for name in ARRAYS}


def expect_immutable(problem):
    for name, array in arrays(problem).items():
        assert array.flags.c_contiguous, name
        owner = array
        while isinstance(owner, np.ndarray):
            assert not owner.flags.writeable, name
            with pytest.raises(ValueError, match="cannot set WRITEABLE"):
                owner.flags.writeable = True
            owner = owner.base


def test_nothing_can_write_to_the_arrays():
    problem = scenes.make_problem()
    expect_immutable(problem)
    expect_immutable(bundle.solve(problem, max_num_iterations=1).problem)


def shared_view(array):
    view = array.view()
    view.flags.writeable = False
    return view


def locked(array):
    array.flags.writeable = False
    return array


def mapped(array, tmp_path):
    np.save(tmp_path / "array.npy", array)
    return np.load(tmp_path / "array.npy", mmap_mode="r")


# From an array that may be written to, to one that looks as if it could not.
DISGUISES = {
    "as it is": lambda array, _: array,
    "read-only view": lambda array, _: shared_view(array),
    "view of a read-only view": lambda array, _: shared_view(array)[:],
    "read-only for now": lambda array, _: locked(array),
    "foreign buffer": lambda array, _: np.frombuffer(bytearray(array), array.dtype),
    "read-only view of a foreign buffer": lambda array, _: np.frombuffer(
        memoryview(bytearray(array)).toreadonly(), array.dtype
    ),
    "mapped file": mapped,
    "DLPack": lambda array, _: shared_view(np.from_dlpack(array)),
}


@pytest.mark.parametrize("disguise", DISGUISES)
def test_an_array_that_somebody_can_change_is_copied(tmp_path, disguise):
    """Indices changed after their check would lead a solve out of its memory."""
    point = scenes.make_problem().observation_point.copy()
    given = DISGUISES[disguise](point, tmp_path)
    problem = scenes.make_problem(observation_point=given)
    assert given.dtype == problem.observation_point.dtype
    assert not np.shares_memory(problem.observation_point, given)
    expect_immutable(problem)


def test_memory_that_nobody_can_change_is_shared():
    problem = scenes.make_problem()
    other = problem.replace(points=problem.points + 1)
    assert np.shares_memory(other.observation_xy, problem.observation_xy)
    constant = np.frombuffer(problem.observation_point.tobytes(), np.int32)
    kept = problem.replace(observation_point=constant)
    assert np.shares_memory(kept.observation_point, constant)
    part = problem.replace(points=problem.points[:], cam_from_world=problem.cam_from_world)
    assert np.shares_memory(part.points, problem.points)
    with pytest.raises(dataclasses.FrozenInstanceError):
        problem.points = other.points


def test_loading_copies_nothing(tmp_path):
    """Arrays of the core are immutable when they arrive."""
    bundle.save(scenes.scene(), tmp_path / "in.txt")
    bundle.save(scenes.make_problem(), tmp_path / "model")
    for path in (tmp_path / "in.txt", tmp_path / "model"):
        problem = bundle.load(path)
        expect_immutable(problem)
        array = immutable("xy", problem.observation_xy, np.float64)
        assert np.shares_memory(array, problem.observation_xy)
    solved = _core.solve(
        problem, bundle.solving.layout.resolve_defaults(problem, OPTIONS).asdict(), None
    )
    assert all(_core.is_immutable(solved[name]) for name in ("cam_from_world", "points"))
    assert all(_core.is_immutable(array) for array in _core.read_bal(tmp_path / "in.txt"))
    _, fields = _core.read_colmap_model(str(tmp_path / "model"))
    assert _core.is_immutable(fields["observation_xy"])


@pytest.mark.parametrize("kind", ["bal", "colmap", "memory"])
@pytest.mark.parametrize(
    "again", [copy.copy, copy.deepcopy, lambda p: pickle.loads(pickle.dumps(p))]
)
def test_copies_are_the_same_problem(tmp_path, kind, again):
    problem = scenes.scene() if kind == "bal" else scenes.make_problem()
    if kind != "memory":
        path = tmp_path / ("in.txt" if kind == "bal" else "model")
        bundle.save(problem, path)
        problem = bundle.load(path)
    result = again(problem)
    expect_immutable(result)
    for name, array in arrays(problem).items():
        np.testing.assert_array_equal(getattr(result, name), array)
    assert result.image_names == problem.image_names
    assert result.camera_models == problem.camera_models
    assert result.format == problem.format
    for saved, before in ((result, tmp_path / "b"), (problem, tmp_path / "a")):
        bundle.save(saved, before)
    first, second = (
        [file.read_bytes() for file in sorted(path.rglob("*")) or [path]]
        for path in (tmp_path / "a", tmp_path / "b")
    )
    assert first == second


def test_a_pickle_that_was_tampered_with_is_refused():
    data = pickle.dumps(scenes.make_problem())
    index = np.array([0, 1, 2, 3, 4] * 2, np.int32).tobytes()
    assert index in data
    with pytest.raises(InputError, match="expected an image index below 5, found 77"):
        pickle.loads(data.replace(index, np.full(10, 77, np.int32).tobytes()))


def test_results_pickle():
    result = bundle.solve(scenes.make_problem(), max_num_iterations=2)
    again = pickle.loads(pickle.dumps(result))
    expect_immutable(again.problem)
    assert again.summary == result.summary
    assert again.options == result.options
    assert again.reprojection_error_after == result.reprojection_error_after
    for name, array in result.iterations.items():
        np.testing.assert_array_equal(again.iterations[name], array)
    deep = copy.deepcopy(result)
    expect_immutable(deep.problem)
    assert deep.summary == result.summary


def test_only_what_has_no_default_is_needed():
    full = scenes.make_problem()
    needed = {
        field.name
        for field in dataclasses.fields(Problem)
        if field.default is field.default_factory is dataclasses.MISSING
    }
    assert needed == {
        "cam_from_world",
        "camera_models",
        "camera_params",
        "points",
        "observation_image",
        "observation_point",
        "observation_xy",
    }
    problem = Problem(**{name: getattr(full, name) for name in needed})
    assert problem.image_ids.tolist() == problem.image_camera.tolist() == [0, 1, 2, 3, 4]
    assert problem.camera_ids.tolist() == [0, 1, 2, 3, 4]
    assert problem.point_ids.tolist() == list(range(40))
    assert problem.image_names == ("",) * 5
    assert problem.camera_sizes.tolist() == [[0, 0]] * 5
    assert problem.observation_keypoint.tolist() == [-1] * 200
    assert (problem.format, problem.source) == ("memory", None)
    expect_immutable(problem)
    one = {"camera_models": full.camera_models[:1], "camera_params": full.camera_params[:1]}
    assert (
        problem.replace(
            **one, camera_ids=None, camera_sizes=None, image_camera=None
        ).image_camera.tolist()
        == [0] * 5
    )
    two = {"camera_models": full.camera_models[:2], "camera_params": full.camera_params[:2]}
    with pytest.raises(InputError, match=r"^image_camera: .* 5 images and 2 cameras"):
        problem.replace(**two, camera_ids=None, camera_sizes=None, image_camera=None)
    for name in needed:
        with pytest.raises(InputError, match=f"^{name}: expected"):
            problem.replace(**{name: None})


def test_projection_centers_are_where_the_cameras_are():
    problem = scenes.make_problem()
    poses = problem.cam_from_world * np.array([3.0] * 4 + [1.0] * 3)  # of any norm
    centers = problem.replace(cam_from_world=poses).projection_centers
    for pose, center in zip(problem.cam_from_world, centers, strict=True):
        rotation = Rotation.from_quat(pose[:4])
        np.testing.assert_allclose(rotation.apply(center) + pose[4:], 0, atol=1e-13)


def changed(name, index, value):
    def change(problem):
        array = getattr(problem, name).copy()
        array[index] = value
        return problem.replace(**{name: array})

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (changed("points", (3, 1), np.nan), "point 4: expected finite coordinates, found nan"),
        (changed("points", (3, 1), -np.inf), "point 4: expected finite coordinates, found -inf"),
        (changed("cam_from_world", (1, 5), np.inf), "image 2: expected a finite pose, found inf"),
        (
            changed("cam_from_world", (1, slice(0, 4)), 0),
            "image 2: expected a rotation, found a quaternion of norm 0",
        ),
        (
            changed("camera_params", (2, 0), 0),
            "camera 3: expected a positive focal length f, found 0",
        ),
        (
            changed("camera_params", (2, 0), -5),
            "camera 3: expected a positive focal length f, found -5",
        ),
        (changed("camera_params", (2, 3), np.nan), "camera 3: expected a finite k, found nan"),
        (
            changed("observation_xy", (7, 0), np.nan),
            r"observation 7 \(image 3, point 2\): expected finite pixels, found nan .*",
        ),
        (
            changed("observation_image", 7, 5),
            "observation 7: expected an image index below 5, found 5",
        ),
        (
            changed("observation_image", 7, -1),
            "observation 7: expected an image index below 5, found -1",
        ),
        (
            changed("observation_point", 7, 40),
            "observation 7: expected a point index below 40, found 40",
        ),
        (changed("image_camera", 0, 9), "image 1: expected a camera index below 5, found 9"),
        (changed("image_ids", 0, 3), "image 3: expected unique ids, found this id twice"),
        (changed("point_ids", 9, 1), "point 1: expected unique ids, found this id twice"),
        (changed("camera_ids", 1, 5), "camera 5: expected unique ids, found this id twice"),
    ],
)
def test_bad_values_are_named(change, message):
    with pytest.raises(InputError, match=f"^{message}$"):
        change(scenes.make_problem())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"points": np.zeros((40, 2))}, r"points: expected shape \(N, 3\), found \(40, 2\)"),
        ({"points": np.zeros(3)}, r"points: expected shape \(N, 3\), found \(3,\)"),
        ({"point_ids": [1]}, r"point_ids: expected shape \(40,\), found \(1,\)"),
        ({"image_names": ["a"]}, "image_names: expected 5 names, found 1"),
        ({"camera_models": []}, "camera_models: expected 5 names, found 0"),
        (
            {"camera_params": np.ones((5, 3))},
            "camera 1: expected 4 parameters of SIMPLE_RADIAL, found 3",
        ),
        ({"cam_from_world": "text"}, "cam_from_world: expected numbers"),
        ({"observation_image": [0.5] * 200}, "observation_image: expected whole numbers"),
    ],
)
def test_bad_shapes_are_named(changes, message):
    with pytest.raises(InputError, match=message):
        scenes.make_problem(**changes)


WRONG_TYPES = {
    "complex": np.ones((40, 3), complex),
    "masked": np.ma.masked_array(np.ones((40, 3)), mask=np.eye(40, 3)),
    "masked nowhere": np.ma.masked_array(np.ones((40, 3))),
    "text": np.full((40, 3), "1.5"),
    "bytes": np.full((40, 3), b"1.5"),
    "booleans": np.ones((40, 3), bool),
    "dates": np.full((40, 3), "2024-01-01", "datetime64[s]"),
    "durations": np.ones((40, 3), "timedelta64[s]"),
    "objects": np.ones((40, 3), object),
    "records": np.zeros((40, 3), [("x", float)]),
    "ragged": [[1.0, 2.0]] * 39 + [[1.0]],
    "a number": 5.0,
    "a mapping": {"x": 1},
    "a generator": (i for i in range(3)),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", ["points", "point_ids"])
@pytest.mark.parametrize("value", WRONG_TYPES.values(), ids=WRONG_TYPES)
def test_wrong_types_are_refused(name, value):
    if name == "point_ids" and isinstance(value, np.ndarray):
        value = value[:, 0]
    with pytest.raises(InputError, match=f"^{name}: expected [^\n]*$"):
        scenes.make_problem(**{name: value})


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("bad", [0.5, np.nan, np.inf, 2.0**63, -1e300, 2**64 - 1])
def test_numbers_that_are_no_ids_are_refused(bad):
    ids = np.arange(40, dtype=np.uint64 if isinstance(bad, int) else np.float64)
    ids[7] = bad
    with pytest.raises(
        InputError, match=re.escape(f"point_ids: expected whole numbers of int64, found {ids[7]}")
    ):
        scenes.make_problem(point_ids=ids)


@pytest.mark.parametrize(
    ("dtype", "order"), [(">f8", "C"), (np.float32, "C"), (np.longdouble, "C"), (float, "F")]
)
def test_numbers_of_any_type_and_order_are_taken(dtype, order):
    points = np.arange(120.0).reshape(40, 3).astype(dtype, order=order)
    assert scenes.make_problem(points=points).points.tolist() == points.tolist()


@pytest.mark.parametrize(
    "name", ["a\nb", "a\x00b", "tab\t", "\x1b[31m", "a\u2028b", "\ud800", "\x7f", "\x85"]
)
def test_names_that_cannot_be_printed_are_refused(name):
    names = ["a", "b", name, "d", "e"]
    with pytest.raises(InputError) as error:
        scenes.make_problem(image_names=names)
    assert str(error.value) == (
        f"image_names: image 3: expected a name in UTF-8 without control characters, found {name!a}"
    )


def test_names_in_any_script_are_taken():
    names = ("été.jpg", "画像 1.png", "a b", "\u00a0", "🎉")
    assert scenes.make_problem(image_names=np.array(names)).image_names == names


@pytest.mark.parametrize("field", ["image_names", "camera_models"])
@pytest.mark.parametrize(
    "value", ["abcde", b"abcde", 5, [1, 2, 3, 4, 5], [b"a"] * 5, ["a", None] * 2]
)
def test_names_have_to_be_strings(field, value):
    with pytest.raises(InputError, match=f"^{field}: expected [^\n]*strings?, found "):
        scenes.make_problem(**{field: value})


@pytest.mark.parametrize(
    ("name", "end"),
    [
        ("SIMPLE_RADAIL", "found 'SIMPLE_RADAIL'; did you mean SIMPLE_RADIAL"),
        ("xyz\n\ud800", r"found 'xyz\n\ud800'"),
    ],
)
def test_a_camera_model_that_does_not_exist_is_refused(name, end):
    with pytest.raises(InputError) as error:
        scenes.make_problem(camera_models=["SIMPLE_RADIAL"] * 4 + [name])
    message = str(error.value)
    assert message.startswith("camera_models: expected one of SIMPLE_PINHOLE, ")
    assert end in message
    assert len(message.splitlines()) == 1


def test_camera_models_are_known_in_any_case():
    problem = scenes.make_problem(camera_models=["simple-radial"] * 4 + ["Simple_Radial"])
    assert problem.camera_models == ("SIMPLE_RADIAL",) * 5


def test_sizes_and_keypoints_below_what_there_is_are_refused():
    with pytest.raises(InputError, match=r"^camera_sizes: camera 4: .* found 640 x -480$"):
        changed("camera_sizes", 3, (640, -480))(scenes.make_problem())
    with pytest.raises(InputError, match=r"^observation_keypoint: observation 9: .* found -2$"):
        changed("observation_keypoint", 9, -2)(scenes.make_problem())
    with pytest.raises(
        InputError,
        match=r"^format: expected one of bal, colmap, .*openmvg, memory, found 'x'$",
    ):
        scenes.make_problem(format="x")


def test_an_empty_problem_is_a_problem():
    problem = scenes.make_problem(num_points=0)
    assert (problem.num_points, problem.num_observations) == (0, 0)
    empty = Problem(
        cam_from_world=np.empty((0, 7)),
        image_ids=[],
        image_names=[],
        image_camera=[],
        camera_ids=[],
        camera_models=[],
        camera_params=np.empty((0, 0)),
        camera_sizes=np.empty((0, 2)),
        points=np.empty((0, 3)),
        point_ids=[],
        observation_image=[],
        observation_point=[],
        observation_xy=np.empty((0, 2)),
        observation_keypoint=[],
    )
    assert repr(empty) == "Problem(memory: 0 images, 0 cameras, 0 points, 0 observations)"
