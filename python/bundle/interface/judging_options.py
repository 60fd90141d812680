"""Options of evaluations, of held-out observations and validations, and of a triage."""

from __future__ import annotations

from bundle.base.records import dataclass
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option
from bundle.interface.options import LOSSES

ALIGNMENTS = ("similarity", "rigid", "yaw", "none")
"""Alignments of the poses of an estimate, the default first."""

AUC_DEFINITIONS = {
    "trapezoid": "trapezoid, pairs i < j (SuperGlue)",
    "colmap": "trapezoid, ordered pairs, missing images 180 degrees (COLMAP)",
    "histogram": "steps of one degree, pairs i < j (PoseDiffusion, VGGT)",
    "integral": "exact integral of the recall, pairs i < j",
}
"""Definitions of the AUC, the default first, with their descriptions."""

POSE_FORMATS = ("tum", "euroc", "kitti", "poses")
DIRECTIONS = ("camera_from_world", "world_from_camera")
"""Directions of the poses in a list; the first is the default."""

INPUT_FORMATS = (*POSE_FORMATS, "colmap", "bal")
REFERENCE_FORMATS = (*INPUT_FORMATS, "gcp")
SIGMAS = ("auto", "on", "off")


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class EvaluateOptions(Options):
    """Options of :func:`bundle.evaluate`.

    Raises:
        InputError: an option has a value outside its range; the message names option and value.
    """

    format: str | None = option(
        None,
        "--format",
        "format of the reference; poses: a list with lines of name qw qx qy qz tx ty tz; gcp: "
        "check points in any form of --gcp",
        choices=REFERENCE_FORMATS,
        metavar="FORMAT",
        unset="by its content",
        late=True,
    )
    input_format: str | None = option(
        None,
        "--input-format",
        "format of A",
        choices=INPUT_FORMATS,
        metavar="FORMAT",
        unset="by its content",
        late=True,
    )
    pose_direction: str = option(
        DIRECTIONS[0],
        "--pose-direction",
        "direction of the poses if the reference is a list; other formats have one direction",
        choices=DIRECTIONS,
        metavar="WAY",
    )
    input_pose_direction: str = option(
        DIRECTIONS[0],
        "--input-pose-direction",
        "direction of the poses if A is a list",
        choices=DIRECTIONS,
        metavar="WAY",
    )
    max_time_difference: float = option(
        0.01,
        "--max-time-difference",
        "largest difference of time stamps of one pose, in seconds",
        minimum=0.0,
        metavar="SECONDS",
    )
    align: str = option(
        ALIGNMENTS[0],
        "--align",
        "alignment of A to the reference by the shared centres: similarity; rigid, at A's scale; "
        "yaw, rotation about z and position only, for odometry with gravity; none: A stays, for "
        "check points in the frame of its georeference.json",
        choices=ALIGNMENTS,
    )
    auc: str = option(
        next(iter(AUC_DEFINITIONS)),
        "--auc",
        "definition of the area under the recall of relative poses (docs/evaluate.md)",
        choices=tuple(AUC_DEFINITIONS),
    )
    delta: int = option(
        1,
        "--delta",
        "number of poses over which relative pose errors (RPE) are measured, in order of time or "
        "name",
        minimum=1,
        metavar="N",
    )
    sigmas: str = option(
        SIGMAS[0],
        "--sigmas",
        "measure the movement in sigmas of A's covariance, for two models; auto: up to 300 images",
        choices=SIGMAS,
    )
    loss: str = option(
        "trivial",
        "--loss",
        "robust loss with which A was refined, for the sigmas",
        choices=LOSSES,
    )
    loss_scale: float = option(
        1.0,
        "--loss-scale",
        "scale of this loss, in pixels",
        above=0.0,
        metavar="PIXELS",
        only_with=("loss", LOSSES[1:]),
    )


MOST_PERCENT = 50.0  # largest share of the observations that can be held out


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class HoldOutOptions(Options):
    """Options of :func:`bundle.hold_out`, for the error of a solve that its fit did not see."""

    hold_out: float = option(
        0.0,
        "--hold-out",
        "also fit without this share of the observations, in percent, and report how well that fit "
        "predicts them; OUTPUT is the fit to all observations. The share is drawn in each image; "
        "each point keeps observations in two images. With --only-images it is drawn in these. 0: "
        "do not",
        minimum=0.0,
        maximum=MOST_PERCENT,
        metavar="PERCENT",
        use=70,
    )
    hold_out_seed: int = option(
        0,
        "--hold-out-seed",
        "seed of the draw; another seed holds out other observations",
        minimum=0,
        metavar="N",
        needs=("hold_out",),
    )


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class ValidationOptions(Options):
    """Options of :func:`bundle.validate`: the candidates and the folds."""

    camera_models: tuple[str, ...] | None = option(
        None,
        "--camera-models",
        "lens models, such as SIMPLE_RADIAL,OPENCV",
        metavar="LIST",
        value="words",
        unset="those of INPUT's kind, from the smallest to the largest",
        use=3,
    )
    share: tuple[str, ...] | None = option(
        None,
        "--share",
        "sharings. each: a lens per image; focal: a focal length per image, all else shared by "
        "images of one size; size: a lens per image size; all: one lens; input: as in INPUT",
        metavar="LIST",
        value="words",
        unset="those that make a difference",
        use=4,
    )
    losses: tuple[str, ...] | None = option(
        None,
        "--losses",
        "robust losses of the fits",
        metavar="LIST",
        value="words",
        unset="cauchy",
        use=5,
    )
    refine_sets: tuple[tuple[str, ...], ...] | None = option(
        None,
        "--refine",
        "sets of refined parameters, separated by /, such as "
        "poses,points,focal,extra/poses,points,focal,principal-point,extra",
        metavar="SETS",
        value="sets",
        unset="poses,points,focal,extra",
    )
    num_folds: int = option(
        5,
        "--folds",
        "number of folds, the same for all candidates; each is predicted by a fit to the others",
        minimum=2,
        maximum=1000,
        metavar="K",
        use=6,
    )
    seed: int = option(0, "--seed", "seed of the division into folds", minimum=0, metavar="N")


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class TriageOptions(Options):
    """Options of :func:`bundle.triage`: the largest differences that count as noise.

    Raises:
        InputError: an option has a value outside its range; the message names option and value.
    """

    time_noise: float = option(
        1.5,
        "--time-noise",
        "largest ratio of two times of equal work that counts as noise; short solves and busy "
        "machines need a larger one",
        minimum=1.0,
        metavar="RATIO",
    )
    cost_noise: float = option(
        1e-3,
        "--cost-noise",
        "largest relative difference of two final costs that counts as noise; ten times as much "
        "for odometry, because its time budget ends some solves early",
        minimum=0.0,
        metavar="X",
    )
    step_noise: float = option(
        0.3,
        "--step-noise",
        "largest relative difference of two numbers of steps that counts as noise; 2 steps always "
        "do",
        minimum=0.0,
        metavar="X",
    )
