"""Choice of the next measurement: the image, tie, control point or bar that helps a quantity most.

A candidate has rows by the unknowns of the joint covariance (``joint_covariance.py``), and needs no
data: it says where it would look, not what it would see.

- image: the rows of all points in view, w.r.t. the parameters of the camera and the points; the
  pose is eliminated, and so are the refined parameters of a camera that took one image only, as the
  next image will then have a camera of its own.
- tie: an observation of a point that its image should see and does not have.
- control point: X / sigma of a point; scale bar: u^T (dX_a - dX_b) / sigma along the bar.

Points with priors, and points of the quantity itself, are not proposed as control points or ends of
bars: otherwise the answer would be to measure the quantity. The candidates are chosen one by one,
each given those before it.

The joint covariance takes a solve for each of its unknowns with the factor of the reduced camera
system. It has at most 150 points: those of the quantity, those with the largest shares of its
variance, and others far apart; and the 50 images that see most of them. A new image counts these
points only, and lowers the sigma more than predicted if it sees others.
"""

from __future__ import annotations

import itertools
import os
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.analysis.uncertainty.covariance_by_input import length_unit, request_at
from bundle.analysis.uncertainty.influence import differentiate, names_of_markers
from bundle.analysis.uncertainty.joint_covariance import (
    Joint,
    Rows,
    joint_covariance,
    null_basis,
    view,
)
from bundle.analysis.uncertainty.quantity import Quantity
from bundle.analysis.uncertainty.reliability import notes_of
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import number, plural
from bundle.errors import InputError
from bundle.georeference.control_point import Sigma, parse_sigma
from bundle.georeference.gcp_list import PIXEL_SHIFT
from bundle.interface.analysis_options import ADDED, parts_of
from bundle.interface.georeference_options import GCP_SIGMA, SCALE_BAR_SIGMA
from bundle.interface.option_class import takes_options
from bundle.interface.option_fields import number as checked_number
from bundle.interface.options import SolveOptions
from bundle.interface.tabular import Tabular
from bundle.io.files import Source
from bundle.io.pose_files import load_poses
from bundle.model.pose_table import PoseTable
from bundle.model.problem import Problem
from bundle.model.rigid_motions import inverse_poses
from bundle.solving.prepare import Prepared
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.georeference.measurements import Prior
    from bundle.graphs.factors.factors import Factor
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule

_Floats = NDArray[np.float64]
_Rows = NDArray[np.int64]

