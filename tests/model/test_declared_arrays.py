"""Every array that a class declares: each way to break it is refused in one line.

The tables of the classes say what is refused. A class with a table needs a valid object here.
"""

import dataclasses
import importlib
import re
from pathlib import Path

import numpy as np
import pytest

import bundle
from bundle.base.arrays import VALUES, Array, Index, as_declared, at, check_distinct, refuse_row
from bundle.io.sequences.trajectory_files import Trajectory
from bundle.model.pose_table import PoseTable
from bundle.model.problem import ARRAYS
from tests.graphs.pose_graphs import graphs
from tests.inertial.vio.test_sequence_folder import sequence
from tests.model.test_rolling_shutter import problem_of
from tests.rig_scenes import rig_problem

ROOT = Path(bundle.__file__).parent
POSES = np.tile([0.0, 0, 0, 1, 1, 2, 3], (4, 1))
OBJECTS = {
    "Problem": lambda: rig_problem(num_frames=2, num_alone=2, num_points=20, seed=1),
    "PoseGraph": lambda: graphs.loop(3),
    "PoseTable": lambda: PoseTable(POSES, timestamps_ns=np.arange(4)),
    "RollingShutter": lambda: problem_of().rolling_shutter,
    "Sequence": sequence,
    "Trajectory": lambda: Trajectory(np.arange(3), np.ones((3, 16))),
    "TrackRows": lambda: bundle.TrackRows(np.ones(4), np.ones((4, 6)), np.ones((4, 3))),
}


def classes():
    """Return the tables of the package by the name of their class."""
    found = {"Problem": ARRAYS}
    for path in ROOT.rglob("*.py"):
        if "_ARRAYS = " in path.read_text():
            parts = ("bundle", *path.relative_to(ROOT).with_suffix("").parts)
            for one in vars(importlib.import_module(".".join(parts))).values():
                if isinstance(one, type) and "_ARRAYS" in vars(one):
                    found[one.__name__] = one._ARRAYS
    return found


TABLES = classes()


def test_every_table_has_an_object():
    assert set(OBJECTS) == set(TABLES)
    for name, make in OBJECTS.items():
        assert {field.name for field in dataclasses.fields(make())} >= set(TABLES[name])


def wrong_numbers(array, declared):
    """Yield (what, array) for each kind of wrong numbers."""
    values = declared.values
    if array.dtype.kind == "f":
        kinds = {"finite": (np.nan, np.inf), "pose": (np.nan, -np.inf), "finite or nan": (np.inf,)}
        for number in kinds.get(values, {"share or nan": (0.0, 1.5)}.get(values, ())):
            yield f"{number:g}", changed(array, -1, number)
    if values == "pose" and array.shape[1] == 7:
        broken = array.copy()
        broken[-1, :4] = 0
        yield "norm 0", broken
    if values in ("at least 0", "whole"):
        yield "-3", changed(array, -1, -3)
    if isinstance(values, Index):
        yield "below", changed(array, -1, values.lowest - 1)
        yield "above", changed(array, -1, 1 << 20)


def changed(array, place, number):
    broken = array.copy()
    broken.flat[place] = number
    return broken


def cases():
    for kind, make in OBJECTS.items():
        made = make()
        for name, declared in TABLES[kind].items():
            array = np.asarray(getattr(made, name))
            if array.size:
                yield kind, name, "short", array[:-1]
                yield kind, name, "deep", array[None]
                yield kind, name, "text", np.full(array.shape, "x")
                for what, broken in wrong_numbers(array, declared):
                    yield kind, name, what, broken


CASES = list(cases())
LEADERS = {
    *(
        ("PoseTable", "poses"),
        ("PoseGraph", "poses"),
        ("PoseGraph", "edges"),
        ("Sequence", "imu_timestamps_ns"),
    ),
    *(("Sequence", "track_timestamps_ns"), ("RollingShutter", "twist")),
    *(("Trajectory", "timestamps_ns"), ("TrackRows", "innovation")),
}
"""Arrays that fix a size; a shorter one is another valid size, and other arrays do not fit."""


@pytest.mark.parametrize(
    ("kind", "name", "what", "broken"), CASES, ids=[" ".join(case[:3]) for case in CASES]
)
def test_what_breaks_a_declaration_is_refused(kind, name, what, broken):
    made = OBJECTS[kind]()
    with pytest.raises(bundle.InputError) as error:
        dataclasses.replace(made, **{name: broken})
    text = str(error.value)
    assert len(text.splitlines()) == 1
    assert "expected" in text and "found" in text, text
    if what == "text" or (kind != "Problem" and what in ("deep", "norm 0")):
        assert name in text, text
    if what == "short" and kind != "Problem" and (kind, name) not in LEADERS:
        assert re.search(rf"{name}: expected shape .*, found \(", text), text


def test_there_are_cases_of_each_kind():
    kinds = {what for _, _, what, _ in CASES}
    assert kinds >= {"short", "deep", "text", "nan", "inf", "norm 0", "below", "above", "1.5", "-3"}
    assert len(CASES) > 120


@pytest.mark.parametrize(
    ("declared", "value", "message"),
    [
        (Array(("n", 3)), [1.0, 2], r"x: expected shape \(n, 3\), found \(2,\)"),
        (Array((3,)), [1.0, 2], r"x: expected shape \(3,\), found \(2,\)"),
        (Array((3,), "finite"), [1, np.nan, 2], r"x: expected finite numbers, found \[1.0, nan"),
        (Array(("n", 2), "above 0"), [[1, 2], [0, 1]], r"x\[1\]: expected numbers above 0, found"),
        (Array(("n",), "not nan"), [1, np.nan], "x: expected numbers, found nan"),
        (Array((4,), "quaternion"), [0, 0, 0, 0], "x: expected a quaternion qx qy qz qw, found n"),
        (Array(("n",), Index("m"), np.int64), [0, 4], "x: expected indices from 0 to 3, found 4"),
        (Array(("m",)), [1.0], r"x: expected shape \(4,\), found \(1,\)"),
    ],
)
def test_messages(declared, value, message):
    with pytest.raises(bundle.InputError, match=f"^{message}"):
        as_declared("x", value, declared, {"m": 4})


def test_valid_arguments_pass_and_fix_sizes():
    sizes = {}
    values = [[1.0, 2], [3, 4], [5, 6]]
    np.testing.assert_array_equal(
        as_declared("x", values, Array(("n", 2), "finite"), sizes), values
    )
    assert sizes["n"] == 3
    assert as_declared("x", [2, 0], Array(("k",), Index("n"), np.int64), sizes).dtype == np.int64
    assert as_declared("x", np.zeros((0, 7)), Array(("n", 7), "pose")).shape == (0, 7)
    for name, (_, test) in VALUES.items():
        assert np.all(test(np.array([0.5]))), name


def test_refused_rows_names_and_places():
    refuse_row([False, False], lambda row: f"row {row}")
    with pytest.raises(bundle.InputError, match=r"^row 1$"):
        refuse_row([False, True, True], lambda row: f"row {row}")
    check_distinct("names: expected each once", ["a", "b"])
    with pytest.raises(bundle.InputError, match=r"^names: expected each once, found 'a' twice$"):
        check_distinct("names: expected each once", ["a", "b", "a"])
    with pytest.raises(bundle.InputError, match=r"^file: line 3: wrong$"), at("file"), at("line 3"):
        raise bundle.InputError("wrong")
    with pytest.raises(bundle.InputError, match=r"^file: bad$"), at("file", ValueError):
        raise ValueError("bad")
    with pytest.raises(ValueError, match=r"^bad$"), at("file"):
        raise ValueError("bad")
