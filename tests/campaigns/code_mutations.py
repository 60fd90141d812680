"""Mutations of the Python sources: does a test fail for each?

python -m tests.campaigns.code_mutations PACKAGE COUNT [SEED] [--tests FOLDER ...]

Draws COUNT edits of python/bundle/PACKAGE (a comparison, a sign, a constant, a condition, a
statement dropped), each in a file drawn by its number of candidates, applies one at a time in place
and runs the tests of the package (tests/PACKAGE unless named). Each line is a mutation with its
verdict: killed, SURVIVED, or slow (no verdict within the limit). The sources are restored, also
after Ctrl-C. A survivor is either equivalent or a missing test.
"""

from __future__ import annotations

import argparse
import ast
import random
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "python" / "bundle"
LIMIT_IN_SECONDS = 900

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
    text = path.read_text()
    starts = [0]
    for line in text.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    encoded = text.encode()

    def at(line: int, column: int) -> int:
        return starts[line - 1] + column

    def edit(node: ast.AST, new: str) -> Mutation:
        begin = at(node.lineno, node.col_offset)  # type: ignore[attr-defined]
        end = at(node.end_lineno, node.end_col_offset)  # type: ignore[attr-defined]
        return Mutation(path, node.lineno, begin, end, encoded[begin:end].decode(), new)  # type: ignore[attr-defined]

    return [edit(node, new) for node, new in _edits(ast.parse(text), text)]


def _edits(tree: ast.Module, text: str) -> Iterator[tuple[ast.AST, str]]:
    skipped = set(_unmeasured(tree))

    def source(node: ast.AST) -> str:
        found = ast.get_source_segment(text, node)
        assert found is not None
        return found

    for node in ast.walk(tree):
        if node in skipped:
            continue
        match node:
            case ast.Compare(left, [operator], [right]) if type(operator) in COMPARISONS:
                other = COMPARISONS[type(operator)]
                yield node, f"{source(left)} {other} {source(right)}"
            case ast.BinOp(left, operator, right) if type(operator) in OPERATORS:
                other = OPERATORS[type(operator)]
                yield node, f"({source(left)}) {other} ({source(right)})"
            case ast.BoolOp(operator, values):
                other = " or " if isinstance(operator, ast.And) else " and "
                yield node, "(" + other.join(f"({source(value)})" for value in values) + ")"
            case ast.UnaryOp(ast.Not() | ast.USub() | ast.Invert(), operand):
                yield node, f"({source(operand)})"
            case ast.Constant(value) if type(value) is int:
                yield node, str(value + 1)
            case ast.Constant(value) if type(value) is float:
                yield node, repr(value * 2 if value else 1.0)
            case ast.Constant(value) if type(value) is bool:
                yield node, repr(not value)
            case ast.If(test) | ast.IfExp(test):
                yield test, f"(not ({source(test)}))"
            case ast.AugAssign() | ast.Assign(targets=[ast.Subscript()]):
                yield node, "pass"
            case ast.Expr(ast.Call()):
                yield node, "pass"


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


def verdict(mutation: Mutation, tests: list[str]) -> str:
    """Apply a mutation, run the tests, restore the source."""
    original = mutation.path.read_bytes()
    mutated = original[: mutation.begin] + mutation.new.encode() + original[mutation.end :]
    try:
        ast.parse(mutated)
        mutation.path.write_bytes(mutated)
        command = [
            sys.executable,
            "-B",
            "-m",
            "pytest",
            "-x",
            "-q",
            "-p",
            "no:cacheprovider",
            *tests,
        ]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, timeout=LIMIT_IN_SECONDS)
        return "SURVIVED" if done.returncode == 0 else "killed"
    except subprocess.TimeoutExpired:
        return "slow"
    finally:
        mutation.path.write_bytes(original)


def main() -> int:
    """Run as the head of the file says; exit 1 if one survived."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("package")
    parser.add_argument("count", type=int)
    parser.add_argument("seed", type=int, nargs="?", default=0)
    parser.add_argument("--tests", nargs="*")
    given = parser.parse_args()
    found = [
        edit for path in sorted((PACKAGE / given.package).glob("*.py")) for edit in candidates(path)
    ]
    drawn = random.Random(given.seed).sample(found, min(given.count, len(found)))
    verdicts = []
    for mutation in drawn:
        verdicts.append(verdict(mutation, given.tests or [f"tests/{given.package}"]))
        print(f"{verdicts[-1]:8s} {mutation}", flush=True)
    print(f"{verdicts.count('killed')} of {len(verdicts)} killed, of {len(found)} candidates")
    return int("SURVIVED" in verdicts)


if __name__ == "__main__":
    sys.exit(main())
