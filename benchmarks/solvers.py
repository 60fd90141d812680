"""The solvers that take part, and the problems that each can be given."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.problems import BenchmarkProblem

# Above this many images a dense reduced camera system (9 rows an image) is nobody's choice: 1000
# images are 0.6 GB and 240 GFLOP a step.
MOST_IMAGES_DENSE = 1000
# What is not somebody's best, or is the same as another row, is tried up to here only.
_SMALL = 300_000
# A run of these takes several minutes beyond.
_MEDIUM = 2_000_000


@dataclass(frozen=True)
class Solver:
    """A row of the tables: a runner module, and what to ask it for.

    Attributes:
        runner: module in benchmarks/runners, without its trailing underscore the family's name.
        solver: linear solver, as the runner knows it.
        backend: of bundle: "auto", "fused" or "ceres"; "" for everybody else.
        reason_not_colmap: why it is not given COLMAP models; "" if it is.
        most_observations: above, a run is sure to end at the limits of time or memory.
    """

    runner: str
    solver: str
    backend: str = ""
    reason_not_colmap: str = ""
    most_observations: float = float("inf")

    @property
    def family(self) -> str:
        """Return whose solver it is, such as "pycolmap" or "ceres-example"."""
        return self.runner.rstrip("_").replace("_", "-")

    @property
    def name(self) -> str:
        """Return what rows and --solvers call it, such as "bundle fused dense-schur"."""
        if self.backend == "auto":
            return f"{self.family} {self.solver}"
        return " ".join(word for word in (self.family, self.backend, self.solver) if word)

    def reason_against(self, problem: BenchmarkProblem) -> str:
        """Return why this solver is not given a problem; "" if it is."""
        if problem.kind == "colmap" and self.reason_not_colmap:
            return self.reason_not_colmap
        if self.solver == "dense-schur" and problem.num_images > MOST_IMAGES_DENSE:
            return f"not tried with more than {MOST_IMAGES_DENSE} images"
        if problem.num_observations > self.most_observations:
            return f"not tried with more than {self.most_observations:,} observations"
        return ""


_SCHUR = ("dense-schur", "sparse-schur", "iterative-schur")

# The first is what the others are compared with.
SOLVERS = (
    Solver("bundle_", "auto", "auto"),
    Solver("bundle_", "auto", "fused", most_observations=_SMALL),
    *(Solver("bundle_", solver, "fused") for solver in _SCHUR),
    Solver("bundle_", "auto", "ceres"),
    Solver("bundle_", "dense-schur", "ceres"),
    Solver("bundle_", "sparse-schur", "ceres", most_observations=_MEDIUM),
    Solver("bundle_", "iterative-schur", "ceres", most_observations=_SMALL),
    Solver("pycolmap_", "auto", most_observations=_MEDIUM),
    *(Solver("pycolmap_", solver, most_observations=_SMALL) for solver in _SCHUR),
    *(
        Solver(
            "ceres_example",
            solver,
            reason_not_colmap="it reads BAL files only",
            most_observations=_MEDIUM if solver == "sparse-schur" else _SMALL,
        )
        for solver in _SCHUR
    ),
    Solver(
        "gtsam_",
        "lm",
        reason_not_colmap="Cal3Bundler has no camera shared by images, no OPENCV distortion",
        most_observations=_SMALL,
    ),
    Solver(
        "scipy_",
        "trf",
        reason_not_colmap="its residual function here knows BAL's camera only",
        most_observations=100_000,
    ),
)
REFERENCE = SOLVERS[0].name
PAIR = (REFERENCE, "pycolmap auto")

# Those whose time to a gap of 1e-8 is measured with the tight stopping rule.
TIGHT = ("bundle auto", "bundle ceres auto", "pycolmap auto", "ceres-example sparse-schur")
# Those that are run with one thread as well.
SCALED = ("bundle fused auto", "bundle ceres auto", "pycolmap auto")


def chosen(names: str) -> list[Solver]:
    """Return the solvers whose name, spaces as hyphens, begins with one of a comma-separated list.

    The reference is always among them.
    """
    wanted = tuple(name.strip().replace(" ", "-") for name in names.split(",") if name.strip())
    return [
        solver
        for solver in SOLVERS
        if solver.name == REFERENCE or solver.name.replace(" ", "-").startswith(wanted)
    ]
