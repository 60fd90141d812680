"""The guard over all paths of a command, and names that say another format."""

import os
from pathlib import Path

import pytest

import bundle
from bundle.cli.main import COMMANDS, command_parser
from bundle.cli.path_checks import PathArgument
from bundle.errors import InputError
from tests.cli.test_bad_input import assert_refused, snapshot
from tests.graphs.pose_graphs import graphs
from tests.scenes import scene

PARSER = command_parser()
REQUIRED = {
    "output": "new", "input": "in", "inputs": "in", "a": "in", "b": "in2", "sequence": "in",
    "old": "old.json", "new": "new.json",
}  # fmt: skip


def paths(command: str) -> list:
    actions = PARSER.commands()[command]._actions
    return [action for action in actions if isinstance(action.type, PathArgument)]


def pairs() -> list[tuple[str, str, str]]:
    """Return what a command writes, and another path that it has."""
    return [
        (command, one.dest, other.dest)
        for command in COMMANDS
        for one in paths(command)
        if one.type.written
        for other in paths(command)
        if other is not one
        and other.dest not in one.type.replaces
        and one.dest not in other.type.replaces
        and {one.dest, other.dest} != {"input", "graph"}
    ]


def parse(command: str, given: dict[str, str]) -> None:
    """Parse a command line with these paths, and what it needs besides."""
    words = [command]
    for action in PARSER.commands()[command]._actions:
        path = given.get(action.dest)
        if path is None and action.required and action.dest in REQUIRED:
            path = REQUIRED[action.dest]
        if path is not None:
            words += [*action.option_strings[-1:], path]
    PARSER.parse_args(words)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name in ("in", "in2"):
        bundle.save(scene(kind="colmap"), tmp_path / name)
    return tmp_path


def test_every_path_is_declared():
    """Those that argparse knows by a file, a folder or a model, and no other."""
    words = ("FILE", "DIR", "PATH", "PAGE", "INPUT", "OUTPUT", "MODEL", "SEQUENCE")
    for command, parser in PARSER.commands().items():
        for action in parser._actions:
            if action.dest != "camera_model" and any(word in str(action.metavar) for word in words):
                assert isinstance(action.type, PathArgument), (command, action.dest)
        assert sum(bool(action.type.written) for action in paths(command)) >= 1


@pytest.mark.parametrize("command", COMMANDS)
def test_no_path_is_replaced(here, command):
    """Every two paths of a command by one form of the same name, which take turns."""
    (here / "file").write_text("# something")
    (here / "page.v2").touch()
    os.link(here / "file", here / "hard")
    (here / "soft").symlink_to("file")
    forms = [
        ("file", "file"), ("file", "soft"), ("soft", "file"), ("hard", "file"),
        (str(here / "file"), "./in/../file"), ("not yet", "./not yet"),
        ("not yet", str(here / "not yet")),
    ]  # fmt: skip
    given = [(written, other) for of, written, other in pairs() if of == command]
    for turn, (written, other) in enumerate(given):
        existing = forms[:5] if other == "config" else forms  # a config is read at once
        one, two = existing[turn % len(existing)]
        with pytest.raises(InputError, match="would replace the file of"):
            parse(command, {written: one, other: two})
        parse(command, {written: "page.v1", other: "page.v2"})


@pytest.mark.parametrize("command", ["refine", "align", "convert", "merge", "covariance"])
def test_files_of_a_model_are_its_own(here, command):
    (here / "page").symlink_to("in/images.bin")
    os.link(here / "in" / "points3D.bin", here / "points")
    out = "arrays" if command == "covariance" else "out"
    (here / "out").mkdir()
    for report in ("page", "points", "in/cameras.bin", "in/georeference.json", "in/frames.txt"):
        with pytest.raises(InputError, match="would replace"):
            parse(command, {"json": report, "output": out})
    if command != "covariance":
        for report in ("out/cameras.bin", "out/georeference.json"):
            with pytest.raises(InputError, match="would replace"):
                parse(command, {"json": report, "output": "out"})
    parse(command, {"json": "in/report.json", "output": out})


@pytest.mark.usefixtures("here")
def test_what_may_be_the_same():
    parse("refine", {"input": "in", "output": "./in", "checkpoint": "c", "resume": "./c"})
    parse("refine", {"input": "in", "output": "in", "gps": "exif", "json": "exif"})
    parse("refine", {"input": "in", "output": "out", "constraints": "in/rules.txt"})
    parse("align", {"input": "in", "output": "in", "reference": "in"} | {"output": "out"})
    parse("merge", {"a": "in", "b": "in2", "output": "in2"})
    for name in ("points3D.txt", "frames.bin", "georeference.json"):  # goes with the old model
        with pytest.raises(InputError, match="--constraints"):
            parse("refine", {"output": "out", "constraints": f"out/{name}"})
    with pytest.raises(InputError, match="--gps"):
        parse("refine", {"output": "out", "gps": "./exif", "json": "exif"})
    with pytest.raises(InputError, match="--reference"):
        parse("align", {"output": "in2", "reference": "in2"})
    with pytest.raises(InputError, match="would replace"):
        parse("synth", {"output": "a.txt", "json": "a_ground_truth.txt"})


