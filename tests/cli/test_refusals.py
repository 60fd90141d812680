"""Refusals of commands: one line beginning "error: ", exit code 2, and nothing is written.

One table has the mistakes of all commands; what every command refuses follows from the rows of
``bundle.cli.commands``.
"""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

import pytest

import bundle
from bundle.cli.commands import COMMANDS, resolve
from bundle.cli.main import command_parser, main
from bundle.cli.option_flags import own_options
from bundle.cli.run import refuse_others
from bundle.errors import InputError
from bundle.interface.option_class import option_class
from bundle.io.recognition import Kind
from bundle.model.problem_keys import MOST_IDS
from tests.cli.test_bad_input import assert_refused, snapshot
from tests.graphs.pose_graphs import graphs
from tests.scenes import make_problem, scene

REFUSED: dict[str, dict[str, str]] = {
    # Words in place of * : what the error has, separated by " & ".
    "*": {"polish": "polish & refine", "refine": "INPUT", "info ''": "INPUT & an empty string"},
    "refine bal.txt *": {
        "": "--output",
        "-o bal.txt/r.txt": "bal.txt/r.txt",
        "-o bal.txt/folder/out.txt": "bal.txt/folder",
        "-o '' --format bal": "",
        "-o ''": "--output & an empty string",
        "-o dir --format bal": "found a folder",
        "-o bal.txt --format colmap": "bal.txt & found a file",
    },
    "refine *": {
        "'' -o out": "INPUT & an empty string",
        "model -o out --html page --images none": "--images",
        "model -o out --images dir": "--images & --gps",
        "model -o out --html model/images.bin": "page",
        "model -o out --loop-loss cauchy": "--loop-loss & --loops",
        "model -o out --loops x.g2o --only-images 1-3": "--loops & --only-images",
        "model -o out --loops x.g2o --loop-loss-scale 0": "--loop-loss-scale & found 0",
        "model -o out --loops bad.g2o": "bad.g2o:1 & 777",
        "model -o out --loops none.g2o": "none.g2o",
        "model -o out --loops x.g2o --json x.g2o": "x.g2o",
        "model -o out --hold-out 70": "--hold-out: expected at most 50, found 70",
        "model -o out --hold-out ten": "--hold-out",
        "model -o out --hold-out-seed 3": "--hold-out-seed: valid only with --hold-out",
        "model -o out --hold-out 0.01":
            "--hold-out: expected at least one observation in 0.01 %",
        "bal.txt -o t.txt --init chordal": "--init",
        "bal.txt -o t.txt --trust-region gauss-newton": "--trust-region",
    },
    "refine bal.txt -o out.txt *": {
        "--solver magic": "--solver & magic & dense-schur",
        "--solv auto": "--solv",
        "--backend gpu": "--backend & gpu & fused",
        "--backend fused --solver cgnr": "--solver: & fused backend & found cgnr",
        "--backend fused --ordering automatic": "--ordering: & points-first & found automatic",
        "--backend fused --preconditioner cluster-jacobi":
            "--preconditioner: & fused backend & found cluster-jacobi",
        "--backend fused --refine points": "--refine: & fused backend & found only points",
        "--threads two": "--threads & two",
        "--threads -1": "--threads & -1",
        "--threads 99999999999": "--threads & at most",
        "--max-iterations -1": "--max-iterations: & -1",
        "--max-iterations 1.5": "--max-iterations & 1.5",
        "--loss-scale 2": "--loss-scale: & --loss trivial",
        "--loss-scale 0": "--loss-scale: & more than 0",
        "--loss-scale nan": "--loss-scale: & finite",
        "--function-tolerance -1": "--function-tolerance:",
        "--refine poses,lens": "--refine: & lens",
        "--fix-images one": "--fix-images & one",
        "--fix-images 9-5": "--fix-images & 9-5",
        "--fix-images 1,,2": "--fix-images",
        "--fix-points 0-99999999999": str(MOST_IDS),
        f"--fix-points 0-{2**63 - 1}": str(MOST_IDS),
        f"--only-images 0-{2**63 - 1}": str(MOST_IDS),
        f"--fix-points {'9' * 50}": "--fix-points",
        "--fix-images 77": "--fix-images: & 77",
        "--format las": "--format & las",
        "--json dir": "found a folder",
        "--json bal.txt/r.json": "bal.txt/r.json",
        "--json out.txt": "out.txt",
        "--json bal.txt": "bal.txt",
    },
    "refine x.g2o -o y.g2o *": {
        "--refine poses": "--refine",
        "--rounds 2": "--rounds",
        "--set 'cameras *: f fixed'": "--set",
        "--check-gradients": "--check-gradients",
        "--solver dense-qr": "--solver",
        "--format bal": "--format",
        "--init odometri": "--init",
        "--loss-on all": "--loss-on",
        "--loops x.g2o": "--loops",
    },
    "info bal.txt --json *": {"./bal.txt": "bal.txt", "''": "--json & an empty string"},
    "convert bal.txt *": {
        "' '": "OUTPUT & an empty string",
        "dir --format bal": "found a folder",
        "/dev/null --format bal": "device",
    },
    "check bal.txt *": {
        "--samples 0": "--samples: expected at least 1, found 0",
        "--seed -1": "--seed",
        "--threads -2": "--threads",
        "--tolerance 0": "tolerance: expected more than 0",
        "--samples 3 --all": "not allowed with",
        "--error g2o": "--error: valid only with a pose graph, found a reconstruction",
    },
    "compare bal.txt *": {
        "''": "INPUT & an empty string",
        "--solvers lu": "--solvers & lu",
        "--solvers ,": "--solvers",
        "--threads two": "--threads & two",
        "--memory-cap much": "--memory-cap & much",
        "--trust-regions newton": "--trust-regions & newton",
        "--perturb 0.6": "--perturb & 0.6",
        "--seed -1": "--seed & -1",
        "--timeout 0": "--timeout & 0",
        "--timeout nan": "--timeout & nan",
        "--repeat 0": "--repeat & 0",
        "--solver=auto": "--solver=auto",
        "--loss-scale 2": "--loss-scale: & --loss trivial",
        "--loss-scale -3": "--loss-scale & -3",
        "nothing.txt": "nothing.txt",
        "--ordering amd": "--ordering & all",
    },
    "covariance solved -o c.npz *": {
        "--gauge none": "--gauge",
        "--gauge some": "--gauge",
        "--of lenses": "--of",
        "--relative 1-3": "--relative",
        "--relative 1:77": "--relative",
        "--scale sigma0 --robust sandwich": "--scale",
        "--fix-images 88": "--fix-images",
    },
    "covariance *": {"solved -o solved/points3D.bin": "solved/points3D.bin"},
    "inspect *": {
        "": "--graph",
        "--graph ''": "--graph & an empty string",
        "bal.txt --graph cycle": "--graph",
        "bal.txt --ordering amd": "--ordering & --graph",
        "bal.txt --block-size 6": "--block-size & --graph",
        "--graph cycle --ordering best": "--ordering & 'best'",
        "--graph cycle --landmarks l1": "--landmarks & 'l1'",
        "--graph cycle --block-size 0": "--block-size & found 0",
        "--graph cycle --refine poses": "--refine: & INPUT",
        "--graph cycle --recalibrate": "--recalibrate: & INPUT",
        "--graph missing": "missing",
        "--graph lines": "lines:2: ",
        "missing": "missing",
        "bal.txt --threads -1": "--threads & found -1",
        "bal.txt --refine nothing": "--refine & nothing",
        "bal.txt --fix-images 77": "--fix-images & found 77",
        "bal.txt --html bal.txt": "bal.txt",
        "--shape 100,20000": "expected three whole numbers",
        "--shape a,b,c": "expected three whole numbers",
        "--shape 3,10,4": "cameras of a point: expected 1 to 3, found 4",
        "--shape 0,10,1": "cameras: expected 1 to",
        "--shape 3,-1,2": "points: expected 1 to",
        "model --shape 3,10,2": "valid only without INPUT",
        "--shape 3,10,2 --refine poses": "--refine",
        "--shape 3,10,2 --recalibrate": "--recalibrate",
    },
    "merge *": {
        "model none -o out/": "none",
        "model bal.txt -o out/": "B: ",
        "bal.txt model -o out/": "A: ",
        "model alone -o out/": "B: ",
        "model -o out/": "B",
        "model other -o out/ --max-error 0": "--max-error",
        "model other -o out/ --max-error x": "--max-error",
    },
    "report model *": {
        "": "-o",
        "-o -": "--output",
        "-o model": "model",
        "-o page --images none": "none & folder",
    },
    "synth *": {
        "''": "OUTPUT & an empty string",
        "a --rings 2": "--rings: & --scene orbit & --scene street",
        "a --scene orbit --no-loop-closure": "--loop-closure:",
        "a --images 1": "--images: ",
        "a --points 1e3": "--points",
        "a --track-length nan": "--track-length: ",
        "a --track-length 50": "--track-length: ",
        "a --scene castle": "--scene",
        "a --image-size 5 5": "--image-size: ",
        "a --pixel-noise 1e308": "--pixel-noise: ",
        "a --seed -1": "--seed: ",
        "a --gravity -1": "--gravity: ",
        "a --orientations 180": "--orientations: ",
        "a --scene orbit --images 200 --points 20": "--points: ",
        "a --format bal --camera-model opencv": "OPENCV",
        "a --duration 3": "--duration: valid only with --scene flight, found --scene street",
        "a --scene flight --rings 3": "--rings: valid only with other scenes",
        "a --scene flight --format bal": "--format: valid only with other scenes",
    },
    "triage *": {
        "r.json notes.txt": "notes.txt",
        "none.json r.json": "none.json",
        "r.json": "NEW.json",
        "r.json r.json --time-noise 0.5": "--time-noise",
    },
    "validate solved --html page.html *": {
        "--folds 1": "--folds: expected at least 2, found 1",
        "--seed -1": "--seed",
        "--camera-models OPENCVV": "--camera-models: expected",
        "--share each,none": "--share: expected",
        "--losses huge": "--losses: expected",
        "--refine poses,lens": "--refine: expected",
        "--gps missing.txt": "missing.txt",
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("refusals")
    bundle.save(scene(), found / "bal.txt")
    model = scene(kind="colmap")
    bundle.save(model, found / "model")
    bundle.save(model, found / "other")
    bundle.save(model.replace(image_names=tuple("abcd")), found / "alone")
    made = make_problem(num_images=4, num_points=30, perturbation=0, format="colmap")
    bundle.save(bundle.solve(made).problem, found / "solved")
    bundle.save(graphs.loop(3), found / "x.g2o")
    (found / "bad.g2o").write_text(
        "EDGE_SE3:QUAT 1 777 0 0 0 0 0 0 1 " + "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n"
    )
    (found / "cycle").write_text("".join(f"{i} {(i + 1) % 6}\n" for i in range(6)))
    (found / "lines").write_text("a b\na b c\n")
    (found / "notes.txt").write_text("no report")
    (found / "dir").mkdir()
    words = ["-o", str(found / "dir/out"), "--json", str(found / "r.json"), "--quiet"]
    assert main(["refine", str(found / "model"), *words]) == 0
    return found


@pytest.fixture
def here(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.parametrize(
    ("line", "words"),
    [
        pytest.param(line, words, id=line)
        for most, mistakes in REFUSED.items()
        for line, words in ((most.replace("*", one), words) for one, words in mistakes.items())
    ],
)
def test_mistakes_of_commands(run, here, monkeypatch, line, words):
    def solve(*_arguments, **_options):
        pytest.fail("solved for nothing")

    if not line.startswith("refine bal.txt -o out.txt"):  # some of these the solver itself finds
        monkeypatch.setattr("bundle.solving.rounds.solve_rounds.solve_prepared", solve)
    before = snapshot(here)
    assert_refused(run(*shlex.split(line), *["--quiet"] * (" " in line)), *words.split(" & "))
    assert snapshot(here) == before
    assert Path("/dev/null").is_char_device()


# What every command refuses, by its row

NEEDED = {
    "input": "model", "inputs": "model", "a": "model", "b": "other", "sequence": "model",
    "old": "r.json", "new": "r.json", "output": "fresh",
}  # fmt: skip


def line_of(name: str, **given: str | None) -> list[str]:
    """Return a command line with all that the command needs; None leaves an argument out."""
    words = [name]
    for action in command_parser().commands()[name]._actions:
        value = given.get(action.dest, NEEDED.get(action.dest))
        if action.required and value is not None and action.dest in {**NEEDED, **given}:
            words += [*action.option_strings[-1:], value]
    return words


def needed(name: str) -> list[argparse.Action]:
    return [action for action in command_parser().commands()[name]._actions if action.required]


@pytest.mark.parametrize("name", COMMANDS)
def test_what_a_command_needs_is_named(run, here, name):
    before = snapshot(here)
    for action in needed(name):
        shown = action.option_strings[-1] if action.option_strings else str(action.metavar)
        # Without one of two words, the second is missing.
        flag = shown if action.option_strings else ""
        assert_refused(run(*line_of(name, **{action.dest: None}), "--quiet"), flag, "required")
        assert_refused(run(*line_of(name, **{action.dest: ""}), "--quiet"), shown, "empty string")
    assert snapshot(here) == before


@pytest.mark.parametrize("name", sorted(set(COMMANDS) - {"synth", "demo", "inspect"}))
def test_a_missing_input_is_named(run, here, name):
    before = snapshot(here)
    (first, *_) = (action for action in needed(name) if not action.option_strings)
    found = {"output": "fresh.npz" if name == "covariance" else "fresh"}
    assert_refused(run(*line_of(name, **{first.dest: "nowhere"}, **found), "--quiet"), "nowhere")
    assert snapshot(here) == before


WRONG_FLAGS = [
    ("--jsn r.json", "unrecognized arguments: --jsn; did you mean --json?"),
    ("--json report.pdf", "expected a name of a report (.json)"),
    ("--json model/images.bin", "model"),
    ("--json dir", "found a folder"),
    ("--json bal.txt/r.json", "bal.txt/r.json"),
    ("--verbose=1", "--verbose"),
]


# All commands have these flags from one place: one mistake for each command, all for `refine`.
@pytest.mark.parametrize(
    ("name", "words", "message"),
    [
        (name, *wrong)
        for k, name in enumerate(COMMANDS)
        for i, wrong in enumerate(WRONG_FLAGS)
        if name == "refine" or i == k % len(WRONG_FLAGS)
    ],
)
def test_flags_of_every_command_are_checked(run, here, name, words, message):
    before = snapshot(here)
    assert_refused(run(*line_of(name), *words.split(), "--quiet"), message)
    assert snapshot(here) == before


OTHERS = [
    (name, kind)
    for name, row in COMMANDS.items()
    for kind, way in row.ways.items()
    if kind != Kind.RECONSTRUCTION and way.accepts is not None
]


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(("name", "kind"), OTHERS)
def test_flags_of_models_are_refused_for_every_other_kind(name, kind):
    """Set each flag as if it had been given."""
    row = COMMANDS[name]
    way = row.ways[kind]
    every = {"json", "quiet", "verbose", "output", "overwrite", "config", "dry_run"}
    names = resolve(way.names) if isinstance(way.names, str) else way.names
    names = names or (option_class(way.options).names() if way.options else ())
    accepted = {*every, *names, *way.accepts.split()}
    arguments = command_parser().parse_args(line_of(name))
    refuse_others(row, kind, arguments)
    refused = 0
    flags = {dest: flag for dest, flag in arguments.flags.items() if dest in arguments}
    for dest, flag in flags.items():
        given = argparse.Namespace(**{**vars(arguments), dest: True})
        if dest in accepted:
            refuse_others(row, kind, given)
            continue
        refused += 1
        with pytest.raises(InputError) as error:
            refuse_others(row, kind, given)
        assert str(error.value) == f"{flag}: valid only with a reconstruction, found {kind}"
    assert refused or (kind == Kind.POSE_GRAPH and name == "check")


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("name", [name for name, kind in OTHERS if kind == Kind.POSE_GRAPH])
def test_flags_of_pose_graphs_are_refused_for_models(name):
    row, arguments = COMMANDS[name], command_parser().parse_args(line_of(name))
    refuse_others(row, Kind.RECONSTRUCTION, arguments)
    own = set(own_options("PoseGraphOptions", "SolveOptions")) & arguments.flags.keys()
    for dest in own if name != "inspect" else ():  # whose --ordering is that of a small graph
        given = argparse.Namespace(**{**vars(arguments), dest: "x"})
        with pytest.raises(InputError, match="valid only with a pose graph"):
            refuse_others(row, Kind.RECONSTRUCTION, given)
