"""Steps to the minimum, for several rules of the trust region radius.

BUNDLE_DATA=... python -m tests.campaigns.steps COUNT OUTPUT.jsonl

COUNT seeded problems (step_problems.py) and, with BUNDLE_DATA, every real one are solved at the
default tolerances: by Ceres' rule, from other initial radii, and by rules that trust good steps
more. OUTPUT has a line of JSON per problem; a campaign that was stopped goes on with the same
command. The table compares each rule with Ceres'.

A step costs a linear solve; the step that meets a tolerance counts, although it is not taken. The
time of a step does not depend on its damping, so that ratios of steps are ratios of time. Rules
other than an initial radius are solves of one iteration each by a :class:`bundle.Solver`, whose
initial radius the rule chooses. The rules are

- threefold: Ceres' rule (cpp/core/minimize/levenberg_marquardt.cpp).
- hundredfold: R becomes 100 R after a step with |1 - t| < 0.1, where t is the quality of the step
  (actual over predicted decrease); otherwise as threefold.
- trusting: R = b R_c, where R_c follows Ceres' rule and the boost b starts at 1. A step with
  |1 - t| < 0.03 multiplies b by 30. After a step with |1 - t| > 1/4, b does not grow any more. A
  rejected step ends the trust, too: b = 1 again, so that the next step is that of R_c.
- damped end: trusting with b R_c <= 1e7, and a boosted step that meets the tolerance after the
  trust has ended is not the end: the solve continues with R_c.

All depend on t alone, so that neither units, nor the scale of the scene, nor the order of images
and points matters.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import bundle
from tests.campaigns import step_problems
from tests.campaigns.step_problems import Case

MAX_STEPS = 100
LARGEST_RADIUS = 1e16
CLOSE = 1e-5  # relative distance from the best known cost
WORSE = 1e-7


class Threefold:
    """Ceres' rule."""

    boost = 1.0

    def __init__(self) -> None:
        self.calm, self._shrink = 1e4, 2.0

    @property
    def radius(self) -> float:
        """Radius of the next step."""
        return min(self.boost * self.calm, LARGEST_RADIUS)

    def accepted(self, quality: float) -> None:
        """Take note of a step that was taken."""
        self.calm = min(self.calm / max(1 / 3, 1 - (2 * quality - 1) ** 3), LARGEST_RADIUS)
        self._shrink = 2.0

    def rejected(self) -> None:
        """Take note of a step that was not taken."""
        self.calm /= self._shrink
        self._shrink *= 2

    def goes_on(self) -> bool:
        """Return whether to continue although a tolerance is met."""
        return False


class Hundredfold(Threefold):
    """A hundredfold radius after good steps."""

    def accepted(self, quality: float) -> None:
        """Grow."""
        before = self.calm
        super().accepted(quality)
        if abs(1 - quality) < 0.1:
            self.calm = min(100 * before, LARGEST_RADIUS)


class Trusting(Threefold):
    """A boost of Ceres' radius, until a step disappoints."""

    limit, ends_calmly = LARGEST_RADIUS, False

    def __init__(self) -> None:
        super().__init__()
        self._trusts = True

    def accepted(self, quality: float) -> None:
        """Boost more, or no more."""
        super().accepted(quality)
        error = abs(1 - quality)
        self._trusts = self._trusts and error <= 0.25
        if self._trusts and error < 0.03:
            self.boost *= 30
        self.boost = max(1.0, min(self.boost, self.limit / self.calm))

    def rejected(self) -> None:
        """Return to Ceres' radius."""
        self._trusts = False
        if self.boost == 1:
            super().rejected()
        self.boost = 1.0

    def goes_on(self) -> bool:
        """Continue with Ceres' radius after a loss of trust."""
        if not self.ends_calmly or self._trusts or self.boost == 1:
            return False
        self.boost = 1.0
        return True


class DampedEnd(Trusting):
    """As Trusting, with a limit, and a calm end."""

    limit, ends_calmly = 1e7, True


RULES: dict[str, Callable[[], Threefold] | float] = {
    "1e4": 1e4,
    "1e5": 1e5,
    "1e6": 1e6,
    "threefold": Threefold,
    "hundredfold": Hundredfold,
    "trusting": Trusting,
    "damped end": DampedEnd,
}
"""An initial radius under Ceres' rule, or a rule."""
REFERENCE = "1e4"


class Trace(NamedTuple):
    """Costs of the states of a solve: after each linear solve, the lowest so far."""

    costs: list[float]
    converged: bool

    @property
    def num_steps(self) -> int:
        """Number of linear solves."""
        return len(self.costs) - 1

    def steps_to(self, cost: float) -> float:
        """Return the number of linear solves to a cost, infinite if it is not reached."""
        reached = [step for step, found in enumerate(self.costs) if found <= cost]
        return reached[0] if reached else math.inf


