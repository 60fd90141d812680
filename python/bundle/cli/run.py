"""One run of a command: check arguments, open INPUT, call the API, report, write; --dry-run.

The row of the command (``bundle.cli.commands``) states the differences. Where more than that
differs, it names a function that gets the run, uses what it needs of it, and returns the report.
"""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, TypeVar

from bundle.cli.commands import COMMANDS, Command, Way, resolve
from bundle.cli.declarations import read_options
from bundle.cli.error_lines import complain
from bundle.cli.inertial_flags import RECORDED
from bundle.cli.option_flags import (
    flags_of,
    naming_flags,
    options_given,
    own_options,
    with_named_images,
)
from bundle.cli.output import Progress, publish
from bundle.cli.problem_edits import rules_as_options, rules_of, with_rigs
from bundle.errors import InputError, shown
from bundle.georeference.measurements import ROWS, Measurements
from bundle.interface.camera_edit_options import RuleOptions
from bundle.interface.option_class import Options, option_class
from bundle.io.recognition import Kind, recognize
from bundle.reports.sections import Report, Section, several

if TYPE_CHECKING:
    from bundle.georeference.measurements import Prior
    from bundle.interface.solve_record import SolveRecord
    from bundle.model.problem import Problem
    from bundle.reports.terminal.solve_data import WallTime
    from bundle.solving.constraints.rule_list import Constraints

AnyOptions = TypeVar("AnyOptions", bound=Options)

_OF_ALL = {
    *("input", "inputs", "output", "json", "quiet", "verbose", "overwrite"),
    *("command", "flags", "taken", "config", "dry_run", "paths"),
}


def prepare(arguments: argparse.Namespace) -> Callable[[], int]:
    """Import what a command line needs; return a function that runs it to its exit code."""
    command = COMMANDS[arguments.command]
    if command.is_for_each:
        kinds = [(path, str(recognize(path))) for path in arguments.inputs]
    else:
        kinds = [(getattr(arguments, "input", None), command.kind(arguments))]
    ways = [command.way(kind) for _, kind in kinds]
    for way in ways:
        for name in (way.call, way.run, way.of, way.main, way.report):
            if name:
                resolve(name)
    if ways[0].main and not arguments.dry_run:
        refuse_others(command, kinds[0][1], arguments)
        return lambda: int(resolve(ways[0].main)(arguments))
    return lambda: _run(command, kinds, arguments)


def _run(command: Command, kinds: list[tuple[Any, str]], arguments: argparse.Namespace) -> int:
    runs: list[Run] = []
    reports = []
    with Progress(quiet=arguments.quiet) as progress:
        for path, kind in kinds:
            kind_of_run = resolve(command.way(kind).of)
            runs.append(kind_of_run(command, kind, arguments, progress, path))
            reports.append(runs[-1].plan() if arguments.dry_run else runs[-1].report())
    if arguments.dry_run:
        arguments.html, arguments.json = None, "-" if arguments.json == "-" else None
    publish(reports[0] if len(reports) == 1 else several(arguments.command, reports), arguments)
    run = next((run for run in runs if run.code), runs[0])
    if run.code and run.complaint and arguments.json == "-":  # standard output has only the JSON
        complain(run.complaint)
    return run.code


