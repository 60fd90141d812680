"""`bundle plan`: its answer, its JSON, the command that follows, and what it refuses."""

import json
import shlex

import numpy as np
import pytest

import bundle
from bundle.model.rigid_motions import inverse_poses
from tests.scenes import make_problem

RATIO = "distance 3 9 / baseline 1 5"
DATUM = ("--set", "point 1: position prior sigma 0.01", "--set", "point 2: position fixed")


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model"
    path.mkdir()
    problem = make_problem(num_points=60, shared=True, perturbation=1e-3)
    bundle.save(bundle.solve(problem).problem, path)
    return path


def test_the_answer_is_short_and_in_the_json(run, model, tmp_path):
    report = tmp_path / "report.json"
    flags = ("--for", RATIO, "--add", "image,tie", "--count", "2", "--json", report, "--quiet")
    done = run("plan", model, *flags)
    assert (done.code, done.err) == (0, "")
    found = json.loads(report.read_text())
    expected = bundle.plan(model, RATIO, add=("image", "tie"), count=2)
    assert len(found["headline"]) <= 6 and found["sigma"] == pytest.approx(expected.sigma)
    for name in ("proposals", "together"):
        pairs = zip(found[name], getattr(expected, name), strict=True)
        for one, other in pairs:
            assert one["kind"] == other.kind and one["what"] == other.what
            assert one["sigma_after"] == pytest.approx(other.sigma_after)
    assert len(found["together"]) == 2
    long = run("plan", model, *flags, "--verbose")
    assert expected.together[-1].what in " ".join(long.out.split())


def test_control_points_and_bars_are_followed(run, model, tmp_path, monkeypatch):
    """The printed command takes the measured lines, and the sigma falls as predicted."""
    monkeypatch.chdir(tmp_path)
    problem = bundle.load(model)
    row = {key: place for place, key in enumerate(problem.point_ids)}
    lines = ["LOCAL"]
    for key in (1, 2, 7):
        for place in np.flatnonzero(problem.observation_point == row[key]):
            x, y = problem.observation_xy[place] - 0.5
            name = problem.image_names[problem.observation_image[place]]
            position = " ".join(map(str, problem.points[row[key]]))
            lines.append(f"{position} {x} {y} {name} gcp{key}")
    listed = tmp_path / "gcp_list.txt"
    listed.write_text("\n".join(lines))
    listed.with_name("named.txt").write_text("\n".join(lines).replace(" gcp", " GCP_"))
    done = run("plan", model, "--for", "distance GCP_1 GCP_2", "--gcp", "named.txt", "--quiet")
    assert done.code == 0 and "distance GCP_1 GCP_2: " in done.out
    loss = ("--loss", "huber", "--loss-scale", "20")
    flags = ("--for", "distance 3 9", "--gcp", listed.name, *loss, "--quiet")
    for kind in ("gcp", "bar"):
        listed.write_text("\n".join(lines))
        given = (*flags, "--add", kind, "--count", "1", "--bar-sigma", "0.01")
        done = run("plan", model.name, *given, "--json", "report.json")
        assert (done.code, done.err) == (0, "")
        found = json.loads((tmp_path / "report.json").read_text())
        (one,) = found["proposals"]
        more = [line.replace("LENGTH", one["what"].split()[-2]) for line in one["lines"]]
        if kind == "gcp":
            key = int(more[0].split()[-1].removeprefix("point_"))
            position = " ".join(map(str, problem.points[row[key]]))
            more = [line.replace("X Y Z", position) for line in more]
        else:
            (tmp_path / "bars.txt").write_text(more.pop())
        listed.write_text("\n".join([*lines, *more, ""]))
        command = found["headline"][1].split(", then bundle ")[1]
        words = shlex.split(command)
        assert " ".join(loss) in command and not {"--for", "--add", "--count"} & set(words)
        words[words.index("measured")] = f"measured_{kind}"
        after = run(*words, "--quiet")
        assert after.code == 0 and (tmp_path / f"measured_{kind}").is_dir()
        if kind == "gcp":  # the core has no bars between points
            again = run("influence", model.name, "--on", *flags[1:], "--json", "again.json")
            assert again.code == 0
            sigma = json.loads((tmp_path / "again.json").read_text())["sigma"]
            assert sigma == pytest.approx(one["sigma_after"], rel=0.1)


def test_sigmas_of_flags_arrive(run, model, tmp_path):
    report = tmp_path / "report.json"
    flags = ("--for", "distance 3 9", *DATUM, "--add", "gcp,bar", "--quiet", "--json", report)
    sigmas = []
    for more in ((), ("--gcp-sigma", "0.001/0.002"), ("--bar-sigma", "0.0001")):
        assert run("plan", model, *flags, *more).code == 0
        found = json.loads(report.read_text())["proposals"]
        sigmas.append({one["kind"]: one["sigma_after"] for one in found})
    plain, points, bars = sigmas
    assert points["gcp"] < plain["gcp"] and points["bar"] == plain["bar"]
    assert bars["bar"] < plain["bar"] and bars["gcp"] == plain["gcp"]


def test_given_poses(run, model, tmp_path):
    problem = bundle.load(model)
    pose = problem.cam_from_world[0] + [0, 0, 0, 0, 0.2, 0, 0]
    qx, qy, qz, qw, *t = pose
    path = tmp_path / "poses.txt"
    path.write_text(" ".join(map(str, ("beside.jpg", qw, qx, qy, qz, *t))) + "\n")
    flags = ("--for", RATIO, "--add", "image", "--candidates", path, "--quiet")
    done = run("plan", model, *flags)
    assert (done.code, done.err) == (0, "") and "beside.jpg" in done.out
    table = bundle.PoseTable(inverse_poses(pose[None]), ("beside.jpg",))
    found = bundle.plan(model, RATIO, add="image", candidates=table)
    assert found.together == found.proposals and len(found.together) == 1
    path.write_text(" ".join(map(str, ("beside.jpg", qw, qx, qy, qz, 1e4, 1e4, -1e4))) + "\n")
    refused = run("plan", model, *flags)
    assert refused.code == 2 and refused.out == "" and "beside.jpg" in refused.err
    assert refused.err.startswith("error: --candidates: ") and refused.err.count("\n") == 1


@pytest.mark.parametrize(
    "flags",
    [
        (),
        ("--for", ""),
        ("--for", "distance 3 3"),
        ("--for", "distance 3 999"),
        ("--for", "distance 3 9"),
        ("--for", RATIO, "--count", "0"),
        ("--for", RATIO, "--count", "-1"),
        ("--for", RATIO, "--add", "photograph"),
        ("--for", RATIO, "--add", "gcp,bar"),
        ("--for", RATIO, "--gcp-sigma", "0"),
        ("--for", RATIO, "--bar-sigma", "0"),
        ("--for", RATIO, "--candidates", "nowhere.txt"),
    ],
)
def test_bad_input_is_one_line(run, model, flags):
    done = run("plan", model, "--quiet", *flags)
    assert done.code == 2 and done.out == ""
    assert done.err.startswith("error: ") and done.err.count("\n") == 1
