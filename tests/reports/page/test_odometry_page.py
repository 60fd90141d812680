"""The page of an odometry: what is drawn is what the records say, in Matplotlib's figures too."""

import dataclasses
import json
import re

import matplotlib
import numpy as np
import pytest

import bundle
from bundle import InputError, figures, pictures
from bundle.cli.main import main
from bundle.inertial.vio.odometry import run_odometry
from bundle.inertial.vio.trajectory_comparison import aligned_in_yaw, compare_trajectories
from bundle.io.sequences.sequence_folder import save_sequence
from bundle.io.sequences.trajectory_files import Trajectory
from bundle.reports.page.result_pages import write_odometry
from bundle.reports.terminal.vio_reports import odometry_headline
from bundle.synthetic.synthetic_flight import synthesize_flight
from tests.reports.page.browser import check_nothing_is_clipped
from tests.reports.page.reader import Page, check_self_contained

matplotlib.use("agg")
NAMES = [
    "path", "error", "times", "steps", "costs", "sizes", "fill", "spectrum", "prior", "nullity",
    "excitation", "imu_excess", "gyro_bias", "accel_bias", "yaw_sigma", "ages", "landmarks_left",
]  # fmt: skip


@pytest.fixture(scope="module")
def flight():
    return synthesize_flight(duration=5.0, rest=1.5, num_tracks=20, seed=2)


@pytest.fixture(scope="module")
def told(flight):
    """A window that has lost keyframes, with all that it can measure of itself."""
    return run_odometry(
        flight.sequence, window=4, nullity=True, covariance=True,
        start_yaw_sigma=1.0, start_position_sigma=0.01, time_budget=10.0,
    )  # fmt: skip


@pytest.fixture(scope="module")
def truth(flight):
    return flight.ground_truth


@pytest.fixture(scope="module")
def page(told, truth, tmp_path_factory):
    path = tmp_path_factory.mktemp("odometry") / "page.html"
    write_odometry(told, path, truth=truth, name="a <flight> & back")
    return path, Page(path)


def numbers(page):
    return {one["name"]: one["lines"] for one in json.loads(page[1].scripts[0])["figures"]}


def line_of(page, figure, label):
    (found,) = (line for line in numbers(page)[figure] if line["label"] == label)
    return np.array(found["x"], float), np.array(found["y"], float)


def test_the_page_stands_alone_and_escapes_names(page):
    check_self_contained(page[1])
    assert "<flight>" not in page[1].source.replace("&lt;flight&gt;", "")
    assert list(numbers(page)) == NAMES


def test_the_page_begins_with_the_headline_of_the_report(page, told):
    headline, *_ = odometry_headline(told, None)
    assert f"<h1>{headline}</h1>" in page[1].source


def test_the_error_is_the_title_and_what_is_unknown_has_no_figure(told, truth, tmp_path):
    unknown = [dataclasses.replace(record, yaw_sigma=None) for record in told.keyframes]
    blind = dataclasses.replace(told, keyframes=tuple(unknown))
    error = compare_trajectories(told.trajectory, truth)
    write_odometry(blind, tmp_path / "page.html", truth=truth, error=error)
    page = Page(tmp_path / "page.html")
    title = re.search("<h1>(.*?)</h1>", page.source)[1]
    assert title.startswith("Position error") and f"{error.ate:.4g} m" in title
    assert set(NAMES) - set(numbers((None, page))) == {"yaw_sigma"}
    # The path comes before the table of facts, and an interruption before its error.
    assert page.source.index('data-figure="path"') < page.source.index("<table")
    early = odometry_headline(dataclasses.replace(told, interrupted=True), error)
    assert early[0].startswith("Interrupted") and early[1] == title


