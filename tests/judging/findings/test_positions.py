"""Measured positions: their sigmas per axis, advice where files have sigmas, and drifts."""

import shlex

import numpy as np
import pytest

import bundle
from bundle.georeference.similarity import moved
from bundle.judging.findings import positions as positions_module
from bundle.judging.findings.find import find
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.positions import _shrinking, sigma_factors
from tests.campaigns.findings import make

HORIZONTAL, VERTICAL = 0.3, 3.0


@pytest.fixture(scope="module")
def flight():
    """Return a flight and positions with other errors up than east and north."""
    scene = bundle.synthesize(
        scene="drone-grid", num_images=36, num_points=900, pixel_noise=0.5, seed=5
    )
    truth = scene.ground_truth
    rng = np.random.default_rng(3)
    noise = rng.normal(size=(truth.num_images, 3)) * [HORIZONTAL, HORIZONTAL, VERTICAL]
    return scene.problem, truth.projection_centers + noise


def priors_of(problem, positions, sigma):
    images = problem.image_ids.tolist()
    return [bundle.PositionPrior(one, p, sigma) for one, p in zip(images, positions, strict=True)]


def solved(problem, priors, **options):
    return bundle.solve(problem, priors=priors, align=True, num_threads=1, **options)


def advised(result, priors, *given):
    found = [one for one in find(result.problem, options=result.options, priors=priors, given=given)
             if one.kind == "positions"]  # fmt: skip
    return found[0] if found else None


@pytest.mark.parametrize("sigma", [0.1, (0.04, 0.2)])
def test_sigmas_are_found_per_axis(flight, sigma):
    problem, positions = flight
    priors = priors_of(problem, positions, sigma)
    result = solved(problem, priors)
    finding = advised(result, priors, "--gps", "g", "--gps-sigma", "0.1")
    horizontal, vertical = finding.evidence["sigmas_found"]
    assert horizontal == pytest.approx(HORIZONTAL, rel=0.3)  # redundancies of about 60 and 30
    assert vertical == pytest.approx(VERTICAL, rel=0.3)
    words = shlex.split(finding.command)
    if sigma == 0.1:  # the flag's: it is replaced
        assert words[-2] == "--gps-sigma" and words.count("--gps-sigma") == 1
        assert [float(w) for w in words[-1].split("/")] == pytest.approx(
            [horizontal, vertical], rel=0.06
        )
    else:  # the file's own: factors
        assert words[-2] == "--gps-sigma-scale"
        assert [float(w) for w in words[-1].split("/")] == pytest.approx(
            [horizontal / 0.04, vertical / 0.2], rel=0.06
        )
    better = priors_of(problem, positions, (horizontal, vertical))
    assert advised(solved(problem, better), better) is None


def test_factors_multiply_those_of_the_run(flight):
    problem, positions = flight
    priors = priors_of(problem, positions, 0.1)
    given = ("--gps", "g", "--gps-sigma", "0.1", "--gps-sigma-scale", "2/4")
    finding = advised(solved(problem, priors), priors, *given)
    words = shlex.split(finding.command)
    horizontal, vertical = (float(word) for word in words[-1].split("/"))
    found = finding.evidence["factors"]
    assert words.count("--gps-sigma-scale") == 1
    assert [horizontal / 2, vertical / 4] == pytest.approx(found, rel=0.06)


def test_few_positions_have_no_estimate(flight):
    """The heights of 6 positions have a redundancy below 10."""
    problem, positions = flight
    rows = [0, 5, 14, 21, 30, 35]
    every = priors_of(problem, positions, 0.1)
    priors = [every[row] for row in rows]
    result = solved(problem, priors)
    measured = Measured(
        whole=result.problem, command=NextCommand(), priors=priors, options=result.options
    )
    assert sigma_factors(measured, rows, priors, 3.0)[1] is None
    many = priors_of(problem, positions, 0.1)
    measured = Measured(
        whole=result.problem, command=NextCommand(), priors=many, options=result.options
    )
    factors = sigma_factors(measured, list(range(36)), many, 3.0)
    assert factors == pytest.approx((HORIZONTAL / 0.1, VERTICAL / 0.1), rel=0.3)


def test_one_wrong_position_is_named_among_weak_heights(flight):
    """Heights ten times less certain than said accuse no image; a wrong one stands out."""
    problem, positions = flight
    shifted = positions.copy()
    shifted[7, 0] += 40 * HORIZONTAL
    priors = priors_of(problem, shifted, HORIZONTAL)
    finding = advised(solved(problem, priors), priors)
    assert finding.evidence["image_ids"] == [int(problem.image_ids[7])]
    assert "--prior-loss cauchy" in finding.command


def test_sigmas_of_right_size_are_left(flight):
    problem, positions = flight
    priors = priors_of(problem, positions, (HORIZONTAL, VERTICAL))
    assert advised(solved(problem, priors), priors) is None


