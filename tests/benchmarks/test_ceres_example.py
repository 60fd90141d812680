from __future__ import annotations

import pytest
from benchmarks.runners import ceres_example as runner
from benchmarks.runners import protocol

from benchmarks import bal, ceres_example, series

SOURCE = """
  options.gradient_tolerance = 1e-16;
  options.function_tolerance = 1e-16;
    bal_problem.WriteToPLYFile(CERES_GET_FLAG(FLAGS_initial_ply));
    bal_problem.WriteToPLYFile(CERES_GET_FLAG(FLAGS_final_ply));
"""


def test_the_edits_reach_tolerances_and_output_and_nothing_else():
    text = ceres_example.edited(SOURCE)
    for name in ("gradient", "function", "parameter"):
        value = f'std::atof(std::getenv("{name.upper()}_TOLERANCE"))'
        assert f"options.{name}_tolerance = {value};" in text
    assert "1e-16" not in text
    assert "WriteToPLYFile(CERES_GET_FLAG(FLAGS_initial_ply))" in text
    assert "WriteToFile(CERES_GET_FLAG(FLAGS_final_ply))" in text


@pytest.mark.parametrize("source", ["", 2 * SOURCE, SOURCE.replace("gradient", "grad")])
def test_another_source_is_refused(source):
    with pytest.raises(ceres_example.UnavailableError, match="has changed"):
        ceres_example.edited(source)


def test_without_debian_the_row_says_so(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ceres_example.UnavailableError, match="no Debian source packages"):
        ceres_example.binary()


def test_a_command_that_fails_gives_its_last_line():
    with pytest.raises(ceres_example.UnavailableError, match=r"^sh: no such luck$"):
        ceres_example._run(["sh", "-c", "echo first >&2; echo no such luck >&2; exit 3"])
    with pytest.raises(ceres_example.UnavailableError, match="no-such-command"):
        ceres_example._run(["no-such-command"])


def request(path, rule="default"):
    return protocol.Request(
        path=path,
        kind="bal",
        solver="dense-schur",
        backend="",
        threads=1,
        memory_limit=0,
        **series.RULES[rule],
    )


def fake(tmp_path, script):
    """A program in the example's place."""
    program = tmp_path / "bundle_adjuster"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    return program


def test_an_example_that_fails_is_told_by_its_last_line(monkeypatch, scene, tmp_path):
    bal.write(scene, tmp_path / "problem.txt")
    program = fake(tmp_path, "echo 'Check failed: luck' >&2; exit 3")
    monkeypatch.setattr(ceres_example, "binary", lambda: program)
    with pytest.raises(RuntimeError, match="exit 3: Check failed: luck"):
        runner.run(request(tmp_path / "problem.txt"))


def test_the_cost_is_that_of_what_it_wrote_with_everybodys_tolerances(monkeypatch, scene, tmp_path):
    from tests.benchmarks.test_ceres_log import PRINTED

    problem, log = tmp_path / "problem.txt", tmp_path / "log"
    bal.write(scene, problem)
    log.write_text(PRINTED)
    script = f"""
        for flag in "$@"; do case $flag in
            --input=*) input=${{flag#*=}};; --final_ply=*) output=${{flag#*=}};; esac; done
        cp "$input" "$output"; cat {log}
        echo "$FUNCTION_TOLERANCE $GRADIENT_TOLERANCE $PARAMETER_TOLERANCE $*" > {tmp_path}/given
    """
    monkeypatch.setattr(ceres_example, "binary", lambda: fake(tmp_path, script))
    outcome = runner.run(request(problem, "tight"))
    assert outcome.verified_cost == bal.cost(scene, behind="algebraic")
    assert outcome.final_cost == 1.803391e4  # what it says; the row will doubt it
    assert (outcome.num_steps, outcome.minimizer, outcome.solve) == (7, 0.593452, 0.687784)
    function, gradient, parameter, *flags = (tmp_path / "given").read_text().split()
    assert [float(function), float(gradient), float(parameter)] == [1e-12, 1e-12, 1e-14]
    assert {"--num_iterations=300", "--linear_solver=dense_schur", "--num_threads=1"} <= set(flags)
