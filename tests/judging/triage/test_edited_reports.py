"""`bundle triage` of reports in which one number differs, and of files that are no such reports."""

import json

import pytest

import bundle
from bundle.errors import InputError
from tests.campaigns.triage_inputs import Workshop


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    """One report of a graph, a model and a flight, at an unloaded machine."""
    workshop = Workshop(tmp_path_factory.mktemp("reports"), 3)
    made = {
        "graph": workshop.run("refine", workshop.graph()),
        "model": workshop.run("refine", workshop.model()),
        "flight": workshop.run("vio", workshop.flight(duration=6.0)),
        "graphs": workshop.run("compare", workshop.graph(), "--repeat", 1, "--backends", "fused"),
        "models": workshop.run(
            *("compare", workshop.model(), "--repeat", 1, "--backends", "fused"),
            *("--solvers", "dense-schur,sparse-schur"),
        ),
    }
    for path in made.values():
        content = json.loads(path.read_text())
        content["environment"]["load_before"] = 0.0
        content["environment"]["num_cores"] = 8
        content["environment"] |= {"waiting": 0.0, "preemptions": 0}
        path.write_text(json.dumps(content))
    return made


def edited(path, *changes, name="edited"):
    """The report with entries replaced: (keys, value or function of the old value)."""
    content = json.loads(path.read_text())
    for keys, value in changes:
        *parents, last = keys.split(".")
        place = content
        for key in parents:
            place = place[int(key) if key.isdigit() else key]
        place[last] = value(place[last]) if callable(value) else value
    out = path.with_name(f"{path.stem}-{name}.json")
    out.write_text(json.dumps(content))
    return out


def causes(old, new, **options):
    return [one.cause for one in bundle.triage(old, new, **options).causes]


def times(factor):
    return lambda value: value * factor


@pytest.mark.parametrize("kind", ["graph", "model"])
def test_more_flops_at_the_same_information_matrix_are_the_ordering(reports, kind):
    new = edited(
        reports[kind],
        ("summary.num_factor_nonzeros", times(34)),
        ("summary.factor_flops", times(200)),
        ("summary.total_time_in_seconds", times(150)),
    )
    found = bundle.triage(reports[kind], new)
    assert [one.cause for one in found.causes] == ["ordering"]
    assert "Ordering, not size: nnz(Lambda) is unchanged" in found.causes[0].sentence
    assert found.causes[0].evidence["factor_flops"]["new"] > 100


def test_a_grown_graph_is_not_its_ordering(reports):
    new = edited(
        reports["graph"],
        ("input.num_poses", 1200),
        ("input.num_edges", 1400),
        *((f"summary.{name}", times(2)) for name in (
            "num_information_nonzeros", "num_factor_nonzeros", "factor_flops",
            "num_parameters_reduced", "num_residuals_reduced", "initial_cost", "final_cost")),
    )  # fmt: skip
    assert causes(reports["graph"], new) == ["data"]


def test_a_denser_matrix_of_as_many_variables_is_a_prior(reports):
    more = [(f"summary.{name}", times(3)) for name in (
        "num_information_nonzeros", "num_factor_nonzeros", "factor_flops")]  # fmt: skip
    assert causes(reports["graph"], edited(reports["graph"], *more)) == ["prior-densifies"]
    flight = json.loads(reports["flight"].read_text())
    wide = edited(
        reports["flight"],
        *((f"keyframes.{k}.num_prior_columns", times(3)) for k in range(len(flight["keyframes"]))),
    )
    assert causes(reports["flight"], wide) == ["prior-densifies"]


def test_fill_outgrows_a_slightly_denser_matrix(reports):
    new = edited(
        reports["graph"],
        ("summary.num_information_nonzeros", times(1.03)),
        ("summary.num_residuals_reduced", times(1.03)),
        ("summary.num_factor_nonzeros", times(2)),
        ("summary.factor_flops", times(6)),
    )
    assert causes(reports["graph"], new) == ["fill"]


