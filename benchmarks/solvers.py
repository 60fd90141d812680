"""Which solvers take part, and which kinds of problem each can be given."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Solver:
    """A row of the tables: a runner module and the name of a solver within it."""

    runner: str
    solver: str
    reason_not_colmap: str = ""

    @property
    def name(self) -> str:
        """Return what rows and --solvers call it, such as "pycolmap dense-schur"."""
        return f"{self.runner.rstrip('_')} {self.solver}"

    def reason_against(self, kind: str) -> str:
        """Return why this solver is not given problems of this kind; "" if it is."""
        return self.reason_not_colmap if kind == "colmap" else ""


_SCHUR = ("auto", "dense-schur", "sparse-schur", "iterative-schur")

# The first is what the others are compared with.
SOLVERS = (
    *(Solver("bundle_", solver) for solver in _SCHUR),
    *(Solver("pycolmap_", solver) for solver in _SCHUR),
    Solver("gtsam_", "lm", "Cal3Bundler has no camera shared by images, no OPENCV distortion"),
    Solver("scipy_", "trf", "its residual function here knows BAL's camera only"),
)
REFERENCE = SOLVERS[0].name


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
