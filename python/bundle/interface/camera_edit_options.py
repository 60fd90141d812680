"""Options that change the cameras of an input, and rules about its parameters."""

from __future__ import annotations

from dataclasses import dataclass

from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option

__all__ = ["LensOptions", "RuleOptions"]


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class LensOptions(Options):
    """Changes of the cameras of an input, made before all other steps."""

    camera_model: str | None = option(
        None,
        "--camera-model",
        "model that all cameras get, such as OPENCV; from the same pixels, exactly where the model "
        "can, else by a fit, whose error is reported",
        metavar="MODEL",
        unset="they keep theirs",
    )
    share_cameras: tuple[int, ...] | bool | str | None = option(
        None,
        "--share-cameras",
        "make these cameras, of one model and size, the one with the lowest id; size: the cameras "
        "of each image size; parameters are the means weighted by observations",
        metavar="IDS|all|size",
        value="ids or all",
    )
    split_cameras: bool = option(
        False, "--split-cameras", "give each image a camera of its own", negatable=False
    )


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class RuleOptions(Options):
    """Rules about what is fixed, bounded, shared or known (:class:`bundle.Constraints`)."""

    rules: tuple[str, ...] | None = option(
        None,
        "--set",
        "hold, bound, share or pull parameters: TARGET: NAMES fixed | NAMES prior [VALUE] sigma S "
        "| NAMES prior [VALUE] P % | NAMES in [MIN, MAX] | share NAMES | NAME/NAME fixed; TARGET: "
        'camera 3, cameras 1-4, cameras *, image 7, image "left/*.jpg", point 12; NAMES: '
        "COLMAP's of the camera model, or position and rotation; may be given several times",
        metavar="RULE",
        value="several",
    )
    constraints: str | None = option(
        None,
        "--constraints",
        "the same rules from a file, one a line; # begins a comment",
        metavar="FILE",
        value="path",
    )
