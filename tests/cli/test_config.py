"""Config files: their entries are flags, and flags of the command line replace them."""

from __future__ import annotations

import argparse
import json

import pytest

from bundle.cli.commands import COMMANDS
from bundle.cli.main import command_parser
from bundle.cli.parser import Config, entries
from bundle.cli.path_checks import PathArgument
from bundle.cli.run import repeated_flags
from bundle.errors import InputError
from tests.cli.test_bad_input import assert_refused

MODES = ("help", "help_all", "config")


@pytest.fixture(scope="module")
def parsers():
    return command_parser().commands()


def words_of(parser):
    """The words that a command line must have."""
    needed = [action for action in parser._actions if action.required]
    found = []
    for k, action in enumerate(needed):
        suffix = (
            (action.type.own or "/").split()[0] if isinstance(action.type, PathArgument) else ""
        )
        found += [*action.option_strings[-1:], f"path{k}{suffix}"]
    return found


def sample(action):
    """A valid value of a flag: as TOML, and as words of the command line."""
    flag = action.option_strings[-1]
    if isinstance(action, argparse.BooleanOptionalAction):
        return "false", [flag]
    if action.nargs == 0:
        return "true", [flag]
    if action.choices is not None:
        first = str(next(iter(action.choices)))
        return f'"{first}"', [flag, first]
    if isinstance(action.nargs, int):
        return f"{[3, 4, 5][: action.nargs]}", [flag, *"345"[: action.nargs]]
    if action.type in (int, float):
        return "2", [flag, "2"]
    own = action.type.own.split()[:1] if isinstance(action.type, PathArgument) else []
    texts = [f"x{own[0]}"] if own else ["1:2", "1", "0.5/1", "word"]
    for text in texts:
        try:
            if callable(action.type):
                action.type(text)
        except argparse.ArgumentTypeError:
            continue
        return f'"{text}"', [flag, text]
    raise AssertionError(f"{flag}: no sample")


def parsed(parser, words):
    """The values of a command line, without the records of how it was typed."""
    found = vars(parser.parse_args(words))
    return {name: one for name, one in found.items() if name not in ("config", "paths", "taken")}


@pytest.mark.parametrize("name", COMMANDS)
def test_an_entry_is_its_flag(name, parsers, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    parser, needed = parsers[name], words_of(parsers[name])
    config = tmp_path / "c.toml"
    flags = [
        a for a in parser._actions if a.option_strings and a.dest not in MODES and not a.required
    ]
    assert len(flags) >= 4
    for action in flags:
        value, words = sample(action)
        key = action.option_strings[0 if value == "false" else -1].removeprefix("--")
        config.write_text(f"{key} = {value}\n")
        from_file = parsed(parser, [*needed, "--config", "c.toml"])
        assert from_file == parsed(parser, [*needed, *words]), key
        assert from_file != parsed(parser, needed), key
        assert parser.config is None
        arguments = parser.parse_args([f"--config={config}", *needed])
        assert arguments.config == Config(str(config), {f"--{key}": 1}, ())


def test_flags_replace_entries_and_the_report_says_so(run, model, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.toml").write_text(
        'loss = "huber"\nmax-iterations = 7\n[refine]\noutput = "out.txt"\n'
        'set = ["camera 0: k1 fixed"]\n[info]\nverbose = true\n'
    )
    words = ("refine", model, "--config", "c.toml", "--max-iterations=1")
    code, out, _ = run(*words, "--json", "r.json", "--quiet")
    assert code in (0, 1)
    assert (tmp_path / "out.txt").exists()
    report = json.loads((tmp_path / "r.json").read_text())
    assert (report["options"]["loss"], report["options"]["max_num_iterations"]) == ("HUBER", 1)
    lines = {"--loss": 1, "--output": 4, "--set": 5}
    assert report["config"] == {
        "path": "c.toml", "lines": lines, "replaced": ["--max-iterations"],
    }  # fmt: skip
    told = " ".join(out[out.index("config") :].split())
    assert all(word in told for word in ("--loss", "--set", "c.toml", "--max-iterations"))
    arguments = command_parser().parse_args([str(word) for word in words])
    repeated = repeated_flags(arguments)
    assert repeated == ("--loss", "huber", "--set", "camera 0: k1 fixed", "--max-iterations", "1")


@pytest.mark.parametrize(
    ("text", "error"),
    {
        'losss = "huber"': "c.toml:1: & 'losss' & loss",
        '# first\n[refine]\nrounds = "many"': "c.toml:3: rounds: expected numbers, found 'many'",
        "rounds = 2.5": "c.toml:1: & --rounds & 2.5",
        "loss = 3": "c.toml:1: & --loss & '3'",
        "loss = true": "c.toml:1: loss: expected text, found True",
        "quiet = 1": "c.toml:1: quiet: expected true or false, found 1",
        "quiet = [true, 1]": "c.toml:1: quiet: expected true or false",
        "[refine.loss]\nname = 1": "c.toml:1: loss: expected text",
        'output = "o"\nmin-track = 3': "c.toml:2: --min-track: valid only with --rounds",
        'help = true': "c.toml:1: & 'help'",
        'config = "d.toml"': "c.toml:1: & 'config'",
        '[polish]\nloss = "huber"': "c.toml:1: & 'polish'",
        "rounds = \n": "c.toml:1: expected TOML",
        "\n\nrounds": "c.toml:3: expected TOML",
        'html = "c.toml"': "c.toml",
    }.items(),
)  # fmt: skip
def test_errors_name_file_and_line(run, model, tmp_path, monkeypatch, text, error):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.toml").write_text(text + "\n")
    outcome = run("refine", model, "-o", "out.txt", "--config", "c.toml", "--quiet")
    assert_refused(outcome, *error.split(" & "))
    assert not (tmp_path / "out.txt").exists()


def test_a_flag_that_contradicts_an_entry_is_refused_with_its_line(
    run, model, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.toml").write_text("\nall = true\n")
    assert_refused(
        run("check", model, "--config", "c.toml", "--samples", "3"), "c.toml:2: ", "--all"
    )


@pytest.mark.parametrize("content", [b"loss = \xff", b"\x00"])
def test_a_file_that_is_no_text_is_refused(run, model, tmp_path, monkeypatch, content):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.toml").write_bytes(content)
    assert_refused(run("info", model, "--config", "c.toml"), "c.toml")


def test_a_file_that_is_missing_is_refused(run, model):
    assert_refused(run("info", model, "--config", "none.toml"), "none.toml: No such file")
    assert_refused(run("info", model, "--config"), "--config")


def test_lines_of_entries(tmp_path):
    path = tmp_path / "c.toml"
    path.write_bytes(
        b'\xef\xbb\xbf"loss" = "huber"\r\n  rounds=2\r\n[info]\r\nloss = 1\r\n'
        b"[refine]\r\nseed = 3\r\n"
    )
    assert [*entries(str(path), "refine")] == [
        ("loss", "huber", 1), ("rounds", 2, 2), ("seed", 3, 6),
    ]  # fmt: skip
    path.write_text("a = 1\na = 2\n")
    with pytest.raises(InputError, match=r"c\.toml:\d: expected TOML"):
        [*entries(str(path), "refine")]
