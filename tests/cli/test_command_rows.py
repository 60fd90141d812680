"""A command is a row: help, run, JSON, report, page, completion and reference follow from it."""

from __future__ import annotations

import dataclasses
import json
import re
import shlex
from pathlib import Path
from types import SimpleNamespace

import pytest

import bundle
from bundle.base.records import dataclass
from bundle.cli.commands import COMMANDS, Command, Way
from bundle.cli.main import command_parser, main
from bundle.cli.run import Run
from bundle.errors import InputError
from bundle.interface.camera_edit_options import RuleOptions
from bundle.interface.georeference_options import GeoreferenceOptions
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option
from bundle.io.recognition import Kind
from bundle.reports.sections import Column, Report, Section, Table, fields
from tests.cli.test_bad_input import assert_refused
from tests.graphs.pose_graphs import graphs
from tests.reports.page.reader import Page, check_self_contained
from tests.scenes import scene


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class SawOptions(Options):
    """Options of ``saw``."""

    width: float = option(2.0, "--width", "width of a plank", above=0, metavar="W")
    wood: str = option("oak", "--wood", "what is sawn", choices=("oak", "red_fir"))


@dataclasses.dataclass(frozen=True)
class Plank:
    image: str
    length: float


@dataclasses.dataclass(frozen=True)
class Planks:
    planks: tuple[Plank, ...]
    wood: str

    def save(self, path):
        Path(path).write_text(f"{len(self.planks)} of {self.wood}\n")


def saw(problem, *, width, wood, seen=None):
    """The function of the API: a plank per image."""
    if width > 9:
        raise InputError(f"width: expected at most 9, found {width:g}")
    if seen is not None:
        seen(1, 2)
    names = getattr(problem, "image_names", None) or [str(pose) for pose in problem.ids]
    return Planks(tuple(Plank(name, width * k) for k, name in enumerate(names)), wood)


def sawn(source, found, asked, wall):
    columns = [Column("image", "image"), Column("length", "length", "{:.1f}".format)]
    return Report(
        command="saw",
        title=f"Planks of {source}",
        headline=[f"{len(found.planks)} planks of {found.wood}."],
        sections=[
            Section(title="Planks", tables=[Table(columns, found.planks)]),
            Section(title="Took", facts=[("time", f"{wall:.0f} s")], is_detail=True),
        ],
        data={"asked": asked, **fields(found)},
    )


TELLS = "source found asked wall"
ROW = Command(
    help="saw a model into planks",
    usage="INPUT -o FILE [options]",
    arguments=lambda a: (
        a.INPUT,
        a.ARRAYS,
        a.options(SawOptions, "planks"),
        a.page("page", "also write a page of planks"),
    ),
    ways={
        Kind.RECONSTRUCTION: Way(
            call=saw,
            stage="sawing",
            keywords=SawOptions,
            gives="seen=share",
            saves=True,
            report=sawn,
            tells=TELLS,
            code=lambda found: 0 if found.wood == "oak" else 1,
        ),
        Kind.POSE_GRAPH: Way(
            call=saw, keywords=SawOptions, accepts="width html", report=sawn, tells=TELLS
        ),
    },
)


def test_a_row_has_only_the_fields_of_its_class():
    with pytest.raises(TypeError, match=r"Way: expected its fields, found \['cal', 'sawn'\]"):
        Way(call=saw, sawn=1, cal=2)


@pytest.fixture(autouse=True)
def _table(monkeypatch):
    monkeypatch.setitem(COMMANDS, "saw", ROW)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bundle.save(scene(kind="colmap"), "in")
    bundle.save(graphs.loop(3), "x.g2o")
    return tmp_path


@pytest.fixture
def printed(capsys):
    """Function that returns the output of a command line that ends at once."""

    def call(*words):
        with pytest.raises(SystemExit):
            main(list(words))
        return capsys.readouterr().out

    return call


def test_it_stands_in_the_help_and_has_one(printed):
    assert re.search(r"^    saw +saw a model into planks$", printed("--help"), re.MULTILINE)
    out = printed("saw", "--help")
    assert out.startswith("usage: bundle saw INPUT -o FILE [options]\n\nsaw a model into planks\n")
    for words in (
        r"INPUT  ", r"-o(, --output)? FILE.npz", r"--json FILE", r"planks:\n  --width W +width of",
        r"--wood WOOD +what is sawn \(one of oak, red-fir; default: oak\)", r"--html FILE",
    ):  # fmt: skip
        assert re.search(words, out), words


def test_it_runs_and_writes_json_a_report_a_page_and_its_result(run, here):
    words = ("saw", "in", "-o", "o.npz", "--width", "3", "--json", "r.json", "--html", "p.html")
    done = run(*words)
    assert done.code == 0
    assert done.err == "reading in ...\nsawing ...\nwriting o.npz ...\n"
    assert "4 planks of oak." in done.out and "9.0" in done.out and "Took" not in done.out
    assert "time" in run(*words, "--verbose", "--quiet").out
    report = json.loads((here / "r.json").read_text())
    assert report["command"] == "saw" and report["planks"][3]["length"] == 9.0
    assert (here / "o.npz").read_text() == "4 of oak\n"
    page = Page(here / "p.html")
    check_self_contained(page)
    assert "<title>Planks of in</title>" in page.source and "4 planks of oak." in page.source


