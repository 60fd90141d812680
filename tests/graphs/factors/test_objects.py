"""Graph objects as Python objects: copies, pickles, what they print, whose memory they hold."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest

import bundle
from bundle.graphs.factors.image_factors import VelocityFactor

EYE = [0.0, 0, 0, 1]


class Twice:
    """A function that pickles, which a lambda does not."""

    def __call__(self, values):
        return 2 * values[0], [2 * np.eye(2)]


def everything():
    """A graph with every manifold, every factor, a bound and a held coordinate."""
    graph = bundle.FactorGraph()
    graph.add_variable("plain", [1.0, 2.0], lower=0)
    graph.add_variable("pose", [*EYE, 0, 0, 1], "se3", fixed=[2])
    graph.add_variable("next", [*EYE, 0, 0, 2], "se3")
    graph.add_variable("camera", [500.0, 320, 240])
    graph.add_variable(("point", 7), [0.0, 0.1, 3])
    graph.add_variable("angle", 0.3, "so2")
    graph.add_variable("turn", [0, 0, 0.6, 0.8], "so3")
    graph.add_variable("place", [1, 2, 0.3], "se2")
    graph.add_variable("speed", [0.0, 0, 1])
    graph.add_variable("rest", [0.0, 0, 1])
    graph.add_variable("biases", np.zeros(6))
    graph.add_variable("later biases", np.zeros(6))
    noise = bundle.ImuNoise(1e-3, 1e-2, 1e-4, 1e-3)
    motion = bundle.Preintegration(noise)
    motion.integrate(np.zeros((5, 3)), np.tile([0, 0, 9.81], (5, 1)), np.full(5, 0.2))
    for factor in (
        bundle.PriorFactor("plain", [0, 0], 1.0, loss="huber", loss_scale=2.0),
        bundle.FunctionFactor(["plain"], Twice()),
        bundle.LinearPrior(np.eye(2), [1, 2], {"plain": [0, 0]}, ["plain"]),
        bundle.PositionFactor("pose", [0.1, 0, 0], 1.0, lever_arm=[0.5, 0, 0]),
        bundle.RelativePoseFactor("pose", "next", [0, 0, 0, 1, 1, 0, 0], 4.0),
        bundle.BetweenFactor("pose", "next", [*EYE, 0.1, 0, 1], 4.0),
        bundle.ReprojectionFactor("pose", "camera", ("point", 7), [300, 200], "SIMPLE_PINHOLE"),
        bundle.PriorFactor("camera", [500, 320, 240], 1.0),
        bundle.PriorFactor(("point", 7), [0, 0, 3], 1.0),
        bundle.ScalarPriorFactor("camera", 0, 510, 0.02, relative=True),
        bundle.PriorFactor("angle", [0.1], 1.0),
        bundle.PriorFactor("turn", EYE, 1.0),
        bundle.PriorFactor("place", [0, 0, 0], 1.0),
        bundle.ImuFactor("pose", "speed", "biases", "next", "rest", motion),
        bundle.BiasWalkFactor("biases", "later biases", noise, 1.0),
        bundle.PriorFactor("biases", np.zeros(6), 1.0),
    ):
        graph.add_factor(factor)
    return graph


def public_objects():
    graph = everything()
    return [graph, graph.solve(), graph.check_gradients(), *graph.factors]


COPIES = {
    "pickle": lambda thing: pickle.loads(pickle.dumps(thing)),
    "deepcopy": copy.deepcopy,
    "copy": copy.copy,
}


@pytest.mark.parametrize("how", COPIES)
def test_copies_print_the_same_as_text_and_as_html(how):
    for thing in public_objects():
        again = COPIES[how](thing)
        assert type(again) is type(thing)
        assert repr(again) == repr(thing)
        assert 1 <= len(repr(thing).splitlines()) < 12
        assert thing._repr_html_().startswith("<div><b>")


@pytest.mark.parametrize("how", COPIES)
def test_copies_of_a_graph_solve_alike_and_grow_apart(how):
    graph = everything()
    again = COPIES[how](graph)
    assert again.keys == graph.keys and len(again.factors) == len(graph.factors)
    assert again.cost() == graph.cost()
    ours, theirs = (g.solve(num_threads=1) for g in (graph, again))
    for key, value in ours.values.items():
        np.testing.assert_array_equal(theirs.values[key], value)
    again.add_variable("new", [0.0])
    again.add_factor(bundle.PriorFactor("new", [0.0], 1.0))
    assert "new" not in graph.keys and len(again.factors) == len(graph.factors) + 1
    assert "new" in again.values and len(again.values) == len(graph.values) + 1


def arrays_of(thing):
    for field in dataclasses.fields(thing):
        value = getattr(thing, field.name)
        yield from value.values() if isinstance(value, dict) else [value]


@pytest.mark.parametrize("how", [None, *COPIES])
def test_no_array_of_a_graph_can_be_written(how):
    graph = everything() if how is None else COPIES[how](everything())
    arrays = list(graph.values.values())
    for factor in graph.factors:
        arrays += [value for value in arrays_of(factor) if isinstance(value, np.ndarray)]
    assert len(arrays) == 12 + 2 * 8 + 4 + 3 + 3 + 2
    for array in arrays:
        with pytest.raises(ValueError, match=r"read-only|WRITEABLE"):
            array[...] = 0
        with pytest.raises(ValueError, match="WRITEABLE"):
            array.setflags(write=True)


def test_arrays_are_copied_when_they_are_given():
    value, lower, information = np.array([1.0, 2]), np.zeros(2), np.eye(2)
    fixed, keys, point = [0], ["x"], {"x": np.zeros(2)}
    graph = bundle.FactorGraph()
    graph.add_variable("x", value, lower=lower, fixed=fixed)
    graph.add_factor(bundle.PriorFactor("x", value, information))
    graph.add_factor(bundle.LinearPrior(information, value, point, keys))
    graph.add_factor(bundle.FunctionFactor(keys, Twice()))
    before = graph.solve().values["x"]
    for array in (value, lower, information, point["x"]):
        array += 5
    fixed.append(1)
    keys.append("y")
    point.clear()
    np.testing.assert_array_equal(graph.values["x"], [1, 2])
    np.testing.assert_array_equal(graph.solve().values["x"], before)


def test_what_a_function_does_to_its_values_stays_there():
    def vandal(values):
        residual = values[0] - 3
        values[0][:] = np.nan
        values.clear()
        return residual, [np.eye(2)]

    graph = bundle.FactorGraph()
    graph.add_variable("x", [1.0, 2.0])
    graph.add_factor(bundle.FunctionFactor(["x"], vandal))
    np.testing.assert_allclose(graph.solve().values["x"], 3, atol=1e-3)
    np.testing.assert_array_equal(graph.values["x"], [1, 2])


def test_a_function_may_keep_the_arrays_that_it_gave_and_got():
    kept = []

    def function(values):
        residual, jacobian = values[0] - 3, np.eye(2)
        kept.append((values[0], values[0].copy(), residual, residual.copy(), jacobian))
        return residual, [jacobian]

    graph = bundle.FactorGraph()
    graph.add_variable("x", [1.0, 2.0])
    graph.add_factor(bundle.FunctionFactor(["x"], function))
    graph.solve()
    assert len(kept) > 3
    for value, value_then, residual, residual_then, jacobian in kept:
        np.testing.assert_array_equal(value, value_then)
        np.testing.assert_array_equal(residual, residual_then)
        np.testing.assert_array_equal(jacobian, np.eye(2))


def test_values_are_a_view_and_keys_and_factors_are_made_once():
    """A loop over graph.values[key] or graph.factors[i] must not copy the graph each time."""
    graph = everything()
    values = graph.values
    assert graph.keys is graph.keys and graph.factors is graph.factors
    assert list(values) == list(graph.keys)
    graph.add_variable("new", [4.0])
    assert values["new"] == 4 and graph.keys[-1] == "new"
    assert "nothing" not in values and values.get("nothing") is None
    assert repr(values) == repr(dict(values))
    with pytest.raises(TypeError):
        values["new"] = [5.0]
    moved = graph.with_values({"new": [5.0]})
    assert values["new"] == 4 and moved.values["new"] == 5


def test_a_function_that_knows_its_graph_copies_with_it():
    class Knowing(Twice):
        graph = None

    graph = bundle.FactorGraph()
    graph.add_variable("x", [1.0, 2.0])
    function = Knowing()
    graph.add_factor(bundle.FunctionFactor(["x"], function))
    function.graph = graph
    again = copy.deepcopy(graph)
    assert again.factors[0].function.graph is again
    assert again.cost() == graph.cost()


def test_factors_can_be_made_anew_with_a_change():
    prior = bundle.PriorFactor("x", [1.0, 2], 3.0)
    other = dataclasses.replace(prior, loss="cauchy", key="y")
    assert (other.loss, other.keys, other.name) == ("cauchy", ("y",), "PriorFactor('y')")
    np.testing.assert_array_equal(other.value, prior.value)
    with pytest.raises(dataclasses.FrozenInstanceError):
        prior.key = "z"


def test_an_antenna_without_a_lever_arm_is_at_the_camera():
    factor = bundle.PositionFactor(("image", 1), [1.0, 2.0, 3.0], 1.0)
    assert np.asarray(factor.lever_arm).tolist() == [0.0, 0.0, 0.0]


WEIGHTED = {
    "prior": lambda **given: bundle.PriorFactor("x", [0.0, 0, 0], **given),
    "between": lambda **given: bundle.BetweenFactor("x", "y", [0.0, 0, 0], **given),
    "position": lambda **given: bundle.PositionFactor("x", [0.0, 0, 0], **given),
    "rotation": lambda **given: bundle.RotationFactor("x", [0.0, 0, 0, 1], **given),
    "velocity": lambda **given: VelocityFactor(
        ("image", 1), ("twist", 1), ("readout", 1), [0.0, 0, 0], **given
    ),
}


@pytest.mark.parametrize("make", WEIGHTED.values(), ids=WEIGHTED)
def test_an_information_is_a_matrix_a_diagonal_or_sigmas(make):
    matrix = np.diag([100.0, 25.0, 400.0])
    for given in (
        {"information": [100, 25, 400]}, {"sigmas": [0.1, 0.2, 0.05]}, {"information": matrix},
    ):  # fmt: skip
        np.testing.assert_allclose(make(**given).information, matrix, rtol=1e-14)
    np.testing.assert_allclose(make(sigma=0.2).information, 25.0)
    again = pickle.loads(pickle.dumps(dataclasses.replace(make(sigma=0.2), loss="huber")))
    np.testing.assert_allclose(again.information, 25.0)
    assert not np.asarray(again.information).flags.writeable
    for wrong in (
        {}, {"sigma": 1, "information": 1}, {"sigma": 1, "sigmas": [1, 1, 1]}, {"sigma": 0},
        {"sigma": [1, 1, 1]}, {"sigmas": 1}, {"sigmas": [1, -1, 1]}, {"sigma": np.nan},
    ):  # fmt: skip
        with pytest.raises(bundle.InputError, match="sigma"):
            make(**wrong)


@pytest.mark.parametrize("word", ["covariance", "noise_model", "Sigma", "robust"])
def test_words_of_other_tools_lead_to_the_ways_to_give_noise(word):
    for make in (bundle.BetweenFactor, bundle.PriorFactor):
        with pytest.raises(bundle.InputError, match=f"^{make.__name__}: .*{word}.*sigmas?"):
            make("x", "y", [0.0, 0, 1], **{word: np.eye(3)})


def test_as_many_sigmas_as_coordinates():
    graph = bundle.FactorGraph()
    graph.add_variable("x", [0.0, 0, 0], "se2")
    for given in ({"sigmas": [1.0]}, {"sigmas": [1.0, 1.0]}, {"information": [1.0, 1.0]}):
        with pytest.raises(bundle.InputError, match=r"expected shape \(3, 3\)"):
            graph.add_factor(bundle.PriorFactor("x", [0.0, 0, 0], **given))
    graph.add_factor(bundle.PriorFactor("x", [0.1, 0, 0], sigmas=[0.1, 1, 1]))
    assert graph.cost() == pytest.approx(0.5)


def test_a_reprojection_has_one_pixel_by_default():
    for given, expected in (({}, 1.0), ({"sigma": 0.5}, 4.0), ({"information": 3.0}, 3.0)):
        factor = bundle.ReprojectionFactor("p", "c", "x", [1, 2], "PINHOLE", **given)
        assert float(np.asarray(factor.information)) == expected


@pytest.mark.parametrize(
    ("name", "here"),
    [("optimize", "solve"), ("marginal_covariance", "bundle.covariance"), ("slove", "solve")],
)
def test_names_of_other_packages_point_to_those_here(name, here):
    with pytest.raises(AttributeError, match=here):
        getattr(bundle.FactorGraph(), name)
    assert not hasattr(bundle.FactorGraph(), "_repr_latex_")


def test_a_function_that_changes_its_arguments_is_named():
    def doubled(values):
        x = values[0]
        x *= 2
        return [x[0] - 3, x[1]], [np.eye(2)]

    graph = bundle.FactorGraph()
    graph.add_variable("a", [1.0, 2.0])
    graph.add_factor(bundle.FunctionFactor(["a"], doubled))
    with pytest.raises(bundle.InputError, match=r"FunctionFactor.*change its arguments.*block 0"):
        graph.check_gradients()
    with pytest.raises(bundle.InputError, match=r"^function: .*change its arguments.*block 0"):
        bundle.check_gradients(doubled, [[1.0, 2.0]])


@pytest.mark.parametrize(
    ("size", "order"), [(3, "se2: x y angle"), (4, "se3: qx qy qz qw tx ty tz")]
)
def test_a_matrix_for_a_pose_names_its_numbers(size, order):
    with pytest.raises(
        bundle.InputError, match=rf"'x': .* found shape \({size}, {size}\) \({order}"
    ):
        bundle.FactorGraph().add_variable("x", np.eye(size), f"se{size - 1}")
