"""Advice on chi2 of a pose graph, on both sides of each of its limits."""

import dataclasses

import pytest

import bundle
from bundle.analysis.diagnosis.chi2_kinds import Chi2Kind
from bundle.reports.terminal.graph_headline import about_information
from tests.campaigns.triage_inputs import chain_of_poses

OPEN = Chi2Kind(
    kind="all",
    count=40,
    chi2=121.0,
    degrees=10.0,
    low=50.0,
    high=100.0,
    scale=float("nan"),
    verdict="undecided",
)


@pytest.mark.parametrize(
    ("change", "is_advised"),
    [
        ({}, True),
        ({"chi2": 119.0}, False),
        ({"degrees": 9.9}, False),
        ({"verdict": "as-expected"}, False),
    ],
)
def test_chi2_beyond_its_expectation_short_of_a_minimum(change, is_advised):
    solved = bundle.solve(chain_of_poses(0, 30, 3), max_num_iterations=1)
    found = about_information("a b.g2o", solved, [dataclasses.replace(OPEN, **change)])
    assert len(found) == is_advised
    for one in found:
        assert "did not reach a minimum" in one.sentence and "(at most 100)" in one.sentence
        assert one.command == "bundle refine 'a b.g2o' -o OUTPUT --loss auto"


def test_no_advice_without_an_expectation():
    graph = chain_of_poses(0, 30, 3)
    for changes in ({"loss": "huber"}, {"loss": "cauchy"}):
        solved = bundle.solve(graph, max_num_iterations=1, **changes)
        assert about_information("x.g2o", solved, [OPEN]) == []
    assert about_information("x.g2o", bundle.solve(graph), []) == []
