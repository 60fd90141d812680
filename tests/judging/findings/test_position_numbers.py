"""Findings about measured positions on planted scenes with exact numbers."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle import PositionPrior
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.positions import (
    _sums,
    is_tense,
    measured_positions,
    positions_of_start,
    scale_drift,
)
from tests.georeference.test_attitude_priors import upright_and_turned

ARM = np.array([0.3, -0.2, 0.5])
COUNT = 24


def model(count=COUNT):
    return upright_and_turned(num_images=count)[0]


def antennas(problem):
    turns = Rotation.from_quat(np.array(problem.cam_from_world[:, :4]))
    return problem.projection_centers + turns.inv().apply(ARM)


def measured(problem, places, sigma=0.1, **changes):
    priors = [
        PositionPrior(int(one), place, sigma, lever_arm=ARM, **changes)
        for one, place in zip(problem.image_ids, places, strict=True)
    ]
    return Measured(whole=problem, command=NextCommand(), priors=priors)


def test_positions_of_antennas_are_exact():
    problem = model()
    assert not is_tense(measured(problem, antennas(problem), sigma=1e-6))
    assert measured_positions(measured(problem, antennas(problem), sigma=1e-6)) is None
    away = antennas(problem)
    away[5] += [0.0, 0.0, 0.7]
    finding = measured_positions(measured(problem, away))
    assert finding.evidence["image_ids"] == [int(problem.image_ids[5])]
    assert finding.evidence["sigmas"] == pytest.approx([7.0])
    assert "--prior-loss cauchy" in finding.command


@pytest.mark.parametrize(("sigmas", "is_found"), [(5.05, True), (4.95, False)])
def test_single_positions_beyond_five_sigmas(sigmas, is_found):
    problem = model()
    away = antennas(problem)
    away[5, 0] += 0.1 * sigmas
    found = measured(problem, away)
    assert (measured_positions(found) is not None) == is_found
    assert is_tense(found) == is_found


@pytest.mark.parametrize(("num", "are_named"), [(8, True), (9, False)])
def test_a_third_of_the_positions_may_be_wrong(num, are_named):
    problem = model()
    away = antennas(problem)
    away[:, 0] += 0.001
    away[:num, 1] += 1.0
    finding = measured_positions(measured(problem, away))
    assert (finding is not None) == are_named
    if are_named:
        assert finding.evidence["image_ids"] == problem.image_ids[:num].tolist()


def test_a_start_far_from_its_positions_gets_their_distance_as_sigma():
    problem = model()
    away = antennas(problem)
    away[:, 0] += 0.236  # 2.004 times the sigmas in the median
    found = positions_of_start(measured(problem, away))
    assert found.command == "bundle refine INPUT -o OUTPUT --gps-sigma-scale 2"
    assert found.evidence["ratio"] == pytest.approx(2.36 / np.sqrt(1.3863))
    assert "by 2.004 times their sigmas (0.1 m)" in found.sentence
    for scale, advised in (("1", "2"), ("3/2", "6/4"), ("2/0.9", None)):
        command = NextCommand("INPUT", "OUTPUT", ("--gps-sigma-scale", scale))
        found = positions_of_start(measured(problem, away).of_command(command))
        assert (found and found.command.split()[-1]) == advised  # those of a drift are not undone
    away[:, 0] -= 0.001
    assert positions_of_start(measured(problem, away)) is None
    few = dataclasses.replace(measured(problem, away + 9.0), priors=())
    assert positions_of_start(few) is None


def test_positions_that_motion_bends_keep_their_sigmas():
    problem = model()
    away = antennas(problem)
    away[:, 0] += 0.236
    found = measured_positions(measured(problem, away), is_moving=True)
    assert "--gps-sigma" not in found.command and "Motion during the exposure" in found.sentence
    away[:, 0] -= 0.001
    assert measured_positions(measured(problem, away), is_moving=True) is None
    away[5, 0] += 1.0  # a wrong one is named all the same
    found = measured_positions(measured(problem, away), is_moving=True)
    assert found.command.endswith("--prior-loss cauchy")


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("growth", [1.2, 1 / 1.2])
def test_a_drift_has_its_sign_and_its_size(growth, flat):
    problem = model()
    places = antennas(problem)
    order = np.argsort(problem.image_ids)
    for part, scale in ((order[: COUNT // 2], growth**-0.5), (order[COUNT // 2 :], growth**0.5)):
        middle = places[part].mean(axis=0)
        places[part] = middle + scale * (places[part] - middle)
    if flat:
        places[:, 2] = np.nan
    found = measured(problem, places, sigma=0.01)
    finding = scale_drift(found, problem)
    assert finding is not None and finding.kind == "scale_drift"
    assert finding.evidence["change"] == pytest.approx(growth - 1, abs=0.02)
    assert f"{100 * (growth - 1):+.0f}"[:2] in finding.sentence
    errors = []
    for part in (order[: COUNT // 2], order[COUNT // 2 :]):
        away = (places[part] - places[part].mean(axis=0))[:, : 2 if flat else 3]
        errors.append(0.01 * np.sqrt(COUNT / 2) / np.linalg.norm(away, axis=1).sum())
    assert finding.evidence["standard_error"] == pytest.approx(np.hypot(*errors))
    straight = scale_drift(measured(problem, antennas(problem), sigma=0.01), problem)
    assert straight is None


def test_a_loss_accuses_no_single_position():
    problem = model()
    away = antennas(problem)
    away[5] += 1.0
    robust = measured(problem, away, loss="cauchy")
    assert measured_positions(robust) is None
    few = dataclasses.replace(robust, priors=robust.priors[:5])
    assert not is_tense(few) and measured_positions(few) is None


def test_redundancies_are_those_of_the_antenna():
    """The oracle moves the pose numerically."""
    rng = np.random.default_rng(4)
    turn, t, arm = Rotation.random(random_state=1), rng.normal(size=3), rng.normal(size=3)
    root = 0.1 * rng.normal(size=(6, 6))
    spread, sigma = root @ root.T, np.array([0.5, 0.7, 1.1])

    def antenna(step):
        moved = Rotation.from_rotvec(step[:3]) * turn
        return moved.inv().apply(arm - t - step[3:])

    jacobian = np.stack([(antenna(h) - antenna(-h)) / 2e-5 for h in 1e-5 * np.eye(6)], axis=1)
    left = 1 - np.diag(jacobian @ spread @ jacobian.T) / sigma**2
    offset = np.array([0.3, -0.2, 0.9])
    prior = PositionPrior(1, antenna(np.zeros(6)) - offset, sigma, lever_arm=arm)
    pose = np.concatenate([turn.as_quat(), t])[None]
    found = _sums(SimpleNamespace(cam_from_world=pose), [0], [prior], spread[None])
    squares = (offset / sigma) ** 2
    np.testing.assert_allclose(found[0], [squares[:2].sum(), left[:2].sum()], rtol=1e-6)
    np.testing.assert_allclose(found[1], [squares[2], left[2]], rtol=1e-6)


@pytest.mark.parametrize(
    ("flags", "own", "advised"),
    [
        ((), 0.1, "--gps-sigma-scale 2"),  # 0.1 m is not the default
        (("--gps-sigma", "0.1"), 0.1, "--gps-sigma 0.2"),
        (("--gps-sigma", "0.1/0.3"), (0.1, 0.3), "--gps-sigma 0.2/0.6"),
        (("--gps-sigma", "0.1/0.3"), 0.1, "--gps-sigma-scale 2"),
        (("--gps-sigma", "0.11"), 0.1, "--gps-sigma-scale 2"),
    ],
)
@pytest.mark.parametrize("is_high", [True, False])
def test_sigmas_of_a_flag_are_replaced_and_those_of_a_file_scaled(flags, own, advised, is_high):
    """An axis without a measurement has no sigma to compare."""
    problem = model()
    away = antennas(problem)
    away[:, 0] += 0.236
    if not is_high:
        away[:, 2] = np.nan
        own, advised = (own if np.isscalar(own) else own[0]), advised.partition("/")[0]
        flags = tuple(word.partition("/")[0] for word in flags)
        if flags == ("--gps-sigma", "0.1"):
            advised = "--gps-sigma 0.2"
    found = measured(problem, away, own).of_command(NextCommand("INPUT", "OUTPUT", flags))
    assert positions_of_start(found).command.endswith(advised)
