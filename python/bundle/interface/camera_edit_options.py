"""Options of camera models, shared cameras, rules (``--set``) and rolling shutters."""

from __future__ import annotations

from bundle.base.records import dataclass
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class LensOptions(Options):
    """Changes of the cameras of an input, made before all other steps."""

    camera_model: str | None = option(
        None,
        "--camera-model",
        "new model of all cameras, such as OPENCV; parameters are converted exactly if the new "
        "model permits, otherwise fitted to the same pixels, and the error is reported",
        metavar="MODEL",
        unset="they keep theirs",
        use=50,
    )
    share_cameras: tuple[int, ...] | bool | str | None = option(
        None,
        "--share-cameras",
        "replace these cameras of one model and size by the camera with the lowest id; size: the "
        "cameras of each image size; parameters are means weighted by observations",
        metavar="IDS|all|size",
        value="ids or all",
    )
    split_cameras: bool = option(
        False, "--split-cameras", "give each image its own camera", negatable=False
    )


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class RuleOptions(Options):
    """Rules about what is fixed, bounded, shared or known (:class:`bundle.Constraints`)."""

    rules: tuple[str, ...] | None = option(
        None,
        "--set",
        "fix, bound, share or pull parameters: TARGET: NAMES fixed | NAMES prior [VALUE] sigma S | "
        "NAMES prior [VALUE] P % | NAMES in [MIN, MAX] | share NAMES | NAME/NAME fixed | "
        "on plane [A B C D] sigma S | on level plane sigma S | on line X Y Z U V W sigma S; "
        'TARGET: camera 3, cameras 1-4, cameras *, image 7, image "left/*.jpg", point 12; NAMES: '
        "parameters of the camera model, or position and rotation; may be given several times",
        metavar="RULE",
        value="several",
        use=60,
    )
    constraints: str | None = option(
        None,
        "--constraints",
        "the same rules from a file, one per line; # begins a comment",
        metavar="FILE",
        value="path",
    )


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class ShutterOptions(Options):
    """Rolling shutters of all cameras with images (:class:`bundle.RollingShutter`)."""

    rolling_shutter: str = option(
        "input",
        "--rolling-shutter",
        "how cameras read an image: rows, from top to bottom; columns, from left to right; global, "
        "at once; input: as rolling_shutter.json of INPUT says, global without that file",
        choices=("input", "global", "rows", "columns"),
    )
    readout: str | None = option(
        None,
        "--readout",
        "time from the first to the last row as a share of the time between two frames, or in "
        "seconds with --frame-rate; estimate: refine it, from tied or hard twists (--twists)",
        metavar="SHARE|SECONDS|estimate",
        unset="as in INPUT",
    )
    frame_rate: float = option(
        0.0,
        "--frame-rate",
        "frames per second of the video, for a readout and times in seconds; 0: unknown",
        minimum=0.0,
        metavar="HZ",
    )
    frames: str | None = option(
        None,
        "--frames",
        "csv of the images' times in their video, for tied and hard twists: image_id or name; "
        "frame, or time_s with --frame-rate; neighbour_a and neighbour_b, the ids of the images "
        "before and after (default: the nearest in time of the same camera)",
        metavar="FILE",
        value="path",
    )
    row_time: str = option(
        "fixed-point",
        "--row-time",
        "row whose time is the time of an observation. fixed-point: the row of the projection. "
        "observed: the row of the measurement, which biases free twists",
        choices=("fixed-point", "observed"),
    )
