"""georeference.json: always true of the model beside it."""

import json

import numpy as np
import pytest

import bundle
from bundle.georeference.local_frame import LocalFrame
from tests.cli.test_gps import write_geo
from tests.georeference.test_prior_alignment import problem_and_goal
from tests.georeference.test_solve_with_priors import noisy

NAME = "georeference.json"


@pytest.fixture
def placed(run, tmp_path):
    """A model that was put on the earth, and one that was not."""
    problem, goal = problem_and_goal(noise=0.1)
    bundle.save(problem, tmp_path / "plain", "colmap")
    write_geo(tmp_path / "geo.txt", problem.image_names, noisy(goal, 0.1))
    code, _, _ = run(
        "align", tmp_path / "plain", "-o", tmp_path / "placed", "--gps", tmp_path / "geo.txt"
    )
    assert code == 0
    return tmp_path / "placed"


def content(folder):
    path = folder / NAME
    return json.loads(path.read_text()) if path.exists() else None


def enu_error(folder):
    """Distances of the cameras from the measured file in metres, by the folder's georeference."""
    model, found = bundle.load(folder), content(folder)
    given = bundle.georeference.read_geo_file(folder.parent / "geo.txt")
    places = LocalFrame(**found["origin"]).to_enu(given.geodetic)
    return np.abs(model.projection_centers - places).max()


def test_a_model_without_a_place_replaces_the_file_too(run, placed):
    plain = placed.parent / "plain"
    for words in (("convert", plain, placed), ("refine", plain, "-o", placed)):
        (placed / NAME).write_text(json.dumps({"reference_system": "EPSG:1"}))
        code, _, err = run(*words, "--overwrite")
        assert code == 0, err
        assert content(placed) is None
    (placed / NAME).write_text(json.dumps({"reference_system": "EPSG:1"}))
    bundle.save(bundle.load(plain), placed)
    assert content(placed) is None
    # What is no such file is not ours.
    (placed / NAME).write_text("my notes")
    bundle.save(bundle.load(plain), placed)
    assert (placed / NAME).read_text() == "my notes"


def test_convert_carries_it_along(run, placed):
    before = content(placed)
    for words in (("text", "--format", "colmap-text"), ("text",), ("binary/",)):
        target = placed.parent / words[0]
        assert run("convert", placed, target, *words[1:], "--overwrite")[0] == 0
        assert content(target) == before
    assert run("convert", placed, placed)[0] == 0
    assert content(placed) == before
    folder = placed.parent / "files"
    folder.mkdir()
    assert run("convert", placed, folder / "a.txt", "--format", "bal")[0] == 0
    assert content(folder) == before | {"model": "a.txt"}
    # Another model in the same folder does not take it, nor is it said to be there.
    assert run("convert", placed, folder / "b.txt", "--format", "bal")[0] == 2
    assert not (folder / "b.txt").exists()
    assert run("convert", placed.parent / "plain", folder / "c.txt", "--format", "bal")[0] == 0
    assert content(folder) == before | {"model": "a.txt"}
    assert run("convert", folder / "c.txt", folder.parent / "c", "--format", "colmap")[0] == 0
    assert content(folder.parent / "c") is None
    assert run("convert", folder / "a.txt", folder.parent / "a", "--format", "colmap")[0] == 0
    assert content(folder.parent / "a") == before
    words = ("--format", "bal", "--overwrite")
    assert run("convert", placed.parent / "plain", folder / "a.txt", *words)[0] == 0
    assert content(folder) is None


def test_a_refinement_without_positions_keeps_the_frame_alone(run, placed):
    before = content(placed)
    out = placed.parent / "again"
    assert run("refine", placed, "-o", out)[0] == 0
    after = content(out)
    for name in ("reference_system", "origin", "pipeline"):
        assert after[name] == before[name]
    assert after["gps"] == after["gcps"] == []
    assert after["rms_enu"] is None
    assert after["similarity"]["scale"] == 1
    assert len(after["notes"]) == 1
    assert enu_error(out) < enu_error(placed) + 0.5
    assert run("report", out, "-o", placed.parent / "page.html")[0] == 0
    assert run("refine", placed, "-o", placed)[0] == 0  # in its place
    assert content(placed) == after


def test_a_model_aligned_to_another_has_the_frame_of_that(run, placed):
    plain, out = placed.parent / "plain", placed.parent / "like"
    assert run("align", plain, "-o", out, "--reference", placed)[0] == 0
    assert content(out)["origin"] == content(placed)["origin"]
    assert content(out)["shared_images"]
    assert enu_error(out) == pytest.approx(enu_error(placed), abs=1e-6)
    assert run("align", placed, "-o", out, "--reference", plain, "--overwrite")[0] == 0
    assert content(out)["origin"] is None
