"""Options of inspections and comparisons of solver methods."""

from __future__ import annotations

import dataclasses
from typing import Any

from bundle.base.arrays import at
from bundle.base.records import dataclass
from bundle.base.words import SHARE_OF_FREE_MEMORY, parse_size
from bundle.errors import InputError
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import checked, option
from bundle.interface.options import BACKENDS as EVERY_BACKEND
from bundle.interface.options import (
    LINEAR_SOLVER_TYPES,
    PRECONDITIONER_TYPES,
    TRUST_REGION_STRATEGIES,
)
from bundle.interface.options import ORDERINGS as EVERY_ORDERING

# Options of a comparison, with the defaults of :func:`bundle.compare`.
#
# The compared methods are all combinations of the values of six solve options (``COMPARED``).

__all__ = [
    "BACKENDS",
    "COMPARED",
    "LARGEST_PERTURBATION",
    "ORDERINGS",
    "PRECONDITIONERS",
    "REPEAT",
    "SECONDS_NOT_REPEATED",
    "SHARE_OF_FREE_MEMORY",
    "SOLVERS",
    "THREADS",
    "TIMEOUT",
    "TRUST_REGIONS",
    "CompareOptions",
]

BACKENDS = ("fused", "ceres")
SOLVERS = ("dense_schur", "sparse_schur", "iterative_schur")
PRECONDITIONERS = ("auto",)
ORDERINGS = ("points_first",)
TRUST_REGIONS = TRUST_REGION_STRATEGIES
THREADS = (0,)
REPEAT = 3  # number of runs of each method
TIMEOUT = 60.0  # seconds after which a solve is stopped
SECONDS_NOT_REPEATED = 10.0
"""Time in seconds above which a run is not repeated, because its spread is small."""
LARGEST_PERTURBATION = 0.5

COMPARED = {
    "backend": "backends",
    "linear_solver_type": "solvers",
    "linear_solver_ordering": "orderings",
    "preconditioner_type": "preconditioners",
    "trust_region_strategy_type": "trust_regions",
    "num_threads": "threads",
}
"""Options of a solve that are compared, with the arguments (and flags) that list their values."""


def _listed(
    default: tuple[str, ...], flag: str, words: str, choices: tuple[str, ...], use: int = 0
) -> Any:
    text = f"{words}out of {', '.join(choices).replace('_', '-')}"
    return option(default, flag, text, metavar="LIST", value="words", late=True, use=use)


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class CompareOptions(Options):
    """Options of ``bundle compare``."""

    solvers: tuple[str, ...] = _listed(SOLVERS, "--solvers", "", LINEAR_SOLVER_TYPES, use=3)
    backends: tuple[str, ...] = _listed(BACKENDS, "--backends", "", EVERY_BACKEND, use=4)
    preconditioners: tuple[str, ...] = _listed(
        PRECONDITIONERS,
        "--preconditioners",
        "for iterative solvers, ",
        ("auto", *PRECONDITIONER_TYPES),
        use=5,
    )
    orderings: tuple[str, ...] = _listed(
        ORDERINGS, "--orderings", "which blocks are eliminated first, ", EVERY_ORDERING
    )
    trust_regions: tuple[str, ...] = _listed(
        TRUST_REGIONS,
        "--trust-regions",
        "doglegs with direct solvers only, ",
        TRUST_REGION_STRATEGIES,
    )
    threads: tuple[int, ...] = option(
        THREADS,
        "--threads",
        "numbers of threads, such as 1,2; 0: all cores",
        metavar="LIST",
        value="counts",
        late=True,
        use=81,
    )
    repeat: int = option(
        REPEAT,
        "--repeat",
        "runs of each method, of which the table shows the median; a run of more than "
        f"{SECONDS_NOT_REPEATED:g} s is not repeated",
        minimum=1,
        metavar="N",
        use=7,
    )
    timeout: float = option(
        TIMEOUT,
        "--timeout",
        "time after which a solve is stopped",
        metavar="SECONDS",
        late=True,
    )
    memory_cap: str | None = option(
        None,
        "--memory-cap",
        "memory beyond the loaded problem above which a solve is stopped, such as 500MB; 1 MB is "
        "1,000,000 bytes",
        metavar="SIZE",
        unset=f"{100 * SHARE_OF_FREE_MEMORY:g} % of the memory that is free at the start",
    )

    perturb: float = option(
        0.0,
        "--perturb",
        "perturb the start: standard deviation of centres and points relative to their distances, "
        "of rotations in radians, and of focal lengths relatively; such as 0.01",
        minimum=0.0,
        maximum=LARGEST_PERTURBATION,
        metavar="SIZE",
        use=6,
    )
    seed: int = option(0, "--seed", "seed of --perturb", minimum=0, metavar="N")

    def __post_init__(self) -> None:
        _ = self.memory_cap_in_bytes
        super().__post_init__()
        if not self.timeout > 0:
            raise InputError(f"timeout: expected more than 0 seconds, found {self.timeout:g}")

    @property
    def memory_cap_in_bytes(self) -> int:
        """Bytes that a solve may use in addition to the loaded problem; 0: part of free memory."""
        with at("memory_cap"):
            return 0 if self.memory_cap is None else parse_size(self.memory_cap)

    def _checked(self, field: dataclasses.Field[Any], value: Any) -> Any:
        return tuple(value) if isinstance(field.default, tuple) else checked(field, value)


