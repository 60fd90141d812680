"""Options of feature tracking."""

from __future__ import annotations

from bundle.base.records import dataclass
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class TrackingOptions(Options):
    """Options of tracking features through images.

    Raises:
        InputError: an option has a value outside its range; the message names option and value.
    """

    num_features: int = option(
        100,
        "--num-features",
        "number of cells of the grid over the usable pixels; each has at most one new corner",
        minimum=10,
        metavar="N",
    )
    max_backward_error: float = option(
        0.5,
        "--max-backward-error",
        "distance above which a track ends: tracked to the next image and back, a feature must "
        "return to its position, pixels",
        above=0.0,
        metavar="PX",
    )
    max_epipolar_error: float = option(
        1.0,
        "--max-epipolar-error",
        "distance from the epipolar line above which a track ends, pixels",
        above=0.0,
        metavar="PX",
    )
