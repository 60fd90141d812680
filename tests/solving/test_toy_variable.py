"""A variable is a row: one row of the table carries an array that the package does not know.

The toy is a gain per image. A problem with gains is defined here; a solve here adds 1 to each gain.
"""

import dataclasses

import numpy as np
import pytest

import bundle
from bundle.base.arrays import freeze
from bundle.georeference.similarity import Similarity, moved
from bundle.model.content_digests import content_digests
from bundle.model.estimates import VARIABLES, Variable, estimates
from bundle.model.problem_keys import ProblemKeys, kinds
from bundle.planning.comparison.process import restore_solution, store_solution
from bundle.solving.executors import ThisProcess
from bundle.solving.hold_out import with_values
from bundle.solving.ranks.partition import divide, part_of
from bundle.solving.rounds import input_digest
from tests import scenes

ROW = Variable("gain", "gain", "images", 1, 1, "lengths", slice(0, 1))
OPTIONS = bundle.SolveOptions(deterministic=True, num_threads=1, max_num_iterations=6)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ProblemWithGains(bundle.Problem):
    """A problem with a gain (num_images, 1)."""

    gain: np.ndarray

    def __post_init__(self):
        super().__post_init__()
        object.__setattr__(self, "gain", freeze(np.array(self.gain, np.float64)))


@pytest.fixture(autouse=True)
def row(monkeypatch):
    """Add the row, and let a solve estimate it."""
    VARIABLES.append(ROW)
    run = ThisProcess.run

    def estimating(prepared, progress):
        return run(prepared, progress) | {"gain": freeze(prepared.start.gain + 1)}

    monkeypatch.setattr(ThisProcess, "run", staticmethod(estimating))
    yield
    VARIABLES.remove(ROW)


@pytest.fixture
def problem():
    plain = scenes.make_problem(seed=3)
    fields = {field.name: getattr(plain, field.name) for field in dataclasses.fields(plain)}
    return ProblemWithGains(**fields, gain=np.arange(plain.num_images)[:, None] / 4)


def test_results_carry_it(problem):
    result = bundle.solve(problem, OPTIONS)
    np.testing.assert_array_equal(result.problem.gain, problem.gain + 1)
    assert estimates(result.problem)["gain"] is result.problem.gain


class KillError(Exception):
    """Stands for a kill."""


def test_a_resumed_run_continues_from_it(problem, tmp_path):
    file, steps = tmp_path / "run.npz", iter(range(100))
    how = {"options": OPTIONS, "num_rounds": 0, "checkpoint_interval": 2}

    def progress(_):
        if next(steps) == 3:
            raise KillError

    with pytest.raises(KillError):
        bundle.solve_rounds(problem, checkpoint=file, progress=progress, **how)
    with np.load(file) as saved:
        np.testing.assert_array_equal(saved["gain"], problem.gain + 1)
    whole = bundle.solve_rounds(problem, checkpoint=tmp_path / "whole.npz", **how)
    again = bundle.solve_rounds(problem, resume=file, **how)
    np.testing.assert_array_equal(again.problem.gain, whole.problem.gain)
    assert (again.problem.gain > problem.gain + 1).all()


def test_held_out_fits_carry_it(problem):
    refined = problem.replace(gain=problem.gain - 2)
    np.testing.assert_array_equal(with_values(problem, refined).gain, problem.gain - 2)
    result = bundle.solve(problem, OPTIONS, hold_out=10)
    np.testing.assert_array_equal(result.problem.gain, problem.gain + 1)


def test_selections_and_slices_carry_it(problem):
    images = np.array([4, 1, 2])
    part = problem.select(images=images)
    np.testing.assert_array_equal(part.problem.gain, problem.gain[[1, 2, 4]])
    back = part.put_back(problem, part.problem.replace(gain=part.problem.gain + 5))
    np.testing.assert_array_equal(np.flatnonzero(back.gain != problem.gain), [1, 2, 4])
    division = divide(problem, 2)
    for points in division.parts:
        np.testing.assert_array_equal(part_of(problem, points, division.section).gain, problem.gain)


def test_similarities_move_it(problem):
    there = Similarity(2.5, np.eye(3), np.zeros(3))
    np.testing.assert_array_equal(moved(problem, there).gain, 2.5 * problem.gain)


def test_digests_and_processes_see_it(problem, tmp_path):
    other = problem.replace(gain=np.nextafter(problem.gain, 9))
    assert input_digest.digest(other) != input_digest.digest(problem)
    one, two = content_digests(problem), content_digests(other)
    assert {name for name in one if one[name] != two[name]} == {"start"}
    store_solution(other, tmp_path / "0.npz")
    restored = restore_solution(problem, tmp_path / "0.npz")
    np.testing.assert_array_equal(restored.gain, other.gain)


def test_keys_name_it(problem):
    assert kinds()[-1] == "gain"
    keys = ProblemKeys(problem, kinds(), "variable")
    wanted = int(problem.image_ids[2])
    assert keys.find("factors", ("gain", wanted)) == ("gain", 2)
    with pytest.raises(bundle.InputError, match=r"no gain 99 in the problem"):
        keys.find("factors", ("gain", 99))