class Run:
    """One run of a command on one INPUT.

    Attributes:
        arguments: parsed command line.
        progress: display of the stages.
        source: path of INPUT, or the paths that the API reads.
        detected: kind of INPUT.
        target: path of OUTPUT, if the command has one.
        options: options of the call, or None.
        rules: rules as given.
        constraints: the parsed rules.
        georeference: options of measurements; None: the command has none.
        input: INPUT once it is opened.
        known: what was read of all measurements.
        found: result of the call.
        findings: findings about INPUT.
        times: seconds of the stages that were timed, by name.
        code: exit code.
        complaint: what standard error says where standard output has only JSON.
    """

    def __init__(
        self,
        command: Command,
        kind: str,
        arguments: argparse.Namespace,
        progress: Progress,
        source: Any,
    ) -> None:
        self._started = perf_counter()
        self._command, self._kind = command, kind if kind in command.ways else Kind.RECONSTRUCTION
        self._way, self.detected = command.way(kind), kind
        self.arguments, self.progress, self.source = arguments, progress, source
        self.target: str = getattr(arguments, "output", None) or ""
        self.options: Any = None
        self.rules = RuleOptions()
        self.constraints: Constraints | tuple[()] = ()
        self.georeference: Any = None
        self.input: Any = None
        self.known = Measurements()
        self.found: Any = None
        self.findings: Any = ()
        self.times: dict[str, float] = {}
        self.code, self.complaint = 0, ""

    def report(self) -> Report:
        """Run all steps; return the report."""
        way, arguments = self._way, self.arguments
        refuse_others(self._command, self._kind, arguments)
        if way.run:
            report: Report = resolve(way.run)(self)
            return report
        keywords = self.given(_class(way.keywords)).asdict() if way.keywords else {}
        if way.options:
            self.options = self.given(_class(way.options), _names(self._way))
        self.check_knowledge(getattr(self.options, "refine", ()))
        if way.reads:
            self.source = tuple(getattr(arguments, name) for name in way.reads.split())
        else:
            self.open()
        if way.call:
            self._call(keywords)
        if way.judges:
            self.progress.stage("judging")
            self.judge()
        if way.saves and self.target:
            self.write(self.target, self.found.save)
        if way.code is not None:
            self.code = way.code(self.found)
        made: Report = resolve(way.report)(*(getattr(self, name) for name in way.tells.split()))
        return made

    def plan(self) -> Report:
        """Check the command line and read INPUT; return the report on what a run would do."""
        way, arguments = self._way, self.arguments
        refuse_others(self._command, self._kind, arguments)
        predicted: list[str] = []
        is_plain = not (way.run or way.main)
        if is_plain:
            if way.keywords:
                self.given(_class(way.keywords))
            if way.options:
                self.options = self.given(_class(way.options), _names(way))
            self.check_knowledge(getattr(self.options, "refine", ()))
        if way.plan:
            predicted = resolve(way.plan)(self)
        elif self.source is not None and self.detected in (Kind.RECONSTRUCTION, Kind.POSE_GRAPH):
            (self.open if is_plain else self.load)()
        return planned(self, predicted)

    # Check

    def given(self, kind: type[AnyOptions], names: Collection[str] | None = None) -> AnyOptions:
        """Return the options of a class from the command line; see ``options_given``."""
        return options_given(self.arguments, kind, names=names, names_follow=True)

    def check_knowledge(self, refined: Iterable[str] = (), *, page: bool = False) -> None:
        """Read the flags of positions, control points and rules, as far as the command has them."""
        if "gps" in self.arguments and self._kind == Kind.RECONSTRUCTION:
            from bundle.cli.georeferencing import georeference_given  # few commands need it

            own = _class(self._way.keywords).names() if self._way.keywords else ()
            given = self.arguments, tuple(refined)
            self.georeference = georeference_given(*given, page=page, beside=own)
        if "rules" in self.arguments:
            self.rules = self.given(RuleOptions)
            self.constraints = rules_of(self.rules)

    # Open

    def load(self, *, rigs: bool = True) -> Any:
        """Read INPUT, with the rigs of the command line."""
        given = self.arguments
        reading = (read_options(given),) if "input_format" in given else ()
        self.progress.stage(f"reading {shown(self.source)}")
        if self._kind == Kind.POSE_GRAPH:
            from bundle.io.g2o_files import load_g2o  # for pose graphs only

            self.input = load_g2o(self.source)
        else:
            from bundle.io.open import load

            self.input = load(self.source, self.progress.text, *reading)
            if rigs and "rig_config" in given:
                self.input = with_rigs(self.input, given.rig_config)
        return self.input

    def open(self) -> None:
        """Read INPUT; find the images that options name, and the priors."""
        self.load()
        named = getattr(self.arguments, "fixed_image_ids", None)
        if isinstance(named, str) and self._kind == Kind.RECONSTRUCTION:
            self.options = with_named_images(self.options, named, self.input)
        if self.georeference is not None:
            from bundle.cli.georeferencing import priors_of

            self.known = priors_of(self.georeference, self.input)

    @property
    def priors(self) -> tuple[Prior, ...]:
        """Priors of all measurements."""
        return self.known.priors

    # Call

    def _call(self, keywords: dict[str, Any]) -> None:
        way = self._way
        for word in way.gives.split():
            name, _, attribute = word.partition("=")
            keywords[name] = getattr(self, attribute or name)
        keywords["options"] = self.options
        keywords = {name: value for name, value in keywords.items() if value is not None}
        inputs = list(self.source) if way.reads else [self.input]
        if way.stage:
            paths = f" {' with '.join(map(shown, self.source))}" if way.reads else ""
            self.progress.stage(f"{way.stage}{paths}")
        with self.naming():
            self.found = resolve(way.call)(*inputs, **keywords)

    @contextmanager
    def naming(self) -> Iterator[None]:
        """Replace keywords by flags in errors."""
        flags = {name: name.upper() for name in self._way.reads.split()}
        if self.options is not None:
            flags |= flags_of(type(self.options))
        flags |= self.arguments.flags | ({} if self.rules.constraints else {"constraints": "--set"})
        if self.georeference is not None:
            from bundle.cli.georeferencing import prior_flags

            flags |= prior_flags(self.georeference)
        with naming_flags(**flags):
            yield

    def judge(self, problem: Problem | None = None, **known: Any) -> None:
        """Search for findings about a problem, by default INPUT."""
        from bundle.judging.findings.find import find

        given = {
            "source": self.source,
            "given": repeated_flags(self.arguments),
            "options": self.options,
            "priors": self.priors,
            "constraints": self.constraints,
        }
        self.findings = find(self.input if problem is None else problem, **{**given, **known})

    # Report and write

    def write(self, path: str, save: Callable[[str], Any]) -> Any:
        """Write a file; return what the function that writes it returns."""
        self.progress.stage(f"writing {shown(path)}")
        return save(path)

    def page(self, writer: str, found: Any, *more: Any, **known: Any) -> None:
        """Write the page on a result by a function with this name, if the command line asks."""
        path = self.arguments.html
        if path is not None:
            self.write(path, lambda _: resolve(writer)(found, path, *more, **known))

    def end(self, code: int, complaint: str = "") -> None:
        """Set the exit code, and the line on standard error if standard output has only JSON."""
        self.code, self.complaint = code, complaint

    @contextmanager
    def timing(self, stage: str) -> Iterator[None]:
        """Measure the time of a stage."""
        begun = perf_counter()
        yield
        self.times[stage] = perf_counter() - begun

    @property
    def wall(self) -> float:
        """Seconds since the start of the run."""
        return perf_counter() - self._started

    def wall_time(self, solved: SolveRecord) -> WallTime:
        """Return the times of the stages of a run that solves."""
        from bundle.reports.terminal.solve_data import WallTime  # few commands solve

        return WallTime(
            **self.times,
            build=solved.build_time_in_seconds,
            solve=solved.solve_time_in_seconds,
            total=self.wall,
        )

    @property
    def asked(self) -> dict[str, Any]:
        """Values of the options of this way, and the rules."""
        named = {name: getattr(self.options, name) for name in _names(self._way) or ()}
        return named | rules_as_options(self.rules)

    @property
    def settings(self) -> dict[str, Any]:
        """Values of all options, rules and priors."""
        known = {} if self.georeference is None else self.georeference.changed()
        return {**self.options.asdict(), **rules_as_options(self.rules), **known}

    @property
    def flags(self) -> str:
        """Flags of rigs, positions, control points and rules, for `bundle refine`."""
        words: list[str] = []
        if self.arguments.rig_config is not None:
            words += ["--rig-config", self.arguments.rig_config]
        known = {} if self.georeference is None else self.georeference.changed()
        for name, value in {**known, **self.rules.changed()}.items():
            for one in value if isinstance(value, tuple | list) else (value,):
                words += [self.arguments.flags[name], str(one)]
        return shlex.join(words)

    @property
    def repeated(self) -> str:
        """Flags of this run that affect the model, for `bundle refine`."""
        return shlex.join(repeated_flags(self.arguments))

    def share(self, done: int, count: int, *_: Any) -> None:
        """Show how much of the call is done."""
        self.progress.share(done / count)


