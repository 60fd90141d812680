"""Every report validates against the published schema, which describes each of its entries."""

import json
import shlex
from pathlib import Path

import jsonschema
import pytest

import bundle
from bundle.cli.main import COMMANDS, main
from bundle.reports.json_schema import described_entries, report_schema
from tests import scenes

PUBLISHED = Path(__file__).parents[2] / "docs" / "reference" / "report.schema.json"
VALIDATOR = jsonschema.Draft202012Validator(report_schema())
RUNS = {
    "info": "info IN",
    "inspect": "inspect IN",
    "diagnose": "diagnose IN",
    "check": "check IN",
    "convert": "convert IN OUT.txt",
    "refine": "refine IN -o OUT",
    "refine in rounds": "refine IN -o OUT --rounds 2 --hold-out 20 --loss huber",
    "refine that fails": "refine BEHIND -o OUT",
    "covariance": "covariance IN -o OUT.npz",
    "report": "report IN -o OUT.html",
    "diagnose reliability": "diagnose IN --reliability",
    "evaluate": "evaluate IN --reference IN",
    "influence": "influence IN --on 'f 1'",
    "plan": "plan IN --for 'f 1' --add image,tie",
    "merge": "merge IN PART -o OUT",
    "validate": "validate IN --folds 2 --camera-models SIMPLE_RADIAL",
    "align": "align IN -o OUT --reference IN",
    "synth": "synth OUT --scene orbit",
    "compare": "compare IN --repeat 1 --backends fused --solvers dense-schur,sparse-schur",
    "demo": "demo OUT",
    "graph": "refine GRAPH.g2o -o OUT.g2o",
    "info of a graph": "info GRAPH.g2o",
    "certified graph": "refine GRAPH.g2o -o OUT.g2o --certify",
    "diagnose a graph": "diagnose GRAPH.g2o",
    "inspect a graph": "inspect GRAPH.g2o",
    "compare orderings": "compare GRAPH.g2o --ordering all",
    "check a graph": "check GRAPH.g2o",
    "covariance of a graph": "covariance GRAPH.g2o -o OUT.npz",
    "report on a graph": "report GRAPH.g2o -o OUT.html",
    "another lens": "refine IN -o OUT --camera-model OPENCV",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("json")
    problem = bundle.synthesize(num_images=6, num_points=60, seed=3).problem
    bundle.save(problem, folder / "IN", "colmap")
    bundle.save(problem.select(images=[1, 2, 3, 4, 5]).problem, folder / "PART", "colmap")
    turned = problem.cam_from_world.copy()
    turned[:, :4] = [0, 1, 0, 0]
    bundle.save(problem.replace(cam_from_world=turned), folder / "BEHIND", "colmap")
    (folder / "GRAPH.g2o").write_text(scenes.SQUARE)
    return folder


def report_of(folder, words, target):
    names = ("IN", "PART", "BEHIND", "GRAPH.g2o", "OUT")
    line = []
    for word in shlex.split(words):
        path = folder if word.split(".")[0] in ("IN", "PART", "BEHIND", "GRAPH") else target
        is_path = word.split(".")[0] in {name.split(".")[0] for name in names}
        line.append(str(path / word) if is_path else word)
    main([*line, "--quiet", "--json", str(target / "report.json")])
    return json.loads((target / "report.json").read_text())


@pytest.mark.parametrize("name", RUNS)
def test_reports_of_commands(folder, tmp_path, name, capsys):
    report = report_of(folder, RUNS[name], tmp_path)
    VALIDATOR.validate(report)
    command = "refine" if name == "demo" else RUNS[name].split()[0]
    assert set(report) <= described_entries()[command]
    capsys.readouterr()


def test_triage_vio_and_reports_of_solves_in_python(folder, tmp_path, capsys):
    result = bundle.solve(folder / "IN")
    bundle.save_report(result, tmp_path / "a.json", name="a")
    bundle.save_report(bundle.solve(folder / "IN", loss="huber"), tmp_path / "b.json", name="a")
    places = {name: str(tmp_path / name) for name in ("a.json", "b.json", "s", "p.tum")}
    for command, words in {
        "triage": "a.json b.json",
        "synth": "s --scene flight --duration 3 --quiet",
        "vio": "s -o p.tum --quiet",
    }.items():
        line = [places.get(word, word) for word in words.split()]
        main([command, *line, "--json", str(tmp_path / f"{command}.json")])
    for name in ("a", "b", "triage", "synth", "vio"):
        VALIDATOR.validate(json.loads((tmp_path / f"{name}.json").read_text()))
    capsys.readouterr()


def test_a_wrong_report_is_refused(folder, tmp_path, capsys):
    report = report_of(folder, RUNS["refine"], tmp_path)
    for change in (
        {"headline": "good"},
        {"schema": 2},
        {"summary": {**report["summary"], "final_cost": "small"}},
        {"findings": [{"kind": "outliers"}]},
        {"options": {**report["options"], "max_num_iterations": "many"}},
    ):
        with pytest.raises(jsonschema.ValidationError):
            VALIDATOR.validate(report | change)
    for missing in ("summary", "version", "findings"):
        with pytest.raises(jsonschema.ValidationError):
            VALIDATOR.validate({key: report[key] for key in report if key != missing})
    capsys.readouterr()


def test_the_published_schema_is_that_of_the_code_and_names_every_command():
    assert json.loads(PUBLISHED.read_text()) == report_schema(), "run `make quotes`"
    jsonschema.Draft202012Validator.check_schema(report_schema())
    # The report of demo is that of refine; that of --dry-run is the same for all.
    assert set(described_entries()) == set(COMMANDS) - {"demo"} | {"dry-run"}


def test_a_report_of_every_command_is_validated():
    validated = {words.split()[0] for words in RUNS.values()} | {"triage", "vio"}
    assert validated == set(COMMANDS)


def test_entries_have_the_types_of_the_results():
    branches = zip(described_entries(), report_schema()["allOf"], strict=True)
    entries = {name: branch["then"]["properties"] for name, branch in branches}
    number, record = {"type": ["number", "null"]}, {"type": "object"}
    check = entries["check"]
    assert check["tolerance"] == number  # a field of GradientReport
    assert check["num_factors"] == {"type": "integer", "minimum": 0}  # a field of FactorCheck
    assert check["worst"] == {"type": "array", "items": record}
    assert check["verdict"] == {"enum": ["correct", "wrong", "undecided"]}
    assert "details" not in check and "findings" not in check
    assert entries["evaluate"]["lens_difference"] == {"type": ["null", "object"]}  # a property
    assert entries["refine"]["wall_time"] == record | {"additionalProperties": number}
    assert entries["info"]["suspicions"]["items"] == {"$ref": "#/$defs/finding"}
    options = entries["vio"]["options"]["properties"]
    assert options["time_budget"] == number and options["window"] == {"type": "integer"}
