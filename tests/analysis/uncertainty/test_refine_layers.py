"""Refinement inside of torch and jax: their own checks of derivatives, on fixed worlds."""

import numpy as np
import pytest

import bundle
from tests.rig_scenes import STEREO, rig_problem
from tests.scenes import make_problem

FIXED = {"fixed_image_ids": (1, 2)}


def scene(name):
    """A problem of few points, and settings that fix its world."""
    if name == "rig":
        problem = rig_problem(num_frames=3, num_points=5, seed=1, noise=0.3, rigs=(STEREO,))
        return problem, {"fixed_image_ids": (1, 3), "refine": ("poses", "points")}
    shape = {"num_images": 3, "num_points": 6, "seed": 2, "noise": 0.3}
    if name == "one_lens":
        return make_problem(**shape, shared=True), {**FIXED, "refine": ("poses", "points", "focal")}
    problem = make_problem(**shape, model="PINHOLE")
    given = {**FIXED, "refine": ("poses", "points")}
    if name == "loss":
        return problem, {**given, "loss": "cauchy", "loss_scale": 1.0}
    if name == "priors":
        known = [
            bundle.PositionFactor(("image", key), center, sigma=0.05)
            for key, center in zip((1, 2, 3), problem.projection_centers + 0.01, strict=True)
        ]
        return problem, {"refine": ("poses", "points"), "factors": known}
    return problem, given


SCENES = ("plain", "one_lens", "loss", "priors", "rig")


@pytest.fixture
def torch():
    return pytest.importorskip("torch", reason="PyTorch, the extra torch, is not installed")


@pytest.fixture
def jax():
    jax = pytest.importorskip("jax", reason="JAX, the extra jax, is not installed")
    jax.config.update("jax_enable_x64", True)
    yield jax
    jax.config.update("jax_enable_x64", False)


@pytest.mark.parametrize("name", SCENES)
def test_torch_checks_the_derivatives(name, torch):
    problem, settings = scene(name)
    rng = np.random.default_rng(0)
    weights = rng.uniform(0.5, 2, problem.num_observations)
    data = [
        torch.tensor(array, dtype=torch.float64, requires_grad=True)
        for array in (problem.observation_xy, weights, problem.camera_params)
    ]

    def refined(*given):
        # Of the start of refined parameters, minima do not depend.
        return tuple(bundle.torch.refine(*given, problem=problem, **settings))

    assert torch.autograd.gradcheck(refined, data, eps=1e-4, atol=1e-6, rtol=1e-6)


def test_torch_refuses_and_warns_in_one_line(torch):
    problem, settings = scene("plain")
    refine = bundle.torch.refine
    for given, words in (
        ({"pixels": torch.zeros(3, 2)}, "pixels: expected a tensor of torch.float64"),
        ({"pixels": problem.observation_xy}, "pixels: expected a tensor of torch.float64"),
        ({"weights": torch.zeros(3, dtype=torch.float64)}, "weights: expected shape"),
        ({"weights": torch.zeros(18, dtype=torch.float64)}, "weights: expected numbers above 0"),
    ):
        with pytest.raises(bundle.InputError, match=words) as error:
            refine(**given, problem=problem, **settings)
        assert "\n" not in str(error.value)
    with pytest.raises(bundle.InputError, match="problem: expected a Problem"):
        refine(problem="sparse/0")
    pixels = torch.tensor(problem.observation_xy, requires_grad=True)
    refined = refine(pixels, problem=problem, refine=("poses", "points"))
    with pytest.warns(bundle.GaugeWarning, match="%"):
        refined.points[0, 0].backward()
    (gradient,) = torch.autograd.grad(
        refine(pixels, problem=problem, **settings).points[0, 0], pixels, create_graph=True
    )
    with pytest.raises(RuntimeError):  # derivatives are of first order
        gradient.sum().backward()


@pytest.mark.parametrize("name", SCENES)
def test_jax_has_the_derivatives_of_the_core(name, jax):
    problem, settings = scene(name)
    directions = np.random.default_rng(1).normal(size=problem.points.shape)

    def loss(pixels, weights, cameras):
        found = bundle.jax.refine(pixels, weights, cameras, problem=problem, **settings)
        return (found.points * directions).sum() + found.poses[2, 4] + found.poses[2, 0]

    weights = np.ones(problem.num_observations)
    data = (problem.observation_xy, weights, problem.camera_params)
    found = jax.grad(loss, argnums=(0, 1, 2))(*data)
    again = jax.jit(jax.grad(loss))(*data)
    np.testing.assert_allclose(again, found[0], rtol=1e-6, atol=1e-9)
    rng = np.random.default_rng(2)
    for which, derivative in enumerate(found):
        direction = rng.normal(size=data[which].shape) * (np.asarray(derivative) != 0)

        def at(h, which=which, direction=direction):
            moved = list(data)
            moved[which] = data[which] + h * direction
            return float(loss(*moved))

        slopes = [(at(h) - at(-h)) / (2 * h) for h in (1e-3, 5e-4)]
        expected = (4 * slopes[1] - slopes[0]) / 3
        scale = np.linalg.norm(derivative) * np.linalg.norm(direction)
        assert (derivative * direction).sum() == pytest.approx(expected, rel=1e-6, abs=1e-6 * scale)


def test_jax_refuses_in_one_line(jax):
    problem, settings = scene("plain")
    with pytest.raises(bundle.InputError, match="pixels: expected shape"):
        bundle.jax.refine(np.zeros((3, 2)), problem=problem, **settings)
    jax.config.update("jax_enable_x64", False)
    with pytest.raises(bundle.InputError, match="jax_enable_x64"):
        bundle.jax.refine(problem=problem, **settings)


def test_layers_name_what_is_not_installed(monkeypatch):
    import sys

    from bundle.analysis.uncertainty import with_torch

    with_torch._torch.cache_clear()
    problem, _ = scene("plain")
    for name, call in (("torch", bundle.torch.refine), ("jax", bundle.jax.refine)):
        monkeypatch.setitem(sys.modules, name, None)
        with pytest.raises(bundle.InputError, match=rf"bundle-adjust\[{name}\]"):
            call(problem=problem)
