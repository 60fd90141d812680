"""Options of rounds, of a part of the images, of checkpoints, out of core; records of rounds."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Self

from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

CHECKPOINT_INTERVAL = 20  # iterations from one checkpoint to the next within a round

NUM_TRACK_ROUNDS = 6
"""Default number of rounds that also extend tracks: COLMAP's 5, after one of the input alone."""

DEFAULT_SHARE = 10.0
"""Default share of the observations in percent that a run with these rounds holds out."""

RESTS = ("fixed", "marginal")  # treatments of the variables that a local adjustment does not refine


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class RoundOptions(Options):
    """Options of :func:`bundle.solve_rounds` and of its filter."""

    num_rounds: int = option(
        0,
        "--rounds",
        "maximum number of rounds. Each round adjusts, then removes observations and points beyond "
        "the limits. Rounds end early if one removes less than 0.05 % of its observations; the "
        "remaining problem is then adjusted once more. 0: adjust once, remove nothing",
        minimum=0,
        metavar="N",
        use=20,
    )
    max_error: float = option(
        4.0,
        "--max-error",
        "largest reprojection error that a round keeps, in pixels",
        above=0.0,
        metavar="PIXELS",
        needs=("num_rounds",),
        use=21,
    )
    min_angle: float = option(
        1.5,
        "--min-angle",
        "smallest triangulation angle of a point (the largest over pairs of its observations) that "
        "a round keeps, in degrees; 0: any",
        minimum=0.0,
        maximum=90.0,
        metavar="DEGREES",
        needs=("num_rounds",),
    )
    min_track_length: int = option(
        2,
        "--min-track",
        "smallest number of observations of a point that a round keeps",
        minimum=0,
        metavar="N",
        needs=("num_rounds",),
    )
    standardized: bool = option(
        False,
        "--standardized",
        "compare each error with --max-error as it is relative to a model of all other "
        "observations: a residual is divided by the root of its redundancy",
        negatable=False,
        needs=("num_rounds",),
    )
    database: str | None = option(
        None,
        "--database",
        "complete, merge and triangulate tracks before each further round, with the verified "
        "matches of this COLMAP database, which is not changed; it needs the images and keypoints "
        f"of INPUT. Defaults are then --rounds {NUM_TRACK_ROUNDS} and --hold-out {DEFAULT_SHARE:g}",
        metavar="FILE",
        value="path",
        use=22,
    )


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class LocalOptions(Options):
    """Selection of the variables to refine; all others stay constant."""

    only_images: str | None = option(
        None,
        "--only-images",
        "refine only these images, the points that they see and their cameras; everything else "
        "stays the same, bit for bit. Other images that see these points take part with constant "
        "poses",
        metavar="IMAGES",
        value="names of images",
        unset="all images",
    )
    rest: str = option(
        RESTS[0],
        "--rest",
        "with --only-images, treatment of everything else. fixed: other images that see these "
        "points are constant. marginal: these images and their cameras move, too, under the exact "
        "marginal prior of everything that does not take part; only the named images, their points "
        "and cameras are written",
        choices=RESTS,
        needs=("only_images",),
    )


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class CheckpointOptions(Options):
    """Checkpoint files, from which a killed run can be resumed."""

    checkpoint: str | None = option(
        None,
        "--checkpoint",
        "write FILE after each round and every few iterations, for --resume",
        metavar="FILE",
        value="checkpoint",
    )
    resume: str | None = option(
        None,
        "--resume",
        "continue from this checkpoint, with the same INPUT and options (--threads may differ), "
        "and continue to write it; begin at the start if the file does not exist. With "
        "--deterministic, the result equals that of a run with --checkpoint that was not killed, "
        "bit for bit",
        metavar="FILE",
        value="resumed checkpoint",
    )
    checkpoint_interval: int = option(
        CHECKPOINT_INTERVAL,
        "--checkpoint-interval",
        "iterations from one checkpoint to the next within a round; the solver restarts at each "
        "checkpoint, which takes a few more steps",
        metavar="N",
        needs=("checkpoint", "resume"),
        late=True,
    )


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class OutOfCoreOptions(Options):
    """Folder for problems that are larger than the memory."""

    out_of_core: str | None = option(
        None,
        "--out-of-core",
        "keep observations and points in files in this folder, of a local disk; the result has the "
        "same bits. For BAL files and binary COLMAP models, without rounds and other inputs. The "
        "files are temporary and have no names",
        metavar="DIR",
        value="path",
    )