def test_more_steps_at_a_smaller_radius_are_a_jacobian(reports):
    rejected = {"step_is_successful": False, "trust_region_radius": 1e-3}

    def longer(steps):
        return [*steps, *([{**steps[-1], **rejected}] * 9), steps[-1]]

    found = causes(reports["model"], edited(reports["model"], ("iterations", longer)))
    assert found == ["jacobian"]
    kept = {"trust_region_radius": 1e4}
    calm = edited(reports["model"], ("iterations", lambda steps: [*steps, *[steps[-1] | kept] * 9]))
    assert causes(reports["model"], calm) == ["convergence"]
    warned = edited(reports["model"], ("summary.warning_kinds", ["suspicious_jacobian"]))
    assert causes(reports["model"], warned) == ["jacobian"]


@pytest.mark.parametrize(("kind", "time"), [
    ("graph", "summary.total_time_in_seconds"),
    ("model", "summary.total_time_in_seconds"),
    ("flight", "wall_time.solve"),
])  # fmt: skip
def test_time_alone_is_the_machine(reports, kind, time):
    old = edited(reports[kind], (time, 2.0), name="base")
    assert causes(old, edited(old, (time, times(3)))) == ["machine"]
    assert causes(old, edited(old, (time, times(1 / 3)))) == ["machine"]
    assert causes(old, edited(old, (time, times(1.3)))) == []
    assert causes(old, edited(old, (time, times(1.3))), time_noise=1.2) == ["machine"]
    busy = [("environment.load_before", 20.0), (time, times(3))]
    assert causes(old, edited(old, *busy)) == [], "a load of 20 on 8 cores explains a factor of 2.5"
    busy = [("environment.load_before", 20.0), (time, times(5))]
    found = bundle.triage(old, edited(old, *busy)).causes
    assert [one.cause for one in found] == ["machine"]
    assert "other processes" in found[0].sentence
    shared = [("environment.load_before", 8.0), (time, times(1.6))]
    assert causes(old, edited(old, *shared)) == [], "9 threads on 8 cores explain a factor of 1.125"
    waited = [("environment.waiting", 3.5), (time, times(3))]
    assert causes(old, edited(old, *waited)) == [], "4 s, in which others held the cores for 3.5 s"
    preempted = [("environment.preemptions", 700), (time, times(3))]
    assert causes(old, edited(old, *preempted)) == []
    assert causes(edited(old, *preempted, name="late"), old) == []


def test_threads_explain_their_times(reports):
    old = edited(
        reports["graph"],
        ("summary.total_time_in_seconds", 2.0),
        ("summary.num_threads_used", 8),
        name="eight",
    )
    half = [("summary.num_threads_used", 4), ("summary.total_time_in_seconds", times(1.9))]
    found = bundle.triage(old, edited(old, *half))
    assert found.causes == () and "Threads differ" in found.notes[0]
    few = [("summary.num_threads_used", 2), ("summary.total_time_in_seconds", times(2.5))]
    assert causes(old, edited(old, *few)) == [], "the noise doubles, however many threads differ"
    assert causes(edited(old, *few, name="two"), old) == []
    one = [("summary.num_threads_used", 1), ("summary.total_time_in_seconds", times(7))]
    assert causes(old, edited(old, *one)) == ["options"]


def test_a_slower_option_is_no_machine(reports):
    time = "summary.total_time_in_seconds"
    old = edited(reports["model"], (time, 2.0), name="base")
    new = edited(old, (time, times(4)), ("options.linear_solver_type", "DENSE_QR"))
    assert causes(old, new) == ["options"]


def test_a_median_method_decides_about_the_machine(reports):
    runs = range(len(json.loads(reports["graphs"].read_text())["runs"]))
    old = edited(
        reports["graphs"], *((f"runs.{k}.time_in_seconds", 1.0) for k in runs), name="base"
    )
    assert causes(old, edited(old, ("runs.0.time_in_seconds", 3.0))) == []
    slow = edited(old, *((f"runs.{k}.time_in_seconds", 3.0) for k in runs))
    found = bundle.triage(old, slow)
    assert [one.cause for one in found.causes] == ["machine"]
    assert len(found.methods["machine"]) == len(runs)
    slow = edited(old, *((f"runs.{k}.time_in_seconds", 3.0 + k) for k in runs))
    (machine,) = bundle.triage(old, slow).causes
    assert machine.evidence["excess"] == pytest.approx(3.0), "that of the first method"


