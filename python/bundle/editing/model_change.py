"""Change of camera models that preserves the pixels.

The conversion is exact if the new model can represent the old lens (``exact_image``). Otherwise the
new parameters are fitted (``lens_fit``) in the image region with observations (``lens_region``).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import as_integers
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import pixels, plural
from bundle.errors import InputError
from bundle.interface.option_fields import choice
from bundle.io.files import Source, as_problem
from bundle.model.cameras import camera_models, project
from bundle.model.lenses.exact_image import exact_params
from bundle.model.lenses.lens_fit import fit_lens, lens_region
from bundle.model.problem import Problem

BAD_FIT = 1.0  # largest error in pixels of an observation without a warning

MOST_WARNINGS = 5

_SPHERE = "EQUIRECTANGULAR"


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraModelChange:
    """Result for one camera.

    Attributes:
        camera_id: id in the problem.
        old_model: COLMAP's name of the old model.
        new_model: COLMAP's name of the new model.
        before: old parameters by name.
        after: new parameters by name.
        exact: True if the new lens equals the old one; False if it was fitted.
        converged: True if the fit ended in a minimum, and for exact conversions.
        rms: root mean square distance of old and new pixels at the camera's observations; without
            observations, at the fitted pixels. 0 if exact.
        max: largest distance of old and new pixels.
        num_observations: number of compared observations; 0: pixels of the grid were compared.
        num_without_ray: further observations at pixels where the old lens has no ray.
    """

    camera_id: int
    old_model: str
    new_model: str
    before: dict[str, float]
    after: dict[str, float]
    exact: bool
    converged: bool
    rms: float
    max: float
    num_observations: int
    num_without_ray: int


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ChangedModels(Displayed):
    """Problem with other camera models.

    Attributes:
        problem: new problem; the given problem if no camera changed.
        changes: one record per camera that had another model.
        warnings: one sentence for each of the worst fits whose error exceeds a pixel or that did
            not converge.
    """

    problem: Problem
    changes: tuple[CameraModelChange, ...]
    warnings: tuple[str, ...]

    def _display(self) -> Display:
        rows = tuple(
            (f"{change.camera_id} {change.old_model}", pixels(change.rms), pixels(change.max))
            for change in self.changes[:10]
        )
        model = f" {self.changes[0].new_model}" if self.changes else ""
        return Display(
            title=f"{plural(len(self.changes), 'camera')} changed{f' to{model}' if model else ''}",
            facts=tuple(("warning", sentence) for sentence in self.warnings),
            head=("camera", "rms [px]", "max [px]") if rows else (),
            rows=rows,
        )


def change_camera_model(
    problem: Source, model: str, camera_ids: Iterable[int] | None = None
) -> ChangedModels:
    """Give cameras another model that reproduces the pixels of the old one as well as possible.

    The conversion is exact if the new model can represent the old lens: a larger model of the same
    family, or a smaller model if the missing coefficients are zero. Otherwise the new lens is
    fitted over the image up to the farthest observation, and the error of the fit is reported.
    Poses and points do not change. See docs/lenses.md.

    Args:
        problem: Problem, path of one, or pycolmap.Reconstruction; not modified.
        model: COLMAP's name, from ``bundle.camera_models()``.
        camera_ids: ids of the cameras to change; None: all.

    Raises:
        InputError: a model or camera does not exist; a model is EQUIRECTANGULAR, which does not
            describe a lens; observations are 90 degrees or more from the axis, where the new model
            has no projection; or no fit exists.
        OSError: the path cannot be read.

    Example:
        >>> changed = bundle.change_camera_model("sparse/0", "OPENCV")
        >>> result = bundle.solve(changed.problem)
    """
    problem = as_problem(problem)
    model = choice("model", model, camera_models())
    cameras = [
        camera for camera in _cameras(problem, camera_ids) if problem.camera_models[camera] != model
    ]
    if not cameras:
        return ChangedModels(problem=problem, changes=(), warnings=())
    names = camera_models()
    models = list(problem.camera_models)
    params = np.zeros((problem.num_cameras, max(problem.camera_params.shape[1], len(names[model]))))
    params[:, : problem.camera_params.shape[1]] = problem.camera_params
    observed = _ObservedPixels(problem)
    changes = []
    for camera in cameras:
        new, change = _changed(problem, camera, model, observed.of(camera))
        changes.append(change)
        models[camera] = model
        params[camera] = 0.0
        params[camera, : len(new)] = new
    width = max(len(names[name]) for name in models)
    return ChangedModels(
        problem=problem.replace(camera_models=tuple(models), camera_params=params[:, :width]),
        changes=tuple(changes),
        warnings=_warnings(changes),
    )


class _ObservedPixels:
    """Pixels of the observations of each camera."""

    def __init__(self, problem: Problem) -> None:
        camera = problem.image_camera[problem.observation_image]
        self._order = np.argsort(camera, kind="stable")
        self._ends = np.cumsum(np.bincount(camera, minlength=problem.num_cameras))
        self._xy = problem.observation_xy

    def of(self, camera: int) -> NDArray[np.float64]:
        start = self._ends[camera - 1] if camera else 0
        return self._xy[self._order[start : self._ends[camera]]]


def _cameras(problem: Problem, camera_ids: Iterable[int] | None) -> list[int]:
    """Return the indices of cameras by their ids."""
    if camera_ids is None:
        return list(range(problem.num_cameras))
    index = {key: camera for camera, key in enumerate(problem.camera_ids.tolist())}
    found = dict.fromkeys(as_integers("camera_ids", camera_ids).ravel().tolist())
    for key in found:
        if key not in index:
            raise InputError(f"camera_ids: camera {key} is not in the problem")
    return [index[key] for key in found]


def _changed(
    problem: Problem, camera: int, model: str, observed: NDArray[np.float64]
) -> tuple[NDArray[np.float64], CameraModelChange]:
    """Return the new parameters of a camera and its result record."""
    old_model, camera_id = problem.camera_models[camera], int(problem.camera_ids[camera])
    if _SPHERE in (model, old_model):
        raise InputError(
            f"camera {camera_id}: expected two lens models, found a change from {old_model} to "
            f"{model}: {_SPHERE} is an image of the whole sphere"
        )
    names = camera_models()
    old = problem.camera_params[camera, : len(names[old_model])]
    new = exact_params(old_model, old, model)
    exact, converged, errors = new is not None, True, np.zeros(1)
    num_observations, num_without_ray = len(observed), 0
    if new is None:
        what = f"camera {camera_id} ({old_model})"
        region = lens_region(what, old_model, old, model, problem.camera_sizes[camera], observed)
        fit = fit_lens(model, (old_model, old), region.grid_rays, region.grid)
        if fit is None:
            raise InputError(f"{what}: no lens of model {model} is close to it")
        new, converged = fit
        num_observations, num_without_ray = len(region.observed), region.num_without_ray
        rays, xy = region.grid_rays, region.grid
        if num_observations:
            rays, xy = region.observed_rays, region.observed
        errors = np.linalg.norm(project(model, new, rays)[0] - xy, axis=1)
        if np.isnan(errors).any():
            raise InputError(
                f"{what}: expected {model} to project {plural(len(xy), 'observation')}, but it "
                f"cannot project {np.isnan(errors).sum()}"
            )
    return new, CameraModelChange(
        camera_id=camera_id,
        old_model=old_model,
        new_model=model,
        before=dict(zip(names[old_model], old.tolist(), strict=True)),
        after=dict(zip(names[model], new.tolist(), strict=True)),
        exact=exact,
        converged=converged,
        rms=float(np.sqrt(np.mean(errors**2))),
        max=float(errors.max()),
        num_observations=num_observations,
        num_without_ray=num_without_ray,
    )


def _warnings(changes: list[CameraModelChange]) -> tuple[str, ...]:
    bad = [change for change in changes if change.max > BAD_FIT or not change.converged]
    bad.sort(key=lambda change: -change.max)
    sentences = [
        (
            f"Camera {change.camera_id}: {change.new_model} differs from {change.old_model} "
            f"by up to {pixels(change.max)} px (rms {pixels(change.rms)} "
            f"px){'' if change.converged else '; the fit did not converge'}."
        )
        for change in bad[:MOST_WARNINGS]
    ]
    if len(bad) > MOST_WARNINGS:
        others = plural(len(bad) - MOST_WARNINGS, "other camera")
        sentences.append(f"{others} likewise: differences above {BAD_FIT:g} px, or no convergence.")
    return tuple(sentences)
