"""Rolling shutters given by options: directions, readouts and twists, camera by camera."""

import numpy as np
import pytest

import bundle
from bundle.editing.rolling_shutters import FIRST_READOUT, with_shutters
from bundle.interface.camera_edit_options import ShutterOptions
from tests import scenes

OPTIONS = bundle.SolveOptions()
TIED = bundle.SolveOptions(twists="tied", twist_sigma=(0.01, 0.02))


@pytest.fixture
def problem():
    """Four images of three cameras; a fourth camera has none."""
    made = scenes.make_problem(num_images=4, num_points=10)
    return made.replace(image_camera=np.array([0, 0, 1, 2], np.int32))


@pytest.fixture
def rolling(problem):
    """Cameras with rows, columns and a global shutter; twists by image."""
    twist = np.arange(24.0).reshape(4, 6) + 1
    twist[3] = 0
    shutter = bundle.RollingShutter(
        direction=("rows", "columns", "global", "rows"),
        readout=[0.3, np.nan, np.nan, 0.4],
        twist=twist,
        frame_rate=25.0,
    )
    return problem.replace(rolling_shutter=shutter)


def shutter_of(problem, options=OPTIONS, **given):
    edited, options = with_shutters(problem, ShutterOptions(**given), options)
    return edited.rolling_shutter, options


def test_without_options_nothing_changes(rolling):
    assert with_shutters(rolling, ShutterOptions(), OPTIONS) == (rolling, OPTIONS)


def test_cameras_without_images_stay_global(problem):
    shutter, _ = shutter_of(problem, rolling_shutter="columns")
    assert shutter.direction == ("columns",) * 3 + ("global",)
    assert not shutter.twist.any() and np.isnan(shutter.readout).all()


def test_twists_of_the_same_direction_stay(rolling):
    shutter, _ = shutter_of(rolling, rolling_shutter="rows")
    assert shutter.direction == ("rows", "rows", "rows", "global")
    before = rolling.rolling_shutter.twist
    np.testing.assert_array_equal(shutter.twist[:2], before[:2])
    assert not shutter.twist[2:].any()
    np.testing.assert_array_equal(shutter.readout, [0.3, np.nan, np.nan, np.nan])
    assert shutter.frame_rate == 25.0


def test_global_shutters_leave_none(rolling):
    assert shutter_of(rolling, rolling_shutter="global")[0] is None


@pytest.mark.parametrize(
    ("given", "rate", "share"),
    [("0.25", 0, 0.25), ("1", 0, 1.0), ("0.02", 25, 0.5), ("0.04", 25, 1.0)],
)
def test_a_readout_is_a_share_or_seconds(rolling, given, rate, share):
    more = {"frame_rate": rate} if rate else {}
    shutter, options = shutter_of(rolling, readout=given, **more)
    np.testing.assert_allclose(shutter.readout, [share, share, np.nan, share], rtol=1e-15)
    assert options is OPTIONS
    assert shutter.frame_rate == 25.0


@pytest.mark.parametrize(
    ("given", "rate", "words"),
    [
        ("1.0000001", 0, "at most 1,"),
        ("0", 0, "above 0"),
        ("-0.1", 0, "above 0"),
        ("0.0400001", 25, "seconds above 0 and at most 0.04 seconds"),
        ("nan", 0, "readout: expected"),
    ],
)
def test_other_readouts_are_refused(rolling, given, rate, words):
    more = {"frame_rate": rate} if rate else {}
    with pytest.raises(bundle.InputError, match=words):
        shutter_of(rolling, readout=given, **more)


def test_an_estimate_starts_at_the_input_or_at_a_half(rolling):
    shutter, options = shutter_of(rolling, TIED, readout="estimate")
    np.testing.assert_array_equal(shutter.readout, [0.3, FIRST_READOUT, np.nan, 0.4])
    assert options.refine_readout and not OPTIONS.refine_readout
    assert FIRST_READOUT == 0.5


def test_a_rate_and_a_row_time_are_taken_over(rolling):
    shutter, _ = shutter_of(rolling, frame_rate=30.0, row_time="observed")
    assert (shutter.frame_rate, shutter.row_time) == (30.0, "observed")
    np.testing.assert_array_equal(shutter.twist, rolling.rolling_shutter.twist)


def test_without_a_shutter_there_is_none_to_change(problem):
    with pytest.raises(bundle.InputError, match=r"^readout: expected a rolling shutter"):
        shutter_of(problem, readout="0.5")
