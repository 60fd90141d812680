"""Tables as pandas.DataFrame: against loops over the arrays."""

import sys

import numpy as np
import pytest

import bundle
from tests import scenes


@pytest.fixture
def problem() -> bundle.Problem:
    return scenes.make_problem(num_images=4, num_points=20, model="OPENCV", track=3)


def test_observations(problem) -> None:
    frame = problem.to_dataframe()
    assert len(frame) == problem.num_observations
    errors, behind = bundle.reprojection_errors(problem)
    np.testing.assert_allclose(frame["error"], errors, rtol=1e-12)
    np.testing.assert_allclose(np.hypot(frame["residual_x"], frame["residual_y"]), errors)
    row = frame.iloc[7]
    image = problem.observation_image[7]
    assert row["image_id"] == problem.image_ids[image] and row["camera_id"] == image + 1
    assert (row[["x", "y"]] == problem.observation_xy[7]).all() and not behind.any()
    weighted = problem.replace(observation_sigma=np.full(problem.num_observations, 2.0))
    assert (weighted.to_dataframe()["sigma"] == 2).all()


@pytest.mark.parametrize(
    ("table", "column", "owner"),
    [("points", "point_id", "point_id"), ("images", "image_id", "image_id"), ("cameras",) * 3],
)
def test_grouped_by_owner(problem, table, column, owner) -> None:
    if table == "cameras":
        column = owner = "camera_id"
    frame = problem.to_dataframe(table).set_index(column)
    grouped = problem.to_dataframe().groupby(owner)["error"]
    assert (frame["num_observations"] == grouped.count()).all()
    np.testing.assert_allclose(frame["rmse"], np.sqrt(grouped.apply(lambda e: (e**2).mean())))
    np.testing.assert_allclose(frame["max_error"], grouped.max())


def test_images_and_cameras(problem) -> None:
    images, cameras = problem.to_dataframe("images"), problem.to_dataframe("cameras")
    assert images["name"].tolist() == list(problem.image_names)
    np.testing.assert_array_equal(
        images[["center_x", "center_y", "center_z"]], problem.projection_centers
    )
    mixed = problem.replace(
        camera_models=["SIMPLE_PINHOLE", *["OPENCV"] * 3],
        camera_params=[[800.0, 400, 300, *[0.0] * 5], *problem.camera_params[1:]],
    ).to_dataframe("cameras")
    assert mixed["f"].isna().tolist() == [False, True, True, True]
    assert cameras["fx"].tolist() == problem.camera_params[:, 0].tolist()
    with pytest.raises(bundle.InputError, match="table: expected one of observations, "):
        problem.to_dataframe("tracks of animals")


def test_a_point_without_observations(problem) -> None:
    alone = scenes.with_observations(problem, problem.observation_point > 0)
    row = alone.to_dataframe("points").iloc[0]
    assert row["num_observations"] == 0 and np.isnan(row["rmse"]) and np.isnan(row["max_error"])


def test_iterations_and_covariances(problem) -> None:
    result = bundle.solve(problem)
    frame = result.to_dataframe()
    assert frame["cost"].tolist() == list(result.iterations["cost"])
    assert len(result.to_dataframe("points")) == problem.num_points
    covariance = bundle.covariance(result)
    for block, count in (("points", 20), ("poses", 4), ("cameras", 4), ("relative", 0)):
        assert len(covariance.to_dataframe(block)) == count
    sigma = covariance.to_dataframe("points")
    expected = np.sqrt(covariance.point(sigma["point_id"][3])[1, 1])
    assert sigma["sigma_y"][3] == pytest.approx(expected)
    assert list(covariance.to_dataframe("poses"))[:3] == ["image_id", "sigma_wx", "sigma_wy"]


def test_pandas_is_an_extra(problem, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(bundle.InputError, match=r"install bundle-adjust\[tables\]"):
        problem.to_dataframe()
