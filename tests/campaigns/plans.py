"""Plans followed: is the true error with a proposal as small as predicted?

A scene with noise is solved, and its best image, tie, control point or scale bar for a length is
asked for. Many times over, all measurements are then drawn anew from the truth, with and without
the proposed one, and solved. With e the error of the length and s the predicted sigma, the mean of
(e / s)^2 has to be 1 before and after, and the ratio of the errors that of the sigmas.

python -m tests.campaigns.plans SCENES [REPEATS] [SEED]
"""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

import numpy as np

import bundle
from bundle.analysis.uncertainty import measurement_plan as planning
from bundle.analysis.uncertainty.covariance_by_input import request_at
from bundle.analysis.uncertainty.influence import differentiate
from bundle.analysis.uncertainty.quantity import quantity_of

SCENES = ("street", "orbit", "drone_grid", "photo_collection")
KINDS = ("image", "tie", "gcp", "bar")
NOISE, SIZE = 0.5, (1280, 960)
SOLVED: dict[str, Any] = {"num_threads": 1, "check_solution": False}


class Followed(NamedTuple):
    """Errors of one scene in predicted sigmas, without and with the proposal."""

    scene: str
    kind: str
    predicted: float  # ratio of the sigmas after and before
    before: np.ndarray  # (repeats,)
    after: np.ndarray  # (repeats,)

    @property
    def measured(self) -> float:
        """Ratio of the true errors after and before."""
        return float(self.predicted * np.sqrt((self.after**2).mean() / (self.before**2).mean()))


class _World:
    """The truth, the length, its control points, and measurements drawn from them."""

    def __init__(self, name: str, kind: str, seed: int) -> None:
        made = bundle.synthesize(
            scene=name, num_images=8, num_points=60, pixel_noise=0, image_size=SIZE, seed=seed
        )
        truth = made.ground_truth
        exact = bundle.reprojection_errors(made.problem.replace(**_values(truth)))[0].max()
        assert exact < 1e-6
        sigmas = np.full(truth.num_observations, NOISE)
        self.truth = truth.replace(
            observation_xy=made.problem.observation_xy, observation_sigma=sigmas
        )
        self.rng = np.random.default_rng(seed)
        rays = np.bincount(truth.observation_point, minlength=truth.num_points)
        rows = np.flatnonzero(rays >= 4)
        rows = rows if len(rows) >= 8 else np.argsort(-rays, kind="stable")[:8]
        chosen = self.rng.permutation(rows)[:5]
        self.control, ends = chosen[:3], truth.point_ids[chosen[3:]]
        extent = np.linalg.norm(truth.points[rows].std(axis=0))
        self.sigma = 0.003 * float(extent)
        self.text = f"distance {ends[0]} {ends[1]}"
        self.has_datum = kind in ("gcp", "bar")
        if not self.has_datum:
            self.text += f" / baseline {truth.image_ids[0]} {truth.image_ids[-1]}"
        self.value = self.length(self.truth)

    def length(self, problem: bundle.Problem) -> float:
        """Return the quantity of a problem."""
        return quantity_of(self.text, problem, {}).value

    def known(self, rows: np.ndarray) -> list[bundle.PriorFactor]:
        """Return control points with errors."""
        return [
            bundle.PriorFactor(
                ("point", int(self.truth.point_ids[row])),
                self.truth.points[row] + self.rng.normal(0, self.sigma, 3),
                np.eye(3) / self.sigma**2,
            )
            for row in rows
        ]

    def drawn(self, problem: bundle.Problem) -> bundle.Problem:
        """Return a problem with noise."""
        noise = self.rng.normal(0, NOISE, problem.observation_xy.shape)
        return problem.replace(observation_xy=problem.observation_xy + noise)


def _values(truth: bundle.Problem) -> dict[str, Any]:
    names = ("cam_from_world", "camera_params", "points")
    return {name: getattr(truth, name) for name in names}


