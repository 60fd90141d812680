"""The full report of a result: damping, rejected share, and the table of iterations."""

import pickle

import numpy as np
import pytest

import bundle
from tests import scenes
from tests.campaigns import orderings
from tests.campaigns.triage_inputs import chain_of_poses


def table(text):
    """Return the rows of the trace by iteration."""
    lines = text.splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("iteration"))
    assert "lambda" in lines[start] and "radius" in lines[start]
    return [line.split() for line in lines[start + 1 :] if line.strip()]


@pytest.mark.parametrize("kind", ["model", "pose graph", "factor graph"])
def test_rows_are_the_iterations(kind):
    walk = chain_of_poses(0, 30, 6)
    result = {
        "model": lambda: bundle.solve(scenes.make_problem(perturbation=0.03)),
        "pose graph": lambda: bundle.solve(walk),
        "factor graph": orderings.factors(walk).solve,
    }[kind]()
    text = result.summary.full_report()
    rows = table(text)
    iterations = result.iterations
    assert len(rows) == len(iterations["cost"])
    for row, cost, radius in zip(
        rows, iterations["cost"], iterations["trust_region_radius"], strict=True
    ):
        assert float(row[1]) == pytest.approx(cost, rel=1e-6)
        assert float(row[6]) == pytest.approx(radius, rel=0.06)
        assert float(row[7]) == pytest.approx(1 / radius, rel=0.06)
    assert pickle.loads(pickle.dumps(result)).summary.full_report() == text


def test_rejected_steps_are_marked_and_counted():
    problem = scenes.make_problem(perturbation=0.3)
    result = bundle.solve(problem, initial_trust_region_radius=1e12, max_num_iterations=60)
    accepted = np.asarray(result.iterations["step_is_successful"], bool)[1:]
    text = result.summary.full_report()
    assert sum("rejected" in row for row in table(text)) == (~accepted).sum()
    share = next(line for line in text.splitlines() if line.startswith("rejected share"))
    assert share.split()[-2:] == [f"{100 * (~accepted).mean():.1f}", "%"]


def test_a_summary_alone_has_no_table():
    summary = bundle.solve(scenes.make_problem()).summary
    alone = bundle.Summary(**vars(summary))
    assert alone == summary
    assert pickle.loads(pickle.dumps(alone)) == alone
    assert "lambda" not in alone.full_report()
    assert "lambda" in summary.full_report()
