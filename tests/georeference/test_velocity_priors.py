"""Priors of velocities: costs by matrix exponentials, both backends, readouts, refusals."""

import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import bundle
from bundle import InputError, PositionPrior, VelocityPrior
from bundle.georeference.similarity import Similarity, moved
from bundle.georeference.velocities import ProblemVelocities
from bundle.solving.request import place_at_priors
from tests import rolling, scenes
from tests.campaigns.rolling_shutter import found_readout, make

RATE = 30.0
EXACT = {"function_tolerance": 1e-14, "gradient_tolerance": 1e-13, "max_num_iterations": 100}
REFINE = ("poses", "points")
LEVER = (0.3, -0.2, 0.5)


def filmed(ties=False, **changes):
    """A filmed problem with a readout of 0.8 and 30 frames per second."""
    scene = {"num_images": 6, "num_points": 40, "seed": 2, "perturbation": 0, **changes}
    problem = rolling.filmed(scenes.make_problem(**scene), seed=3, ties=ties)
    return problem.replace(rolling_shutter=problem.rolling_shutter.replace(frame_rate=RATE))


def velocities_of(problem, lever=(0.0, 0.0, 0.0), step=1e-4):
    """(num_images, 3) velocities of the antennas per second, by differences of exact positions."""
    shutter, poses = problem.rolling_shutter, rolling.matrices(problem)
    found = []
    for image, twist in enumerate(shutter.twist):
        places = [
            np.linalg.solve(expm(rolling.hats(s * twist[None])[0]) @ poses[image], [*lever, 1])[:3]
            for s in (-step, step)
        ]
        seconds = 2 * step * shutter.readout[problem.image_camera[image]] / RATE
        found.append((places[1] - places[0]) / seconds)
    return np.array(found)


def priors_of(problem, sigma=0.1, seed=0, lever=(0.0, 0.0, 0.0), **settings):
    noise = sigma * np.random.default_rng(seed).standard_normal((problem.num_images, 3))
    measured = velocities_of(problem, lever) + noise
    return [
        VelocityPrior(int(image), velocity, sigma, lever_arm=lever, **settings)
        for image, velocity in zip(problem.image_ids, measured, strict=True)
    ]


def velocity_text(priors, name):
    """The content of a file; ``name`` returns the name of an image."""
    lines = ["name vx vy vz sigma_horizontal sigma_vertical"]
    for prior in priors:
        numbers = [*prior.velocity, *prior.sigma[1:]]
        lines.append(" ".join([f'"{name(prior.image)}"', *(repr(float(n)) for n in numbers)]))
    return "\n".join([*lines, ""])


def positions_of(problem, sigma, seed=1):
    noise = sigma * np.random.default_rng(seed).standard_normal((problem.num_images, 3))
    places = problem.projection_centers + noise
    pairs = zip(problem.image_ids.tolist(), places, strict=True)
    return [PositionPrior(image, place, sigma) for image, place in pairs]


def start_of(problem):
    """The problem with zero twists and noisy poses."""
    rng = np.random.default_rng(8)
    poses = problem.cam_from_world.copy()
    turns = Rotation.from_rotvec(0.003 * rng.standard_normal((len(poses), 3)))
    poses[:, :4] = (turns * Rotation.from_quat(poses[:, :4])).as_quat()
    return rolling.still(problem.replace(cam_from_world=poses))


def test_costs_are_those_of_antennas_on_exact_motions(backend):
    problem = filmed()
    rng = np.random.default_rng(4)
    root = rng.standard_normal((3, 3))
    covariance = root @ root.T + np.eye(3)
    measured = rng.standard_normal((problem.num_images, 3))
    priors = [
        VelocityPrior(int(image), velocity, covariance=covariance, lever_arm=LEVER)
        for image, velocity in zip(problem.image_ids, measured, strict=True)
    ]
    found = bundle.solve(problem, priors=priors, backend=backend, max_num_iterations=0)
    errors = velocities_of(problem, LEVER) - measured
    expected = 0.5 * np.einsum("ni,ij,nj->n", errors, np.linalg.inv(covariance), errors)
    np.testing.assert_allclose(found.factor_costs_before, expected, rtol=1e-6)
    known = ProblemVelocities.make(problem, priors)
    np.testing.assert_allclose(known.residuals(problem), errors, atol=1e-5)
    lengths = [image.sigmas for image in known.errors(problem).images]
    np.testing.assert_allclose(np.square(lengths), 2 * expected, rtol=1e-5)