def _names(way: Way) -> tuple[str, ...] | None:
    found: tuple[str, ...] | None = resolve(way.names) if isinstance(way.names, str) else way.names
    return found


def _class(kind: str | type[Options]) -> type[Options]:
    return option_class(kind) if isinstance(kind, str) else kind


def given_flags(arguments: argparse.Namespace, names: Iterable[str]) -> Iterator[str]:
    """Yield the flags of these arguments that the command line has."""
    for name in names:
        if getattr(arguments, name, None) is not None:
            yield arguments.flags[name]


def refuse_others(command: Command, kind: str, arguments: argparse.Namespace) -> None:
    """Refuse flags of other kinds of INPUT."""
    way = command.way(kind)
    if way.accepts is None:
        return
    if way is not command.ways[Kind.RECONSTRUCTION]:
        names = _names(way) or (_class(way.options).names() if way.options else ())
        taken = {*_OF_ALL, *names, *way.accepts.split()}
        for name, value in vars(arguments).items():
            if name not in taken and value is not None and value is not False:
                flag = arguments.flags[name]
                raise InputError(f"{flag}: valid only with a reconstruction, found {kind}")
        return
    if "error" in arguments:  # the options of pose graphs
        for flag in given_flags(arguments, own_options("PoseGraphOptions", "SolveOptions")):
            raise InputError(f"{flag}: valid only with a pose graph, found a reconstruction")
    if Kind.SEQUENCE in command.ways:
        refuse_recording_flags(arguments)


