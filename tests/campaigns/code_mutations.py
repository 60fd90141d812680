"""Mutations of the Python sources: does a test fail for each?

python -m tests.campaigns.code_mutations COUNT SEED PATH ... [--wide] [--tests FILE ...] [--list]

Draws COUNT lines of the files or folders PATH in python/bundle and one edit of each (a comparison,
a sign, an operator, a threshold ten times larger or smaller, a count one off, a term or a condition
dropped, arguments or arrays exchanged, max for min, a statement dropped). Applies one at a time in
place and runs the test files that import the module or have its name; with --wide also its mirror
folder and the test files of modules that import it. Each line is a mutation with its verdict:
killed by which test, SURVIVED, or slow (no verdict within the limit). FILE may be any argument of
pytest, such as a test of a file. The sources are restored, also after Ctrl-C. A survivor is either
equivalent or a missing test.
"""

from __future__ import annotations

import argparse
import ast
import compileall
import contextlib
import itertools
import multiprocessing
import os
import random
import re
import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import pycolmap  # noqa: F401
import pytest
import scipy.optimize  # noqa: F401

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "python" / "bundle"
LIMIT_IN_SECONDS = 300

COMPARISONS = {
    **{ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "=="},
    **{ast.Is: "is not", ast.IsNot: "is", ast.In: "not in", ast.NotIn: "in"},
}
OPERATORS = {
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "/",
    ast.Div: "*",
    ast.BitAnd: "|",
    ast.BitOr: "&",
}
OTHERS = dict(
    pair
    for a, b in [
        ("min", "max"),
        ("minimum", "maximum"),
        ("nanmin", "nanmax"),
        ("argmin", "argmax"),
        ("all", "any"),
        ("sin", "cos"),
        ("mean", "sum"),
        ("zeros", "ones"),
        ("ceil", "floor"),
    ]
    for pair in [(a, b), (b, a)]
)
"""Functions, with or without np., that are taken for each other."""
TEXTS = {"_display", "asdict", "__repr__", "__all__"}
"""Functions of wording, which golden reports hold."""


@dataclass(frozen=True)
class Mutation:
    """An edit of a source: `old` between two offsets becomes `new`."""

    path: Path
    line: int
    begin: int
    end: int
    old: str
    new: str

    def __str__(self) -> str:
        """Return file, line and both texts, on one line."""
        old, new = (" ".join(text.split()) for text in (self.old, self.new))
        return f"{self.path.relative_to(PACKAGE)}:{self.line}: {old[:60]!r} -> {new[:60]!r}"


def candidates(path: Path) -> list[Mutation]:
    """Return all mutations of a source."""
    text = path.read_bytes()
    starts = list(itertools.accumulate(map(len, text.splitlines(keepends=True)), initial=0))

    def span(node: Any) -> tuple[int, int]:
        begin = starts[node.lineno - 1] + node.col_offset
        return begin, starts[node.end_lineno - 1] + node.end_col_offset

    def source(node: ast.AST) -> str:
        return text[slice(*span(node))].decode()

    return [
        Mutation(path, node.lineno, *span(node), source(node), new)  # type: ignore[attr-defined]
        for node, new in _edits(ast.parse(text), source)
    ]


def _edits(tree: ast.Module, source: Callable[[ast.AST], str]) -> Iterator[tuple[ast.AST, str]]:
    skipped = set(_unmeasured(tree))
    for node in ast.walk(tree):
        if node in skipped:
            continue
        match node:
            case ast.Compare(left, [operator], [right]) if type(operator) in COMPARISONS:
                other = COMPARISONS[type(operator)]
                yield node, f"({source(left)}) {other} ({source(right)})"
            case ast.BinOp(left, operator, right) if type(operator) in OPERATORS:
                other = OPERATORS[type(operator)]
                yield node, f"(({source(left)}) {other} ({source(right)}))"
                yield node, f"({source(left)})"
            case ast.BoolOp(operator, values):
                other = " or " if isinstance(operator, ast.And) else " and "
                yield node, "(" + other.join(f"({source(value)})" for value in values) + ")"
                yield values[-1], repr(isinstance(operator, ast.And))
            case ast.UnaryOp(ast.Not() | ast.USub() | ast.Invert(), operand):
                yield node, f"({source(operand)})"
            case ast.Constant(value) if type(value) is int:
                yield node, str(value + 1)
                yield node, str(value - 1)
            case ast.Constant(value) if type(value) is float:
                yield node, repr(value * 10 if value else 1.0)
                yield node, repr(value / 10)
            case ast.Constant(value) if type(value) is bool:
                yield node, repr(not value)
            case ast.If(test) | ast.IfExp(test):
                yield test, f"(not ({source(test)}))"
            case ast.AugAssign() | ast.Assign(targets=[ast.Subscript()]):
                yield node, "pass"
            case ast.Expr(ast.Call()):
                yield node, "pass"
        match node:
            case ast.Call(ast.Name(name) | ast.Attribute(attr=name) as function) if name in OTHERS:
                yield function, re.sub(rf"{name}$", OTHERS[name], source(function))
        match node:
            case ast.Call(function, [ast.expr() as first, ast.expr() as second, *_]) if (
                source(function).split(".")[-1] not in OTHERS
                and not isinstance(first, ast.Constant)
                and not isinstance(second, ast.Constant)
            ):
                one, other = source(first), source(second)
                before, _, rest = source(node).removeprefix(source(function)).partition(one)
                between, _, after = rest.partition(other)
                yield node, source(function) + before + other + between + one + after
        match node:
            case ast.Assign(value=value) | ast.Return(value=ast.expr() as value):
                inner = list(ast.walk(value))
                called = [one.func for one in inner if isinstance(one, ast.Call)]
                owners = [one.value for one in inner if isinstance(one, ast.Attribute)]
                names = [
                    one for one in inner if isinstance(one, ast.Name) and one not in called + owners
                ]
                for name, other in itertools.pairwise([*names, *names[:1]]):
                    if name.id != other.id:
                        yield name, other.id