@pytest.mark.parametrize("mode", ["free", "tied", "readout", "far"])
def test_both_backends_take_the_same_steps(mode):
    truth = filmed(ties=True)
    start = start_of(truth)
    if mode == "far":
        away = Similarity(3.0, np.eye(3), np.array([4e5, 5e6, 100]))
        truth, start = moved(truth, away), moved(start, away)
    priors = priors_of(truth, lever=LEVER, loss="cauchy") + positions_of(truth, 0.02)
    options = {"refine": REFINE, "align": False, "max_num_iterations": 8, "num_threads": 2}
    if mode in ("tied", "readout"):
        options |= {"twists": "tied", "twist_sigma": (0.002, 0.01)}
        options["refine_readout"] = mode == "readout"
    costs = []
    for backend in ("fused", "ceres"):
        solved = bundle.solve(start, priors=priors, backend=backend, **options)
        costs.append(np.asarray(solved.iterations["cost"])[:6])
    assert costs[0][0] > 1.5 * costs[0][-1]
    # 5000 km away, the positions themselves have steps of 1e-9 m.
    np.testing.assert_allclose(*costs, rtol=1e-9 if mode != "far" else 1e-8)


def test_the_checker_approves_the_jacobians():
    problem = filmed()
    placed = place_at_priors(problem, (), tuple(priors_of(problem, lever=LEVER)), None)
    report = bundle.check_factors(placed.problem, placed.factors)
    assert report
    assert len(placed.factors) == problem.num_images


def test_the_solution_does_not_depend_on_order_names_or_frame():
    truth = filmed()
    positions, velocities = positions_of(truth, 0.02), priors_of(truth, lever=LEVER)
    start, options = start_of(truth), {"refine": REFINE, **EXACT}
    base = bundle.solve(start, priors=[*positions, *velocities], **options)
    turn = Rotation.random(random_state=5).as_matrix()
    elsewhere = moved(start, Similarity(0.2, turn, np.array([10.0, -4, 30])))
    images = np.random.default_rng(0).permutation(truth.num_images)
    names = dict(zip(truth.image_ids.tolist(), truth.image_names, strict=True))
    named = [
        VelocityPrior(names[one.image], one.velocity, one.sigma, lever_arm=one.lever_arm)
        for one in velocities
    ]
    for problem, priors in (
        (elsewhere, [*positions, *velocities]),
        (start, [*named[::-1], *positions]),
        (start.select(images=images).problem, [*positions, *velocities]),
    ):
        found = bundle.solve(problem, priors=priors, **options)
        assert found.summary.final_cost == pytest.approx(base.summary.final_cost, rel=1e-9)
        np.testing.assert_allclose(
            np.sort(found.problem.rolling_shutter.twist, axis=0),
            np.sort(base.problem.rolling_shutter.twist, axis=0),
            atol=1e-6,
        )


def test_errors_are_those_of_the_sigmas():
    """Mean of 2 cost / dof over seeds, whose standard deviation is sqrt(2 / (8 dof))."""
    ratios = []
    for seed in range(8):
        made = make(0, seed, num_images=12, num_points=150)
        shutter = made.ground_truth.rolling_shutter.replace(frame_rate=RATE)
        truth = made.ground_truth.replace(rolling_shutter=shutter)
        start = made.problem.replace(rolling_shutter=rolling.still(truth).rolling_shutter)
        priors = positions_of(truth, 0.02, seed) + priors_of(truth, 0.1, seed + 100)
        found = bundle.solve(start, priors=priors, refine=REFINE, **EXACT)
        count = 2 * truth.num_observations + 6 * truth.num_images
        dof = count - 12 * truth.num_images - 3 * truth.num_points
        ratios.append(2 * found.summary.final_cost / dof)
    assert np.mean(ratios) == pytest.approx(1, abs=4 * math.sqrt(2 / (8 * dof)))


def test_a_robust_loss_ignores_a_gross_error(backend):
    truth = filmed()
    positions, options = positions_of(truth, 0.02), {"refine": REFINE, "backend": backend, **EXACT}
    start = bundle.solve(start_of(truth), priors=positions, **options).problem
    ends = []
    for loss in ("trivial", "tukey"):
        first, *others = priors_of(truth, loss=loss)
        wrong = VelocityPrior(first.image, first.velocity + np.array([9.0, -5, 3]), 0.1, loss=loss)
        found = bundle.solve(start, priors=[*positions, wrong, *others], **options)
        twists = found.problem.rolling_shutter.twist - truth.rolling_shutter.twist
        ends.append(np.linalg.norm(twists[0, 3:]))
    assert ends[1] < 0.5 * ends[0]


