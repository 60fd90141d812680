"""The spot check at the end of a solve sees Jacobians that lie, and no others.

Lies that leave no trace in the iterations are the point: see test_convergence_watch.py for others.
"""

import numpy as np
import pytest

import bundle
from bundle import _core
from bundle.model.residuals import Linearization
from tests import scenes
from tests.printed import in_order
from tests.solving.solve import levenberg_marquardt
from tests.solving.solve.absurd_problems import absurd_problem
from tests.solving.solve.lies import LIES, SCENES, UNSEEN, scaled


def spot_check(problem, rotation_offsets=None, lie=None, **options):
    """Report of the spot check at a problem, where `lie` changes the Jacobians."""
    if rotation_offsets is None:
        rotation_offsets = np.zeros((problem.num_images, 3))
    options = {**_core.default_options(), "cheirality": "algebraic", **options}

    def claim(_, jacobian):
        pose, params, point = np.split(jacobian, [6, jacobian.shape[1] - 3], axis=1)
        parts = lie(Linearization(np.zeros(2), pose, params, point, np.zeros((2, 6))))
        return np.hstack([parts.d_pose, parts.d_params, parts.d_point])

    return _core.spot_check(problem, options, rotation_offsets, claim if lie else None)


@pytest.mark.parametrize("scene", SCENES)
def test_every_lie_is_noticed_and_the_truth_is_not(scene):
    changes, columns = SCENES[scene]
    problem = scenes.make_problem(**changes)
    for name, lie in LIES.items():
        lying = levenberg_marquardt.solve(problem, lie, columns=columns, max_num_iterations=3)
        sentence = spot_check(lying.problem, lying.rotation_offsets, lie)
        assert "`bundle check`" in sentence, name
        assert "\n" not in sentence
        assert spot_check(lying.problem, lying.rotation_offsets) == "", name


@pytest.mark.parametrize("lie", UNSEEN)
def test_lies_without_a_trace_are_noticed_where_their_solve_ends(lie):
    changes, columns = SCENES["arc"]
    lying = levenberg_marquardt.solve(
        scenes.make_problem(**changes), LIES[lie], columns=columns, max_num_iterations=25
    )
    assert lying.iterations[-1]["cost"] < 0.9 * lying.iterations[0]["cost"]
    assert spot_check(lying.problem, lying.rotation_offsets, LIES[lie])


@pytest.mark.parametrize(
    "lie, said",
    [
        ("factor 2 on k1", "k SIMPLE_RADIAL 2"),
        ("sign of k1", "k SIMPLE_RADIAL -1"),
        ("k1 forgotten", "k SIMPLE_RADIAL 0.001"),
        ("factor 1/2 on the focal length", "f SIMPLE_RADIAL 0.5"),
        ("focal length and k1 swapped", "f SIMPLE_RADIAL % k"),
        ("degrees for radians", "rotation x y z SIMPLE_RADIAL 0.01745"),
        ("sign of rotation y", "rotation y SIMPLE_RADIAL -1"),
        ("translation x and y swapped", "translation x y SIMPLE_RADIAL %"),
        ("rotation and translation swapped", "SIMPLE_RADIAL translation x y z"),
        ("factor 2 on points", "point x y z SIMPLE_RADIAL 2"),
    ],
)
def test_kind_and_factor_are_named(lie, said):
    sentence = spot_check(scenes.make_problem(), lie=LIES[lie])
    assert in_order(sentence, *said.split(), "bundle check"), sentence


@pytest.mark.parametrize("factor", [-1.0, 0.0, 1e-3, 0.5, 0.99, 1.01, 2.0, 1e3])
@pytest.mark.parametrize("model", sorted(bundle.camera_models()))
def test_every_parameter_of_every_model_is_checked(model, factor):
    problem = scenes.make_problem(model=model, seed=3)
    refine = ["poses", "points", "focal", "principal_point", "extra"]
    for column, name in enumerate(bundle.camera_models()[model]):
        if name in ("w", "h"):
            continue  # never refined
        sentence = spot_check(problem, lie=scaled("d_params", column, factor), refine=refine)
        assert in_order(sentence, name, model, f"{factor:g}"), sentence


def test_a_left_jacobian_forgotten_away_from_the_start_of_the_chart():
    problem = scenes.make_problem(seed=4)
    offsets = np.full((problem.num_images, 3), [0.3, -0.2, 0.1])

    def without(parts):
        x, y, z = offsets[0]
        skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        left = np.eye(3) + skew / 2 + skew @ skew / 6  # to third order in an angle of 0.37
        pose = parts.d_pose.copy()
        pose[:, :3] = pose[:, :3] @ np.linalg.inv(left)
        return parts._replace(d_pose=pose)

    assert spot_check(problem, offsets) == ""
    assert in_order(spot_check(problem, offsets, without), "rotation", "x", "y", "z")


