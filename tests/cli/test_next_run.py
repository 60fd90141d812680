"""The next command keeps every flag of the run, wherever the words stand."""

import argparse
import shlex

import numpy as np
import pytest

from bundle.cli import path_checks
from bundle.cli.main import command_parser
from bundle.cli.run import DROPPED, repeated_flags
from bundle.judging.findings.next_command import NextCommand

BESIDE = {*DROPPED, "input", "command", "kind", "flags", "taken"}


@pytest.fixture(autouse=True)
def any_path(monkeypatch):
    """Words stand for files that need not exist."""
    monkeypatch.setattr(path_checks, "check_paths", lambda *_: None)


def actions() -> list[argparse.Action]:
    found = command_parser().commands()["refine"]._actions
    return [
        one
        for one in found
        if one.option_strings and not one.dest.startswith("help") and one.dest not in BESIDE
    ]


def value(action: argparse.Action, parser: argparse.ArgumentParser) -> list[str]:
    """Return words that the argument accepts as its values."""
    if action.nargs == 0:
        return []
    if isinstance(action.nargs, int):
        return ["12"] * action.nargs
    if action.choices is not None:
        return [str(next(reversed(list(action.choices))))]
    for word in ("M", "2", "1,2", "1:2", "all"):  # "M" is the name of INPUT, too
        try:
            parser._get_value(action, word)
        except (argparse.ArgumentError, ValueError):
            continue
        return [word]
    raise AssertionError(action.dest)


def parsed(words: list[str]) -> dict[str, object]:
    arguments = vars(command_parser().parse_args(words))
    return {name: given for name, given in arguments.items() if name not in BESIDE}


def followed(words: list[str], *flags: str) -> list[str]:
    arguments = command_parser().parse_args(words)
    command = NextCommand("M", "OUT", repeated_flags(arguments)).refine(*flags)
    return shlex.split(command)[1:]


@pytest.mark.parametrize("seed", range(6))
def test_every_flag_of_refine_survives(seed):
    rng = np.random.default_rng(seed)
    parser = command_parser().commands()["refine"]
    chosen = [one for one in actions() if one.dest != "resume" and rng.random() < 0.5]
    groups = [[one.option_strings[0], *value(one, parser)] for one in chosen]
    if not any(one.dest == "orientations" for one in chosen):
        groups.append(["--orientations", "xmp"])  # which needs --images
    groups += [["M"], ["--set", "camera 1: f fixed"], ["--set", "image 2: position prior sigma 1"]]
    groups = [groups[k] for k in rng.permutation(len(groups))]
    words = ["refine", "-o", "OUT", "--json", "M", *(word for one in groups for word in one)]
    before, after = parsed(words), parsed(followed(words, "--loss", "cauchy"))
    if not any(before[name] == word for name, word in (("gps", "exif"), ("orientations", "xmp"))):
        before["images"] = None
    assert after.pop("loss") == "cauchy"
    before.pop("loss")
    assert after == before


def test_each_flag_survives_alone_directly_before_the_input():
    parser = command_parser().commands()["refine"]
    for action in actions():
        for flag in action.option_strings:
            words = ["refine", "-o", "OUT", flag, *value(action, parser), "M"]
            given = followed(words)
            stays = action.dest != "images"  # without a flag that reads them
            assert given.count("M") == 1 + stays * value(action, parser).count("M")
            if stays and action.dest != "resume":
                assert parsed(given) == parsed(words)


def test_rules_add_up_and_other_flags_are_replaced():
    words = [*shlex.split("refine M -o OUT --set 'cameras *: k fixed' --loss=huber"), "--no-rounds"]
    words[-1:] = ["--rounds", "2", "--no-check-solution"]
    found = followed(words, "--set", "camera 1: f prior 2 %", "--loss", "cauchy")
    assert found == shlex.split(
        "refine M -o OUT --set 'cameras *: k fixed' --rounds 2 --no-check-solution "
        "--set 'camera 1: f prior 2 %' --loss cauchy"
    )
    assert followed(words, "--check-solution").count("--no-check-solution") == 0
    twice = followed([*words, "--rounds", "5", "--loss", "cauchy"])
    assert twice[6:] == shlex.split("--loss cauchy --rounds 5 --no-check-solution")
    again = followed(found, "--set", "camera 1: f prior 2 %")
    assert again.count("camera 1: f prior 2 %") == 1


def test_values_that_begin_with_a_dash_stay_values():
    words = ["refine", "M", "-o", "OUT", "--gps", "g.txt", "--antenna=-1,0,2"]
    assert followed(words)[-1] == "--antenna=-1,0,2"
    assert parsed(followed(words)) == parsed(words)


def test_a_resumed_run_begins_its_checkpoint_anew():
    words = ["refine", "M", "-o", "OUT", "--resume", "r.npz", "--checkpoint-interval", "5"]
    assert followed(words)[4:] == ["--checkpoint", "r.npz", "--checkpoint-interval", "5"]


@pytest.mark.parametrize(
    ("words", "stays"),
    [
        ("--velocities xmp", True),
        ("--orientations xmp", True),
        ("--gps exif", True),
        ("--gps exif.txt", False),
        ("--html p.html", False),
    ],
)
def test_the_folder_of_photographs_stays_where_it_is_read(words, stays):
    found = followed(["refine", "M", "-o", "OUT", "--images", "photos", *words.split()])
    assert ("photos" in found) == stays


def test_flags_of_files_and_of_the_terminal_are_not_repeated():
    words = ["refine", "IN", "-o", "OUT", "--json", "a.json", "--html", "a.html", "--quiet"]
    for more in (["--verbose"], ["--check-gradients"]):
        given = command_parser().parse_args([*words, *more, "--loss", "huber"])
        assert repeated_flags(given) == ("--loss", "huber")
