"""The finding about attitudes that contradict the others: planted and healthy ones."""

import dataclasses
import shlex

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import GravityPrior, HeadingPrior, OrientationPrior
from bundle.georeference.attitudes import AttitudeErrors, Attitudes, ImageAttitude
from bundle.judging.findings.find import find
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.wrong_attitudes import wrong_attitudes
from tests.georeference.test_attitude_errors import AXIS, measured
from tests.georeference.test_attitude_priors import gravity_of, rotations, upright_and_turned


def found(problem, priors):
    return [one for one in find(problem, priors=priors) if one.kind == "attitudes"]


def test_planted_images_are_named_in_models_that_were_turned_and_others():
    truth, given = upright_and_turned()
    priors = gravity_of(truth, 1.0, upside_down=(2, 5))
    solved = bundle.solve(given, priors=priors).problem
    for model in (solved, given):
        (finding,) = found(model, priors)
        assert set(finding.evidence["images"]) == {"image2.jpg", "image5.jpg"}
        assert min(finding.evidence["degrees"]) > 170
        assert "--prior-loss tukey" in finding.command
    robust = [dataclasses.replace(prior, loss="tukey") for prior in priors]
    assert not found(solved, robust)


def test_moderate_errors_are_found():
    truth, _ = upright_and_turned()
    priors = gravity_of(truth, 0.5)
    turned = Rotation.from_euler("x", 6, degrees=True).apply(np.array(priors[3].direction))
    priors[3] = dataclasses.replace(priors[3], direction=turned)
    (finding,) = found(truth, priors)
    assert finding.evidence["images"] == ["image3.jpg"]


def test_small_sigmas_are_found_with_the_right_ones():
    truth, _ = upright_and_turned(num_images=30)
    priors = [dataclasses.replace(p, sigma_degrees=0.3) for p in gravity_of(truth, 2.0)]
    (finding,) = found(truth, priors)
    assert finding.evidence["ratio"] * 0.3 == pytest.approx(2.0, rel=0.4)
    assert "--gravity-sigma" in finding.command


@pytest.mark.parametrize("kind", [GravityPrior, HeadingPrior])
def test_few_healthy_measurements_are_not_accused(kind):
    """The median of few lengths scatters: that of six headings is often above twice its value."""
    truth, _ = upright_and_turned(num_images=6)
    rng = np.random.default_rng(0)
    priors = (measured(truth, kind, 2.0, rng) for _ in range(80))
    models = (Measured(whole=truth, command=NextCommand(), priors=one) for one in priors)
    assert sum(wrong_attitudes(one) is not None for one in models) < 2


@pytest.mark.parametrize("seed", range(8))
def test_healthy_measurements_are_not_accused(seed):
    truth, given = upright_and_turned(seed, num_images=25)
    rng = np.random.default_rng(seed)
    headings = np.degrees(np.arctan2(*rotations(truth).inv().apply([1, 0.3, 0.2]).T[:2]))
    priors = gravity_of(truth, 1.5, seed)
    for image, rotation, heading in zip(truth.image_ids, rotations(truth), headings, strict=True):
        noise = Rotation.from_rotvec(np.radians([1, 1, 5]) * rng.normal(size=3))
        measured = (rotation * noise).as_quat()
        priors.append(OrientationPrior(int(image), measured, (5, 1)))
        heading += 4 * rng.normal()
        priors.append(HeadingPrior(int(image), heading, 4, axis=(1, 0.3, 0.2)))
    for whole in (given, truth):
        assert wrong_attitudes(Measured(whole=whole, command=NextCommand(), priors=priors)) is None


PRIORS = {
    "gravity": GravityPrior(1, (0, 0, -1), 3.0),
    "orientation": OrientationPrior(1, (0, 0, 0, 1), (3.0, 3.0)),
    "heading": HeadingPrior(1, 0.0, 3.0, axis=AXIS),
}
"""One with its own sigma, of each kind."""