def test_a_bent_model_is_judged_without_its_bends():
    """The command about positions repairs the lens, too; with it, their sigmas are the planted."""
    scene = make(50_016)
    result = bundle.solve(scene.start, priors=scene.priors, align=True, num_threads=1)
    found = {one.kind: one for one in find(result.problem, options=result.options,
             priors=scene.priors)}  # fmt: skip
    assert {"lens_model", "positions"} == set(found)
    assert "--camera-model" in found["positions"].command


def test_smaller_sigmas_are_advised_until_the_positions_hold_the_scale():
    scene = make(20_000, ("scale_drift",))
    tighter, steps = 1.0, 0
    while steps < 4:
        tight = [bundle.PositionPrior(p.image, p.position, p.sigma * tighter) for p in scene.priors]
        result = bundle.solve(scene.start, priors=tight, align=True, num_threads=1)
        found = [one for one in find(result.problem, options=result.options, priors=tight)
                 if one.kind == "scale_drift"]  # fmt: skip
        if not found or not found[0].command:
            break
        assert abs(found[0].evidence["left"]) > 0.029
        steps += 1
        tighter *= float(shlex.split(found[0].command)[-1])  # --gps-sigma-scale
    assert 1 <= steps <= 2


@pytest.mark.parametrize("has_start", [True, False])
@pytest.mark.parametrize(
    ("given", "usable", "tries"),
    [(1e4, 1.0, [1.0]), (1e4, 0.01, [1.0, 0.01]), (1e4, None, [1.0, 0.01]), (0.1, 0.1, [0.1])],
)
def test_sigmas_are_advised_only_if_a_model_can_have_them(
    monkeypatch, given, usable, tries, has_start
):
    scene = make(20_000, ("scale_drift",))
    result = bundle.solve(scene.start, priors=scene.priors, align=True, num_threads=1)
    gravity = bundle.GravityPrior(int(scene.start.image_ids[0]), [0.0, 1.0, 0.0], 90.0)
    tried = []

    def solved(_, start, options, priors):
        tried.append((start, options, priors))
        if options.initial_trust_region_radius != usable:
            raise bundle.InputError("nothing is usable")

    monkeypatch.setattr(positions_module, "solved", solved)
    first = scene.start if has_start else None
    options = result.options.replace(initial_trust_region_radius=given)
    priors = [gravity, *scene.priors]
    judged = find(result.problem, options=options, priors=priors, start=first)
    (found,) = [one for one in judged if one.kind == "scale_drift"]
    radii = [options.initial_trust_region_radius for _, options, _ in tried]
    assert radii == tries  # to the first usable one, none longer than that of the run
    factors = set()
    for start, options, priors in tried:
        assert start is (scene.start if has_start else result.problem)
        assert options.loss == "trivial" and options.max_num_iterations == 50  # of 100
        assert priors[len(scene.priors) :] == [gravity]
        factors |= {
            round(np.mean(np.asarray(one.sigma) / np.asarray(scaled_from.sigma)), 12)
            for one, scaled_from in zip(priors[: len(scene.priors)], scene.priors, strict=True)
        }
    (factor,) = factors
    if usable is None:
        assert not found.command
    else:
        flags = shlex.split(found.command)[5:]
        assert flags[:3] == ["--initial-trust-region-radius", f"{usable:g}", "--gps-sigma-scale"]
        assert float(flags[3]) == pytest.approx(factor, rel=0.05)  # two digits


def test_a_drift_is_mended_by_short_steps_from_the_start():
    """Longer steps with these sigmas move observations behind their cameras."""
    scene = make(66_012)
    assert scene.planted == {"duplicate_points", "outliers", "scale_drift"}
    flags = {"loss": "cauchy", "loss_scale": 2.0, "num_threads": 1}
    result = bundle.solve(scene.start, priors=scene.priors, align=True, **flags)
    start = moved(scene.start, result.similarity)
    judged = find(result.problem, options=result.options, priors=scene.priors, start=start)
    (found,) = [one for one in judged if one.kind == "scale_drift"]
    assert abs(found.evidence["left"]) > 0.15
    words = shlex.split(found.command)
    radius = float(words[words.index("--initial-trust-region-radius") + 1])
    scale = float(words[words.index("--gps-sigma-scale") + 1])
    tight = [bundle.PositionPrior(p.image, p.position, p.sigma * scale) for p in scene.priors]
    for steps, is_usable in (({"initial_trust_region_radius": radius}, True), ({}, False)):
        again = bundle.solve(scene.start, priors=tight, align=True, **flags, **steps)
        assert again.summary.is_solution_usable == is_usable


@pytest.mark.parametrize(
    ("left", "factor"),
    [
        (0.15, np.sqrt(1 / 19)),  # 0.3 / 0.15 - 1 of 0.3 / 0.015 - 1
        (0.24, np.sqrt(0.25 / 19)),
        (0.31, 1 / 30),  # larger than without positions
        (0.299, 1 / 30),  # no more than thirty times
        (0.3, 1 / 30),
        (0.031, 1 / 3),  # no less than three times
    ],
)
def test_sigmas_shrink_by_what_is_left_of_a_drift(left, factor):
    assert _shrinking(0.3, left) == pytest.approx(factor)
    assert _shrinking(-0.3, -left) == pytest.approx(factor)