def test_velocities_of_few_images_make_twists_certain():
    truth = filmed()
    options = {"refine": REFINE, "of": "poses"}
    positions, velocities = positions_of(truth, 0.02), priors_of(truth, 0.01)[:2]
    with_some = bundle.covariance(truth, priors=[*positions, *velocities], **options)
    without = bundle.covariance(truth, priors=positions, **options)
    before, after = (
        np.sqrt(np.diagonal(one.twist_covariance[:, 3:, 3:], axis1=1, axis2=2))
        for one in (without, with_some)
    )
    assert after[:2].mean() < 0.5 * before[:2].mean()
    assert (after <= before * (1 + 1e-9)).all()


def readouts(seeds, sigma):
    """z of readouts that velocities and ties of the rotation determine, and their sigmas."""
    found = []
    for seed in seeds:
        made = make(0, seed)
        shutter = made.ground_truth.rolling_shutter.replace(frame_rate=RATE)
        truth = made.ground_truth.replace(rolling_shutter=shutter)
        guess = rolling.still(truth).rolling_shutter
        start = made.problem.replace(
            rolling_shutter=guess.replace(readout=np.full(truth.num_cameras, 0.5))
        )
        priors = positions_of(truth, 0.02, seed) + priors_of(truth, sigma, seed + 100)
        solved = bundle.solve(
            start, priors=priors, refine=REFINE, twists="tied", refine_readout=True,
            twist_sigma=tuple(made.readout * np.asarray(made.shake)), **EXACT,
        )  # fmt: skip
        readout = found_readout(solved)
        spread = bundle.covariance(
            solved.problem, solved.options, of="intrinsics", priors=priors
        ).readout_sigmas[1]
        found.append(((readout - made.readout) / spread, spread))
    return np.array(found).T


def test_estimated_readouts_are_unbiased():
    z, _ = readouts(range(20, 32), 0.1)
    assert np.sqrt((z**2).mean()) < 1.6
    assert abs(z.mean()) < 3 / math.sqrt(len(z))


def test_ties_beside_velocities_of_a_refined_readout_are_of_rotations():
    truth = filmed(ties=True)
    options = {"twists": "tied", "twist_sigma": (0.002, 0.01), "max_num_iterations": 0}
    start = start_of(truth)
    velocities = priors_of(truth)[:2]
    plain, refined = (
        bundle.solve(start, priors=velocities, align=False, refine_readout=flag, **options)
        for flag in (False, True)
    )
    costs, fewer = plain.factor_costs_before[2:], refined.factor_costs_before[2:]
    assert (fewer[:2] < costs[:2]).all()
    np.testing.assert_allclose(fewer[2:], costs[2:], rtol=1e-12)


def test_velocities_hold_the_scale_that_ties_shrink(backend):
    truth = filmed(ties=True)
    start = moved(start_of(truth), Similarity(0.7, np.eye(3), np.zeros(3)))
    found = bundle.solve(
        start, priors=priors_of(truth, 0.05), backend=backend, refine=REFINE,
        twists="tied", twist_sigma=(0.002, 0.01), **EXACT,
    )  # fmt: skip
    assert found.options.gauge == "none" and found.similarity is None
    a, b = found.problem.projection_centers, truth.projection_centers
    ratio = np.linalg.norm(a - a.mean(axis=0)) / np.linalg.norm(b - b.mean(axis=0))
    assert ratio == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize(
    ("which", "vertical", "degrees"), [(6, True, 3), (1, True, 4), (6, False, 3), (0, True, 7)]
)
def test_degrees_of_freedom(which, vertical, degrees):
    """One velocity leaves the turn about itself; the position is free."""
    problem = filmed()
    priors = [
        prior if vertical else VelocityPrior(prior.image, (*prior.velocity[:2], math.nan), 0.1)
        for prior in priors_of(problem)[:which]
    ]
    assert bundle.gauge_freedom(problem, priors=priors).degrees == degrees
    found = bundle.diagnose(problem, priors=priors, refine=REFINE)
    assert (found.nullity, found.expected_nullity) == (degrees, degrees)


