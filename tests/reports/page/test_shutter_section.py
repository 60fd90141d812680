"""The page's section on rolling shutters: what it says and draws is what the solve found."""

import json

import numpy as np
import pytest

import bundle
from bundle.figures.residual_field import twist_figures
from bundle.reports.page.report_page import write_report
from bundle.solving.parameter_changes import shutter_gain
from tests.campaigns.rolling_shutter import make
from tests.reports.page.reader import Page

SMALL = {"num_images": 10, "num_points": 120}


@pytest.fixture(scope="module")
def filmed():
    return make(0, 5, **SMALL).problem


def written(result, tmp_path):
    write_report(result, tmp_path / "page.html")
    page = Page(tmp_path / "page.html")
    return page, json.loads(page.scripts[0])


@pytest.mark.parametrize("ties", [False, True])
def test_readouts_twists_and_errors_are_those_of_the_solve(filmed, ties, tmp_path):
    given = {"twists": "tied", "twist_sigma": (0.01, 0.01), "refine_readout": True} if ties else {}
    solved = bundle.solve(filmed, gauge="two-cameras", refine=("poses", "points"), **given)
    page, data = written(solved, tmp_path)
    found, gain = data["rolling_shutter"], shutter_gain(solved)
    (camera,) = found["cameras"]
    assert camera["readout"] == solved.problem.rolling_shutter.readout[0]
    assert (camera["readout_sigma"] is not None) == ties
    assert found["rmse"] == gain.rmse < 0.2 * found["rmse_global_shutter"]
    assert found["twist_rms"] == {"rotation": gain.turn, "translation": gain.shift}
    if ties:
        assert f"{camera['readout']:.4g} +- {camera['readout_sigma']:.2g}" in page.text
    assert "Rolling shutter" in page.text
    assert set(data["rows"]) == {"before", "after"}


def test_lines_are_the_twists_in_the_order_of_the_frames(filmed):
    rng = np.random.default_rng(0)
    shutter = filmed.rolling_shutter
    twist, frames = rng.normal(size=shutter.twist.shape), rng.permutation(len(shutter.twist))
    turn, shift = twist_figures(
        filmed.replace(rolling_shutter=shutter.replace(twist=twist, frames=frames.astype(float)))
    )
    order = np.argsort(frames)
    for k in range(3):
        np.testing.assert_array_equal(turn.marks[k].x, frames[order])
        np.testing.assert_allclose(turn.marks[k].y, np.degrees(twist[order, k]))
        np.testing.assert_array_equal(shift.marks[k].y, twist[order, 3 + k])


def test_without_motions_there_is_nothing_to_draw(filmed, tmp_path):
    assert twist_figures(filmed) == [] == twist_figures(filmed.replace(rolling_shutter=None))
    page, data = written(filmed, tmp_path)
    assert data["rolling_shutter"]["is_estimated"] is False
    assert "all twists are zero" in page.text
    page, data = written(filmed.replace(rolling_shutter=None), tmp_path)
    assert "rolling_shutter" not in data and "Rolling shutter" not in page.text