def planted(monkeypatch, noun, *, ratio=1.0, good=(1.0,) * 10, wrong=(), given=(), sigma=None):
    """The finding of residuals with these angles; the sigmas are too small by a ratio."""
    images = [ImageAttitude(f"good{k}", one, one, 1.0, True, True) for k, one in enumerate(good)]
    images += [ImageAttitude(f"bad{k}", 0.0, one, 9.0, True, False) for k, one in enumerate(wrong)]
    prior = PRIORS[noun]
    if sigma is not None:
        prior = dataclasses.replace(prior, sigma_degrees=sigma)
    median = float(np.median(prior.sigma_degrees))
    errors = AttitudeErrors(noun, tuple(images), 1.0, ratio, median, 0.0, 0.1)
    monkeypatch.setattr(Attitudes, "errors", lambda *_, **__: (errors,))
    command = NextCommand("in", "out", given)
    truth, _ = upright_and_turned(num_images=3)
    return wrong_attitudes(Measured(whole=truth, command=command, priors=[prior]))


@pytest.mark.parametrize(
    ("noun", "sigma", "given", "advised"),
    [
        # The default, or the number of the flag, is replaced; sigmas of the file are multiplied.
        ("gravity", 1.0, (), ["--gravity-sigma", "2.6"]),
        ("gravity", 3.0, ("--gravity-sigma", "3"), ["--gravity-sigma", "7.7"]),
        ("gravity", 3.0, (), ["--gravity-sigma-scale", "2.6"]),
        ("gravity", 1.0, ("--gravity-sigma-scale", "2"), ["--gravity-sigma-scale", "5.1"]),
        ("heading", 3.0, ("--orientation-sigma-scale", "2"), ["--orientation-sigma-scale", "5.1"]),
        ("orientation", (1.0, 1.0), (), ["--orientation-sigma-scale", "2.6"]),
    ],
)
def test_the_advised_sigma_is_what_the_residuals_show(monkeypatch, noun, sigma, given, advised):
    finding = planted(monkeypatch, noun, ratio=2.57, given=given, sigma=sigma)
    assert shlex.split(finding.command) == ["bundle", "refine", "in", "-o", "out", *advised]
    assert finding.evidence == {"noun": noun, "num_images": 10, "ratio": 2.57}


@pytest.mark.parametrize(
    ("noun", "count", "largest"),
    [
        # max(2, 1 + 3 c / sqrt(n)), c = 1.17, 0.72 and 0.56
        *(("heading", 6, 2.432), ("heading", 8, 2.240), ("heading", 16, 2.0)),
        *(("gravity", 6, 2.0), ("orientation", 6, 2.0)),
    ],
)
def test_the_largest_ratio_of_right_sigmas(monkeypatch, noun, count, largest):
    def is_accused(ratio, count):
        return planted(monkeypatch, noun, ratio=ratio, good=(1.0,) * count) is not None

    assert not is_accused(largest, count)
    assert is_accused(largest + 0.002, count)
    assert not is_accused(9.0, 5)


@pytest.mark.parametrize(
    ("good", "wrong", "names"),
    [
        (10, (1.0,), None),
        (10, (1.01,), ["bad0"]),
        (10, (0.5, 3.0, 7.0), ["bad2", "bad1"]),
        (3, (9.0, 9.0), ["bad0", "bad1"]),
        *((2, (9.0, 9.0), None), (2, (9.0,), ["bad0"]), (1, (9.0,), None)),
    ],
)
def test_single_images_are_accused_above_a_degree_and_in_less_than_half(
    monkeypatch, good, wrong, names
):
    finding = planted(monkeypatch, "gravity", good=(0.25,) * good, wrong=wrong)
    assert (finding and finding.evidence["images"]) == names
    if names:
        by_name = {f"bad{k}": one for k, one in enumerate(wrong)}
        assert finding.evidence["degrees"] == [by_name[name] for name in names]
        assert shlex.split(finding.command)[-2:] == ["--prior-loss", "tukey"]


def test_lenses_are_judged_without_the_directions_that_bend_a_model():
    """Gravity with sigmas 60 times too small bends the block, which looks like a small lens."""
    made = bundle.synthesize(scene="drone-grid", num_images=16, num_points=400, seed=7)
    priors = gravity_of(made.ground_truth, 3.0)
    priors = [dataclasses.replace(prior, sigma_degrees=0.05) for prior in priors]
    result = bundle.solve(made.problem, priors=priors, num_threads=1, max_num_iterations=200)
    bent = {one.kind: one for one in find(result.problem, options=result.options, is_minimum=True)}
    assert "lens_model" in bent  # without the measurements the bend is taken for a lens
    given = {"options": result.options, "priors": priors, "is_minimum": True}
    assert [one.kind for one in find(result.problem, **given)] == ["attitudes"]
