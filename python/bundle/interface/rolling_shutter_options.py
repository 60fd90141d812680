"""Options that say how the cameras of an input read their images, and when."""

from __future__ import annotations

from bundle.base.records import dataclass
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class ShutterOptions(Options):
    """Rolling shutters of all cameras with images (:class:`bundle.RollingShutter`)."""

    rolling_shutter: str = option(
        "input",
        "--rolling-shutter",
        "how cameras read an image: rows, from top to bottom; columns, from left to right; global, "
        "at once; input: as the rolling_shutter.json of INPUT says, without it global",
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
        "time at which a point is read: that of the row where the image sees it (fixed-point), or "
        "where it was measured (observed), which draws free twists to wrong values",
        choices=("fixed-point", "observed"),
    )
