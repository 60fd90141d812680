"""Every combination of options that the command line lets through ends in a result or a refusal.

The product of solver, ordering, preconditioner and trust region is complete by each backend, each
of its members on two of the six scenes of option_driver.py; the other options are drawn anew for
each, seeded, so that every pair of values occurs. The solves run in processes of their own: an
abort inside a solver would take the tests along.
"""

import dataclasses
import itertools
import json
import math
import random
import subprocess
import sys
from pathlib import Path

import pytest

from bundle.interface.options import (
    CHEIRALITIES,
    GAUGES,
    LINEAR_SOLVER_TYPES,
    LOSSES,
    ORDERINGS,
    PRECONDITIONER_TYPES,
    REFINABLE,
    TRUST_REGION_STRATEGIES,
    SolveOptions,
)
from tests.cli.conftest import environment
from tests.cli.option_driver import SCENES
from tests.solving.solve.problems import FUSED_SOLVERS

REPOSITORY = Path(__file__).parents[2]
FIELDS = {field.name for field in dataclasses.fields(SolveOptions)}
SUBSETS = [
    ",".join(subset)
    for size in range(len(REFINABLE) + 1)
    for subset in itertools.combinations(REFINABLE, size)
]
DRAWN = {
    "--loss": LOSSES,
    "--gauge": GAUGES,
    "--cheirality": CHEIRALITIES,
    "--refine": SUBSETS,
    "--threads": ("1", "2", "0"),
    "--deterministic": (),
    "--max-iterations": ("0", "1", "4"),
    "--function-tolerance": ("1e-6", "0", "1e300"),
    "--loss-scale": ("1", "1e-12", "1e150"),
    "--no-check-solution": (),
}


def one_or_all(ids):
    return str(ids[0]), ",".join(map(str, ids))


def combinations(name, backend):
    """A third of the products of the four choices about the linear algebra, the rest drawn."""
    draw = random.Random(f"options of {name}")
    first = list(SCENES).index(name)
    problem = SCENES[name]()
    drawn = DRAWN | {
        "--fix-images": one_or_all(problem.image_ids),
        "--fix-cameras": one_or_all(problem.camera_ids),
        "--fix-points": one_or_all(problem.point_ids),
    }
    choices = (
        LINEAR_SOLVER_TYPES,
        ORDERINGS,
        ("auto", *PRECONDITIONER_TYPES),
        TRUST_REGION_STRATEGIES,
    )
    for *numbers, repetition in itertools.product(*(range(len(c)) for c in choices), range(4)):
        # Any three of them together: the fourth goes through its values from scene to scene.
        if (sum(numbers) + first) % 3:
            continue
        solver, ordering, preconditioner, region = (
            choice[n] for choice, n in zip(choices, numbers, strict=True)
        )
        # The fused backend refuses most; what it takes, it is asked more often.
        takes = solver in FUSED_SOLVERS and ordering == "points_first"
        if repetition > 0 and not (backend == "fused" and takes):
            continue
        flags = ["--solver", solver, "--ordering", ordering, "--preconditioner", preconditioner]
        flags += ["--trust-region", region, "--backend", backend]
        # Half of the draws keep an option at its default, so that solves also get somewhere.
        for flag, values in drawn.items():
            value = [draw.choice(values)] if values else []
            if draw.random() < 0.5:
                flags += [flag, *value]
        yield without_idle_scale(flags)


def without_idle_scale(flags):
    """Leave out the scale of a loss that has none: it is refused, as test_idle_options holds."""
    loss = flags[flags.index("--loss") + 1] if "--loss" in flags else "trivial"
    if "--loss-scale" not in flags or loss != "trivial":
        return flags
    at = flags.index("--loss-scale")
    return flags[:at] + flags[at + 2 :]


def run(sets):
    """Return the answers of the driver, or fail naming the set that ended it."""
    lines = "".join(json.dumps(one) + "\n" for one in sets)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "tests.cli.option_driver"],
            cwd=REPOSITORY, env=environment(), input=lines, capture_output=True, text=True,
            timeout=120, check=False,
        )  # fmt: skip
        out, err, code = done.stdout, done.stderr, done.returncode
    except subprocess.TimeoutExpired as late:
        out, err, code = (late.stdout or b"").decode(), "", "a hang"
    answers = [json.loads(line) for line in out.splitlines()]
    if code != 0:
        culprit = max((entry["begins"] for entry in answers if "begins" in entry), default=None)
        words = sets[culprit] if culprit is not None else "before the first"
        pytest.fail(f"ended by {code} at: {words}\n{err[-2000:]}")
    return [entry for entry in answers if "begins" not in entry]


def test_no_combination_aborts(backend):
    sets = [(name, flags) for name in SCENES for flags in combinations(name, backend)]
    answers = run(sets)
    assert len(answers) == len(sets)
    for name in SCENES:
        of = [(flags, a) for (of, flags), a in zip(sets, answers, strict=True) if of == name]
        check(name, backend, of)


def check(name, backend, answered):
    solved = 0
    for flags, answer in answered:
        if "refused" in answer:
            # The options are to blame, not what a solve made of the problem.
            assert answer["refused"].partition(":")[0] in FIELDS, (flags, answer)
            assert "\n" not in answer["refused"], flags
            continue
        assert answer["words"], flags
        if answer["usable"]:
            solved += 1
            assert math.isfinite(answer["final"]), flags
            assert answer["final"] <= answer["initial"] * (1 + 1e-9), flags
    # Refusing everything would be no answer either. The fused backend takes half of the solvers in
    # one of three orders, and needs points and cameras to refine.
    share = 4 if backend == "ceres" else 15
    if name == "one image":
        share *= 2  # its points are no reconstruction unless some are held
    assert solved > len(answered) / share
