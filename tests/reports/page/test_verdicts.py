"""Verdicts of the report page: marks of planted faults, and none of healthy scenes."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.georeference.similarity import Similarity, moved
from bundle.interface.finding import Finding
from bundle.reports.page.report_page import write_report
from tests.figures.matplotlib.test_placement_numbers import RECORD
from tests.reports.page.reader import Page
from tests.scenes import make_problem, with_observations

ORDER = ["unknown", "good", "attention", "problem"]


def healthy(**changes):
    given = {"num_images": 12, "num_points": 400, "shared": True, "track": 6, "seed": 8}
    return make_problem(**{**given, **changes})


@pytest.fixture(scope="module")
def solved():
    return bundle.solve(healthy(), hold_out=10)


@pytest.fixture
def told(tmp_path):
    def tell(made, **more):
        path = tmp_path / "page.html"
        write_report(made, path, **more)
        page = Page(path)
        data = json.loads(page.scripts[0])
        for one in data["verdicts"]:
            assert one["mark"] in ORDER and one["name"] in page.text and one["number"] in page.text
        for one in data["findings"]:
            assert one["sentence"] in page.text and one["command"] in page.text
        return {one["name"]: one for one in data["verdicts"]}

    return tell


def marks(found):
    return {name: one["mark"] for name, one in found.items()}


def planted_outliers():
    problem, rng = healthy(), np.random.default_rng(1)
    xy = problem.observation_xy.copy()
    rows = rng.choice(len(xy), len(xy) // 12, replace=False)
    xy[rows] += rng.uniform(-200, 200, (len(rows), 2))
    return bundle.solve(problem.replace(observation_xy=xy), loss="cauchy")


def two_pieces():
    problem = bundle.solve(healthy()).problem
    first = problem.observation_image < 6
    return with_observations(problem, first == (problem.observation_point % 2 == 0))


def too_small_a_lens():
    problem = healthy(num_points=1500)
    xy = problem.observation_xy.copy()
    xy[:, 1] += 2.0 * np.sin(0.02 * xy[:, 0])  # no lens bends horizontal lines into waves
    return bundle.solve(problem.replace(observation_xy=xy))


def one_bad_image():
    problem, rng = healthy(), np.random.default_rng(2)
    xy = problem.observation_xy.copy()
    rows = problem.observation_image == 3
    xy[rows] += rng.normal(0, 2.5, (int(rows.sum()), 2))
    return bundle.solve(problem.replace(observation_xy=xy))


@pytest.mark.parametrize(
    ("make", "name", "least"),
    [
        (healthy, "Reprojection error", "attention"),  # before any solve
        (planted_outliers, "Outliers", "attention"),
        (two_pieces, "Connection", "problem"),
        (too_small_a_lens, "Lens model", "attention"),
        (one_bad_image, "Images", "attention"),
        (lambda: bundle.solve(healthy(perturbation=0.05), max_num_iterations=1), "Solve",
         "attention"),
        (lambda: bundle.solve(make_problem(num_images=2, num_points=12)), "Intrinsics",
         "attention"),
    ],
    ids=["unrefined", "outliers", "pieces", "lens", "image", "steps", "two images"],
)  # fmt: skip
def test_a_planted_fault_has_its_mark(told, make, name, least):
    mark = told(make())[name]["mark"]
    assert ORDER.index(mark) >= ORDER.index(least)


def test_a_healthy_scene_is_good_in_any_frame_and_order(told, solved):
    found = told(solved)
    assert set(marks(found).values()) == {"good"}
    assert len(found) == 10
    problem = solved.problem
    held = solved.held_out
    assert f"{held.median:.3g} px of {held.num_observations:,}" in found["Held-out error"]["number"]
    error = bundle.describe(problem).reprojection_error
    assert f"median {error.median:.3g} px" in found["Reprojection error"]["number"]
    turn = Rotation.from_rotvec([0.3, -2.0, 1.0]).as_matrix()
    elsewhere = moved(problem, Similarity(37.0, turn, np.array([5.0, -300.0, 20.0])))
    rows = np.random.default_rng(3).permutation(problem.num_observations)
    now, then = told(problem), told(with_observations(elsewhere, rows))
    assert marks(now) == marks(then)
    for name in set(now) - {"Positions"}:  # its lengths have the unit of the model
        assert now[name]["number"] == then[name]["number"]


def test_a_start_is_not_judged_as_a_minimum(told):
    found = marks(told(healthy()))
    assert found["Reprojection error"] in ("attention", "problem")
    for name in ("Outliers", "Images", "Lens model", "Intrinsics", "Positions"):
        assert found[name] == "unknown"


def test_a_suspect_control_point_needs_attention(told, solved):
    found = told(solved.problem, georeference=RECORD)
    assert ORDER.index(found["Georeference"]["mark"]) >= ORDER.index("attention")
    assert "1 check point, RMS 3 m" in found["Georeference"]["number"]
    assert "1 suspect point" in found["Georeference"]["number"]
    assert next(iter(found)) == "Georeference"  # the answer of a survey, before its reasons


@pytest.mark.parametrize(("east", "mark"), [(0.3, "good"), (3.9, "good"), (4.4, "attention")])
def test_one_point_far_beyond_its_sigma_needs_attention(told, solved, east, mark):
    """The root mean square of all hides it; four sigmas are one good point in a thousand."""
    point = {**RECORD["gcps"][0], "suspect": False, "sigma": [1.0, 1.0, 1.0]}
    gcps = [
        {**point, "name": f"p{k}", "residual_enu": [x, 0.0, 0.0]}
        for k, x in enumerate([0.2, -east, 0.1, 0.0])
    ]
    found = told(solved.problem, georeference={**RECORD, "gcps": gcps})["Georeference"]
    assert found["mark"] == mark and ("p1 beyond 4 sigmas" in found["number"]) == (east > 4)


def test_collapsed_points_are_a_problem(told, solved):
    problem = solved.problem
    points = problem.points.copy()
    points[:60] = problem.projection_centers[0] + 1e-9
    found = told(problem.replace(points=points))
    assert "problem" in marks(found).values()
    assert found["Tracks"]["mark"] == "problem" and "collapsed" in found["Tracks"]["number"]


def test_given_findings_hide_no_warning_and_no_suspicion(tmp_path):
    problem = healthy(num_points=60)
    names = ["twice.jpg", *problem.image_names[:1], *problem.image_names[1:-1]]
    names[1] = "twice.jpg"
    solved = bundle.solve(problem.replace(image_names=names), max_num_iterations=1)
    write_report(solved, tmp_path / "page.html", findings=[])
    text = Page(tmp_path / "page.html").text
    assert "name of another image" in text
    assert all(words in text for words in solved.summary.warnings)


def test_only_open_verdicts_have_a_command(told, solved):
    assert not any(one["command"] for one in told(solved, findings=[]).values())
    xy = solved.problem.observation_xy
    far = solved.problem.replace(
        observation_xy=xy + np.random.default_rng(0).normal(0, 9, xy.shape)
    )
    found = told(far, findings=[])
    assert (
        found["Reprojection error"]["mark"] == "problem" and found["Reprojection error"]["command"]
    )
    hidden = told(far, findings=[Finding(kind="rules", sentence="A sentence.")])
    assert hidden["Reprojection error"]["mark"] == "problem"
    assert not any(one["command"] for one in hidden.values())


def test_a_limit_of_steps_is_said_once(told):
    loose = bundle.solve(healthy(num_points=60), max_num_iterations=0)
    about = Finding(kind="not_converged", sentence="Steps.", command="bundle x")
    number = told(loose, findings=[about])["Solve"]["number"]
    assert number.lower().count("not converged") == 1


def test_a_command_is_shown_once_by_the_line_of_its_subject(tmp_path, solved):
    about = Finding(kind="not_converged", sentence="Steps.", command="bundle x")
    other = Finding(kind="without_a_line", sentence="Other.", command="bundle y")
    write_report(solved, tmp_path / "page.html", findings=[about, other])
    text = Page(tmp_path / "page.html").text
    body = text[: text.index("Steps.")], text[text.index("Steps.") :]
    assert [part.count("bundle x") for part in body] == [1, 0]
    assert [part.count("bundle y") for part in body] == [0, 1]


def test_findings_that_are_given_are_those_of_the_page(told, solved):
    given = [Finding(kind="weak_joint", sentence="A <joint>.", command="bundle info 'a b'")]
    found = told(solved, findings=given)
    assert found["Connection"]["mark"] == "attention"
    assert "weak joint" in found["Connection"]["number"]
    assert "bundle info 'a b'" in str(found["Connection"])


@pytest.mark.parametrize("kind", ["not_refined", "rules", "constant_poses", "constant_lens"])
def test_what_hides_the_answer_leaves_it_unknown_and_without_a_command(told, solved, kind):
    found = told(solved, findings=[Finding(kind=kind, sentence="A sentence.", command="bundle x")])
    unknown = {"Outliers", "Images", "Lens model", "Positions"} & found.keys()
    assert {found[name]["mark"] for name in unknown} == {"unknown"} and len(unknown) > 2
    assert (found["Intrinsics"]["mark"] == "attention") == (kind == "constant_lens")
    assert sum("bundle" in str(one) for one in found.values()) == 1  # that of the finding


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("rules", "Solve"),
        ("constant_poses", "Solve"),
        ("constant_sensors", "Solve"),
        ("constant_lens", "Intrinsics"),
        ("motion", "Images"),
    ],
)
def test_what_a_finding_is_about_needs_attention(told, solved, kind, name):
    found = told(solved, findings=[Finding(kind=kind, sentence="A sentence.")])
    assert found[name]["mark"] == "attention"
    assert kind.replace("_", " ") in found[name]["number"]
