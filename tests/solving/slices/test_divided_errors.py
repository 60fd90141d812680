"""Statistics over processes equal those of one."""

import dataclasses
import threading

import numpy as np
import pytest

from bundle.model.residuals import summarize_errors
from bundle.solving.slices.slice_process import divided_statistics
from tests.solving.ranks.thread_crew import ThreadCrew


def divided(parts, cheirality):
    crew, found = ThreadCrew(len(parts)), {}

    def work(rank):
        found[rank] = divided_statistics(crew.meeting(rank), *parts[rank], cheirality)

    threads = [threading.Thread(target=work, args=(rank,)) for rank in range(len(parts))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return found[0]


def some_errors(count, seed):
    rng = np.random.default_rng(seed)
    errors = rng.exponential(size=count)
    errors[rng.random(count) < 0.1] = 0.0
    errors[rng.random(count) < 0.1] = 0.25  # ties
    errors[rng.random(count) < 0.1] = np.nan
    return errors, rng.random(count) < 0.2


@pytest.mark.parametrize("cheirality", ["zero", "algebraic"])
@pytest.mark.parametrize("counts", [(40, 1, 7), (0, 5), (2, 2), (1, 0, 0)])
def test_statistics_are_those_of_all(counts, cheirality):
    parts = [some_errors(count, seed) for seed, count in enumerate(counts)]
    errors, behind = (np.concatenate(column) for column in zip(*parts, strict=True))
    expected = dataclasses.asdict(summarize_errors(errors, behind, cheirality))
    found = dataclasses.asdict(divided(parts, cheirality))
    exact = ("median", "p95", "max", "num_observations", "num_behind_camera")
    np.testing.assert_array_equal([found[n] for n in exact], [expected[n] for n in exact])
    for name in ("rmse", "mean"):
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-14)


def test_no_observation_counts():
    nothing = (np.full(3, np.nan), np.zeros(3, bool))
    found = divided([nothing, nothing], "zero")
    assert found.num_observations == 0
    assert np.isnan([found.rmse, found.median, found.max]).all()


def test_infinite_errors():
    found = divided([(np.array([1.0, np.inf]), np.zeros(2, bool))] * 2, "zero")
    assert (found.max, found.p95) == (np.inf, np.inf)


def test_a_quantile_at_an_error_beside_an_infinite_one_is_that_error():
    errors = np.array([3.0, 1.0, np.inf, 2.0, np.inf])
    parts = [(errors[:2], np.zeros(2, bool)), (errors[2:], np.zeros(3, bool))]
    found = divided(parts, "zero")
    assert found.median == 3.0
    assert found.median == summarize_errors(errors, np.zeros(5, bool), "zero").median