def two_models(seed=0):
    """SIMPLE_RADIAL in most images; PINHOLE, whose measurements are all off, in one."""
    problem = scenes.make_problem(seed=seed, num_images=6, num_points=400)
    params = problem.camera_params.copy()
    params[5] = [params[5, 0], params[5, 0], *params[5, 1:3]]
    return problem.replace(camera_models=["SIMPLE_RADIAL"] * 5 + ["PINHOLE"], camera_params=params)


def test_a_model_of_few_images_is_not_drowned_by_the_others():
    problem = two_models()
    pinhole = problem.observation_image == 5

    def claim(observation, jacobian):
        return jacobian * np.where(pinhole[observation] & (np.arange(13) == 7), 2, 1)

    options, offsets = _core.default_options(), np.zeros((6, 3))
    assert _core.spot_check(problem, options, offsets, None) == ""
    sentence = _core.spot_check(problem, options, offsets, claim)
    assert in_order(sentence, "fy", "PINHOLE", "2")


def asked_for(problem, **options):
    observations = []

    def claim(observation, jacobian):
        observations.append(observation)
        return jacobian

    options = {**_core.default_options(), **options}
    _core.spot_check(problem, options, np.zeros((problem.num_images, 3)), claim)
    return np.array(observations)


def test_the_sample_is_the_same_each_time_and_spread_over_models_and_images():
    problem = two_models()
    sample = asked_for(problem)
    np.testing.assert_array_equal(sample, asked_for(problem))
    assert len(np.unique(sample)) == len(sample)
    counts = np.bincount(problem.observation_image[sample], minlength=6)
    assert counts.tolist() == pytest.approx([3.2] * 5 + [16], abs=1)  # 32 in all
    large = scenes.make_problem(num_images=40, num_points=1500)
    assert 200 < len(asked_for(large)) < 320
    assert set(large.observation_image[asked_for(large)]) == set(range(40))


@pytest.mark.parametrize("share, noticed", [(0.0, False), (0.08, False), (0.5, True), (1.0, True)])
def test_what_is_wrong_in_some_observations_only(share, noticed):
    problem = scenes.make_problem(num_images=10, num_points=3000)
    wrong = np.random.default_rng(0).random(problem.num_observations) < share

    def claim(observation, jacobian):
        return -jacobian if wrong[observation] else jacobian

    options = _core.default_options()
    found = _core.spot_check(problem, options, np.zeros((10, 3)), claim)
    assert bool(found) == noticed


def test_what_is_fixed_is_not_checked():
    problem = scenes.make_problem()
    lie = LIES["factor 2 on the focal length"]
    assert spot_check(problem, lie=lie)
    assert spot_check(problem, lie=lie, refine=["poses", "points", "extra"]) == ""
    assert spot_check(problem, lie=lie, fixed_camera_ids=[1, 2, 3, 4, 5]) == ""
    lie = LIES["factor 2 on points"]
    assert spot_check(problem, lie=lie, refine=["poses", "focal"]) == ""
    sample = asked_for(problem, fixed_image_ids=[1], refine=["poses"])
    assert set(problem.observation_image[sample]) == {1, 2, 3, 4}


@pytest.mark.parametrize("batch", range(4))
def test_honest_problems_however_absurd_are_not_suspected(batch):
    checked = 0
    for seed in range(150 * batch, 150 * (batch + 1)):
        rng = np.random.default_rng(seed)
        problem, offsets, what = absurd_problem(rng, seed)
        cheirality = str(rng.choice(["zero", "algebraic"]))
        assert spot_check(problem, offsets, cheirality=cheirality) == "", (seed, what)
        lie = LIES["factor 2 on points"]
        checked += seed % 5 == 0 and spot_check(problem, offsets, lie, cheirality=cheirality) != ""
    assert checked > 12  # of thirty: most of these problems can be judged


def test_an_observation_without_a_value_says_nothing():
    problem = scenes.make_problem(model="SIMPLE_PINHOLE")
    poses = problem.cam_from_world.copy()
    poses[:, 6] -= 100  # everything is behind
    problem = problem.replace(cam_from_world=poses)
    lie = LIES["factor 2 on points"]
    assert spot_check(problem, lie=lie, cheirality="zero") == ""
    assert spot_check(problem, lie=lie, cheirality="algebraic")


def test_a_claim_of_another_size_is_refused():
    with pytest.raises(bundle.InputError, match="lie: expected 26 values, found 4"):
        _core.spot_check(
            scenes.make_problem(), _core.default_options(), np.zeros((5, 3)), lambda *_: np.eye(2)
        )
