"""`bundle triage` from the outside."""

import json

import pytest

from tests.campaigns.triage_inputs import Workshop


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    workshop = Workshop(tmp_path_factory.mktemp("triage"), 5)
    graph = workshop.graph()
    return [
        workshop.run("refine", graph, *flags)
        for flags in ((), ("--threads", 1), ("--pose-ordering", "natural"))
    ]


def test_exit_codes_and_json(run, reports, tmp_path):
    code, out, _ = run("triage", *reports[:2], "--quiet")
    assert code == 0 and out.startswith("Nothing changed beyond noise.")
    code, out, _ = run("triage", reports[0], reports[2], "--quiet", "--json", tmp_path / "t.json")
    assert code == 1 and out.startswith("Ordering, not size")
    found = json.loads((tmp_path / "t.json").read_text())
    assert [set(cause) for cause in found["causes"]] == [{"cause", "sentence", "evidence"}]
    assert found["causes"][0]["cause"] == "ordering"
    assert found["headline"] == [found["causes"][0]["sentence"]]
    by_name = {one["name"]: one for one in found["quantities"]}
    assert by_name["information_nonzeros"]["ratio"] == 1 < by_name["factor_flops"]["ratio"]