def follow(seed: int, repeats: int = 10) -> Followed | None:
    """Plan for one scene, and follow the proposal many times; None without one."""
    name, kind = SCENES[seed % 4], KINDS[seed // 4 % 4]
    try:
        world = _World(name, kind, seed)
    except bundle.InputError:  # a scene in two parts
        return None
    control = world.known(world.control) if world.has_datum else []
    model = bundle.solve(world.drawn(world.truth), factors=control, align=False, **SOLVED).problem
    sigmas = {"gcp_sigma": world.sigma, "bar_sigma": world.sigma}
    try:
        found = bundle.plan(
            model, world.text, add=kind, count=1, factors=control, align=False, **sigmas
        )
    except bundle.InputError:
        return None
    (one,) = found.together
    larger, new_points, bar = _with(world, model, one, control)
    before, after = [], []
    for _ in range(repeats):
        known = world.known(world.control) if world.has_datum else []
        noisy = world.drawn(larger)
        count = world.truth.num_observations
        plain = world.truth.replace(observation_xy=noisy.observation_xy[:count])
        without = bundle.solve(plain, factors=known, align=False, **SOLVED).problem
        before.append((world.length(without) - world.value) / one.sigma_before)
        more = []
        if bar is not None:
            ends = world.truth.points[list(bar)]
            length = np.linalg.norm(ends[0] - ends[1]) + world.rng.normal(0, world.sigma)
            keys = [("point", int(world.truth.point_ids[row])) for row in bar]
            more = [bundle.ScaleBar(*keys, float(length), world.sigma)]
        whole = bundle.solve(
            noisy, factors=[*known, *world.known(new_points)], priors=more, align=False, **SOLVED
        )
        after.append((world.length(whole.problem) - world.value) / one.sigma_after)
    ratio = one.sigma_after / one.sigma_before
    return Followed(name, kind, ratio, np.array(before), np.array(after))


def _with(
    world: _World, model: bundle.Problem, one: planning.Proposal, control: list[Any]
) -> tuple[bundle.Problem, np.ndarray, tuple[int, int] | None]:
    """Return the truth with a proposal: its observations, new control points, and a bar."""
    given: dict[str, Any] = {"factors": control, "priors": (), "align": False, "bounds": None}
    request = request_at(model, None, {}, "plan", constraints=(), **given)
    scene = planning.Scene.of(*differentiate(request, world.text))
    sigma = planning.parse_sigma("gcp_sigma", world.sigma)
    found = scene.candidates((one.kind,), None, sigma, world.sigma)
    rows = next(other for other in found if other.what == one.what).rows
    points = [row for row, place in scene.joint.points.items() if place in rows.columns]
    truth, none = world.truth, np.zeros(0, int)
    if one.kind == "gcp":
        return truth, np.array(points), None
    if one.kind == "bar":
        return truth, none, (points[0], points[1])
    if one.kind == "tie":
        image = next(i for i, place in scene.joint.images.items() if place in rows.columns)
        pose = truth.cam_from_world[image]
    else:
        image = truth.image_names.index(one.what.partition(" (")[0].split()[-1])  # beside it
        pose = np.array(one.lines[0].split()[1:], float)[[1, 2, 3, 0, 4, 5, 6]]
    camera = int(truth.image_camera[image])
    view = planning.view(truth, pose, camera, np.array(points))
    count = len(view.points)
    if one.kind == "image":
        image = truth.num_images
        if (truth.image_camera == camera).sum() == 1:  # each image has a camera of its own
            names = ("camera_params", "camera_sizes")
            arrays = {name: getattr(truth, name) for name in names}
            truth = truth.replace(
                camera_ids=np.append(truth.camera_ids, truth.camera_ids.max() + 1),
                camera_models=(*truth.camera_models, truth.camera_models[camera]),
                **{name: np.vstack([one, one[camera]]) for name, one in arrays.items()},
            )
            camera = truth.num_cameras - 1
        truth = truth.replace(
            cam_from_world=np.vstack([truth.cam_from_world, pose]),
            image_camera=np.append(truth.image_camera, camera),
            image_ids=np.append(truth.image_ids, truth.image_ids.max() + 1),
            image_names=(*truth.image_names, "new.jpg"),
            observation_keypoint=None,
        )
    larger = truth.replace(
        observation_image=np.append(truth.observation_image, np.full(count, image)),
        observation_point=np.append(truth.observation_point, view.points),
        observation_xy=np.vstack([truth.observation_xy, view.xy]),
        observation_sigma=np.append(truth.observation_sigma, np.full(count, NOISE)),
        observation_keypoint=None,
    )
    return larger, none, None


def main(num_scenes: int, repeats: int = 10, seed: int = 0) -> None:
    """Print the errors of every scene and group."""
    done = []
    for k in range(num_scenes):
        one = follow(seed + k, repeats)
        if one is None:
            print(seed + k, "no scene or no candidate", flush=True)
            continue
        done.append(one)
        spread = np.sqrt((one.before**2).mean()), np.sqrt((one.after**2).mean())
        print(
            seed + k, one.scene, one.kind, f"predicted {one.predicted:.3f} true {one.measured:.3f} "
            f"errors in sigmas {spread[0]:.2f} {spread[1]:.2f}", flush=True,
        )  # fmt: skip
    for group in (*KINDS, *SCENES, ""):
        of_group = [one for one in done if group in (one.kind, one.scene, "")]
        if not of_group:
            continue
        before, after = (
            np.sqrt(np.mean(np.concatenate([getattr(one, name) for one in of_group]) ** 2))
            for name in ("before", "after")
        )
        print(
            f"{group or 'all'}: {len(of_group)} scenes, errors in sigmas {before:.3f} before, "
            f"{after:.3f} after, ratio {after / before:.3f}"
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