def test_cost_and_termination(reports):
    graph = reports["graph"]
    worse = edited(graph, ("summary.final_cost", times(2)))
    assert causes(graph, worse) == ["convergence"]
    both = edited(graph, ("summary.final_cost", times(2)), ("summary.initial_cost", times(2)))
    assert causes(graph, both) == ["data"]
    loss = edited(graph, ("summary.final_cost", times(2)), ("options.loss", "CAUCHY"))
    found = bundle.triage(graph, loss)
    assert [one.cause for one in found.causes] == ["options"]
    assert found.causes[0].evidence["loss"] == {"old": "TRIVIAL", "new": "CAUCHY"}
    ended = edited(graph, ("summary.termination_type", "NO_CONVERGENCE"))
    assert causes(graph, ended) == ["convergence"]
    unusable = edited(graph, ("summary.is_solution_usable", False))
    assert causes(graph, unusable) == ["convergence"]


def test_differences_without_effect_are_notes(reports):
    new = edited(reports["model"], ("options.loss_scale", 2.0), ("input.digests.start", "0"))
    found = bundle.triage(reports["model"], new)
    assert found.causes == ()
    assert len(found.notes) == 2 and "loss_scale" in found.notes[0]


def test_reports_without_digests_environment_and_structure(reports):
    content = json.loads(reports["graph"].read_text())
    for name in ("environment", "structure"):
        del content[name]
    del content["input"]["digests"]
    old = reports["graph"].with_name("bare.json")
    old.write_text(json.dumps(content))
    assert causes(old, old) == []
    new = edited(old, ("input.num_edges", 702), ("summary.final_cost", times(9)))
    (cause,) = bundle.triage(old, new).causes
    assert cause.cause == "data"
    assert cause.evidence["num_edges"]["new"] == 702
    assert f"edges {cause.evidence['num_edges']['old']} -> 702" in cause.sentence


@pytest.mark.parametrize(("text", "words"), [
    ("", "no JSON"),
    ("[1]", "found [1]"),
    ("{}", "found {}"),
    ('{"command": "info"}', "found one of bundle info"),
    ('{"command": "refine", "schema": 2}', "schema 1, found schema 2"),
    ('{"command": "refine", "schema": 1, "version": "9"}', "version"),
    ('{"command": "refine", "schema": 1, "version": "V"}', "entry 'input', it is missing"),
    ("[" * 100000, "no JSON"),
])  # fmt: skip
def test_files_that_are_no_reports(reports, tmp_path, text, words):
    path = tmp_path / "bad.json"
    path.write_text(text.replace('"V"', f'"{bundle.__version__}"'))
    with pytest.raises(InputError, match=r"bad.json: expected") as refused:
        bundle.triage(reports["graph"], path)
    assert words in str(refused.value) and "\n" not in str(refused.value)


def test_reports_of_different_inputs(reports):
    with pytest.raises(InputError, match=r"walk.g2o.*found .*orbit.txt"):
        bundle.triage(reports["graph"], reports["model"])
    with pytest.raises(InputError, match=r"bundle refine as .*found one of bundle vio"):
        bundle.triage(reports["graph"], reports["flight"])
    other = edited(reports["graph"], ("input.path", "a/other.g2o"), ("input.num_poses", 9))
    with pytest.raises(InputError, match=r"600 poses.*9 poses"):
        bundle.triage(reports["graph"], other)
    with pytest.raises(InputError, match=r"g2o, 600 poses.*other, 600 poses"):
        bundle.triage(reports["graph"], edited(reports["graph"], ("input.format", "other")))
    renamed = edited(reports["graph"], ("input.path", "a/other.g2o"))
    assert causes(reports["graph"], renamed) == []


