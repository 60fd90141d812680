"""The headline of `bundle refine` in cases that are built to mislead, checked by other code.

pycolmap reads INPUT and OUTPUT, formulas of the tests project the points, and observations are
matched by image and pixel. Numbers of the headline must be those of this computation: RMSE and
median before and after on the same observations, deletions, edits, movement. Sentences that
restrict the numbers must be there exactly where they are due.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.cli.output import Progress
from tests.cli.headline_cases import CASES, outliers
from tests.printed import figures
from tests.scenes import make_problem, project, scene, with_observations


def errors_of(path, algebraic=False):
    """Return the error of each observation by image and pixel; nan behind its camera."""
    model = pycolmap.Reconstruction(path)
    found = {}
    for image in model.images.values():
        camera = model.cameras[image.camera_id]
        pose = image.cam_from_world()
        for point2d in image.points2D:
            if not point2d.has_point3D():
                continue
            place = pose * model.points3D[point2d.point3D_id].xyz
            xy = project(camera.model.name, camera.params, place[None])[0]
            error = float(np.linalg.norm(xy - point2d.xy))
            seen = algebraic or place[2] > 0
            found[image.name, *point2d.xy.tolist()] = error if seen else np.nan
    return found


def shown(value):
    return f"{value:.4f}" if value >= 0.01 or value == 0 else f"{value:.3g}"


def refine(run, source, target, words, report):
    return run("refine", source, "-o", f"{target}/", "--json", report, "--quiet", *words)


@pytest.mark.parametrize("name", CASES)
def test_the_headline_is_true(run, tmp_path, monkeypatch, name):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.chdir(tmp_path)  # a path longer than a line would not wrap
    case = CASES[name]
    source, target, report = Path("in"), Path("out"), Path("report.json")
    bundle.save(case.problem, f"{source}/", "colmap")
    case.files(tmp_path)
    for words in case.before:
        assert refine(run, source, source, words.split(), report).code == 0
    words = [
        word.strip("'").replace("{folder}", ".") for word in re.findall(r"'[^']*'|\S+", case.flags)
    ]
    if case.again:
        assert refine(run, source, "first", words, report).code == 0
    if case.interrupt is not None:
        begun = []

        def stop(_, values):
            begun.extend([0] * (values["iteration"] == 0))
            if values["iteration"] >= case.interrupt and len(begun) > case.rounds_before:
                raise KeyboardInterrupt

        monkeypatch.setattr(Progress, "iteration", stop)
    done = refine(run, source, target, words, report)
    assert done.code == case.code, done.err
    data = json.loads(report.read_text())
    first = data["headline"][0]
    text = " ".join(data["headline"])
    lines = done.out.splitlines()
    assert len(lines) <= 25 and max(map(len, lines)) <= 80
    assert " ".join(lines[:6]).replace("  ", " ").startswith(first[:60])

    given = errors_of(source, "algebraic" in case.flags)
    if not Path(target).exists():
        assert "no usable solution" in text and "->" not in text
        return
    left = errors_of(target, "algebraic" in case.flags)
    assert left.keys() <= given.keys()
    pairs = np.array([(given[key], error) for key, error in left.items()])
    pairs = pairs[~np.isnan(pairs).any(axis=1)]
    rmse, median = np.sqrt(np.mean(pairs**2, axis=0)), np.median(pairs, axis=0)
    check_errors(data, first, rmse, median, len(left), len(pairs))
    check_deletions(case, data, text, given, left)
    check_edits(case, data, text, given)
    check_outcome(case, data, first, rmse)
    check_movement(source, target, data)
    if shown(rmse[1]) != shown(rmse[0]) and rmse[1] > rmse[0] and case.interrupt is None:
        reasons = ("RMSE of all rises because", "RMSE rises because", "The edits raised RMSE")
        assert any(reason in text for reason in reasons), text
    if "RMSE rises because" in text and "--gps" in case.flags:
        assert "the cost of positions falls" in text


def check_errors(data, first, rmse, median, count, compared):
    """RMSE and median of JSON and of the first sentence."""
    kept = data["reprojection_error"]["kept"]
    assert kept["num_observations"] == count
    assert kept["before"]["num_observations"] == kept["after"]["num_observations"] == compared
    for side, which in enumerate(("before", "after")):
        expected = [rmse[side], median[side]]
        found = [kept[which]["rmse"], kept[which]["median"]]
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
    numbers = figures(first.split("RMSE ")[1])
    if rmse.min() > 1e-6:
        assert numbers[:4] == [*map(shown, rmse), *map(shown, median)]
    assert f"{compared:,}" in numbers[4:]


def check_deletions(case, data, text, given, left):
    """Counts of deletions, and what they alone change."""
    gone = given.keys() - left.keys()
    images = len({key[0] for key in given}) - len({key[0] for key in left})
    assert data["deleted"]["num_observations"] == len(gone)
    assert data["deleted"]["num_images"] == images
    assert bool(gone) == case.deletes == ("Deleted" in text)
    before = np.array([*given.values()])
    before = before[~np.isnan(before)]
    total = data["reprojection_error"]["before"]
    np.testing.assert_allclose(total["rmse"], np.sqrt(np.mean(before**2)), rtol=1e-6, atol=1e-9)
    if gone:
        sentence = next(one for one in data["headline"] if one.startswith("Deleted"))
        kept = data["reprojection_error"]["kept"]["before"]["rmse"]
        assert figures(sentence)[0] == f"{len(gone):,}"
        assert figures(sentence)[-2:] == [shown(total["rmse"]), shown(kept)]
        assert data["edits"][-1]["edit"] == "deletion"


def check_edits(case, data, text, given):
    """Names of the edits; each begins where the last ended, the first at INPUT."""
    edits = [edit for edit in data["edits"] if edit["edit"] != "deletion"]
    assert [edit["edit"] for edit in edits] == list(case.edits)
    last = data["reprojection_error"]["before"]["rmse"]
    for edit in edits:
        assert edit["before"]["rmse"] == pytest.approx(last, rel=1e-9)
        last = edit["after"]["rmse"]
    changed = [edit for edit in edits if edit["edit"] != "alignment"]
    if changed and len(data.get("rounds", [])) == 0 and data["options"]["loss"] == "TRIVIAL":
        # The solve began where the edits ended.
        cost = np.sqrt(2 * data["summary"]["initial_cost"] / len(given))
        assert last == pytest.approx(cost, rel=1e-6)
    if changed and shown(last) != shown(data["reprojection_error"]["before"]["rmse"]):
        assert "The edits" in text and shown(last) in text


def check_outcome(case, data, first, rmse):
    """The claim of a minimum, of convergence, of an interruption."""
    summary = data["summary"]
    claimed = first.startswith("Already at its minimum")
    if case.minimum is not None:
        assert claimed == case.minimum, first
    if claimed:
        assert rmse[1] == pytest.approx(rmse[0], rel=1e-3, abs=1e-9)
        assert summary["termination_type"] == "CONVERGENCE"
    starts = {"CONVERGENCE": ("Already", "Converged"), "NO_CONVERGENCE": ("Not converged",)}
    if case.interrupt is not None:
        assert first.startswith("Interrupted")
    else:
        assert first.startswith(starts[summary["termination_type"]])
    rounds = data.get("rounds", [])
    steps = len(data["iterations"]) - 1
    if rounds:
        done = sum(one["num_iterations"] for one in rounds)
        steps = done + steps * (rounds[-1]["num_observations_removed"] > 0)
    assert f"{steps} step" in first


def check_movement(source, target, data):
    """Medians of the motion, from the poses that pycolmap reads."""
    models = [pycolmap.Reconstruction(path) for path in (source, target)]
    centers = [
        {image.name: image.projection_center() for image in one.images.values()} for one in models
    ]
    place = data.get("georeference", {}).get("similarity")
    moved = []
    for name, center in centers[0].items():
        if place is not None:
            center = place["scale"] * np.array(place["rotation"]) @ center + place["translation"]
        moved.append(np.linalg.norm(centers[1][name] - center))
    moved = np.array(moved)
    count = data["movement"]["num_images"]
    assert count >= (moved > 1e-9).sum()
    if count:
        largest = np.sort(moved)[-count:]
        assert data["movement"]["position"] == pytest.approx(np.median(largest), rel=1e-6, abs=1e-9)
    else:
        assert moved.max() < 1e-9
        assert "No camera moved" in data["headline"][-1] or "No camera" in " ".join(
            data["headline"]
        )


def test_there_are_enough_cases():
    assert len(CASES) >= 40


def test_no_observation_left_is_an_error(run, tmp_path):
    bundle.save(make_problem(), f"{tmp_path}/in/", "colmap")
    done = run("refine", tmp_path / "in", "-o", f"{tmp_path}/out/", "--rounds", 1,
               "--max-error", 1e-6, "--quiet")  # fmt: skip
    assert done.code == 2 and done.err.startswith("error: --rounds: ")
    assert not (tmp_path / "out").exists()


def test_observations_of_a_bal_file_are_compared_by_its_own_formula(run, tmp_path):
    """BAL: p = -P / P.z, f (1 + k1 r^2 + k2 r^4) p; every observation counts."""
    bundle.save(scene(), tmp_path / "in.txt")
    report = tmp_path / "r.json"
    done = run("refine", tmp_path / "in.txt", "-o", tmp_path / "out.txt", "--json", report)
    assert done.code == 0
    data = json.loads(report.read_text())
    rmse = [np.sqrt(np.mean(bal_errors(tmp_path / name) ** 2)) for name in ("in.txt", "out.txt")]
    assert figures(data["headline"][0])[1:3] == [f"{value:.4f}" for value in rmse]


def bal_errors(path):
    words = path.read_text().split()
    cameras, points, count = map(int, words[:3])
    table = np.array(words[3 : 3 + 4 * count], float).reshape(count, 4)
    rest = np.array(words[3 + 4 * count :], float)
    camera = rest[: 9 * cameras].reshape(cameras, 9)[table[:, 0].astype(int)]
    point = rest[9 * cameras :].reshape(points, 3)[table[:, 1].astype(int)]
    place = Rotation.from_rotvec(camera[:, :3]).apply(point) + camera[:, 3:6]
    p = -place[:, :2] / place[:, 2:]
    r2 = (p**2).sum(axis=1)
    scale = camera[:, 6] * (1 + camera[:, 7] * r2 + camera[:, 8] * r2**2)
    return np.linalg.norm(scale[:, None] * p - table[:, 2:], axis=1)


def test_a_mask_of_rows_keeps_the_order():
    """The mask of kept rows gives the rows of the output, in their order."""
    problem = outliers()
    result = bundle.solve_rounds(problem, num_rounds=2, max_error=3.0)
    chosen = with_observations(problem, result.observation_mask)
    np.testing.assert_array_equal(chosen.observation_xy, result.problem.observation_xy)
