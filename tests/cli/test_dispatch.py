"""The tables of commands: each has arguments, handlers that exist, and a default for any kind."""

from __future__ import annotations

import inspect

import pytest

from bundle.cli.commands import COMMANDS, FLIGHT, GRAPH_FILE, resolve
from bundle.cli.main import command_parser
from bundle.interface.option_class import option_class
from bundle.io.recognition import Kind, recognize

WAYS = [
    pytest.param(way, id=f"{name} {kind}")
    for name, row in COMMANDS.items()
    for kind, way in row.ways.items()
]


@pytest.mark.parametrize("way", WAYS)
def test_every_function_of_a_row_exists(way):
    names = [name for name in (way.call, way.run, way.of, way.main, way.report) if name]
    assert names and all(callable(resolve(name)) for name in names)
    for name in names:
        module, _, function = name.partition(":")
        found = resolve(name)
        assert (found.__module__, found.__name__) == (f"bundle.{module}", function)
    assert bool(way.report) != bool(way.run or way.main), "one function makes the report"


CALLS = [param for param in WAYS if param.values[0].call]


@pytest.mark.parametrize("way", CALLS)
def test_options_have_the_names_of_the_keywords_of_the_api(way):
    function = inspect.signature(resolve(way.call)).parameters
    keywords = {word.partition("=")[0] for word in way.gives.split()}
    if way.keywords:
        names = option_class(way.keywords).names()
        accepted = way.accepts.split()
        keywords |= {name for name in names if name in accepted or not accepted}
    assert keywords <= function.keys()
    assert not way.options or "options" in function
    assert set(way.reads.split()) <= function.keys()


@pytest.mark.parametrize("command", COMMANDS)
def test_any_other_kind_goes_to_the_reader_of_reconstructions(command):
    row = COMMANDS[command]
    assert row.way("nothing") is row.ways[Kind.RECONSTRUCTION]


@pytest.mark.parametrize(
    ("words", "kind"),
    [
        (("refine", "a.g2o", "-o", "b"), Kind.POSE_GRAPH),
        (("refine", "a.txt", "-o", "b"), Kind.RECONSTRUCTION),
        (("compare", "a.txt", "b.g2o"), Kind.POSE_GRAPH),
        (("compare", "a.txt", "b.txt"), Kind.RECONSTRUCTION),
        (("inspect", "a.g2o"), Kind.POSE_GRAPH),
        (("inspect", "--graph", "a.txt"), GRAPH_FILE),
        (("inspect",), GRAPH_FILE),
        (("synth", "out", "--scene", "flight"), FLIGHT),
    ],
)
def test_the_kind_of_a_command_line(words, kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = command_parser().parse_args(list(words))
    assert (arguments.command, COMMANDS[words[0]].kind(arguments)) == (words[0], kind)


def test_kinds_are_told_by_content_and_pipes_are_left_alone(tmp_path):
    (tmp_path / "graph.txt").write_text("VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    (tmp_path / "problem.txt").write_text("1 1 1\n0 0 1 1\n")
    (tmp_path / "flight").mkdir()
    (tmp_path / "flight" / "imu.csv").touch()
    assert recognize(tmp_path / "graph.txt") is Kind.POSE_GRAPH
    assert recognize(tmp_path / "problem.txt") is Kind.RECONSTRUCTION
    assert recognize(tmp_path / "flight") is Kind.SEQUENCE
    assert recognize(None) is Kind.RECONSTRUCTION
