"""Steps to the minimum, for several rules of the trust region radius.

BUNDLE_DATA=... python -m tests.campaigns.steps COUNT OUTPUT.jsonl [FIRST_SEED]

COUNT seeded problems (step_problems.py) and, with BUNDLE_DATA, every real one are solved at the
default tolerances: by Ceres' rule, from other initial radii, and by rules that trust good steps
more. OUTPUT has a line of JSON per problem; a campaign that was stopped goes on with the same
command. The table compares each rule with Ceres'.

A step costs a linear solve; the step that meets a tolerance counts, although it is not taken. The
time of a step does not depend on its damping, so that ratios of steps are ratios of time. Rules
other than an initial radius are solves of one iteration each by a :class:`bundle.Solver`, whose
initial radius the rule chooses. Each restart decides again which observations count, so that these
rules are compared with "threefold", Ceres' rule by restarts. With t, the quality of a step (actual
over predicted decrease):

- threefold: Ceres' rule (cpp/core/minimize/levenberg_marquardt.cpp).
- hundredfold: R becomes 100 R after a step with |1 - t| < 0.1; otherwise as threefold.
- trusting: R = b R_c, where R_c follows Ceres' rule and the boost b starts at 1. A step with
  |1 - t| < 0.03 multiplies b by 30. After a step with |1 - t| > 1/4, b does not grow any more. A
  rejected step ends the trust, too: b = 1 again, so that the next step is that of R_c.
- last step: trusting; and a step that changes the cost by 1e-7 to 1e-6 of it, which meets the
  tolerance, is taken before the solve ends. It ends there only if |1 - t| < 1/4.
- gradual: last step, but a rejected step divides b by 30.
- cautious: gradual, if the first step has |1 - t| < 0.03; otherwise b stays 1.

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
TOLERANCE = 1e-6
POOR = 0.25
GROWTH = 30


class Threefold:
    """Ceres' rule."""

    boost, takes_last = 1.0, False

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

    def __init__(self) -> None:
        super().__init__()
        self._trusts = True

    def accepted(self, quality: float) -> None:
        """Boost more, or no more."""
        super().accepted(quality)
        error = abs(1 - quality)
        self._trusts = self._trusts and error < POOR
        if self._trusts and error < 0.03:
            self.boost *= GROWTH

    def rejected(self) -> None:
        """Return to Ceres' radius."""
        self._trusts = False
        if self.boost == 1:
            super().rejected()
        self.boost = 1.0


class LastStep(Trusting):
    """As Trusting, with the step that meets the tolerance."""

    takes_last = True


class Gradual(LastStep):
    """As LastStep, but trust ends gradually."""

    def rejected(self) -> None:
        """Return to the boost before the last step that was taken."""
        boost = max(1.0, self.boost / GROWTH)
        super().rejected()
        self.boost = boost


class Cautious(Gradual):
    """As Gradual, if the first step is good."""

    def accepted(self, quality: float) -> None:
        """Boost only after a good start."""
        super().accepted(quality)
        self._trusts = self._trusts and self.boost > 1


RULES: dict[str, Callable[[], Threefold] | float] = {
    "1e4": 1e4,
    "1e5": 1e5,
    "1e6": 1e6,
    "threefold": Threefold,
    "hundredfold": Hundredfold,
    "trusting": Trusting,
    "last step": LastStep,
    "gradual": Gradual,
    "cautious": Cautious,
}
"""An initial radius under Ceres' rule, or a rule."""


def reference_of(rule: str) -> str:
    """Return the name of Ceres' rule, executed like a rule."""
    return "threefold" if callable(RULES[rule]) else "1e4"


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
    tolerance = TOLERANCE / 10 if rule.takes_last else TOLERANCE
    while len(costs) <= MAX_STEPS and not converged:
        result = solver.solve(
            problem,
            max_num_iterations=1,
            initial_trust_region_radius=rule.radius,
            function_tolerance=tolerance,
        )
        iterations, message = result.iterations, result.summary.message
        costs = costs or [float(iterations["cost"][0])]
        if len(iterations["cost"]) == 2:
            is_taken = bool(iterations["step_is_successful"][1])
            costs.append(float(iterations["cost"][1]) if is_taken else costs[-1])
            converged = message.startswith("Gradient")
            if is_taken:
                quality = float(iterations["relative_decrease"][1])
                rule.accepted(quality)
                problem = result.problem
                # Other observations may count than in the solve before.
                is_small = bool(np.ptp(iterations["cost"]) <= TOLERANCE * iterations["cost"][0])
                converged = converged or (is_small and abs(1 - quality) < POOR)
            else:
                rule.rejected()
        elif result.summary.termination_type == "CONVERGENCE":
            if not message.startswith("Gradient"):
                costs.append(costs[-1])
            converged = True
        else:
            break
    return Trace(costs, converged)


Rules = Sequence[str]


def campaign(cases: Iterable[Case], rules: Rules = tuple(RULES)) -> dict[str, dict[str, Trace]]:
    """Solve each problem by each rule; {name of the problem: {name of the rule: trace}}."""
    return {case.name: {rule: solve(case, RULES[rule]) for rule in rules} for case in cases}


def comparison(found: dict[str, dict[str, Trace]], rule: str):
    """Return the row of a rule, over the problems that its reference solves to convergence."""
    reference = reference_of(rule)
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
    "steps / Ceres'",
    "to 1e-5 / Ceres'",
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
        found.setdefault(record["group"], {}).setdefault(record["name"], {}).update(traces)
    return found


def main() -> int:
    """Solve what OUTPUT does not hold yet, and print a table of seeded and of real problems."""
    count, output = int(sys.argv[1]), Path(sys.argv[2])
    first = int(sys.argv[3]) if len(sys.argv) > 3 else 0
    data = os.environ.get("BUNDLE_DATA")
    groups = {"real": step_problems.real(Path(data))} if data else {}
    known = recorded(output)
    with output.open("a") as file:
        for group, cases in {**groups, "seeded": step_problems.seeded(count, first)}.items():
            for case in cases:
                missing = [
                    rule for rule in RULES if rule not in known.get(group, {}).get(case.name, {})
                ]
                if not missing:
                    continue
                found = campaign([case], missing)[case.name]
                traces = {rule: trace._asdict() for rule, trace in found.items()}
                record = {"group": group, "name": case.name, "traces": traces}
                print(json.dumps(record), file=file, flush=True)
    for group, traces in recorded(output).items():
        converged = sum(by["1e4"].converged for by in traces.values())
        print(f"{group}: {len(traces)} problems, {converged} of which converge from 1e4")
        print(*COLUMNS, sep=" | ")
        for rule in RULES:
            print(*comparison(traces, rule), sep=" | ")
    return 0


if __name__ == "__main__":
    sys.exit(main())