GRAPH_ORDERINGS = (
    "natural",
    "reverse",
    "landmarks_first",
    "minimum_degree",
    "amd",
    "colamd",
    "metis",
    "nesdis",
)
"""Orders in which :func:`bundle.inspect_graph` eliminates the variables of a graph."""


MOST = 10**9  # largest number of cameras or points of a shape


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class RankOptions(Options):
    """Processes for which an inspection predicts times, and the network between them."""

    ranks: str | None = option(
        None,
        "--ranks",
        "numbers of processes for which `mpirun -n N bundle refine` is predicted, such as "
        "1,4,16,64,256",
        metavar="LIST",
    )
    network: str = option(
        "10,50",
        "--network",
        "network between the processes: gigabits per second and microseconds of latency",
        metavar="GBIT,US",
        needs=("ranks",),
    )

    def counts(self) -> list[int]:
        """Return the numbers of processes."""
        try:
            return [] if self.ranks is None else [int(count) for count in self.ranks.split(",")]
        except ValueError:
            raise InputError(
                f"--ranks: expected numbers of processes such as 1,4,16, found {self.ranks}"
            ) from None

    def rate_and_latency(self) -> tuple[float, float]:
        """Return gigabits per second and microseconds of the network."""
        try:
            rate, latency = (float(number) for number in self.network.split(","))
        except ValueError:
            raise InputError(
                "--network: expected gigabits per second and microseconds such as 10,50, "
                f"found {self.network}"
            ) from None
        return rate, latency


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class GraphFileOptions(Options):
    """A small graph from a file, which is eliminated step by step."""

    graph: str | None = option(
        None,
        "--graph",
        "file of a small graph, which is eliminated step by step: one edge per line, two names; # "
        "begins a comment",
        metavar="FILE",
        value="path",
    )
    ordering: str = option(
        "natural",
        "--ordering",
        "of the graph",
        choices=GRAPH_ORDERINGS,
        needs=("graph",),
        late=True,
    )
    landmarks: str | None = option(
        None,
        "--landmarks",
        "variables that landmarks-first eliminates first, such as l1,l2",
        metavar="NAMES",
        unset="those whose names are an l and a number",
        needs=("graph",),
    )
    block_size: int = option(
        1,
        "--block-size",
        "number of scalars of each variable, such as 6 for poses",
        metavar="N",
        needs=("graph",),
        late=True,
    )


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class ShapeOptions(Options):
    """Counts of a problem that does not exist yet, for a textbook estimate."""

    shape: str | None = option(
        None,
        "--shape",
        "estimate the flops of a step, with and without eliminating the points first, from the "
        "numbers of cameras, of points, and of cameras that see a point, such as 100,20000,4",
        metavar="CAMERAS,POINTS,TRACK",
    )

    def counts(self) -> tuple[int, int, int]:
        """Return the numbers of cameras and points, and the length of a track."""
        try:
            cameras, points, track = (int(count) for count in str(self.shape).split(","))
        except ValueError:
            raise InputError(
                f"--shape: expected three whole numbers such as 100,20000,4, found {self.shape}"
            ) from None
        for name, count, most in (
            ("cameras", cameras, MOST),
            ("points", points, MOST),
            ("cameras of a point", track, cameras),
        ):
            if not 1 <= count <= most:
                raise InputError(f"--shape: {name}: expected 1 to {most}, found {count}")
        return cameras, points, track
