"""Options that change the cameras of an input, and rules about its parameters."""

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
        "NAMES prior [VALUE] P % | NAMES in [MIN, MAX] | share NAMES | NAME/NAME fixed; TARGET: "
        'camera 3, cameras 1-4, cameras *, image 7, image "left/*.jpg", point 12; NAMES: '
        "parameters of the camera model, or position and rotation; may be given several times",
        metavar="RULE",
        value="several",
    )
    constraints: str | None = option(
        None,
        "--constraints",
        "the same rules from a file, one per line; # begins a comment",
        metavar="FILE",
        value="path",
    )