def test_an_unknown_vertical_does_not_count():
    problem = filmed()
    (first, *_) = priors_of(problem)
    flat = [VelocityPrior(first.image, (*first.velocity[:2], up), (0.1, 0.1, math.inf))
            for up in (7.0, math.nan)]  # fmt: skip
    costs = [bundle.solve(problem, priors=[one], max_num_iterations=0) for one in flat]
    assert costs[0].factor_costs_before == pytest.approx(costs[1].factor_costs_before)
    errors = ProblemVelocities.make(problem, flat[1:]).errors(problem)
    assert math.isnan(errors.images[0].z) and math.isfinite(errors.median)
    assert errors.rms_sigmas == pytest.approx(errors.images[0].sigmas / math.sqrt(2))


def test_errors_have_images_and_axes_in_the_order_of_the_priors():
    problem, off = filmed(), np.array([0.3, -0.2, 0.1])
    velocities, order = velocities_of(problem), np.arange(problem.num_images)[::-1]
    given = [
        VelocityPrior(int(problem.image_ids[k]), velocities[k] - k * off, (0.5, 2.0))
        for k in order.tolist()
    ]
    errors = ProblemVelocities.make(problem, given).errors(problem)
    assert [one.image for one in errors.images] == [problem.image_names[k] for k in order]
    axes = [[one.x, one.y, one.z] for one in errors.images]
    np.testing.assert_allclose(axes, order[:, None] * off, atol=1e-5)
    length = np.linalg.norm(off / [0.5, 0.5, 2.0])
    np.testing.assert_allclose([one.sigmas for one in errors.images], order * length, atol=1e-4)
    assert errors.rms_sigmas == pytest.approx(length * np.sqrt(np.mean(order**2) / 3), rel=1e-4)


def shutter_with(problem, **changes):
    return problem.replace(rolling_shutter=problem.rolling_shutter.replace(**changes))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: p.replace(rolling_shutter=None), ["VelocityPrior(1)", "global shutter"]),
        (lambda p: shutter_with(p, readout=None), ["VelocityPrior(1)", "readout of camera"]),
        (lambda p: shutter_with(p, frame_rate=math.nan), ["VelocityPrior(1)", "frame rate"]),
    ],
)
def test_problems_without_velocities_are_refused(change, words):
    problem = filmed()
    with pytest.raises(InputError) as caught:
        bundle.solve(change(problem), priors=priors_of(problem))
    assert all(word in str(caught.value) for word in words)
    assert "\n" not in str(caught.value)


def test_hard_twists_are_refused():
    problem = filmed(ties=True)
    with pytest.raises(InputError, match="twists: expected free or tied with velocities"):
        bundle.solve(problem, priors=priors_of(problem), twists="hard")


def test_alignment_needs_positions():
    problem = filmed()
    with pytest.raises(InputError, match="positions of at least 3 images"):
        bundle.solve(problem, priors=priors_of(problem), align=True)


@pytest.mark.parametrize(
    ("arguments", "settings", "words"),
    [
        ((1, (0, 0, 1)), {"sigma": 0}, "sigma: expected numbers above 0"),
        ((1, (0, 0, 1)), {}, "either sigma or covariance"),
        ((1, (0, math.nan, 1), 1), {}, "velocity: expected finite numbers"),
        ((1, (0, math.inf, 1), 1), {}, "velocity: expected finite numbers"),
        ((1, (0, 1), 1), {}, "velocity: expected 3 numbers"),
        ((1, (0, 0, 1), 1), {"lever_arm": (0, 0, math.nan)}, "lever_arm"),
        ((1, (0, 0, 1), 1), {"loss": "square"}, "loss"),
        ((True, (0, 0, 1), 1), {}, "image"),
    ],
)
def test_wrong_priors_are_refused(arguments, settings, words):
    with pytest.raises(InputError) as caught:
        VelocityPrior(*arguments, **settings)
    assert str(caught.value).startswith("VelocityPrior")
    assert words in str(caught.value)


@pytest.mark.parametrize(("images", "words"), [((99,), "99"), ((1, 1), "another prior of 1")])
def test_wrong_images_are_refused(images, words):
    problem = filmed()
    priors = [VelocityPrior(image, (1, 0, 0), 0.1) for image in images]
    with pytest.raises(InputError, match=words):
        bundle.solve(problem, priors=priors)


def test_frame_rates_are_numbers_above_zero():
    shutter = filmed().rolling_shutter
    for rate in (0, -1, math.inf, "30"):
        with pytest.raises(InputError, match="rolling_shutter: frame_rate"):
            shutter.replace(frame_rate=rate)