WRONG = [None, -1, 7, 1e308, True, "x", [], {}, [1, [2]], {"a": 1}]


def leaves(value, names=()):
    """The names that lead to each entry of a report; of a list its first item."""
    items = value.items() if isinstance(value, dict) else enumerate(value[:1])
    for key, part in items:
        yield (*names, key)
        if isinstance(part, dict | list):
            yield from leaves(part, (*names, key))


def shortened(value):
    """Return a report with at most four items of each list, which are checked alike."""
    if isinstance(value, dict):
        return {key: shortened(part) for key, part in value.items()}
    return [shortened(part) for part in value[:4]] if isinstance(value, list) else value


def replaced(base, names, value):
    """Return a copy of a report with one entry replaced."""
    copy = json.loads(json.dumps(base))
    place = copy
    for name in names[:-1]:
        place = place[name]
    place[names[-1]] = value
    return copy


@pytest.mark.parametrize("kind", ["graph", "model", "flight", "graphs", "models"])
def test_any_wrong_entry_is_refused_in_one_line_or_harmless(reports, kind):
    base = shortened(json.loads(reports[kind].read_text()))
    old, new = (reports[kind].with_name(f"{kind}-{name}.json") for name in ("short", "wrong"))
    old.write_text(json.dumps(base))
    assert bundle.triage(old, old).causes == ()
    refused = 0
    for k, names in enumerate(leaves(base)):
        for value in (WRONG[k % len(WRONG)], WRONG[(7 * k + 3) % len(WRONG)]):
            new.write_text(json.dumps(replaced(base, names, value)))
            try:
                for pair in ((old, new), (new, old), (new, new)):
                    json.dumps(bundle.triage(*pair).asdict(), allow_nan=False)
            except InputError as error:
                refused += 1
                assert "\n" not in str(error)
    assert refused > 20


@pytest.mark.parametrize(("name", "value", "words"), [
    ("iterations", 3, "iterations: expected a list, found 3"),
    ("summary.final_cost", "x", "summary.final_cost: expected a number, found 'x'"),
    ("summary.num_threads_used", True, "summary.num_threads_used: expected a number"),
    ("summary.warning_kinds", ["a", 1], r"summary.warning_kinds\[1\]: expected a string"),
    ("input.digests.start", 1, "input.digests.start: expected a string"),
    ("environment.num_cores", [2], "environment.num_cores: expected a number"),
    ("options", None, "options: expected a table"),
])  # fmt: skip
def test_a_wrong_entry_is_named(reports, name, value, words):
    with pytest.raises(InputError, match=words):
        bundle.triage(reports["graph"], edited(reports["graph"], (name, value)))


@pytest.mark.parametrize("literal", ["NaN", "Infinity", "-Infinity", "1e999", "9" * 400])
def test_numbers_that_are_not_finite_are_refused(reports, literal):
    text = reports["graph"].read_text().replace('"final_cost": ', f'"final_cost": {literal}, "x": ')
    path = reports["graph"].with_name("huge.json")
    path.write_text(text)
    with pytest.raises(InputError, match="finite"):
        bundle.triage(reports["graph"], path)


def test_an_entry_that_is_missing_is_named(reports):
    content = json.loads(reports["graph"].read_text())
    del content["summary"]["final_cost"]
    path = reports["graph"].with_name("short.json")
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"expected an entry 'summary\.final_cost'"):
        bundle.triage(reports["graph"], path)


def test_a_cost_that_is_no_longer_known_is_a_change(reports):
    unknown = edited(reports["graph"], ("summary.final_cost", None))
    for pair in ((reports["graph"], unknown), (unknown, reports["graph"])):
        assert causes(*pair) == ["convergence"]
    assert causes(unknown, unknown) == []


@pytest.mark.parametrize("number", [-1, 0.5, 2])
def test_a_run_of_an_unknown_input_is_refused(reports, number):
    with pytest.raises(InputError, match=r"runs\[0\]\.input: expected the index of one of 1"):
        bundle.triage(reports["models"], edited(reports["models"], ("runs.0.input", number)))
