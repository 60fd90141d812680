"""`bundle report`, and the page of `bundle refine`."""

import json

import pytest

import bundle
from tests.cli.test_gps import write_geo
from tests.figures.matplotlib.test_placement_numbers import RECORD
from tests.georeference.test_prior_alignment import problem_and_goal
from tests.scenes import make_problem


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model"
    bundle.save(make_problem(num_images=4, num_points=40), path, format="colmap-text")
    return path


def certainty(page):
    """The section as it is written, numbers and all."""
    return page.read_text().partition('id="certainty"')[2].partition("<h2")[0]


def test_a_page_is_written_and_described(run, model, tmp_path):
    page, report = tmp_path / "page.html", tmp_path / "report.json"
    code, out, _ = run("report", model, "-o", page, "--json", report)
    assert code == 0
    assert str(page) in out.replace("\n", "")
    found = json.loads(report.read_text())
    assert (found["command"], found["notes"]) == ("report", [])
    assert found["output"] == {"path": str(page), "format": "html"}
    assert found["input"]["num_images"] == 4
    assert page.read_text().startswith("<!doctype html>")


def test_refine_writes_its_page(run, model, tmp_path):
    page = tmp_path / "page.html"
    code = run(
        "refine", model, "-o", tmp_path / "out", "--html", page, "--images", tmp_path, "--quiet"
    ).code
    assert code == 0
    assert "before" in page.read_text()


def test_what_refine_said_of_positions_is_on_the_page(run, model, tmp_path):
    beside, page = model / "georeference.json", tmp_path / "page.html"
    beside.write_text(json.dumps(RECORD))
    assert run("report", model, "-o", page, "--quiet").code == 0
    assert "Control points and positions" in page.read_text()
    beside.write_text("[1, 2]")
    report = tmp_path / "report.json"
    assert run("report", model, "-o", page, "--quiet", "--json", report).code == 0
    assert "Control points and positions" not in page.read_text()
    (note,) = json.loads(report.read_text())["notes"]
    assert "georeference.json" in note


def test_positions_are_on_the_page_of_refine(run, tmp_path):
    problem, goal = problem_and_goal(noise=0.1)
    bundle.save(problem, tmp_path / "model", "colmap")
    write_geo(tmp_path / "geo.txt", problem.image_names, goal.projection_centers)
    page = tmp_path / "page.html"
    words = ("refine", tmp_path / "model", "-o", tmp_path / "out/", "--gps", tmp_path / "geo.txt")
    assert run(*words, "--html", page, "--images", tmp_path, "--quiet").code == 0
    assert "measured positions<" in page.read_text()
    # The same priors are counted in a page of its own; without them, the model is less certain.
    alone, again = tmp_path / "alone.html", tmp_path / "again.html"
    assert run("report", tmp_path / "out", "-o", alone, "--quiet").code == 0
    positions = ("--gps", tmp_path / "geo.txt")
    assert run("report", tmp_path / "out", "-o", again, "--quiet", *positions).code == 0
    assert certainty(again) == certainty(page) != certainty(alone)


def test_a_page_under_the_loss_of_the_solve(run, tmp_path):
    scene = bundle.synthesize(
        num_images=8, num_points=150, outlier_share=0.03, seed=3, scene="orbit"
    )
    bundle.save(scene.problem, tmp_path / "model", "colmap")
    page, alone, again = (tmp_path / name for name in ("page.html", "alone.html", "again.html"))
    loss, out = ("--loss", "cauchy", "--loss-scale", "0.8"), tmp_path / "out"
    words = ("refine", tmp_path / "model", "-o", out, "--html", page, "--quiet")
    assert run(*words, *loss).code == 0
    assert run("report", out, "-o", alone, "--quiet").code == 0
    report = tmp_path / "report.json"
    assert run("report", out, "-o", again, "--quiet", "--json", report, *loss).code == 0
    assert certainty(again) == certainty(page) != certainty(alone)
    found = json.loads(report.read_text())["findings"]
    assert "not_refined" not in {one["kind"] for one in found}
    commands = [one["command"] for one in found if one.get("command", "").startswith("bundle ref")]
    assert all(" ".join(loss) in command for command in commands)
