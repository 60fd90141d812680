"""Answers to misspelt words: the nearest word, and the command that has it."""

from __future__ import annotations

import pytest

from bundle.cli import parser
from bundle.cli.main import COMMANDS, command_parser
from bundle.errors import InputError


@pytest.mark.parametrize(
    ("words", "suggested"),
    [
        (["refin", "MODEL"], ["refine"]),
        (["Info", "MODEL"], ["info"]),
        (["info", "--solver", "auto", "MODEL"], ["refine and validate have --solver"]),
        (["info", "MODEL", "--solver=auto"], ["refine and validate have --solver"]),
        (
            ["info", "MODEL", "--max-iterations", "3"],
            ["refine, compare, validate and vio have --max-iterations"],
        ),
        (["info", "MODEL", "--loss-scael", "3"], ["mean --loss-scale or", "of refine"]),
        (
            ["compare", "MODEL", "--solver", "auto"],
            ["mean --solvers", "refine and validate have --solver"],
        ),
        (["refine", "MODEL", "--outptu", "x"], ["mean --output"]),  # before what is missing
        (["refine", "MODEL", "-o", "x", "--max_iterations", "3"], ["mean --max-iterations"]),
        (["refine", "MODEL", "-o", "x", "--solver", "dense-shur"], ["mean dense-schur"]),
        (["--versoin"], []),
        (["filter", "MODEL"], ["mean refine?"]),
        (["georegister", "MODEL"], ["mean align?"]),
        (["help", "optimize"], ["mean refine?"]),
        (["refine", "MODEL", "-o", "x", "--gcp-accuracy", "0.1"], ["mean --gcp-sigma?"]),
        (["refine", "MODEL", "-o", "x", "--share-intrinsics"], ["mean --share-cameras?"]),
        (["validate", "MODEL", "--share-intrinsics"], ["mean --share?"]),
        (["refine", "MODEL", "-o", "x", "--control-points", "f"], ["mean --gcp?"]),
        (["refine", "MODEL", "-o", "x", "--filter"], ["mean --rounds?"]),
        (["refine", "MODEL", "-o", "x", "--report", "x.html"], ["mean --html?"]),
        (["report", "MODEL", "--html", "x.html"], ["--html; did you mean -o? (see"]),
        (["report", "MODEL", "--page=x.html"], ["mean -o?"]),
        (["merge", "MODEL", "MODEL", "--html", "x.html"], ["compare and 5 others have --html"]),
        (["convert", "MODEL", "-o", "x"], ["mean OUTPUT?"]),
        (["convert", "MODEL", "x", "--lens", "OPENCV"], ["mean --camera-model?"]),
        (["validate", "MODEL", "--lens", "OPENCV"], ["mean --camera-models?"]),
        (["validate", "MODEL", "--kernel", "huber"], ["mean --losses?"]),
        (["refine", "MODEL", "-o", "x", "--share-cameras"], ["argument: IDS|all|size (see"]),
        (["refine", "MODEL", "-o", "x", "--loss"], ["argument: trivial, huber, "]),
        (["synth", "x", "--image-size", "3"], ["2 arguments: WIDTH HEIGHT (see"]),
        (["info", "--zzz", "MODEL"], []),
        (["convert", "MODEL", "b", "c"], ["'c'"[1:-1]]),
        (["report", "MODEL", "refined", "-o", "x.html"], []),  # no flag resembles a word
        (["refine", "MODEL", "out"], ["required: -o/--output", "mean -o out?"]),
        (["refine", "MODEL", "-O", "out"], ["unrecognized arguments: -O", "mean -o?"]),
        (["refine", "MODEL", "a b"], ["mean -o 'a b'?"]),
        (["refine"], ["required: INPUT, -o/--output"]),
        (["evaluate", "MODEL", "MODEL"], ["required: --reference", "mean --reference "]),
        (["refine", "MODEL", "-o", "x", "--robust", "huber"], ["mean --loss?"]),
        (["refine", "MODEL", "-o", "x", "--robust-kernal=huber"], ["mean --loss"]),
        (["refine", "MODEL", "-o", "x", "--accuracy", "0.1"], ["mean --gps-sigma?"]),
        (["info", "MODEL", "--kernel", "huber"], []),  # without --loss
    ],
)
def test_misspelt(run, model, words, suggested):
    code, out, err = run(*(str(model) if word == "MODEL" else word for word in words))
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    for suggestion in suggested:
        assert suggestion in err
    assert suggested or ("mean" not in err and "has" not in err)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_word_in_place_of_a_number_is_refused_in_the_same_words(name):
    command = command_parser().commands()[name]
    numbers = [action for action in command._actions if action.type in (int, float)]
    assert numbers or name not in ("refine", "compare", "synth")
    for action in numbers:
        count = action.nargs if isinstance(action.nargs, int) else 1
        kind = "a whole number" if action.type is int else "a number"
        for word in ("two", "1,5", "", "9" * 5000 + "x"):
            with pytest.raises(InputError) as refused:
                command.parse_args([action.option_strings[-1], *[word] * count])
            flags = "/".join(action.option_strings)
            assert str(refused.value).startswith(f"{flags}: expected {kind}, found '{word[:9]}")
            assert len(str(refused.value)) < 200


def test_other_words_for_a_command_belong_to_one_command():
    words = [word for row in COMMANDS.values() for word in row.also.split()]
    assert len(words) == len(set(words)) > 20
    assert not set(words) & set(COMMANDS)


def test_other_words_for_a_flag_are_no_flags_of_its_command():
    known: set[str] = set()
    for command in ("refine", "validate", "report"):  # they have all flags of the table
        flags = {*command_parser().commands()[command].flags()}
        table = parser.ELSEWHERE.items()
        own = {key: said for key, said in table if key.removeprefix(f"{command} ") in flags}
        words = " ".join(own.values()).split()
        assert len({*words} - flags) == len(words) > 5
        known |= {*own}
    assert {*parser.ELSEWHERE} - known == {"convert OUTPUT", "synth OUTPUT"}


@pytest.mark.parametrize(
    ("count", "listed"),
    [
        (1, "a has"), (2, "a and b have"), (4, "a, b, c and d have"),
        (5, "a, b, c and 2 others have"), (9, "a, b, c and 6 others have"),
    ],
)  # fmt: skip
def test_commands_that_have_a_flag_are_listed_or_counted(count, listed):
    flags = {"x": (), **dict.fromkeys("abcdefghi"[:count], ("--flag",))}
    assert f"; {listed} --flag" in parser.unknown_flag("--flag", "x", flags)


def test_after_two_dashes_everything_is_a_name(run):
    assert "--odd: No such file" in run("info", "--", "--odd").err


def test_bundle_alone_prints_help(run):
    code, out, err = run()
    assert (code, err) == (0, "")
    # A long name has a line of its own.
    listed = {line.split()[0] for line in out.splitlines() if line.startswith("    ")}
    assert set(COMMANDS) <= listed
