"""Candidates of a validation: camera model, sharing, loss, and refined parameters.

Sharing divides the images into groups with one lens each (docs/which_lens.md); images of unknown
size keep the cameras of the input.

Sharings that give the same groups are one candidate, under the first name in the order each, size,
all, input. Sensors of a rig are cameras, so that an input with rigs keeps its own sharing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.editing.camera_sharing import cameras_by_size, share_cameras, split_cameras
from bundle.editing.model_change import change_camera_model
from bundle.interface.options import SolveOptions
from bundle.model.cameras import camera_models, param_kinds, reach
from bundle.model.problem import Problem

SHARING = {
    "size": "shared",
    "all": "one for all",
    "focal": "f per image",
    "each": "per image",
    "input": "as in the input",
}
"""Words for each sharing."""

SHARES = tuple(SHARING)

_DEFAULT_SHARES = ("size", "focal", "each", "input")
_PERSPECTIVE = ("SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
_FISHEYE = ("SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE", "THIN_PRISM_FISHEYE")

_Groups = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A way to refine the input."""

    camera_model: str  # COLMAP's name of the model of all cameras; "" keeps the models of the input
    share: str  # one of :data:`SHARES`
    loss: str = "cauchy"  # robust loss of the fit
    refine: tuple[str, ...] = SolveOptions().refine  # groups of variables, as in SolveOptions

    @property
    def name(self) -> str:
        """Name of the lens, such as "OPENCV, shared by size"."""
        return f"{self.camera_model or 'models of the input'}, {SHARING[self.share]}"


def groups_of(problem: Problem, share: str) -> _Groups:
    """Return the lens of each image, numbered by first appearance."""
    cameras = problem.image_camera.astype(np.int64)
    if share in ("size", "focal"):
        sizes = problem.camera_sizes[cameras]
        known = (sizes > 0).all(axis=1)
        keys = np.column_stack([sizes, np.where(known, -1, cameras)])
        _, labels = np.unique(keys, axis=0, return_inverse=True)
    elif share == "all":
        labels = np.zeros(len(cameras), np.int64)
    else:
        labels = np.arange(len(cameras)) if share == "each" else cameras
    _, first, of_label = np.unique(labels.ravel(), return_index=True, return_inverse=True)
    groups: _Groups = np.argsort(np.argsort(first))[of_label.ravel()]
    return groups


def is_shared(candidate: Candidate) -> bool:
    """Return False if images have parameters of their own."""
    return candidate.share not in ("each", "focal")


def shares_of(problem: Problem, wanted: Iterable[str]) -> tuple[str, ...]:
    """Return the sharings that differ from each other, in the order of :data:`SHARES`."""
    each = groups_of(problem, "each").tobytes()
    found: dict[tuple[bool, bytes], str] = {}
    for share in sorted(set(wanted), key=SHARES.index):
        groups = groups_of(problem, share).tobytes()
        if groups != each:
            found.setdefault((share == "focal", groups), share)
        elif share != "focal":  # else no two images share anything
            found[False, each] = "each"
    return tuple(sorted(found.values(), key=SHARES.index))


def _product(
    problem: Problem,
    models: Sequence[str],
    shares: Sequence[str],
    losses: Sequence[str],
    refines: Sequence[tuple[str, ...]],
) -> list[Candidate]:
    """Return all combinations whose fits differ."""
    return [
        Candidate(camera_model=model, share=share, loss=loss, refine=refine)
        for refine in refines
        for loss in losses
        for share in shares_of(problem, shares)
        for model in dict.fromkeys(models)
        if share != "focal" or _shared_names(model, refine)
    ]


def default_candidates(
    problem: Problem,
    models: Sequence[str] = (),
    shares: Sequence[str] = (),
    losses: Sequence[str] = ("cauchy",),
    refines: Sequence[tuple[str, ...]] = (SolveOptions().refine,),
) -> list[Candidate]:
    """Return the candidates for an input; given arguments replace the defaults.

    By default these are the lenses of the input's kind from the smallest to the largest: all of
    them shared, three per image and two with a focal length per image; and the input's own.
    """
    used = sorted({problem.camera_models[camera] for camera in set(problem.image_camera.tolist())})
    own = used[0] if len(used) == 1 else ""
    default_shares = shares_of(problem, ("input",) if problem.num_frames else _DEFAULT_SHARES)
    chosen = shares_of(problem, shares) if shares else default_shares
    if models:
        return _product(problem, models, chosen, losses, refines)
    family = _FISHEYE if all(reach(model) != "front" for model in used) else _PERSPECTIVE
    fewer = {"each": family[:3], "focal": (family[0], family[2])}
    found = [
        candidate
        for share in chosen
        for candidate in _product(
            problem, fewer.get(share, family) if len(chosen) > 1 else family, [share], losses,
            refines,
        )
    ]  # fmt: skip
    groups = groups_of(problem, "input").tobytes()
    same = (s for s in chosen if s != "focal" and groups_of(problem, s).tobytes() == groups)
    present = _product(problem, [own], [next(same, "input")], losses, refines)
    return list(dict.fromkeys([*found, *present]))


def _shared_names(model: str, refine: tuple[str, ...]) -> list[str]:
    kinds = {kind for kind in ("extra", "principal_point") if kind in refine}
    names = camera_models().get(model, ())
    both = zip(names, param_kinds(model) if names else (), strict=True)
    return [name for name, kind in both if kind in kinds]


def with_cameras(
    problem: Problem, candidate: Candidate, *, keep_scale: bool = False
) -> tuple[Problem, tuple[str, ...]]:
    """Return the problem with the cameras of a candidate, and the rules that tie them.

    Points do not change. Merged cameras start at their mean. With ``keep_scale``, images move along
    their axis to keep their scale.
    """
    model, share = candidate.camera_model, candidate.share
    if model and len(set(problem.camera_models)) > 1:
        problem = change_camera_model(problem, model).problem
    if share in ("size", "focal", "all"):
        used = problem.camera_ids[np.unique(problem.image_camera)].tolist()
        groups = [used] if share == "all" else cameras_by_size(problem)
        for group in groups:
            if len(group) > 1:
                problem = share_cameras(problem, group, keep_scale=keep_scale)
    if model:
        problem = change_camera_model(problem, model).problem
    if share not in ("each", "focal"):
        return problem, ()
    split = split_cameras(problem)
    return split, tying_rules(split, candidate) if share == "focal" else ()


def tying_rules(problem: Problem, candidate: Candidate) -> tuple[str, ...]:
    """Return the rules that leave each camera of images of one size only its focal length."""
    groups = groups_of(problem, "focal")
    shared = _shared_names(candidate.camera_model, candidate.refine)
    ids = problem.camera_ids[problem.image_camera]
    rules = []
    if "fx" in camera_models()[candidate.camera_model]:
        rules.append("cameras *: fx/fy fixed")
    for group in range(int(groups.max(initial=-1)) + 1):
        members = np.unique(ids[groups == group]).tolist()
        if len(members) > 1:
            target = "*" if len(members) == problem.num_cameras else ",".join(map(str, members))
            rules.append(f"cameras {target}: share {','.join(shared)}")
    return tuple(rules)
