"""Digests of factors, bounds and rules; checkpoints of the schema before."""

import dataclasses
import io
import json
import operator
import pickle

import numpy as np
import pytest

import bundle
from bundle.solving.rounds.checkpoint import SCHEMA
from bundle.solving.rounds.input_digest import digest_of_fields
from tests.campaigns import resumes

OPTIONS = bundle.SolveOptions(deterministic=True, num_threads=1, max_num_iterations=6)
RUN = {"num_rounds": 1, "max_error": 1.2, "checkpoint_interval": 2}

PRIOR = bundle.PriorFactor(("point", 1), (1.0, 2.0, 3.0), np.eye(3))
LINEAR = bundle.LinearPrior(
    np.eye(4), np.zeros(4), {("point", 1): np.zeros(3), "f": [1.0]}, (("point", 1), "f")
)


def moved(samples=(0.1,)):
    """Return a preintegration, which has no fields."""
    motion = bundle.Preintegration(bundle.ImuNoise(1e-3, 1e-2, 1e-4, 1e-3))
    count = len(samples)
    motion.integrate(np.zeros((count, 3)), np.ones((count, 3)), np.array(samples))
    return motion


VALUES = [
    PRIOR,
    dataclasses.replace(PRIOR, value=(1.0, 2.0, np.nextafter(3.0, 4.0))),
    dataclasses.replace(PRIOR, key=("point", 2)),
    dataclasses.replace(PRIOR, loss="cauchy"),
    (PRIOR, PRIOR),
    bundle.PositionFactor(("image", 1), (1.0, 2.0, 3.0), np.eye(3)),
    LINEAR,
    LINEAR.reanchor({("point", 1): np.ones(3), "f": [1.0]}),
    bundle.FunctionFactor(("a",), operator.neg),
    bundle.FunctionFactor(("a",), operator.pos),
    moved(),
    moved((0.1, 0.1)),
    {("camera", 1): (np.zeros(3), np.ones(3))},
    {("camera", 1): (np.zeros(3), np.full(3, np.inf))},
    {("camera", 1): (np.zeros(3, np.float32), np.ones(3))},
    bundle.Constraints("cameras *: f prior 2 %"),
    bundle.Constraints("cameras *: f prior 3 %"),
    ((), None),
    ([], None),
    ((None,), ()),
    ("ab", "c"),
    ("a", "bc"),
    1,
    1.0,
    True,
    "1",
    b"1",
]


def test_each_field_decides():
    digests = [digest_of_fields(value) for value in VALUES]
    assert len({*digests}) == len(VALUES)


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_what_was_pickled_or_moved_has_the_same_digest(value, monkeypatch):
    expected = digest_of_fields(value)
    assert digest_of_fields(pickle.loads(pickle.dumps(value))) == expected
    if type(value).__module__.startswith("bundle."):
        monkeypatch.setattr(type(value), "__module__", "bundle.elsewhere")
        assert digest_of_fields(value) == expected


def test_the_order_of_keys_and_what_a_factor_remembers_of_solves_do_not_count():
    bounds = {("camera", 1): (0, 1), ("camera", 2): (0, 2)}
    assert digest_of_fields(bounds) == digest_of_fields(dict(reversed(bounds.items())))
    assert digest_of_fields(frozenset("ab")) == digest_of_fields(frozenset("ba"))
    factor = bundle.FunctionFactor(("a",), operator.neg)
    expected = digest_of_fields(factor)
    factor._set("seconds_a_call", 0.1)
    assert factor.name
    assert digest_of_fields(factor) == expected


def test_functions_that_do_not_pickle_are_refused():
    factor = bundle.FunctionFactor(("a",), lambda values: values)
    with pytest.raises(
        bundle.InputError, match=r"^checkpoint: expected factors that can be pickled"
    ):
        digest_of_fields({1: (factor,)})


class StopError(Exception):
    """Stands for a kill."""


@pytest.fixture(scope="module")
def scene():
    return resumes.make_scene(60)


def stopped(scene, path, **more):
    def stop(values):
        if values["iteration"] == 3:
            raise StopError

    with pytest.raises(StopError):
        bundle.solve_rounds(scene, OPTIONS, checkpoint=path, progress=stop, **RUN, **more)
    return path


@pytest.mark.parametrize("number", [1, 2, 4])
def test_another_schema_is_refused_by_name(scene, tmp_path, number):
    path = stopped(scene, tmp_path / "run")
    arrays = dict(np.load(io.BytesIO(path.read_bytes())).items())
    meta = json.loads(arrays.pop("meta").tobytes())
    assert meta["schema"] == SCHEMA
    meta["schema"] = f"bundle checkpoint {number}"
    with path.open("wb") as file:
        np.savez(file, meta=np.frombuffer(json.dumps(meta).encode(), np.uint8), **arrays)
    with pytest.raises(
        bundle.InputError, match=rf"run: expected a checkpoint .*checkpoint {number}'"
    ):
        bundle.solve_rounds(scene, OPTIONS, resume=path, **RUN)