FOREIGN = (
    "m.obj", "m.json", "m.sfm", "m.xml", "m.pdf", "M.LAS", "m.v1.las", "m.ply.gz", "m.out.gz",
    "m.npz", "m.jpg", "m.csv", "m.zip", "m.html", "m.g2o", "m.tum", "m.bin", "m.db",
)  # fmt: skip


@pytest.mark.parametrize("name", FOREIGN)
def test_a_model_has_no_foreign_name(run, here, name):
    problem = bundle.load(here / "in")
    before = snapshot(here)
    for arguments in (("convert", "in", name), ("refine", "in", "-o", name)):
        assert_refused(run(*arguments, "--quiet"), name)
    assert_refused(run("synth", name, "--images", 8, "--points", 90, "--quiet"), name)
    with pytest.raises(InputError, match="expected a name of"):
        bundle.save(problem, name)
    assert snapshot(here) == before


@pytest.mark.parametrize("name", ["run.v2", "0.5", "sparse", "m.json/", ".hidden"])
def test_other_names_are_folders(run, here, name):
    assert run("convert", "in", name, "--quiet").code == 0
    assert bundle.load(here / name).num_images == 4
    assert run("convert", "in", name, "--quiet").code == 0  # a folder that exists


def test_names_of_other_outputs(run, here):
    for name in ("m.pdf", "m.json", "m.txt", "m.ply", "m.xml"):
        (here / "link").unlink(missing_ok=True)
        (here / "link").symlink_to(name)
        for page in (name, "link"):
            assert_refused(run("report", "in", "-o", page, "--quiet"), name)
            assert_refused(run("refine", "in", "-o", "x", "--html", page, "--quiet"), name)
        with pytest.raises(InputError, match="expected a name of a page"):
            bundle.report(bundle.load("in"), name)
    for name in ("m.pdf", "m.html", "m.ply"):
        assert_refused(run("info", "in", "--json", name, "--quiet"), name)
        assert_refused(run("covariance", "in", "-o", name, "--quiet"), name)
    bundle.save(graphs.loop(3), here / "x.g2o")
    for name in ("m.json", "m.txt.gz", "m.ply", "m.html"):
        assert_refused(run("convert", "x.g2o", name, "--quiet"), name)
    assert not list(here.glob("m.*")) and not (here / "x").exists()


@pytest.mark.usefixtures("here")
def test_an_explicit_format_counts(run):
    assert run("convert", "in", "m.out", "--format", "colmap", "--quiet").code == 0
    assert bundle.load("m.out").num_images == 4


@pytest.mark.parametrize("command", ["refine", "convert", "align"])
def test_another_model_is_not_replaced(run, here, command):
    flag = [] if command == "convert" else ["-o"]
    more = ["--reference", "in2"] if command == "align" else []
    other = scene(num_images=3, kind="colmap")
    bundle.save(other, "few")
    bundle.save(other, "few_text", "colmap-text")
    bundle.save(scene(num_images=3), "few.txt.gz")
    bundle.save(bundle.load("in").replace(image_names=tuple("abcd")), "renamed")
    bundle.save(other, "broken")
    (here / "broken" / "images.bin").write_bytes(b"\x07" * 20)
    bundle.save(graphs.loop(3), here / "x.g2o")
    before = snapshot(here)
    for target in ("few", "few_text", "renamed", "broken"):
        done = run(command, "in", *flag, target, *more, "--quiet")
        assert_refused(done, "--overwrite", target)
    assert snapshot(here) == before
    for target in ("few", "few_text", "renamed", "broken"):
        done = run(command, "in", *flag, target, *more, "--quiet", "--overwrite")
        assert done.code == 0, done.err
        assert bundle.load(target).num_images == 4
        assert run(command, "in", *flag, target, *more, "--quiet").code == 0  # of the same images
    bundle.save(bundle.load("in"), "text", "colmap-text")
    (here / "link").symlink_to("in")
    assert run(command, "in", *flag, "text", *more, "--quiet").code == 0
    assert run(command, "in", *flag, "link", *more, "--quiet").code == 0


def test_other_bal_files_and_graphs_are_not_replaced(run, here):
    bundle.save(scene(num_images=3), "few.txt.gz")
    bundle.save(scene(), "all.txt")
    bundle.save(graphs.loop(3), here / "x.g2o")
    bundle.save(graphs.loop(3), here / "y.g2o")
    bundle.save(graphs.loop(2), here / "flat.g2o")
    bundle.save(graphs.loop(3, num_poses=9), here / "z.g2o")
    before = snapshot(here)
    assert_refused(run("refine", "all.txt", "-o", "few.txt.gz", "--quiet"), "--overwrite")
    assert_refused(run("convert", "x.g2o", "z.g2o", "--quiet"), "--overwrite")
    for target in ("z.g2o", "flat.g2o"):
        assert_refused(run("refine", "x.g2o", "-o", target, "--quiet"), "--overwrite")
    assert_refused(run("convert", "x.g2o", "all.txt", "--quiet"), "all.txt")
    assert snapshot(here) == before
    assert run("refine", "all.txt", "-o", "few.txt.gz", "--overwrite", "--quiet").code == 0
    assert run("refine", "all.txt", "-o", "few.txt.gz", "--quiet").code == 0
    assert run("refine", "x.g2o", "-o", "y.g2o", "--quiet").code == 0
    assert run("convert", "x.g2o", "z.g2o", "--overwrite", "--quiet").code == 0