def _unmeasured(tree: ast.Module) -> Iterator[ast.AST]:
    """Yield nodes of annotations, messages, docstrings and texts."""
    for node in ast.walk(tree):
        parts: list[ast.AST | None] = []
        match node:
            case ast.Raise() | ast.JoinedStr() | ast.Import() | ast.ImportFrom() | ast.Assert():
                parts = [node]
            case ast.AnnAssign():
                parts = [node.annotation]
            case ast.arg():
                parts = [node.annotation]
            case ast.FunctionDef():
                parts = [node.returns]
                parts += [node] if node.name in TEXTS else node.decorator_list
            case ast.ClassDef():
                parts = list(node.decorator_list)
            case ast.If(test=ast.Name(id="TYPE_CHECKING")):
                parts = [node]
            case ast.Module(body=body):
                parts = [line for line in body if _is_type(line)]
            case ast.Call(func=ast.Name(id="zip")):
                parts = list(node.keywords)
        for part in parts:
            if part is not None:
                yield from ast.walk(part)


def _is_type(line: ast.stmt) -> bool:
    match line:
        case ast.Assign(value=ast.Subscript() | ast.BinOp(op=ast.BitOr())):
            return True
    return False


def seen_by(path: Path, wide: bool = False) -> list[str]:
    """Return the test files that import a module or have its name; `wide` as at the head."""

    def importing(path: Path, folder: Path) -> set[Path]:
        *package, name = path.relative_to(PACKAGE.parent).with_suffix("").parts
        dotted = re.escape(".".join(package))
        uses = re.compile(rf"\b{dotted}\.{name}\b|from {dotted} import (\([^)]*|[^\n]*)\b{name}\b")
        return {file for file in folder.rglob("*.py") if uses.search(file.read_text())}

    mirror = ROOT / "tests" / path.relative_to(PACKAGE).parent
    near = importing(path, ROOT / "tests") | set(mirror.glob(f"test_*{path.stem}*.py"))
    if wide or not near:
        near |= set(mirror.glob("test_*.py"))
    if wide:
        for user in importing(path, PACKAGE):
            near |= importing(user, ROOT / "tests")
    kept = [one for one in near if one.name.startswith("test_") and "campaigns" not in one.parts]
    return sorted(str(one.relative_to(ROOT)) for one in kept)


def verdict(mutation: Mutation, tests: list[str]) -> str:
    """Apply a mutation, run the tests, restore the source and its time."""
    if not tests:  # pytest would run all
        return "SURVIVED"
    original, stat = mutation.path.read_bytes(), mutation.path.stat()
    mutated = original[: mutation.begin] + mutation.new.encode() + original[mutation.end :]
    compile(mutated, mutation.path, "exec")
    context = multiprocessing.get_context("fork")
    reader, writer = context.Pipe(duplex=False)
    child = context.Process(target=_run, args=(tests, writer))
    try:
        mutation.path.write_bytes(mutated)
        child.start()
        writer.close()
        if not reader.poll(LIMIT_IN_SECONDS):
            return "slow"
        return str(reader.recv())
    except EOFError:
        return f"killed, exit code {child.exitcode}"
    finally:
        mutation.path.write_bytes(original)
        os.utime(mutation.path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
        if child.pid:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)
            child.join()


def _run(tests: list[str], verdict: Connection) -> None:
    """Run tests in a process group of its own; write no bytecode of a mutation."""
    os.setsid()
    sys.dont_write_bytecode = True
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    failed: list[str] = []

    class Listener:
        def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
            if report.failed:
                failed.append(report.nodeid)

        def pytest_collectreport(self, report: pytest.CollectReport) -> None:
            if report.failed:
                failed.append(report.nodeid)

    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    code = pytest.main(["-x", "-q", "-p", "no:cacheprovider", *tests], plugins=[Listener()])
    is_silent = code in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)
    verdict.send("SURVIVED" if is_silent else f"killed {failed[0] if failed else code}")
    os._exit(0)


def main() -> int:
    """Run as the head of the file says; exit 1 if one survived."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("seed", type=int)
    parser.add_argument("paths", nargs="+")
    parser.add_argument("--wide", action="store_true")
    parser.add_argument("--tests", nargs="*")
    parser.add_argument("--list", action="store_true", help="only print what would be applied")
    given = parser.parse_args()
    places = [PACKAGE / path for path in given.paths]
    files = sorted({file for at in places for file in ([at] if at.is_file() else at.rglob("*.py"))})
    by_line: dict[tuple[Path, int], list[Mutation]] = {}
    for edit in (edit for path in files for edit in candidates(path)):
        by_line.setdefault((edit.path, edit.line), []).append(edit)
    rng = random.Random(given.seed)
    lines = rng.sample(sorted(by_line), min(given.count, len(by_line)))
    drawn = [rng.choice(by_line[line]) for line in lines]
    verdicts = []
    compileall.compile_dir(PACKAGE, quiet=2)  # children write no bytecode, and would compile it all
    for mutation in drawn:
        tests = given.tests or seen_by(mutation.path, given.wide)
        verdicts.append("listed" if given.list else verdict(mutation, tests))
        print(f"{verdicts[-1]} | {mutation}", flush=True)
    killed = sum(one.startswith("killed") for one in verdicts)
    print(f"{killed} of {len(verdicts)} killed, drawn from {len(by_line)} lines")
    return int("SURVIVED" in verdicts)


if __name__ == "__main__":
    sys.exit(main())