MOST_POINTS, MOST_IMAGES = 150, 50
LEAST_IN_VIEW = 4  # points from which a pose is determined, and checked
HELPS = 1e-6  # relative decrease of the variance below which a candidate does not help
GCP = ("--gcp gcp_list.txt",)
BARS = (*GCP, "--scale-bars bars.txt")
MOST_LINES = 5  # lines of a control point: images in which it is marked
SIDES = ((1, 0, "right of"), (-1, 0, "left of"), (0, 1, "below"), (0, -1, "above"))
"""Directions in the frame of a camera."""
WORDS = {"image": "New image", "tie": "Tie", "gcp": "Control point", "bar": "Scale bar"}


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A measurement to add, and the sigma of the quantity without and with it."""

    kind: str  # "image", "tie", "gcp" or "bar"
    what: str  # the measurement, such as "point 11, known to 0.02"
    sigma_before: float  # sigma without it
    sigma_after: float  # sigma with it
    lines: tuple[str, ...]  # to write down: of gcp_list.txt and bars.txt, or a camera_from_world
    then: tuple[str, ...]  # flags with which bundle refine uses these lines; () if none does

    @property
    def is_shown(self) -> bool:
        """True if the sigmas differ in the digits that are printed."""
        return number(self.sigma_before) != number(self.sigma_after)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Plan(Displayed, Tabular):
    """The measurements that would lower the sigma of a quantity most.

    Attributes:
        on: the quantity.
        unit: "" for the unit of the model, "m", "m^3", "px", "degrees" or that of a ratio, "1".
        value: its value.
        sigma: its standard deviation, for residuals of the assumed sigmas.
        proposals: the best candidate of each kind alone, the best first.
        together: the best candidates one by one, each given those before it.
        notes: sentences with remarks.
    """

    on: str
    unit: str
    value: float
    sigma: float
    proposals: tuple[Proposal, ...]
    together: tuple[Proposal, ...]
    notes: tuple[str, ...]

    @property
    def sentences(self) -> tuple[str, ...]:
        """The answer in at most six sentences."""
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        now = number(self.sigma)
        said = [f"{self.on}: {number(self.value)}{unit}, sigma {now}{unit}."]
        for one in self.proposals:
            change = f"{now} -> {number(one.sigma_after)}" if one.is_shown else f"stays {now}"
            said.append(f"{WORDS[one.kind]}: {one.what}: sigma {change}{unit}.")
        if len(self.together) > 1:
            named = "; ".join(f"{one.what} ({WORDS[one.kind].lower()})" for one in self.together)
            last = number(self.together[-1].sigma_after)
            said.append(f"Together, one by one: {named}: sigma {now} -> {last}{unit}.")
        return tuple(said)

    def _display(self) -> Display:
        first, *others = self.sentences
        return Display(title=f"Plan: {first}", facts=tuple(("", one) for one in others))


class Candidate(NamedTuple):
    """A measurement that could be added."""

    kind: str
    what: str
    rows: Rows
    lines: Callable[[], tuple[str, ...]] = tuple
    then: tuple[str, ...] = ()


@takes_options(SolveOptions)
def plan(
    problem: Source | Result,
    on: str,
    options: SolveOptions | None = None,
    *,
    add: str | Iterable[str] = ADDED,
    count: int = 3,
    candidates: PoseTable | str | os.PathLike[str] | None = None,
    gcp_sigma: Any = GCP_SIGMA,
    bar_sigma: float = SCALE_BAR_SIGMA,
    factors: Iterable[Factor] = (),
    priors: Iterable[Prior] = (),
    align: bool | None = None,
    bounds: Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]] | None = None,
    constraints: Constraints | Iterable[str | Rule] = (),
    **changes: Any,
) -> Plan:
    """Find the measurements that would lower the sigma of a quantity most.

    Sigmas are to first order at the problem's values, which should be a minimum of a solve with the
    same options. They do not depend on the gauge. A new observation has the median sigma and, under
    a loss, the median weight of the present ones.

    Args:
        problem: problem, its path, or a pycolmap.Reconstruction. For a :class:`Result`, its refined
            problem and its options are used.
        on: the quantity, as in :func:`bundle.influence`.
        options: refined and constant parameters, and the loss, as in :func:`bundle.solve`; the
            gauge has no effect.
        add: kinds of candidates: some of "image", "tie", "gcp" and "bar".
        count: number of measurements to choose one by one.
        candidates: poses of new images, or the path of a file for :func:`bundle.load_poses`, in the
            frame of the problem, or of its measurements if these move it; None: beside each
            present image, at the median distance between neighbours.
        gcp_sigma: sigma of a new control point in the unit of the model: a number, or horizontal
            and vertical.
        bar_sigma: sigma of a new scale bar, likewise.
        factors: factors in addition to the observations, as in :func:`bundle.solve`.
        priors: measured positions and control points, likewise.
        align: likewise.
        bounds: bounds of camera parameters; a parameter at an active bound is constant.
        constraints: rules, as in :func:`bundle.solve`.
        **changes: options by name, which replace those in ``options``.

    Raises:
        InputError: an argument is wrong, a given pose has fewer than 4 points in view, shutters
            roll, or no candidate lowers the sigma; or as :func:`bundle.influence`.
        OSError: a path cannot be read.

    Example:
        >>> found = bundle.plan("sparse/0", "distance 12 87 / baseline 1 8", add="image,tie")
        >>> found.proposals[0].what, found.proposals[0].sigma_after
    """
    kinds = parts_of("add", add, ADDED)
    count = checked_number("count", count, minimum=1, whole=True)
    sigma_of_point = parse_sigma("gcp_sigma", gcp_sigma, "a length")
    sigma_of_bar = checked_number("bar_sigma", bar_sigma, above=0)
    if candidates is not None and "image" not in kinds:
        raise InputError(f"candidates: expected image in add, found {', '.join(kinds)} only")
    poses = candidates
    if not isinstance(poses, PoseTable | None):
        poses = load_poses(poses)
    request = request_at(
        problem, options, changes, "plan", factors=factors, priors=priors, align=align,
        bounds=bounds, constraints=constraints,
    )  # fmt: skip
    if request.problem.rolling_shutter is not None:
        raise InputError("problem: expected global shutters to plan for, found rolling ones")
    prepared, quantity, out = differentiate(request, on)
    scene = Scene.of(prepared, quantity, out)
    found = [*scene.candidates(kinds, poses, sigma_of_point, sigma_of_bar)]
    groups = [[one for one in found if one.kind == kind] for kind in kinds]
    singles = [best for group in groups if (best := _best(scene.joint, group)) is not None]
    proposals = sorted(
        (_proposal(scene.joint, one) for one in singles), key=lambda one: one.sigma_after
    )
    if not proposals:
        why = "; without a datum, one control point or scale bar changes nothing"
        raise InputError(
            f"add: expected a measurement that lowers the sigma of {quantity.text}, found none "
            f"among {plural(len(found), 'candidate')} ({', '.join(kinds)})"
            + (why if scene.joint.free.size and {"gcp", "bar"} & set(kinds) else "")
        )
    joint, together = scene.joint, list[Proposal]()
    while len(together) < count and (best := _best(joint, found)) is not None:
        together.append(_proposal(joint, best))
        joint = joint.measured(best.rows)
        found = [one for one in found if one is not best]
    return Plan(
        on=quantity.text,
        unit=quantity.unit,
        value=quantity.value,
        sigma=float(np.sqrt(scene.joint.variance)),
        proposals=tuple(proposals),
        together=tuple(together),
        notes=notes_of(prepared, out),
    )


def _best(joint: Joint, candidates: Sequence[Candidate]) -> Candidate | None:
    """Return the candidate with the largest gain, by upper bounds first; None if none helps."""
    most = np.array([joint.most(one.rows) for one in candidates])
    best, gain = None, HELPS * joint.variance
    for place in np.argsort(-most, kind="stable").tolist():
        if most[place] <= gain:
            break
        of_this = joint.gain(candidates[place].rows)
        if of_this > gain:
            best, gain = candidates[place], of_this
    return best


def _proposal(joint: Joint, one: Candidate) -> Proposal:
    before, after = joint.variance, joint.variance - joint.gain(one.rows)
    return Proposal(
        kind=one.kind,
        what=one.what,
        sigma_before=float(np.sqrt(before)),
        sigma_after=float(np.sqrt(max(after, 0))),
        lines=one.lines(),
        then=one.then,
    )


@dataclass(frozen=True, eq=False)
class Scene:
    """A problem, its joint covariance, and the candidates."""

    start: Problem
    joint: Joint
    sigma: float  # of a new observation [px], by the median weight
    names: Mapping[int, str]  # of points, by row
    images: _Rows  # images that may have ties, and beside which new ones are tried
    free: _Rows  # points that can be control points or ends of bars
    unit: str  # " m", or "" for the unit of the model

    @staticmethod
    def of(prepared: Prepared, quantity: Quantity, out: Mapping[str, Any]) -> Scene:
        """Choose points and images, and compute their joint covariance."""
        start, weights, known = prepared.start, out["weights"], prepared.layout.known
        used = weights > 0
        rays = np.bincount(start.observation_point[used], minlength=start.num_points)
        rays[out["null_points"]] = 0
        share = np.zeros(start.num_points)
        np.add.at(share, start.observation_point[used], (out["along"][used] ** 2).sum(axis=1))
        own = np.asarray(quantity.points.any(axis=1))
        points = _chosen(start, np.flatnonzero((rays >= 2) | own), share)
        images = np.unique(start.observation_image[used])
        if len(images) > MOST_IMAGES:
            seeing = start.observation_image[used & np.isin(start.observation_point, points)]
            counts = np.bincount(seeing, minlength=start.num_images)[images]
            images = np.sort(images[np.argsort(-counts, kind="stable")[:MOST_IMAGES]])
        cameras = np.unique(start.image_camera[images])
        wanted = images.tolist(), cameras.tolist(), points.tolist()
        spread = 1.0 if start.observation_sigma is None else start.observation_sigma[used]
        keys = {key for one in (() if known is None else known.factors) for key in one.keys}
        by_id = {key: name for name, key in names_of_markers(prepared).items()}
        ids = {row: int(start.point_ids[row]) for row in wanted[2]}
        return Scene(
            start,
            joint_covariance(prepared, quantity, *wanted),
            float(np.median(spread / np.sqrt(weights[used]))),
            {row: by_id.get(key, f"point {key}") for row, key in ids.items()},
            images,
            np.array([row for row in ids if not own[row] and ("point", ids[row]) not in keys], int),
            length_unit(prepared),
        )

    def candidates(
        self, kinds: Sequence[str], poses: PoseTable | None, gcp: Sigma, bar: float
    ) -> Iterator[Candidate]:
        """Yield the candidates of these kinds."""
        if "image" in kinds:
            yield from self._near_images() if poses is None else self._given_images(poses)
        if "tie" in kinds:
            yield from self._ties()
        if "gcp" in kinds:
            yield from self._control_points(gcp)
        if "bar" in kinds:
            yield from self._bars(bar)

    def _near_images(self) -> Iterator[Candidate]:
        """Yield images beside the present ones, with the same direction."""
        start, centers = self.start, self.start.projection_centers[self.images]
        gaps = np.linalg.norm(centers[:, None] - centers, axis=2)
        gaps[gaps == 0] = np.inf
        nearest = gaps.min(axis=1)
        step = float(np.median(nearest[np.isfinite(nearest)])) if np.isfinite(nearest).any() else 0
        for image in self.images.tolist() if step else ():
            for x, y, side in SIDES:
                pose = start.cam_from_world[image].copy()
                pose[4:] -= step * np.array([x, y, 0.0])
                words = f"{number(step)}{self.unit} {side} {self._image(image)}"
                yield from self._image_at(pose, int(start.image_camera[image]), words)

    def _given_images(self, poses: PoseTable) -> Iterator[Candidate]:
        start, centers = self.start, self.start.projection_centers[self.images]
        for row, (given, name) in enumerate(zip(poses.poses, poses.names, strict=True)):
            near = self.images[np.linalg.norm(centers - given[4:], axis=1).argmin()]
            camera, pose = int(start.image_camera[near]), inverse_poses(given[None])[0]
            words = name or f"pose {row + 1}"
            count = len(view(start, pose, camera, np.unique(start.observation_point)).points)
            if count < LEAST_IN_VIEW:
                raise InputError(
                    f"candidates: expected poses with at least {LEAST_IN_VIEW} points of the model "
                    f"in view, found {words} with {count}"
                )
            yield from self._image_at(pose, camera, words)

    def _image_at(self, pose: _Floats, camera: int, words: str) -> Iterator[Candidate]:
        """Yield the image, unless it sees too little."""
        seen = view(self.start, pose, camera, np.array(list(self.joint.points)), self.sigma)
        m = len(seen.points)
        if m < LEAST_IN_VIEW:
            return
        own, params = seen.by_pose.reshape(2 * m, 6), seen.by_params.reshape(2 * m, -1)
        first = self.joint.cameras[camera]
        if (self.start.image_camera[self.images] == camera).sum() == 1 < len(self.images):
            variances = np.diag(self.joint.matrix)[first : first + params.shape[1]]
            own, params = np.hstack([own, params[:, variances > 0]]), params[:, :0]
        by_points = np.zeros((m, 2, m, 3))
        by_points[np.arange(m), :, np.arange(m)] = seen.by_point
        rows = np.hstack([params, by_points.reshape(2 * m, 3 * m)])
        own = own / np.maximum(np.linalg.norm(own, axis=0), 1e-300)
        places = [first + np.arange(params.shape[1]), *map(self._of_point, seen.points)]
        placed = " ".join(f"{value:.9g}" for value in pose[[3, 0, 1, 2, 4, 5, 6]])
        yield Candidate(
            "image",
            f"{words} ({plural(m, 'point')} in view)",
            Rows(np.concatenate(places), null_basis(own).T @ rows),
            lambda: (f"new {placed}",),
        )

    def _ties(self) -> Iterator[Candidate]:
        start, points = self.start, np.array(list(self.joint.points))
        for image in self.images.tolist():
            camera = int(start.image_camera[image])
            others = np.setdiff1d(points, start.observation_point[start.observation_image == image])
            seen = view(start, start.cam_from_world[image], camera, others, self.sigma)
            for point, xy, *by in zip(*seen, strict=True):
                places = [
                    self.joint.images[image] + np.arange(6),
                    self.joint.cameras[camera] + np.arange(by[1].shape[1]),
                    self._of_point(point),
                ]
                at = f"near {xy[0]:.0f}, {xy[1]:.0f} px"
                what = f"{self.names[int(point)]} also in {self._image(image)}, {at}"
                yield Candidate("tie", what, Rows(np.concatenate(places), np.hstack(by)))

    def _control_points(self, sigma: Sigma) -> Iterator[Candidate]:
        text = "/".join(dict.fromkeys(map(number, sigma))) + self.unit
        whitened = np.diag(1 / np.array([sigma[0], *sigma]))
        for point in self.free.tolist():
            lines = partial(self._marks, point, "X Y Z", "")
            rows = Rows(self._of_point(point), whitened)
            yield Candidate("gcp", f"{self.names[point]}, known to {text}", rows, lines, GCP)

    def _bars(self, sigma: float) -> Iterator[Candidate]:
        for b, a in itertools.combinations(self.free.tolist(), 2):
            along = self.start.points[a] - self.start.points[b]
            length = float(np.linalg.norm(along))
            if length > 0:
                u = along / (length * sigma)
                places = np.concatenate([self._of_point(a), self._of_point(b)])
                what = f"{self.names[b]} to {self.names[a]}, now {number(length)}{self.unit}"
                lines = partial(self._ends, b, a, f"LENGTH {sigma:g}")
                yield Candidate("bar", what, Rows(places, np.hstack([u, -u])[None]), lines, BARS)

    def _ends(self, a: int, b: int, length: str) -> tuple[str, ...]:
        """Return the marks of both ends, whose positions are not measured, and the bar."""
        marks = [
            line
            for end in (a, b)
            for line in self._marks(
                end, " ".join(f"{x:.9g}" for x in self.start.points[end]), " sigma=1000"
            )
        ]
        return (*marks, f"{self._label(a)} {self._label(b)} {length}")

    def _marks(self, point: int, position: str, more: str) -> tuple[str, ...]:
        """Return lines of gcp_list.txt, where the centre of the first pixel is (0, 0)."""
        start = self.start
        rows = np.flatnonzero(start.observation_point == point)[:MOST_LINES]
        end = f"{self._label(point)}{more}"
        pixels = (start.observation_xy[rows] - PIXEL_SHIFT).tolist()
        images = map(self._image, start.observation_image[rows].tolist())
        return tuple(
            f"{position} {x:.2f} {y:.2f} {shlex.quote(image)} {end}"
            for image, (x, y) in zip(images, pixels, strict=True)
        )

    def _of_point(self, point: int) -> _Rows:
        return self.joint.points[int(point)] + np.arange(3)

    def _label(self, point: int) -> str:
        return self.names[point].replace(" ", "_")

    def _image(self, image: int) -> str:
        return str(self.start.image_names[image] or f"image {self.start.image_ids[image]}")


def _chosen(start: Problem, rows: _Rows, share: _Floats) -> _Rows:
    """Return the points of the joint covariance among some, ascending."""
    if len(rows) <= MOST_POINTS:
        return rows
    by_share = rows[np.argsort(-share[rows], kind="stable")]
    chosen = by_share[: MOST_POINTS // 2].tolist()
    reach = np.linalg.norm(start.points[rows] - np.median(start.points[rows], axis=0), axis=1)
    near = rows[reach <= 3 * np.median(reach)]
    gaps = np.full(len(near), np.inf)
    for place in range(MOST_POINTS):
        if place == len(chosen):
            chosen.append(int(near[gaps.argmax()]))
        apart = np.linalg.norm(start.points[near] - start.points[chosen[place]], axis=1)
        gaps = np.minimum(gaps, apart)
    return np.unique(chosen)
