"""Options of a comparison of a model or trajectory with a reference."""

from __future__ import annotations

from bundle.base.records import dataclass
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option

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
        "check points in ODM's gcp_list.txt",
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
        "yaw, rotation about z and position only, for odometry with gravity; none",
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
        "of two models: movement in sigmas of A's covariance; auto: for up to 300 images",
        choices=SIGMAS,
    )
