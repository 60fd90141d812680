"""Findings about control points, alone and as commands that are followed."""

import dataclasses
import json
import shlex

import numpy as np
import pytest

import bundle
from bundle.georeference.alignment_result import ControlPointError, suspicions
from bundle.judging.findings.control_points import control_points
from bundle.judging.findings.next_command import NextCommand
from tests.cli.conftest import run  # noqa: F401 (a fixture)
from tests.cli.test_align import written
from tests.cli.test_gcp import TARGETS
from tests.georeference.flights import flight

COMMAND = NextCommand("in", "out", ("--gcp", "g.txt"))


def point(name, error, *, suspect=False, sigma=(0.02, 0.02, 0.02), role="control"):
    return ControlPointError(name, role, 3, error, error, sigma, 0.5, (), suspect, redundancy=0.5)


def test_right_points_and_check_points_have_none():
    good = [point(f"t{k}", (0.01, 0.01, 0.01)) for k in range(5)]
    checks = [point(f"c{k}", (9.0, 9.0, 9.0), suspect=True, role="check") for k in range(9)]
    assert control_points([*good, *checks], COMMAND) is None
    assert control_points([], COMMAND) is None


@pytest.mark.parametrize("num_wrong", [1, 2])
def test_a_minority_is_named_and_loses_its_influence(num_wrong):
    wrong = [point(f"w{k}", (1.0 + k, 0.0, np.nan), suspect=True) for k in range(num_wrong)]
    points = [*wrong, *(point(f"t{k}", (0.01, 0.0, 0.0)) for k in range(2))]
    found = control_points(points, COMMAND)
    assert found.command == "bundle refine in -o out --gcp g.txt --prior-loss cauchy"
    assert found.evidence["names"] == [f"w{k}" for k in range(num_wrong)]
    assert f"w{num_wrong - 1} by {num_wrong} m" in found.sentence
    assert len(suspicions(points)) == num_wrong
    robust = NextCommand("in", "out", ("--gcp", "g.txt", "--prior-loss", "tukey"))
    assert control_points(points, robust) is None


def test_a_majority_has_too_small_sigmas():
    """Squares: horizontal 0.0025 (median) over 1.3863, vertical 0.0036 over 0.4549."""
    sigma = (0.02, 0.02, 0.04)
    errors = [(0.03, 0.04, 0.06), (0.0, 0.05, -0.06), (0.05, 0.0, 0.06), (0.0, 40.0, 0.06)]
    points = [point(f"t{k}", one, suspect=k != 0, sigma=sigma) for k, one in enumerate(errors)]
    given = NextCommand("in", "out", ("--gcp", "g.txt", "--gcp-sigma", "0.02/0.04"))
    found = control_points(points, given)
    expected = [np.sqrt(0.0025 / 1.3863), np.sqrt(0.0036 / 0.4549)]
    np.testing.assert_allclose(found.evidence["sigmas"], expected, rtol=1e-4)
    assert found.command == "bundle refine in -o out --gcp g.txt --gcp-sigma 0.042/0.089"
    assert len(suspicions(points)) == 1
    # Sigmas of the file: the flag has no influence.
    assert control_points(points, COMMAND).command == ""
    # The model bends to a point, or the others do not place it: the larger error counts.
    bent = [dataclasses.replace(one, residual=(0.0, 0.0, 0.0)) for one in points[:2]]
    free = [dataclasses.replace(one, leave_one_out=(0.0, 0.0, 0.0)) for one in points[2:]]
    assert control_points([*bent, *free], given).evidence["sigmas"] == found.evidence["sigmas"]
    # Half of them: which half is wrong is unknown, and their sigmas are not blamed.
    half = [point(f"t{k}", (1.0, 0, 0), suspect=k < 2) for k in range(4)]
    assert "--prior-loss" in control_points(half, COMMAND).command


def test_points_without_heights_have_one_sigma():
    points = [
        point(f"t{k}", (0.2, 0.1, np.nan), suspect=True, sigma=(0.02, 0.02, np.nan))
        for k in range(4)
    ]
    found = control_points(points, COMMAND)
    np.testing.assert_allclose(found.evidence["sigmas"], [np.sqrt(0.05 / 1.3863)], rtol=1e-4)
    assert found.command.endswith("--gcp-sigma 0.19")


@pytest.mark.parametrize("case", ["sigmas", "one"])
def test_the_command_is_followed(run, tmp_path, case):  # noqa: F811
    scene = flight(TARGETS, num_images=9, num_points=60, start_noise=0.05)
    rng = np.random.default_rng(3)
    for row, gcp in enumerate(scene.gcps):
        off = rng.normal(size=3) * 0.6 if case == "sigmas" else (3.5 * (row == 2), 0.0, 0.0)
        object.__setattr__(gcp, "position", tuple(np.add(gcp.position, off).tolist()))
    bundle.save(scene.elsewhere(), f"{tmp_path}/model/")
    gcps = written(tmp_path / "gcp_list.txt", scene.gcps)

    def refined(words):
        code, _, _ = run(*words, "--json", tmp_path / "r.json", "--quiet", "--overwrite")
        assert code == 0
        report = json.loads((tmp_path / "r.json").read_text())
        return report, [one for one in report["findings"] if one["kind"] == "control_points"]

    report, found = refined(["refine", tmp_path / "model", "-o", f"{tmp_path}/out/", "--gcp", gcps])
    before = [one["suspect"] for one in report["georeference"]["gcps"]]
    assert len(found) == 1 and sum(before) == (1 if case == "one" else 4)
    report, found = refined(shlex.split(found[0]["command"])[1:])
    after = report["georeference"]["gcps"]
    if case == "sigmas":
        assert not found and not any(one["suspect"] for one in after)
        assert 0.2 < after[0]["sigma"][0] < 1.8  # of 6 points with 0.6
    else:
        good = [one["residual_enu"] for one in after if one["name"] != "t2"]
        assert np.abs(good).max() < 0.2
