"""Axes of the accelerometer: which of 24 explain the path, on both sides of each bound."""

from typing import Any

import numpy as np
import pytest

from bundle.inertial.offline import rotation_map as module
from bundle.inertial.offline.inertial_start import InertialStart
from bundle.inertial.vio.window_frame import ImuInterval

TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
FORCES = np.array([1.0, 2.0, 4.0])


@pytest.fixture
def starts(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the axes for starts with (rms, scale, sigma of the scale) of the given and of TURN."""

    def axes_for(given: tuple[float, float, float], turned: tuple[float, float, float]) -> Any:
        seen = []

        def start(*arguments: Any) -> InertialStart:
            forces = arguments[3][0].accel[0]
            seen.append(forces)
            rms, scale, sigma = 1.0, 1.0, 0.01
            for axes, values in ((np.eye(3), given), (TURN, turned)):
                if np.array_equal(forces, axes @ FORCES):
                    rms, scale, sigma = values
            zeros = np.zeros(3)
            return InertialStart(scale, sigma, zeros, zeros, zeros, zeros, rms)

        monkeypatch.setattr(module, "gyro_bias", lambda *_: np.zeros(3))
        monkeypatch.setattr(module, "solve_inertial_start", start)
        interval: Any = ImuInterval(np.zeros((1, 3)), FORCES[None], np.ones(1))
        rotations = np.tile(np.eye(3), (2, 1, 1))
        found = module.accel_axes(rotations, *2 * [rotations[:, 0]], [interval], *3 * [None])  # type: ignore[arg-type]
        columns = [np.abs(each).argsort() for each in seen]
        assert len({tuple(each) for each in seen}) == 24
        for forces, order in zip(seen, columns, strict=True):  # right-handed, by the signs
            axes = np.zeros((3, 3))
            axes[order, range(3)] = np.sign(forces[order])
            assert np.linalg.det(axes) == pytest.approx(1)
        assert found is None or found[1].rms == given[0]
        return None if found is None else found[0]

    return axes_for


@pytest.mark.parametrize(
    ("given", "turned", "axes"),
    [
        ((1.0, 1.0, 0.01), (0.49, 1.0, 0.01), TURN),
        ((1.0, 1.0, 0.01), (0.51, 1.0, 0.01), None),
        ((1.0, -2.0, 0.01), (0.9, 1.0, 0.01), TURN),
        ((1.0, 1.0, 0.01), (0.4, 1.0, 0.11), None),
        ((1.0, 1.0, 0.01), (0.4, 1.0, 0.09), TURN),
        ((1.0, 1.0, 0.01), (0.4, -1.0, 0.01), -TURN),
        ((0.1, -2.0, 0.01), (1.0, 1.0, 0.01), -np.eye(3)),
        ((0.1, 2.0, 0.01), (1.0, 1.0, 0.01), None),
    ],
)
def test_axes_that_explain_the_path(starts: Any, given: Any, turned: Any, axes: Any) -> None:
    found = starts(given, turned)
    assert (found is None) == (axes is None)
    assert axes is None or np.array_equal(found, axes)
