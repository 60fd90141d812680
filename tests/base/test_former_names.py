"""Pickles of before the modules moved to their rooms, and imports by public names."""

import importlib
import io
import operator
import pickle
import pickletools

import numpy as np
import pytest

import bundle
from bundle.base.former_names import FORMER
from tests.campaigns import resumes
from tests.rig_scenes import rig_problem

STAYED = ("checking", "errors", "georeference", "synthetic", "_core")
"""Rooms, and the core, whose modules have the names of before."""

NEW = (
    "graphs.factors.attitude_factors",
    *("graphs.factors.factor_report", "planning.inspection.elimination_costs"),
    "planning.inspection.factor_graph_inspection",
    "analysis.diagnosis.chi2_kinds",
    *("interface.triage_options", "judging.triage.cause_words", "judging.triage.triage_result"),
    *("interface.evaluate_options", "interface.finding", "judging.evaluation.check_points"),
    *("judging.evaluation.evaluation_result", "judging.validation.validation_result"),
    *("graphs.pose_graphs.certificate", "interface.progress_bar", "io.formats.registry"),
    *("model.pose_table", "model.rolling_shutter", "model.selection", "interface.environment"),
    *("solving.request", "editing.global_shutter"),
    *("inertial.tracking.track_images", "inertial.tracking.track_recording"),
    "interface.tracking_options",
)
"""Modules of classes that were not there before."""

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


def former(value):
    """Return the pickle of a value as it was written before the modules moved."""
    written = pickle.dumps(value, protocol=3)  # whose modules stand in lines of their own
    for name, place in FORMER.items():
        written = written.replace(f"cbundle.{place}\n".encode(), f"cbundle.{name}\n".encode())
    return written


def named_modules(written):
    """Return the modules of the package that a pickle names."""
    found = (str(argument).split(" ")[0] for _, argument, _ in pickletools.genops(written))
    return {name for name in found if name.startswith("bundle.")}


def test_pickles_of_before_the_move_load(held):
    places = set()
    for value in held:
        written = former(value)
        places |= named_modules(pickle.dumps(value, protocol=3))
        loaded = pickle.loads(written)
        assert type(loaded) is type(value)
        assert not named_modules(written) & {f"bundle.{place}" for place in FORMER.values()}
        assert repr(loaded) == repr(value)
        assert pickle.dumps(loaded, protocol=3)
    moved = {name.removeprefix("bundle.") for name in places}
    moved = {name for name in moved if name.split(".")[0] not in STAYED}
    assert moved <= {*FORMER.values(), *NEW}, "classes that no former name leads to"


@pytest.mark.parametrize("name", sorted(FORMER))
def test_former_names_are_the_modules_themselves(name):
    module = importlib.import_module(f"bundle.{FORMER[name]}")
    if name == "inertial.preintegration":  # now a package, which serves its former class
        old = importlib.import_module(f"bundle.{name}")
        assert old.Preintegration is bundle.Preintegration
        assert old._restored is module._restored
        return
    assert importlib.import_module(f"bundle.{name}") is module
    assert module.__spec__.name == f"bundle.{FORMER[name]}"


@pytest.mark.parametrize("name", sorted(n for n in bundle.__all__ if n[0].isupper()))
def test_public_classes_have_a_former_name_or_stayed(name):
    place = getattr(bundle, name).__module__.removeprefix("bundle.")
    assert place in {*FORMER.values(), *NEW} or place.split(".")[0] in STAYED


def test_a_covariance_of_before_there_were_requests_computes_relative_poses():
    scene = resumes.make_scene(40)
    factors = (bundle.PositionFactor(("image", 1), scene.projection_centers[0], 1e4),)
    given = {"bounds": None, "priors": (), "factors": factors}
    now = bundle.covariance(scene, of="poses", scale="sigma0", constraints=RULES, **given)
    recipe = now._relative.__self__
    before = object.__new__(type(recipe))
    before.__setstate__(
        {
            **given,
            **{"given": scene, "options": recipe.request.options, "constraints": RULES},
            **{"of": ("poses",), "gauge": "inner", "scale": "sigma0", "robust": "weights"},
        }
    )
    found = before.compute([(1, 3)]).relative_covariance[0]
    np.testing.assert_array_equal(found, now.relative(1, 3))


def test_the_functions_that_pickles_call_are_where_they_were():
    assert importlib.import_module("bundle.problem")._unpacked
    assert importlib.import_module("bundle.solver")._make_solver


def test_modules_below_public_ones_are_loaded_once():
    rules = importlib.import_module("bundle.constraints.rules")
    assert rules is importlib.import_module("bundle.solving.constraints.rules")
    assert importlib.import_module("bundle.html.page").__name__ == "bundle.reports.page.page"


def test_names_that_never_were_are_no_modules():
    for name in ("nowhere", "constraints.nowhere", "graph.nowhere"):
        with pytest.raises(ModuleNotFoundError):
            importlib.import_module(f"bundle.{name}")
    with pytest.raises(ModuleNotFoundError):
        pickle.load(io.BytesIO(b"cbundle.graph.nowhere\nX\n."))
