"""Counts, distributions, reprojection errors and rigs of a problem."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.track_table import Covisibility, covisibility
from bundle.analysis.statistics.suspicions import (
    Depths,
    count_repeated,
    depths_of_observations,
    summarize,
    suspicions,
)
from bundle.base.arrays import distinct
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import number, pixels, plural
from bundle.errors import InputError
from bundle.interface.finding import Finding
from bundle.interface.tabular import Tabular
from bundle.io.files import Source, as_problem
from bundle.model.cameras import camera_models, param_kinds
from bundle.model.problem import Problem
from bundle.model.residuals import (
    ImageError,
    ReprojectionError,
    reprojection_errors,
    resolve_cheirality,
    summarize_errors,
    worst_of_errors,
)
from bundle.model.rig_arrays import reference_cameras, rig_of_image


@dataclass(frozen=True, kw_only=True)
class Distribution:
    """Distribution of whole numbers; every statistic is NaN if there are no numbers.

    ``histogram`` holds (low, high, count), both ends inclusive; each bin is twice as wide as the
    previous one: 0, 1, 2, 3-4, 5-8, 9-16, ... Empty bins outside the range are left out.
    """

    min: float
    median: float
    mean: float
    max: float
    histogram: tuple[tuple[int, int, int], ...]


@dataclass(frozen=True, kw_only=True)
class CameraGroup:
    """Cameras of one model.

    Attributes:
        model: COLMAP's name.
        num_cameras: cameras of this model.
        num_images: images that use one of them.
        images_per_camera: min and max number of images that share one of them.
        focal: smallest and largest focal length in pixels; None for an unknown model.
        supported: True if bundle can refine this model.
    """

    model: str
    num_cameras: int
    num_images: int
    images_per_camera: tuple[int, int]
    focal: tuple[float, float] | None
    supported: bool


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Description(Displayed, Tabular):
    """Description of a problem.

    Attributes:
        cameras: one entry per camera model, the most frequent first.
        track_length: distribution of observations per point.
        observations_per_image: distribution of observations per image.
        covisibility: covisibility graph of the images.
        reprojection_error: pixels, at the problem's values; None for an unknown camera model.
        depths: depths of observed points in their cameras, in the reconstruction's length unit.
        num_repeated_observations: observations whose track contains the same image before; COLMAP
            creates such tracks, and they are no error.
        worst_images: images with the largest errors; empty for an unknown camera model.
        suspicions: possible errors, most severe first.
        rigs: rigs of several sensors, by id.
    """

    cameras: tuple[CameraGroup, ...]
    track_length: Distribution
    observations_per_image: Distribution
    covisibility: Covisibility
    reprojection_error: ReprojectionError | None
    depths: Depths
    num_repeated_observations: int
    worst_images: tuple[ImageError, ...]
    suspicions: tuple[Finding, ...]
    rigs: tuple[RigSummary, ...] = ()

    def _display(self) -> Display:
        error = self.reprojection_error
        models = ", ".join(f"{plural(g.num_cameras, 'camera')} {g.model}" for g in self.cameras)
        rmse = "unknown" if error is None else f"RMSE {pixels(error.rmse)} px"
        pieces = plural(len(self.covisibility.component_sizes), "connected piece")
        facts = [
            ("cameras", models or "none"),
            ("track length", f"mean {number(self.track_length.mean)}"),
            ("observations", f"mean {number(self.observations_per_image.mean)} per image"),
            ("covisibility", pieces),
            ("error", rmse),
        ]
        facts += [
            (
                "rig",
                f"{rig.rig_id}: {plural(len(rig.sensors), 'sensor')}, "
                f"{plural(rig.num_frames, 'frame')}",
            )
            for rig in self.rigs
        ]
        facts += [("suspicion", suspicion.sentence) for suspicion in self.suspicions]
        return Display(title="Description", facts=tuple(facts))


# Numbers of a valid problem may be as large as a double: an overflow becomes infinite and is
# reported.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def describe(problem: Source) -> Description:
    """Describe a problem, as `bundle info` does.

    Args:
        problem: Problem, also one that cannot be refined, path of one, or pycolmap.Reconstruction.

    Returns:
        A :class:`Description`; it keeps no reference to the problem.

    Raises:
        InputError: the argument is not a problem.
        OSError: the path cannot be read.
    """
    problem = as_problem(problem)
    graph = covisibility(problem)
    depths = depths_of_observations(problem)
    errors: NDArray[np.float64] | None
    try:
        errors, behind = reprojection_errors(problem)
        error = summarize_errors(errors.copy(), behind, resolve_cheirality(problem, "auto"))
        worst = worst_of_errors(problem, errors, behind)
    except InputError:  # an unsupported camera model, which `suspicions` reports
        errors, error, worst = None, None, ()
        behind = np.zeros(problem.num_observations, bool)
    return Description(
        cameras=_camera_groups(problem),
        track_length=_distribution(_counts(problem.observation_point, problem.num_points)),
        observations_per_image=_distribution(
            _counts(problem.observation_image, problem.num_images)
        ),
        covisibility=graph,
        reprojection_error=error,
        depths=summarize(depths),
        num_repeated_observations=count_repeated(problem),
        worst_images=worst,
        suspicions=suspicions(problem, graph, errors, behind, depths),
        rigs=rig_summaries(problem),
    )


def _counts(index: NDArray[np.int32], size: int) -> NDArray[np.int64]:
    return np.bincount(index, minlength=size)


def _distribution(values: NDArray[np.int64]) -> Distribution:
    if len(values) == 0:
        nan = float("nan")
        return Distribution(min=nan, median=nan, mean=nan, max=nan, histogram=())
    # Bin of v: 0, 1 and then 1 + ceil(log2(v)).
    exponent = np.ceil(np.log2(np.maximum(values, 1))).astype(np.int64)
    counts = np.bincount(np.where(values == 0, 0, 1 + exponent))
    filled = np.flatnonzero(counts)
    edges = [(0, 0), (1, 1)] + [(2**k // 2 + 1, 2**k) for k in range(1, len(counts))]
    histogram = tuple((*edges[b], int(counts[b])) for b in range(filled[0], filled[-1] + 1))
    return Distribution(
        min=float(values.min()),
        median=float(np.median(values)),
        mean=float(values.mean()),
        max=float(values.max()),
        histogram=histogram,
    )


def _camera_groups(problem: Problem) -> tuple[CameraGroup, ...]:
    models = np.array(problem.camera_models, dtype=str)
    images = np.bincount(problem.image_camera, minlength=problem.num_cameras)
    groups = [
        CameraGroup(
            model=str(model),
            num_cameras=int((members := models == model).sum()),
            num_images=int(images[members].sum()),
            images_per_camera=(int(images[members].min()), int(images[members].max())),
            focal=_focal_range(str(model), problem.camera_params[members]),
            supported=str(model) in camera_models(),
        )
        for model in np.unique(models)
    ]
    return tuple(sorted(groups, key=lambda group: (-group.num_images, group.model)))


def _focal_range(model: str, params: NDArray[np.float64]) -> tuple[float, float] | None:
    if model not in camera_models():
        return None
    focal = params[:, [i for i, kind in enumerate(param_kinds(model)) if kind == "focal"]]
    return (float(focal.min()), float(focal.max())) if focal.size else None


@dataclass(frozen=True, kw_only=True)
class SensorSummary:
    """Camera of a rig.

    Attributes:
        camera_id: id in the source.
        is_reference: True if the pose of the rig is that of this camera.
        baseline: distance from the rig's origin (the reference sensor) in the reconstruction's
            length unit.
        num_images: number of its images.
        num_observations: observations in these images; a sensor without any is not refined.
    """

    camera_id: int
    is_reference: bool
    baseline: float
    num_images: int
    num_observations: int


@dataclass(frozen=True, kw_only=True)
class RigSummary:
    """Rig of several sensors.

    Attributes:
        rig_id: id in the source.
        num_frames: number of frames with an image.
        num_images: number of images in these frames.
        sensors: the reference sensor first if it has images, then those with a known
            sensor_from_rig.
    """

    rig_id: int
    num_frames: int
    num_images: int
    sensors: tuple[SensorSummary, ...]


def rig_summaries(problem: Problem) -> tuple[RigSummary, ...]:
    """Return the rigs of a problem by id; () if every image has its own pose."""
    if not problem.num_frames:
        return ()
    rig = rig_of_image(problem)
    observed = np.bincount(problem.observation_image, minlength=problem.num_images)
    references = reference_cameras(problem)
    baselines = np.linalg.norm(problem.sensor_from_rig[:, 4:], axis=1)

    def sensor(camera_id: int, row: int, rig_id: int) -> SensorSummary:
        images = (rig == rig_id) & (problem.image_sensor == row)
        return SensorSummary(
            camera_id=camera_id,
            is_reference=row < 0,
            baseline=0.0 if row < 0 else float(baselines[row]),
            num_images=int(images.sum()),
            num_observations=int(observed[images].sum()),
        )

    summaries = []
    for rig_id in distinct(problem.frame_rig_ids).tolist():
        rows = np.flatnonzero(problem.sensor_rig_ids == rig_id).tolist()
        first = [sensor(references[rig_id], -1, rig_id)] if rig_id in references else []
        others = [sensor(int(problem.sensor_camera_ids[row]), row, rig_id) for row in rows]
        used = distinct(problem.image_frame[rig == rig_id])
        summaries.append(
            RigSummary(
                rig_id=rig_id,
                num_frames=len(used),
                num_images=int((rig == rig_id).sum()),
                sensors=(*first, *others),
            )
        )
    return tuple(summaries)
