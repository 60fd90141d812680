"""Options of an inspection except the refined parameters: processes, or a graph from a file."""

from __future__ import annotations

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option

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


MOST = 10**9
"""Largest number of cameras or points of a shape."""


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
        "between the processes: gigabits per second and microseconds of latency",
        metavar="GBIT,US",
        needs=("ranks",),
    )

    def counts(self) -> list[int]:
        """Return the numbers of processes.

        Raises:
            InputError: they cannot be read.
        """
        try:
            return [] if self.ranks is None else [int(count) for count in self.ranks.split(",")]
        except ValueError:
            raise InputError(
                f"--ranks: expected numbers of processes such as 1,4,16, found {self.ranks}"
            ) from None

    def rate_and_latency(self) -> tuple[float, float]:
        """Return gigabits per second and microseconds of the network.

        Raises:
            InputError: they cannot be read.
        """
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
        "textbook flops of a step with and without eliminating the points first, of a problem with "
        "these numbers of cameras, of points, and of cameras that see a point, such as 100,20000,4",
        metavar="CAMERAS,POINTS,TRACK",
    )

    def counts(self) -> tuple[int, int, int]:
        """Return the numbers of cameras and points, and the length of a track.

        Raises:
            InputError: they cannot be read, or a point is seen by more cameras than there are.
        """
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