def solve(case: Case, rule: Callable[[], Threefold] | float) -> Trace:
    """Solve a problem by a rule."""
    settings = {"num_threads": 1, "check_solution": False, **case.options}
    if callable(rule):
        return _by_rule(case, rule(), settings)
    result = bundle.solve(
        case.problem,
        initial_trust_region_radius=rule,
        max_num_iterations=MAX_STEPS,
        **settings,
    )
    accepted = np.asarray(result.iterations["step_is_successful"], bool)
    costs = np.minimum.accumulate(np.where(accepted, result.iterations["cost"], np.inf)).tolist()
    converged = result.summary.termination_type == "CONVERGENCE"
    untaken = converged and "tolerance" in result.summary.message.split(".")[0]
    untaken = untaken and not result.summary.message.startswith("Gradient")
    return Trace(costs + costs[-1:] * untaken, converged)


def _by_rule(case: Case, rule: Threefold, settings: dict[str, Any]) -> Trace:
    solver = bundle.Solver(case.problem, **settings)
    problem, costs, converged = case.problem, [], False
    while len(costs) <= MAX_STEPS and not converged:
        result = solver.solve(
            problem, max_num_iterations=1, initial_trust_region_radius=rule.radius
        )
        iterations, message = result.iterations, result.summary.message
        costs = costs or [float(iterations["cost"][0])]
        if len(iterations["cost"]) == 2:
            is_taken = bool(iterations["step_is_successful"][1])
            costs.append(float(iterations["cost"][1]) if is_taken else costs[-1])
            if is_taken:
                rule.accepted(float(iterations["relative_decrease"][1]))
                problem = result.problem
            else:
                rule.rejected()
            converged = message.startswith("Gradient")
        elif result.summary.termination_type == "CONVERGENCE":
            if not message.startswith("Gradient"):
                costs.append(costs[-1])
            converged = not rule.goes_on()
        else:
            break
    return Trace(costs, converged)


Rules = Sequence[str]


def campaign(cases: Iterable[Case], rules: Rules = tuple(RULES)) -> dict[str, dict[str, Trace]]:
    """Solve each problem by each rule; {name of the problem: {name of the rule: trace}}."""
    return {case.name: {rule: solve(case, RULES[rule]) for rule in rules} for case in cases}


def comparison(found: dict[str, dict[str, Trace]], rule: str, reference: str = REFERENCE):
    """Return the row of a rule, over the problems that the reference solves to convergence."""
    pairs = [(by[reference], by[rule], by) for by in found.values() if by[reference].converged]
    counts = np.array([(one.num_steps, other.num_steps) for one, other, _ in pairs], float)
    close = np.array(
        [
            [max(trace.steps_to(limit), 1) for trace in (one, other)]
            for one, other, by in pairs
            for limit in [(1 + CLOSE) * min(trace.costs[-1] for trace in by.values())]
        ],
        float,
    )
    both = np.isfinite(close).all(axis=1)
    change = np.array([other.costs[-1] / one.costs[-1] - 1 for one, other, _ in pairs])
    ratio = np.exp(np.log(close[both, 1] / close[both, 0]).mean()) if both.any() else math.nan
    return [
        rule,
        f"{np.median(counts[:, 1]):g}",
        f"{np.exp(np.log(counts[:, 1] / counts[:, 0]).mean()):.2f}",
        f"{ratio:.2f}",
        f"{(counts[:, 1] > counts[:, 0]).sum()}",
        f"{(change > WORSE).sum()}",
        f"{change.max():.1e}",
        f"{(change < -WORSE).sum()}",
    ]


COLUMNS = (
    "rule",
    "median steps",
    "steps / 1e4's",
    "to 1e-5 / 1e4's",
    "more steps",
    "cost worse",
    "worst",
    "cost better",
)


def recorded(path: Path) -> dict[str, dict[str, dict[str, Trace]]]:
    """Return what a file of records holds: {group: what `campaign` returns}."""
    found: dict[str, dict[str, dict[str, Trace]]] = {}
    for line in path.read_text().splitlines() if path.exists() else ():
        record = json.loads(line)
        traces = {rule: Trace(**trace) for rule, trace in record["traces"].items()}
        found.setdefault(record["group"], {})[record["name"]] = traces
    return found


def main() -> int:
    """Solve what OUTPUT does not hold yet, and print a table of seeded and of real problems."""
    count, output = int(sys.argv[1]), Path(sys.argv[2])
    data = os.environ.get("BUNDLE_DATA")
    groups = {"real": step_problems.real(Path(data))} if data else {}
    known = recorded(output)
    with output.open("a") as file:
        for group, cases in {**groups, "seeded": step_problems.seeded(count)}.items():
            for case in cases:
                if case.name in known.get(group, {}):
                    continue
                traces = {
                    rule: trace._asdict() for rule, trace in campaign([case])[case.name].items()
                }
                record = {"group": group, "name": case.name, "traces": traces}
                print(json.dumps(record), file=file, flush=True)
    for group, traces in recorded(output).items():
        converged = sum(by[REFERENCE].converged for by in traces.values())
        print(f"{group}: {len(traces)} problems, {converged} of which {REFERENCE} solves")
        print(*COLUMNS, sep=" | ")
        for rule in RULES:
            print(*comparison(traces, rule), sep=" | ")
    return 0


if __name__ == "__main__":
    sys.exit(main())
