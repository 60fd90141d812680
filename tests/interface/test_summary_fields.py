"""Construction, equality and copies of summaries, whose methods are written for all fields."""

import copy
import dataclasses
import pickle

import pytest

import bundle
from tests.graphs.pose_graphs import graphs


@pytest.fixture(scope="module")
def summary():
    return bundle.solve(graphs.loop(2)).summary


def test_fields_come_by_name_with_their_defaults(summary):
    given = vars(summary)
    assert list(given) == [field.name for field in dataclasses.fields(summary)]
    without = {name: value for name, value in given.items() if name != "num_left_out_edges"}
    assert type(summary)(**without).num_left_out_edges == 0
    with pytest.raises(TypeError, match=r"missing: init, unknown: -"):
        type(summary)(**{name: value for name, value in given.items() if name != "init"})
    with pytest.raises(TypeError, match=r"missing: -, unknown: other"):
        type(summary)(**given, other=1)
    with pytest.raises(dataclasses.FrozenInstanceError):
        summary.init = "file"


def test_equal_fields_are_equal_summaries(summary):
    changed = dataclasses.replace(summary, num_components=7)
    assert changed.num_components == 7 and changed != summary
    for again in (pickle.loads(pickle.dumps(summary)), copy.deepcopy(summary)):
        assert again == summary and hash(again) == hash(summary)
    plain = {
        field.name: getattr(summary, field.name) for field in dataclasses.fields(bundle.Summary)
    }
    assert bundle.Summary(**plain) != summary and summary != 3
