"""Plugin of pytest: the Jacobians of a project's factors, checked in its own suite.

``pytest --bundle-gradients`` checks the functions of every factor graph before it is solved, each
kind once in a run, and fails the test of a wrong one. The fixture ``check_gradients`` checks on
request, without the flag::

    def test_odometry(check_gradients):
        check_gradients(odometry, [x0, x1], ["se3", "se3"], tangent="manif")

pytest loads this module in every project where the package is installed. Therefore it imports the
package only where needed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from bundle.graphs.factors.factor_graph import FactorGraph

FLAG = "--bundle-gradients"

Check = Callable[..., Any]


class _Checks:
    """Kinds of factors checked in this run, by the verdict."""

    def __init__(self) -> None:
        self.seen: set[Any] = set()
        self.verdicts: Counter[str] = Counter()


_CHECKS = pytest.StashKey[_Checks]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare the flag."""
    parser.getgroup("bundle").addoption(
        FLAG,
        action="store_true",
        help="check the Jacobians of the functions of every bundle.FactorGraph before it is "
        "solved, each kind once, and fail the test of a wrong one",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Begin to count."""
    config.stash[_CHECKS] = _Checks()


@pytest.fixture
def check_gradients() -> Check:
    """Return ``bundle.check_gradients`` that fails the test unless all Jacobians are correct.

    With ``allow_undecided=True``, only wrong ones fail. The function returns the report.
    """

    def check(*arguments: Any, allow_undecided: bool = False, **settings: Any) -> Any:
        from bundle.graphs.factors import checks

        report = checks.check_gradients(*arguments, **settings)
        if report.verdict == "wrong" or not (report.ok or allow_undecided):
            pytest.fail(str(report), pytrace=False)
        return report

    return check


@pytest.fixture(autouse=True)
def _bundle_gradients(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Iterator[None]:
    """Check the functions of graphs before they are solved, if the flag is given."""
    if not request.config.getoption(FLAG):
        yield
        return
    from bundle.graphs.factors.factor_graph import FactorGraph
    from bundle.graphs.factors.problem_factors import ProblemFactors

    checks = request.config.stash[_CHECKS]
    solve, core = FactorGraph.solve, ProblemFactors.core

    def checked_solve(self: FactorGraph, *arguments: Any, **changes: Any) -> Any:
        _check(self, checks)
        return solve(self, *arguments, **changes)

    def checked_core(self: ProblemFactors) -> Any:
        _check(self.graph, checks)
        return core(self)

    monkeypatch.setattr(FactorGraph, "solve", checked_solve)
    monkeypatch.setattr(ProblemFactors, "core", checked_core)
    yield


def _check(graph: FactorGraph, checks: _Checks) -> None:
    """Check one factor of each new kind; fail the test of a wrong one."""
    from bundle.errors import InputError
    from bundle.graphs.factors.factor_check import kind_of

    new: dict[Any, Any] = {}
    for factor in graph.factors:
        if factor.kind == "function":
            new.setdefault(kind_of(factor, graph.variables), factor)
    new = {kind: factor for kind, factor in new.items() if kind not in checks.seen}
    if not new:
        return
    checks.seen |= set(new)
    try:
        found = graph.check_gradients(list(new.values()))
    except InputError:  # the solve reports it
        return
    checks.verdicts.update(group.verdict for group in found.groups)
    if found.verdict == "wrong":
        checks.seen -= set(new)  # every test with this mistake fails
        pytest.fail(str(found), pytrace=False)


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    """Print the number of checked kinds."""
    verdicts = config.stash[_CHECKS].verdicts
    if config.getoption(FLAG) and verdicts:
        counts = ", ".join(f"{count} {verdict}" for verdict, count in sorted(verdicts.items()))
        terminalreporter.write_line(f"Jacobians of functions of factor graphs, by kind: {counts}")