@dataclass(frozen=True, kw_only=True)
class Round:
    """One round: an adjustment, then a filter. Costs of different rounds cannot be compared."""

    round: int  # number of the round, from 1
    initial_cost: float  # cost at the start of the adjustment, 1/2 sum rho(||r||^2)
    cost: float  # cost after the adjustment, before the filter
    termination_type: str  # Ceres' name of the adjustment's termination type
    num_iterations: int  # steps of the adjustment, including rejected steps
    num_points: int  # number of adjusted points
    num_observations: int  # number of adjusted observations
    # observations that the filter removed after the adjustment, including those of removed points
    num_observations_removed: int
    num_points_removed: int  # points that the filter removed after the adjustment
    # removed because of their own error, because they are behind the camera, or because they have
    # no projection
    num_observations_beyond_max_error: int = 0
    num_observations_with_short_track: int = 0  # removed with points whose track became too short
    num_observations_below_min_angle: int = 0  # removed with points of a small triangulation angle
    max_error: float = 0.0  # largest error that the filter keeps [px]
    min_angle: float = 0.0  # smallest triangulation angle that the filter keeps [degrees]
    initial_factor_cost: float = 0.0  # part of `initial_cost` of the factors beside observations


@dataclass(frozen=True, kw_only=True)
class TrackRound:
    """One round of :func:`bundle.refine_tracks`, in numbers of observations."""

    round: int  # number of the round, from 1. Round 1 adjusts the input with its own tracks
    triangulated: int  # observations that continued a track or made a new point
    completed: int  # observations that joined a track over matches of several images
    merged: int  # observations of points that became one point
    deleted: int  # observations that the filter removed after the adjustment
    num_observations: int  # observations after the filter
    num_points: int  # points after the filter
    # RMSE in pixels, of errors clipped as in ``held_out``, at the held-out observations after the
    # same round of the second run; None without any
    held_out_rmse: float | None = None


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class RoundRecords:
    """Records of the rounds of a solve; no record if it had none. See :class:`bundle.Result`."""

    rounds: tuple[Round, ...] = ()
    tracks: tuple[TrackRound, ...] = ()
    observation_mask: NDArray[np.bool_] | None = None

    def _work(self, num_steps: int) -> str:
        rounds = self.rounds
        if not rounds:
            return plural(num_steps, "step")
        if not rounds[-1].num_observations_removed:  # the last round is the last adjustment
            num_steps = 0
        num_steps += sum(done.num_iterations for done in rounds)
        return f"{plural(len(rounds), 'round')}, {plural(num_steps, 'step')}"

    @property
    def initial_factor_cost(self) -> float | None:
        """Cost of the factors at the start of the first round; None without rounds."""
        return self.rounds[0].initial_factor_cost if self.rounds else None

    @property
    def deleted_for_error(self) -> tuple[int, float]:
        """Number of observations that rounds deleted for their errors, and the limit in pixels."""
        far = sum(done.num_observations_beyond_max_error for done in self.rounds)
        return far, self.rounds[-1].max_error if self.rounds else 0.0

    @property
    def causes(self) -> str:
        """Numbers of observations that the filters of the rounds deleted, by limit; "": none."""
        if not self.rounds or self.tracks:  # the filters also deleted added observations
            return ""
        limits = self.rounds[-1]
        counts = {
            cause: sum(getattr(done, f"num_observations_{name}") for done in self.rounds)
            for name, cause in (
                ("beyond_max_error", f"above {limits.max_error:g} px"),
                ("below_min_angle", f"of points below {limits.min_angle:g} degrees"),
                ("with_short_track", "of short tracks"),
            )
        }
        return ", ".join(f"{count:,} {cause}" for cause, count in counts.items() if count)

    @property
    def cost_name(self) -> str:
        """Name of the cost; those of different rounds cannot be compared."""
        return "last adjustment's cost" if self.rounds else "cost"

    def _round_facts(self) -> tuple[tuple[str, str], ...]:
        if not self.rounds:
            return ()
        observations = sum(done.num_observations_removed for done in self.rounds)
        points = sum(done.num_points_removed for done in self.rounds)
        removed = f"{plural(observations, 'observation')} and {plural(points, 'point')} removed"
        return (("rounds", f"{len(self.rounds)}; {removed}"),)

    def following(self, earlier: Self) -> Self:
        """Return the result of an adjustment that follows the rounds of an earlier result."""
        return replace(self, rounds=earlier.rounds, observation_mask=earlier.observation_mask)

    def _counted_without(self, num_points: int) -> Self:
        """Return the result with fewer points in the record of each round."""
        rounds = (replace(done, num_points=done.num_points - num_points) for done in self.rounds)
        return replace(self, rounds=tuple(rounds))