@pytest.mark.usefixtures("here")
def test_its_exit_code_follows_from_the_result(run):
    assert run("saw", "in", "-o", "o.npz", "--wood", "red-fir", "--quiet").code == 1


@pytest.mark.usefixtures("here")
def test_the_exit_code_of_several_inputs_is_that_of_a_failure(run, monkeypatch):
    way = Way(
        call=saw, keywords=SawOptions, report=sawn, tells=TELLS,
        code=lambda found: 0 if len(found.planks) == 4 else 3,
    )  # fmt: skip
    row = Command(
        help="saw models",
        arguments=lambda a: (a.given_input("inputs", nargs="+"), a.options(SawOptions, "planks")),
        is_for_each=True,
        ways={Kind.RECONSTRUCTION: way},
    )
    monkeypatch.setitem(COMMANDS, "saw", row)
    bundle.save(scene(kind="colmap", num_images=5), "five")
    for inputs, code in ((["in"], 0), (["in", "in"], 0), (["in", "five", "in"], 3)):
        done = run("saw", *inputs, "--quiet")
        assert done.code == code and done.out.count("planks of oak") == len(inputs)


@pytest.mark.usefixtures("here")
def test_a_failure_is_told_once(run, monkeypatch):
    """Standard error has it where standard output has only JSON; else the report does."""

    def fail(run):
        run.end(1, "no saw here")
        return Report(command="saw", title="Planks", headline=["no saw here"], sections=[], data={})

    row = Command(
        help="fail", arguments=lambda a: (a.INPUT,), ways={Kind.RECONSTRUCTION: Way(run=fail)}
    )
    monkeypatch.setitem(COMMANDS, "saw", row)
    for words, told in (((), False), (("--json", "r.json"), False), (("--json", "-"), True)):
        done = run("saw", "in", "--quiet", *words)
        assert done.code == 1 and ("no saw here" in done.err) == told
        assert "no saw here" in done.out


@pytest.mark.usefixtures("here")
def test_what_is_not_there_is_no_keyword(run, monkeypatch):
    seen = []

    def look(problem, *, georeference="none", constraints="none", source="none"):
        seen.append((problem.num_images, georeference, constraints, source))
        return Planks((), "oak")

    way = Way(call=look, gives="georeference constraints source", report=sawn, tells=TELLS)
    row = Command(help="look", arguments=lambda a: (a.INPUT,), ways={Kind.RECONSTRUCTION: way})
    monkeypatch.setitem(COMMANDS, "saw", row)
    assert run("saw", "in", "--quiet").code == 0
    assert seen == [(4, "none", (), "in")]


def test_flags_of_a_run_name_its_rigs_positions_and_rules():
    given = SimpleNamespace(
        arguments=SimpleNamespace(
            rig_config="two rigs.json", flags={"gps": "--gps", "rules": "--set"}
        ),
        georeference=GeoreferenceOptions(gps="g.txt"),
        rules=RuleOptions(rules=("image 1: fixed", "cameras *: share f")),
    )
    words = [
        "--rig-config", "two rigs.json", "--gps", "g.txt",
        "--set", "image 1: fixed", "--set", "cameras *: share f",
    ]  # fmt: skip
    assert shlex.split(Run.flags.fget(given)) == words
    given.arguments.rig_config = None
    assert shlex.split(Run.flags.fget(given)) == words[2:]


@pytest.mark.usefixtures("here")
def test_each_kind_of_input_has_its_flags(run):
    done = run("saw", "x.g2o", "-o", "o.npz", "--width", "1", "--quiet")
    assert done.code == 0 and "planks of oak" in done.out
    found = "--wood: valid only with a reconstruction, found a pose graph"
    assert_refused(run("saw", "x.g2o", "-o", "o.npz", "--wood", "oak", "--quiet"), found)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--width", "0"), "--width: expected more than 0, found 0"),
        (("--width", "99"), "--width: expected at most 9, found 99"),
        (("--wood", "elm"), "--wood: expected one of oak, red-fir, found 'elm'"),
        (("--widht", "3"), "unrecognized arguments: --widht; did you mean --width?"),
        (("--json", "in/images.bin"), "in/images.bin: the report would replace the file of INPUT"),
        (("--html", "o.npz"), "o.npz: the page would replace the file of --output"),
        (("--html", "p.pdf"), "expected a name of a page"),
    ],
)
def test_its_arguments_are_checked_as_those_of_the_others(run, here, words, message):
    before = sorted(path.name for path in here.iterdir())
    assert_refused(run("saw", "in", "-o", "o.npz", *words, "--quiet"), message)
    assert sorted(path.name for path in here.iterdir()) == before


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_shells_complete_it(printed, shell):
    pytest.importorskip("shtab")
    script = printed("--print-completion", shell)
    assert "--width" in script and "red-fir" in script and re.search(r"\bsaw\b", script)


def test_the_reference_describes_it():
    pytest.importorskip("sphinx")
    from tools.site.options_reference import arguments_of

    assert "saw" in COMMANDS  # the directive has a section for each
    text = "\n".join(
        node.astext() for node in arguments_of("saw", command_parser().commands()["saw"])
    )
    for words in ("Saw a model into planks.", "Planks", "--width W", "Width of a plank"):
        assert words in text
