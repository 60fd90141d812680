"""Every kind of wrong Jacobian is found and called by its name, in camera models of every size.

What a model changes is the number of its parameters and their derivatives, so that each mistake is
made in one model or two and each model has one mistake, not all with all.
"""

from __future__ import annotations

import os

import numpy as np
import pytest

import bundle
from bundle import Problem
from tests.checking.mutations import MODELS, MUTATIONS, applies, wrong
from tests.checking.reprojection import MANIFOLDS, correct, names, random_blocks
from tests.scenes import PARAMS

CONFIGURATIONS = int(os.environ.get("BUNDLE_CHECK_CONFIGURATIONS", "500"))
"""Random configurations a model; 10000 take about a second a model."""

CASES = [
    (model, name)
    for i, model in enumerate(MODELS)
    for k, name in enumerate(MUTATIONS)
    if (i - k) % len(MUTATIONS) == 0 and applies(name, model)
]


def check(function, model, blocks, **settings):
    return bundle.check_gradients(
        function, blocks, MANIFOLDS, names=names(model), num_samples=3, **settings
    )


def test_every_mistake_is_made():
    assert {name for _, name in CASES} == set(MUTATIONS)


@pytest.mark.parametrize(("model", "name"), CASES)
def test_a_wrong_jacobian_is_found_and_named(model, name):
    blocks = random_blocks(model, np.random.default_rng(sum(map(ord, model + name))))
    report = check(wrong(name, model), model, blocks)
    assert not report
    if name == "off by one parameter" and len(PARAMS[model]) == 2:
        return  # of two columns, shifted by one and swapped are the same
    assert report.kinds == MUTATIONS[name].kinds, report
    assert all(MUTATIONS[name].words in finding.sentence for finding in report.findings)
    assert MUTATIONS[name].words in " ".join(str(report).split())


@pytest.mark.parametrize("model", MODELS)
def test_no_false_alarm_on_a_correct_function(model):
    seed = MODELS.index(model)
    blocks = random_blocks(model, np.random.default_rng(seed))
    assert check(correct(model), model, blocks, seed=seed)


@pytest.mark.parametrize("model", MODELS)
def test_no_false_alarm_over_random_configurations(model):
    """Cameras of random pose and intrinsics, each with one random point, in one problem."""
    rng = np.random.default_rng(7)
    n = CONFIGURATIONS
    quaternions = rng.standard_normal((n, 4))
    params = np.array(PARAMS[model]) * (1 + 0.2 * rng.standard_normal((n, len(PARAMS[model]))))
    depth = 10 ** rng.uniform(-2, 2, n)
    points = depth[:, None] * np.column_stack([rng.uniform(-1, 1, (n, 2)), np.ones(n)])
    # The camera is at the origin: what it sees of X is R X.
    imaginary, real = -quaternions[:, :3], quaternions[:, 3:]
    turned = 2 * np.cross(imaginary, np.cross(imaginary, points) + real * points)
    points = points + turned / (quaternions**2).sum(axis=1)[:, None]
    everybody = np.arange(n)
    problem = Problem(
        cam_from_world=np.hstack([quaternions, np.zeros((n, 3))]),
        image_ids=everybody,
        image_names=[f"{i}.jpg" for i in everybody],
        image_camera=everybody,
        camera_ids=everybody,
        camera_models=[model] * n,
        camera_params=params,
        camera_sizes=np.zeros((n, 2)),
        points=points,
        point_ids=everybody,
        observation_image=everybody,
        observation_point=everybody,
        observation_xy=rng.uniform(0, 800, (n, 2)),
        observation_keypoint=np.full(n, -1),
    )
    report = bundle.check_jacobians(problem, samples_per_image=None)
    assert report, report
    assert report.num_checked == n
    decided = sum(v.num_entries - v.num_undecided for v in report.parameters)
    assert decided > 0.99 * sum(v.num_entries for v in report.parameters)