FIELDS = {
    ("times", "solve"): lambda r: 1e3 * r.times["solve"],
    ("times", "total"): lambda r: 1e3 * r.times["total"],
    ("steps", "tried"): lambda r: r.num_iterations,
    ("steps", "rejected"): lambda r: r.num_rejected,
    ("costs", "visual"): lambda r: r.costs["visual"],
    ("costs", "bias walk"): lambda r: r.costs["bias_walk"],
    ("sizes", "rows"): lambda r: r.num_rows,
    ("sizes", "columns"): lambda r: r.num_columns,
    ("fill", "nnz(L) / nnz(Λ)"): lambda r: r.fill_ratio,
    ("spectrum", "largest"): lambda r: r.prior_max_eigenvalue,
    ("prior", "eigenvalue ratio"): lambda r: r.prior_ratio,
    ("prior", "asymmetry"): lambda r: r.prior_asymmetry,
    ("nullity", "nullity"): lambda r: r.nullity,
    ("nullity", "expected"): lambda r: r.expected_nullity,
    ("excitation", "standard deviation of |a|"): lambda r: r.excitation,
    ("imu_excess", "ratio"): lambda r: r.imu_excess,
    ("gyro_bias", "z"): lambda r: r.gyro_bias[2],
    ("accel_bias", "x"): lambda r: r.accel_bias[0],
    ("yaw_sigma", "sigma of yaw"): lambda r: np.degrees(r.yaw_sigma),
    ("landmarks_left", "into the prior"): lambda r: r.num_absorbed,
}


@pytest.mark.parametrize("which", FIELDS, ids=" ".join)
def test_lines_are_those_of_the_records(which, told, page):
    expected = [FIELDS[which](record) for record in told.keyframes]
    expected = np.array([np.nan if value is None else value for value in expected], float)
    x, y = line_of(page, *which)
    np.testing.assert_allclose(y, expected, rtol=1e-12)
    if which[0] == "yaw_sigma":
        turned = [np.degrees(record.accumulated_rotation) for record in told.keyframes]
        np.testing.assert_allclose(x, turned, rtol=1e-12)
    else:
        begin = told.trajectory.timestamps_ns[0]
        stamps = [1e-9 * (record.timestamp_ns - begin) for record in told.keyframes]
        np.testing.assert_allclose(x, stamps, atol=1e-9)


def test_bands_ages_and_the_budget(told, page):
    (line, *_) = numbers(page)["accel_bias"]
    sigma = [record.accel_bias_sigma[0] for record in told.keyframes]
    np.testing.assert_allclose(line["sigma"], sigma, rtol=1e-12)
    _, ages = line_of(page, "ages", "into the prior")
    expected = [
        np.nan if not r.marginalized else 1e-9 * (r.timestamp_ns - r.marginalized["timestamp_ns"])
        for r in told.keyframes
    ]
    assert np.isfinite(expected).sum() > 3
    np.testing.assert_allclose(ages, expected, atol=1e-9)
    _, budget = line_of(page, "times", "budget of a solve")
    assert budget.tolist() == [1e4, 1e4]


def test_the_rotation_made_is_that_of_the_truth(told, truth):
    stamps = [record.timestamp_ns for record in told.keyframes]
    states = bundle.inertial.vio.trajectory_comparison.states_at(truth, np.array(stamps))
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_quat(states[:, :4])
    expected = (turns[:-1].inv() * turns[1:]).magnitude().cumsum()
    made = np.array([record.accumulated_rotation for record in told.keyframes])
    assert made[-1] - made[0] > 0.5
    np.testing.assert_allclose(made[1:] - made[0], expected, atol=0.05)


def test_the_truth_is_drawn_where_it_is(told, truth, page):
    stamps, found, wanted = aligned_in_yaw(told.trajectory, truth)
    x, y = line_of(page, "path", "ground truth")
    np.testing.assert_allclose(np.c_[x, y], wanted[:, 4:6])
    seconds, height = line_of(page, "error", "vertical")
    np.testing.assert_allclose(height, np.abs(found[:, 6] - wanted[:, 6]), atol=1e-12)
    assert len(seconds) == len(stamps)
    # Turned and shifted, it is the same again: four degrees are nobody's error.
    turn = bundle.two_loops.YawMotion(0.7, (1.0, -2.0, 3.0))
    moved = Trajectory(
        told.trajectory.timestamps_ns, np.array([turn.moved(s) for s in told.trajectory.states])
    )
    np.testing.assert_allclose(aligned_in_yaw(moved, truth)[1][:, 4:], found[:, 4:], atol=1e-9)
    assert np.linalg.norm(found[:, 4:] - wanted[:, 4:], axis=1).max() < 0.2


