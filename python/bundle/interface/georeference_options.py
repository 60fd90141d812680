"""Options of ground control points, and of positions, attitudes and velocities of images."""

from __future__ import annotations

import math
from typing import Any

from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option
from bundle.interface.options import LOSSES

GPS_SIGMA = "2/5"
GCP_SIGMA = "0.02"
"""Default standard deviations in metres, horizontal and vertical, for files without them."""
GCP_PIXEL_SIGMA = 0.5
OFFSET_AXES = {"none": (0.0, 0.0, 0.0), "up": (0.0, 0.0, 1.0), "all": (1.0, 1.0, 1.0)}
"""Coordinates in which an offset of all positions moves them."""
ROBUST_SCALE = math.sqrt(7.814727903251179)
"""Length in sigmas below which 95 % of 3D Gaussian errors are (chi squared: 7.8147)."""
ROBUST_SCALES = {1: math.sqrt(3.841458820694124), 2: math.sqrt(5.991464547107979), 3: ROBUST_SCALE}
"""The same length by the number of residuals."""
GRAVITY_SIGMA = 1.0
"""Default standard deviation of a direction of gravity in degrees, for lines without it."""
ORIENTATION_SIGMA = "5/1"
"""Default standard deviations of an orientation in degrees, heading and tilt."""
SCALE_BAR_SIGMA = 0.001  # default standard deviation of a known length in metres
VELOCITY_SIGMA = "0.1/0.2"
"""Default standard deviations of a velocity in m/s, horizontal and vertical: GPS by Doppler."""


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class GeoreferenceOptions(Options):
    """Positions of images and ground control points, with assumptions on their errors."""

    gps: str | None = option(
        None,
        "--gps",
        "measured positions; exif: from the EXIF tags of the images; FILE: OpenDroneMap's geo.txt, "
        "a table (CSV) with columns image, latitude, longitude, altitude, OpenSfM's "
        "reconstruction.json or its folder, or COLMAP's database (pose priors)",
        metavar="exif|FILE",
        value="exif or path",
        use=40,
    )
    images: str | None = option(
        None,
        "--images",
        "folder of the images, for --gps exif, --orientations xmp and --velocities xmp",
        metavar="DIR",
        value="path",
        needs=("gps", "orientations", "velocities"),
        use=41,
    )
    gps_sigma: str = option(
        GPS_SIGMA,
        "--gps-sigma",
        "standard deviation of positions, horizontal and vertical, in metres, where the source "
        "gives none",
        metavar="H[/V]",
        needs=("gps",),
        use=42,
    )
    gps_offset: str = option(
        "none",
        "--gps-offset",
        "estimate a common offset of all positions from the control points: up, for heights of "
        "two systems (ellipsoid and sea level), or along all axes",
        choices=tuple(OFFSET_AXES),
        needs=("gps",),
        late=True,
    )
    gps_sigma_scale: str = option(
        "1",
        "--gps-sigma-scale",
        "factor on all standard deviations of positions, horizontal and vertical, including those "
        "of the source",
        metavar="H[/V]",
        needs=("gps",),
    )
    antenna: str = option(
        "0,0,0",
        "--antenna",
        "position of the antenna in the camera frame, right, down, forward, in metres",
        metavar="X,Y,Z",
        needs=("gps", "velocities"),
    )
    prior_loss: str = option(
        "trivial",
        "--prior-loss",
        "robust loss of positions, control points, attitudes and velocities: tukey and arctan "
        "ignore gross errors, all others only reduce their influence",
        choices=LOSSES,
        metavar="NAME",
        needs=("gcp", "gps", "gravity", "orientations", "velocities"),
        late=True,
    )
    prior_loss_scale: float = option(
        ROBUST_SCALE,
        "--prior-loss-scale",
        "residual in standard deviations at which this loss begins to bend; 5 % of correct "
        "residuals exceed the default",
        metavar="X",
        needs=("gcp", "gps", "gravity", "orientations", "velocities"),
        late=True,
    )
    gcp: str | None = option(
        None,
        "--gcp",
        "OpenDroneMap's gcp_list.txt, OpenSfM's ground_control_points.json or its folder, "
        "Metashape's markers (.xml), or two tables (CSV), POINTS,MARKS: label, x, y, height; "
        "image, label, px, py",
        metavar="FILE[,MARKS]",
        value="path",
        use=43,
    )
    gcp_sigma: str = option(
        GCP_SIGMA,
        "--gcp-sigma",
        "standard deviation of control points, horizontal and vertical, in metres, if the file "
        "does not give it",
        metavar="H[/V]",
        needs=("gcp",),
    )
    gcp_pixel_sigma: float = option(
        GCP_PIXEL_SIGMA,
        "--gcp-pixel-sigma",
        "standard deviation of their measurements in pixels, if the file does not give it",
        metavar="PX",
        needs=("gcp",),
        late=True,
    )
    check_points: str | None = option(
        None,
        "--check-points",
        "control points that are only compared and have no influence, such as gcp02,gcp07",
        metavar="NAMES",
        unset="those that the file marks so",
        needs=("gcp",),
    )

    gravity: str | None = option(
        None,
        "--gravity",
        "directions of gravity: lines of image, down in the camera frame (right, down, forward), "
        "and standard deviation in degrees; a model without positions is first turned upright",
        metavar="FILE",
        value="path",
    )
    gravity_sigma: float = option(
        GRAVITY_SIGMA,
        "--gravity-sigma",
        "standard deviation of directions in degrees, if the file does not give it",
        metavar="DEGREES",
        needs=("gravity",),
        above=0,
    )
    gravity_sigma_scale: float = option(
        1.0,
        "--gravity-sigma-scale",
        "factor on all standard deviations of directions, including those of the file",
        metavar="X",
        needs=("gravity",),
        above=0,
    )
    orientations: str | None = option(
        None,
        "--orientations",
        "measured orientations or headings; xmp: DJI's gimbal angles in the images; FILE: a header "
        "that names the columns, and a line for each image",
        metavar="FILE|xmp",
        value="xmp or path",
    )
    orientation_sigma: str = option(
        ORIENTATION_SIGMA,
        "--orientation-sigma",
        "standard deviation of orientations, heading and tilt, in degrees, where the source gives "
        "none",
        metavar="H[/T]",
        needs=("orientations",),
    )
    orientation_sigma_scale: float = option(
        1.0,
        "--orientation-sigma-scale",
        "factor on all standard deviations of orientations, including those of the source",
        metavar="X",
        needs=("orientations",),
        above=0,
    )
    velocities: str | None = option(
        None,
        "--velocities",
        "measured velocities of images with a rolling shutter, beside --gps, --gcp or the "
        "georeference.json of INPUT; xmp: DJI's speeds in the images; FILE: a header, name vx vy "
        "vz, and a line for each image, in metres per second to east, north, up",
        metavar="FILE|xmp",
        value="xmp or path",
    )
    velocity_sigma: str = option(
        VELOCITY_SIGMA,
        "--velocity-sigma",
        "standard deviation of velocities, horizontal and vertical, in metres per second, where "
        "the source gives none",
        metavar="H[/V]",
        needs=("velocities",),
    )

    def arguments(self) -> dict[str, Any]:
        """Return the changed options as arguments of readers, with parsed texts."""
        parsed = {"antenna": "lever_arm", "check_points": "check_point_names"}
        return {name: getattr(self, parsed.get(name, name)) for name in self.changed()}

    @property
    def lever_arm(self) -> list[float]:
        """Position of the antenna in the frame of the camera."""
        try:
            numbers = [float(part) for part in self.antenna.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) != 3:
            raise InputError(
                "antenna: expected X,Y,Z in metres, such as 0,-0.1,0.05, "
                f"found {brief(self.antenna)}"
            )
        return numbers

    @property
    def check_point_names(self) -> list[str] | None:
        """Names of the check points; None: those marked as check points in the file."""
        if self.check_points is None:
            return None
        return [name.strip() for name in self.check_points.split(",") if name.strip()]