def refuse_recording_flags(arguments: argparse.Namespace) -> None:
    """Refuse flags of images for other inputs."""
    for flag in given_flags(arguments, RECORDED):
        raise InputError(
            f"{flag}: valid only with images of a visual-inertial sequence, found an input without"
        )


def planned(run: Run, predicted: list[str]) -> Report:
    """Return the report of --dry-run, with sentences on the predicted cost."""
    from bundle.reports.terminal.inputs import about_input, input_facts  # for --dry-run only

    paths: dict[bool, list[str]] = {False: [], True: []}
    for one in run.arguments.paths:
        is_written = bool(one.kind.written) or one.argument == "output"
        if not is_written and run.detected != Kind.PYTHON:
            Path(one.path).stat()
        if one.path != run.source or is_written:
            paths[is_written].append(f"{one.name} {shown(one.path)}")
    options = shlex.join(repeated_flags(run.arguments))
    facts = [("reads", paths[False]), ("writes", paths[True]), ("flags", [options])]
    known = [] if run.input is None else input_facts(run.source, run.input)
    return Report(
        command="dry-run",
        input=None if run.input is None else about_input(run.source, run.input),
        headline=["Dry run: nothing was solved or written.", *predicted],
        sections=[Section(facts=[*known, *((name, "; ".join(x)) for name, x in facts if any(x))])],
        data={
            "run": run.arguments.command,
            "reads": paths[False],
            "writes": paths[True],
            "flags": options,
        },
    )


# Flags of this run that the next command of a finding repeats.
#
# The parser records the words that are values of a flag (``Parser.taken``), so no word is guessed
# to be INPUT, a flag or a value.

DROPPED = (
    *("output", "json", "html", "quiet", "verbose", "check_gradients"),
    *("reliability", "delta0", "config", "dry_run"),
    *("on", "without", "add", "count", "candidates", "bar_sigma"),
)
"""Arguments about the files and the output of a run, which do not affect the model."""
CHECKPOINTS = {"resume": "--checkpoint"}
"""A checkpoint belongs to the options of its run: the next run begins it anew."""


def repeated_flags(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Return the flags of a run with their values, without those about its output."""
    reads_images = any(
        row.from_photographs and getattr(arguments, row.source, None) == row.from_photographs
        for row in ROWS
    )
    dropped = DROPPED if reads_images else (*DROPPED, "images")
    words: dict[int | str, tuple[str, ...]] = {}
    for place, (action, values) in enumerate(arguments.taken):
        if not action.option_strings or action.dest in dropped:
            continue
        flag = CHECKPOINTS.get(action.dest, action.option_strings[-1])
        if isinstance(action, argparse.BooleanOptionalAction):
            flag = action.option_strings[0 if getattr(arguments, action.dest) else -1]
        # Only an argument that collects its values has an effect more than once.
        collects = isinstance(action, argparse._AppendAction)
        words[place if collects else flag] = _words(flag, values)
    return tuple(word for one in words.values() for word in one)


def _words(flag: str, values: list[str]) -> tuple[str, ...]:
    if len(values) == 1 and values[0].startswith("-"):
        return (f"{flag}={values[0]}",)
    return (flag, *values)