def test_paths_in_the_browser_are_the_numbers(page, browser):
    """Each drawn corner is on one affine map from the numbers, log10 where the axis is so."""
    browser.open(page[0])
    assert browser.complaints() == []
    assert browser.requested() == [page[0].as_uri()]
    drawn = browser.evaluate(
        "Object.fromEntries([...document.querySelectorAll('figure[data-figure]')].map((f) =>"
        " [f.dataset.figure, [...f.querySelectorAll('svg[role=img] path.curve')].map((p) =>"
        "  [p.textContent, p.getAttribute('d')])]))"
    )
    assert sorted(drawn) == sorted(NAMES)
    checked = 0
    for name, label, logarithmic in (
        ("path", "estimate", False), ("steps", "tried", False), ("times", "solve", True),
        ("costs", "visual", True), ("excitation", "standard deviation of |a|", True),
        ("accel_bias", "y", False), ("yaw_sigma", "sigma of yaw", False),
    ):  # fmt: skip
        (path,) = (d for title, d in drawn[name] if title == label)
        corners = np.array(re.findall(r"[ML]([-\d.]+) ([-\d.]+)", path), float)
        x, y = line_of(page, name, label)
        values = np.log10(y) if logarithmic else y
        for seen, given in ((corners[:, 0], x), (corners[:, 1], values)):
            slope = np.polyfit(given, seen, 1)
            np.testing.assert_allclose(np.polyval(slope, given), seen, atol=0.11)
            assert (slope[0] > 0) == (given is x)
            checked += 1
    assert checked == 14


@pytest.mark.parametrize("width", [320, 1280])
def test_nothing_is_clipped(page, browser, width):
    check_nothing_is_clipped(browser, page[0], width)


def test_matplotlib_draws_the_same_lines(told, truth):
    for figure in figures.odometry_figures(told, truth):
        made, axes = pictures.figure()
        pictures.draw_lines(axes[0, 0], figure)
        made.canvas.draw()
        shown = {line.get_label(): line for line in axes[0, 0].lines}
        assert list(shown) == [line.label for line in figure.lines]
        for line in figure.lines:
            np.testing.assert_array_equal(shown[line.label].get_ydata(), line.y)
        assert axes[0, 0].get_yscale() == ("log" if figure.y.is_logarithmic else "linear")
        bands = [line for line in figure.lines if line.sigma is not None]
        assert len(axes[0, 0].collections) == len(bands)
    with pytest.raises(InputError, match="figure"):
        pictures.draw_lines(axes[0, 0], told)


def test_the_command_writes_it_without_what_was_not_asked_for(flight, tmp_path):
    save_sequence(flight.sequence, tmp_path / "s")
    target = tmp_path / "page.html"
    arguments = ["vio", str(tmp_path / "s"), "-o", str(tmp_path / "x.tum"), "--quiet"]
    assert main([*arguments, "--html", str(target), "--prior-precision", "single"]) in (0, 1)
    page = (target, Page(target))
    check_self_contained(page[1])
    assert "error" not in numbers(page)
    assert "nullity" not in numbers(page)
    assert "prior not positive" in page[1].text
    for wrong in (tmp_path / "x.tum", tmp_path / "s"):
        assert main([*arguments, "--html", str(wrong)]) == 2


def test_misuse(told, truth, tmp_path):
    late = Trajectory(truth.timestamps_ns + 10**12, truth.states)
    for call, word in (
        (lambda: write_odometry(truth, tmp_path / "x.html"), "result"),
        (lambda: write_odometry(told, tmp_path / "x.html", truth=late), "ground truth"),
    ):
        with pytest.raises(InputError, match=word):
            call()
    assert not (tmp_path / "x.html").exists()
