"""The example of a filter beside a smoother: known numbers, fill, nullities and consistency."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import bundle

FOLDER = Path(__file__).parents[2] / "examples" / "filter_or_smoother"


@pytest.fixture(scope="module")
def example() -> ModuleType:
    name = "filter_or_smoother"
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where its dataclasses look for themselves
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("start", "estimate", "sigma"),
    [
        (1.0, 6.811388, 0.632),
        (0.7, 9.147, 0.880),
        (0.3, 20.2494, 2.010),
        (8.0, 4.215, 0.214),
        (9.0, 4.270, 0.211),
    ],
)
def test_one_range_by_a_filter(
    example: ModuleType, start: float, estimate: float, sigma: float
) -> None:
    found, reported = example.filter_range(start)
    assert found == pytest.approx(estimate, abs=5e-4)
    assert reported == pytest.approx(sigma, abs=5e-4 if sigma < 2 else 5e-3)


def test_one_range_by_a_smoother(example: ModuleType) -> None:
    found, sigma = example.smooth_range(1.0)
    np.testing.assert_allclose(found, [6.811388, 4.142168, 4.000859, 4.0], atol=1e-6)
    assert sigma == pytest.approx(0.25, abs=1e-6)
    wrong, reported = example.filter_range(1.0)
    assert (wrong - 4) / reported == pytest.approx(4.45, abs=5e-3)


def test_a_filter_fills_its_covariance(example: ModuleType) -> None:
    assert example.memory_of_filter(500) == (124_750, 998_000, 8 * 1003**2)
    found = example.fill()
    pairs = example.LANDMARKS * (example.LANDMARKS - 1) // 2
    assert found["pairs"] == pairs
    assert found["covariance"] == (3 + 2 * example.LANDMARKS) ** 2
    assert found["information"] < 0.1 * found["size"] ** 2


def test_the_jacobians_of_the_example_are_derivatives(example: ModuleType) -> None:
    loop = example.drive(0)
    graph = example.smoother(loop, example.run_filter(loop))
    (sight, *_) = (f for f in graph.factors if isinstance(f, bundle.FunctionFactor))
    assert graph.check_gradients(sight)
    pose, step, landmark = np.array([1.0, 2, 0.4]), np.array([0.5, 0.1, 0.2]), np.array([3.0, 1])
    by_pose, by_step = example.step_jacobians(pose, step)
    of_pose, of_landmark = example.sight_jacobians(pose, landmark)

    def sight_of(pose: np.ndarray, landmark: np.ndarray) -> np.ndarray:
        return example.turn(pose[2]).T @ (landmark - pose[:2])

    for function, at, jacobian in (
        (lambda x: example.moved(x, step), pose, by_pose),
        (lambda x: example.moved(pose, x), step, by_step),
        (lambda x: sight_of(x, landmark), pose, of_pose),
        (lambda x: sight_of(pose, x), landmark, of_landmark),
    ):
        steps = 1e-6 * np.eye(len(at))
        numeric = [(function(at + d) - function(at - d)) / 2e-6 for d in steps]
        np.testing.assert_allclose(np.transpose(numeric), jacobian, atol=1e-8)


def test_a_filter_loses_the_yaw(example: ModuleType) -> None:
    loop = example.drive(0)
    assert example.nullity(example.rows_at_one_point(loop)) == 3
    assert example.nullity(example.run_filter(loop).rows) == 2


def test_a_smoother_is_consistent_where_a_filter_is_not(
    example: ModuleType, tmp_path: Path
) -> None:
    found = example.consistency(20)
    # 99 % of the means of 20 chi-squared of 3 degrees are within 1.77 and 4.60.
    assert 1.77 < found["smoother"].mean() < 4.60
    late = slice(example.LAP + 2, None)
    assert found["filter"][:, late].mean() > 8
    rms = np.sqrt((found["yaw_error"][:, late] ** 2).mean())
    assert rms > 1.5 * found["yaw_sigma"][:, late].mean()
    pytest.importorskip("matplotlib")
    example.draw(found, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
