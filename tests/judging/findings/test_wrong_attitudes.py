"""The finding about attitudes that contradict the others: planted and healthy ones."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import GravityPrior, HeadingPrior, OrientationPrior
from bundle.judging.findings.find import find
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.wrong_attitudes import wrong_attitudes
from tests.georeference.test_attitude_errors import measured
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
