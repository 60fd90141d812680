"""Imports by public names, and pickles of what users keep."""

import importlib
import operator
import pickle

import numpy as np
import pytest

import bundle
from tests.campaigns import resumes
from tests.rig_scenes import rig_problem

RULES = bundle.Constraints("cameras *: f prior 2 %", "image 1: rotation fixed")
POSE, MOVED = np.array([0, 0, 0, 1.0, 0, 0, 0]), np.array([0, 0, 0, 1.0, 1, 0, 0])
"""Two poses."""


@pytest.fixture(scope="module")
def held():
    """Objects of all kinds that users keep in pickles."""
    scene = resumes.make_scene(40)
    factor = bundle.PositionFactor(("image", 1), scene.projection_centers[0], 1e4)
    known = {"factors": [factor], "constraints": RULES}
    solved = bundle.solve_rounds(scene, num_rounds=1, max_num_iterations=3, **known)
    part = {"only_images": "1-3", "rest": "marginal", "num_rounds": 0}
    poses = bundle.PoseGraph(
        poses=np.stack([POSE, MOVED]),
        edges=np.array([(0, 1)], np.int32),
        measurements=MOVED[None],
        information=np.eye(6)[None],
    )
    graph = bundle.FactorGraph()
    graph.add_variable("a", POSE, "se3")
    graph.add_factor(bundle.PriorFactor("a", POSE, 1.0))
    noise = bundle.ImuNoise(1e-3, 1e-2, 1e-4, 1e-3)
    linear = bundle.LinearPrior(np.eye(3), np.zeros(3), {("p", 1): np.zeros(3)}, (("p", 1),))
    flight = bundle.synthesize_flight(duration=4.0, num_tracks=40)
    return [
        scene,
        rig_problem(),
        bundle.SolveOptions(loss="cauchy"),
        bundle.PoseGraphOptions(),
        bundle.SceneOptions(),
        bundle.FlightOptions(),
        bundle.WindowOptions(),
        bundle.PositionPrior("a.jpg", (1, 2, 3), (1, 2)),
        bundle.GroundControlPoint(name="a", position=(1, 2, 3), measurements=[("a", 1.0, 2.0)]),
        RULES,
        solved,
        solved.summary,
        solved.gauge_freedom,
        bundle.solve_rounds(scene, max_num_iterations=2, **part),
        bundle.Solver(scene, **known),
        bundle.covariance(scene, of="poses", **known),
        bundle.diagnose(scene),
        bundle.filter_observations(scene),
        bundle.describe(scene),
        bundle.describe(rig_problem()),
        bundle.inspect(scene),
        bundle.check_jacobians(scene),
        bundle.check_factors(scene, [factor]),
        bundle.change_camera_model(scene, "OPENCV"),
        bundle.to_global_shutter(
            bundle.synthesize(
                scene="orbit", num_images=3, num_points=50, rolling_shutter=0.5
            ).problem
        ),
        factor,
        linear,
        linear.spectrum,
        bundle.BetweenFactor("a", "b", MOVED, 1.0),
        bundle.ScalarPriorFactor("a", 0, 1.0, 1.0),
        bundle.FunctionFactor(("a",), operator.neg),
        graph,
        graph.solve(),
        poses,
        bundle.solve(poses),
        bundle.covariance(poses),
        bundle.diagnose(poses),
        bundle.inspect(poses),
        bundle.compare(poses),
        bundle.Preintegration(noise),
        noise,
        flight,
        bundle.run_odometry(flight.sequence),
    ]


def test_pickles_load(held):
    for value in held:
        loaded = pickle.loads(pickle.dumps(value))
        assert type(loaded) is type(value)
        assert repr(loaded) == repr(value)
        assert pickle.dumps(loaded)


@pytest.mark.parametrize("name", sorted(bundle._MODULES))
def test_public_modules_are_the_modules_themselves(name):
    module = importlib.import_module(f"bundle.{bundle._MODULES[name]}")
    assert importlib.import_module(f"bundle.{name}") is module
    assert module.__spec__.name == f"bundle.{bundle._MODULES[name]}"


def test_modules_below_public_ones_are_loaded_once():
    rules = importlib.import_module("bundle.constraints.rules")
    assert rules is importlib.import_module("bundle.solving.constraints.rules")
    assert importlib.import_module("bundle.html.page").__name__ == "bundle.reports.page.page"


def test_other_names_are_no_modules():
    for name in ("nowhere", "constraints.nowhere", "georeference.nowhere", "constraints_"):
        with pytest.raises(ModuleNotFoundError):
            importlib.import_module(f"bundle.{name}")
