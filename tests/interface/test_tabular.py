"""Every public result with a table has `to_dataframe`; tables have a row per record."""

import dataclasses
import inspect
import re
import sys

import numpy as np
import pandas
import pytest

import bundle
from bundle.interface.tabular import Tabular, columns_of, has_records
from tests import scenes

NO_RESULTS = {"GroundControlPoint", "Constraints", "ChangedModels"}
"""Classes with lists of records that are inputs, or sentences on a change."""


def public_classes():
    found = [getattr(bundle, name) for name in bundle.__all__]
    return [one for one in found if inspect.isclass(one) and dataclasses.is_dataclass(one)]


def test_no_table_is_forgotten() -> None:
    with_tables = [
        one for one in public_classes() if any(map(has_records, dataclasses.fields(one)))
    ]
    names = {one.__name__ for one in with_tables}
    assert {"Result", "Comparison", "Inspection", "Validation", "OdometryResult"} <= names
    missing = {one.__name__ for one in with_tables if not hasattr(one, "to_dataframe")}
    assert missing == NO_RESULTS & names
    for name in ("Problem", "Covariance", "GraphCovariance", "FactorGraphCovariance", "PoseGraph"):
        assert callable(getattr(bundle, name).to_dataframe), name


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict[str, object]:
    folder = tmp_path_factory.mktemp("tables")
    (folder / "g.g2o").write_text(scenes.SQUARE)
    problem = scenes.make_problem(num_images=5, num_points=60, model="SIMPLE_RADIAL", track=4)
    bundle.save(problem, folder / "in", "colmap")
    graph = bundle.load(folder / "g.g2o")
    solved = bundle.solve(graph)
    result = bundle.solve(problem)
    return {
        "Result": result,
        "PoseGraph": graph,
        "PoseGraphResult": solved,
        "Inspection": bundle.inspect(problem),
        "Comparison": bundle.compare(problem, solvers=["dense_schur"], repeat=1),
        "Description": bundle.describe(problem),
        "Diagnosis": bundle.diagnose(problem),
        "Evaluation": bundle.evaluate(result.problem, problem),
        "Validation": bundle.validate(problem, num_folds=2, camera_models=["SIMPLE_RADIAL"]),
        "FactorGraphInspection": bundle.inspect(graph),
        "GradientReport": bundle.check_jacobians(problem),
    }


def test_each_table_is_a_frame_with_a_row_per_record(results) -> None:
    for name, result in results.items():
        assert type(result).__name__ == name and isinstance(result, Tabular)
        for table, columns in result._tables().items():
            frame = result.to_dataframe(table)
            assert isinstance(frame, pandas.DataFrame), (name, table)
            assert list(frame) == list(columns)
            for column, values in columns.items():
                assert len(frame[column]) == len(values)
        first = next(iter(result._tables()))
        pandas.testing.assert_frame_equal(result.to_dataframe(), result.to_dataframe(first))
        with pytest.raises(bundle.InputError, match="table: expected one of "):
            result.to_dataframe("tracks of animals")


def test_values(results) -> None:
    iterations = results["PoseGraphResult"].to_dataframe()
    assert iterations["cost"].iloc[-1] == pytest.approx(
        results["PoseGraphResult"].summary.final_cost
    )
    runs = results["Comparison"].to_dataframe("runs")
    assert len(runs) == len(results["Comparison"].runs) > 0
    images = results["Evaluation"].to_dataframe("images")
    np.testing.assert_array_equal(images["position"], results["Evaluation"].position_errors)
    poses = results["PoseGraph"].to_dataframe("poses")
    np.testing.assert_array_equal(poses[["x", "y", "angle"]], results["PoseGraph"].poses)
    edges = results["PoseGraph"].to_dataframe("edges")
    assert edges[["pose_id_a", "pose_id_b"]].to_numpy().tolist() == [[0, 1], [1, 2], [2, 0]]
    covariance = bundle.covariance(results["PoseGraph"], relative=[(0, 2)])
    sigmas = covariance.to_dataframe()
    assert [*sigmas] == ["pose_id", "sigma_x", "sigma_y", "sigma_angle"]
    expected = np.sqrt(np.diag(covariance.pose(2)))
    np.testing.assert_allclose(sigmas.iloc[2, 1:].to_numpy(float), expected)
    relative = covariance.to_dataframe("relative")
    assert [*relative][:3] == ["pose_id_a", "pose_id_b", "sigma_x"]
    with pytest.raises(bundle.InputError, match=r"^block: expected one of poses, relative"):
        covariance.to_dataframe("points")
    assert relative.iloc[0, :2].tolist() == [0, 2]


def test_covariance_of_a_factor_graph() -> None:
    graph = bundle.FactorGraph()
    graph.add_variable("x", [1.0, 2.0])
    graph.add_factor(bundle.PriorFactor("x", [0.0, 0.0], np.diag([4.0, 25.0])))
    frame = bundle.covariance(graph).to_dataframe()
    assert frame["key"].tolist() == ["x", "x"] and frame["coordinate"].tolist() == [0, 1]
    np.testing.assert_allclose(frame["sigma"], [0.5, 0.2])
    assert graph.solve().to_dataframe("iterations")["cost"].iloc[-1] < 1e-12


def test_odometry() -> None:
    found = bundle.run_odometry(bundle.synthesize_flight(duration=3.0, seed=1).sequence)
    frame, keyframes = found.to_dataframe(), found.keyframes
    assert len(frame) == len(keyframes) > 2
    names = ("timestamp_ns", "num_landmarks", "num_iterations", "nullity", "prior_max_eigenvalue")
    for name in names:
        expected = [getattr(one, name) for one in keyframes]
        np.testing.assert_array_equal(frame[name].to_numpy(), expected, err_msg=name)
    assert len(set(frame["num_landmarks"])) > 1  # each row is of its own keyframe
    np.testing.assert_array_equal(
        np.stack(frame["gyro_bias"].tolist()), [one.gyro_bias for one in keyframes]
    )
    assert frame["timestamp_ns"].is_monotonic_increasing


def test_empty_tables_and_a_machine_without_pandas(results, monkeypatch) -> None:
    assert columns_of(()) == {}
    assert re.search("rounds", str(results["Result"]._tables().keys()))
    assert len(results["Result"].to_dataframe("rounds")) == 0
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(bundle.InputError, match=r"install bundle-adjust\[tables\]"):
        results["Inspection"].to_dataframe()
