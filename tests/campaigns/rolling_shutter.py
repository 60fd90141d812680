"""Solves of filmed scenes with rolling shutters against the Cramer-Rao bound.

python -m tests.campaigns.rolling_shutter [SCENES] [SEED]

Each scene (phone walk, drone grid, car, in turn; readout 10 to 30 ms of a frame of 33 ms) is solved
with free twists from its start, from the solution with global shutters, and from the truth, and
with tied twists, positions and an estimated readout. Errors of positions are after the best
similarity. Their prediction is dense: Jacobians by rows of the truth, points eliminated, the seven
similarities projected out.

A line per scene; at the end the mean ratio of errors to predictions, the root mean square of
(readout - truth) / sigma, and the number of planar collapses: solves whose positions are off by
more than four predictions.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

import bundle
from bundle.interface.scene_options import SceneOptions
from bundle.model.reprojection import linearize
from bundle.synthetic.video.video_scene import FilmedScene, film
from tests.rolling import still

SCENES = ("orbit", "drone_grid", "street")
NOISE = 0.5
PRIOR_SIGMA = {"orbit": 0.02, "drone_grid": 0.05, "street": 0.05}
EXACT = {"function_tolerance": 1e-10, "max_num_iterations": 200}
REFINE = ("poses", "points")


@dataclass(frozen=True)
class Outcome:
    """Errors of one scene, in units of their predictions."""

    scene: str
    readout: float
    free: float
    from_global: float
    from_truth: float
    of_global: float
    tied_z: float
    tied: float
    same_cost: bool

    @property
    def collapses(self) -> int:
        return int(max(self.free, self.from_global, self.from_truth) > 4)

    def __str__(self) -> str:
        return (
            f"{self.scene:11s} readout {self.readout:.2f}: error / prediction {self.free:.2f}, "
            f"from global {self.from_global:.2f}, from the truth {self.from_truth:.2f}, global "
            f"shutters {self.of_global:.1f}; tied {self.tied:.2f}, readout z {self.tied_z:+.2f}"
            f"{'' if self.same_cost else ', minima differ'}"
        )


def make(number: int, seed: int, **changes: object) -> FilmedScene:
    rng = np.random.default_rng([seed, number])
    options = SceneOptions(
        **{
            "scene": SCENES[number % 3],
            "rolling_shutter": float(rng.uniform(0.3, 0.9)),
            "seed": int(rng.integers(1 << 30)),
            "num_images": 30,
            "num_points": 700,
            "pixel_noise": NOISE,
            "outlier_share": 0.0,
            "focal_noise": 0.0,
            "distortion_noise": 0.0,
            **changes,
        }
    )
    made = film(options)
    sigma = np.full(made.problem.num_observations, NOISE)
    truth = made.ground_truth.replace(observation_sigma=sigma)
    start = made.problem.replace(
        observation_sigma=sigma, camera_params=made.ground_truth.camera_params
    )
    return FilmedScene(
        **{**vars(made), "problem": start, "ground_truth": truth},
    )


def predicted(truth: bundle.Problem) -> float:
    """Root mean square error of positions by the Cramer-Rao bound, free twists."""
    found = linearize(truth)
    count, points = truth.num_images, truth.num_points
    jacobian = np.concatenate([found.d_pose, found.d_twist], axis=2) / NOISE
    by_point = found.d_point / NOISE
    information = np.zeros((12 * count, 12 * count))
    own = np.zeros((points, 3, 3))
    mixed = np.zeros((points, 12 * count, 3))
    for image in range(count):
        mine = truth.observation_image == image
        block = slice(12 * image, 12 * image + 12)
        rows = jacobian[mine]
        information[block, block] = np.einsum("nri,nrj->ij", rows, rows)
        which = truth.observation_point[mine]
        mixed[which, block] += np.einsum("nri,nrj->nij", rows, by_point[mine])
    np.add.at(own, truth.observation_point, np.einsum("nri,nrj->nij", by_point, by_point))
    solved = np.linalg.solve(own, mixed.transpose(0, 2, 1))
    information -= np.einsum("nia,naj->ij", mixed, solved)
    scale = np.sqrt(np.diag(information))
    values, vectors = np.linalg.eigh(information / scale / scale[:, None])
    inverse = np.where(np.arange(len(values)) < 7, 0, 1 / np.maximum(values, 1e-300))
    covariance = (vectors * inverse) @ vectors.T / scale / scale[:, None]
    centres = truth.projection_centers
    by_pose = np.zeros((3 * count, 12 * count))
    for image in range(count):
        pose = bundle_matrix(truth, image)
        rotation, t = pose[:3, :3], pose[:3, 3]
        block = slice(3 * image, 3 * image + 3)
        by_pose[block, 12 * image : 12 * image + 3] = -rotation.T @ cross(t)
        by_pose[block, 12 * image + 3 : 12 * image + 6] = -rotation.T
    moves = np.zeros((3 * count, 7))
    arm = centres - centres.mean(axis=0)
    for image in range(count):
        block = slice(3 * image, 3 * image + 3)
        moves[block, :3] = np.eye(3)
        moves[block, 3:6] = -cross(arm[image])
        moves[block, 6] = arm[image]
    kept = np.eye(3 * count) - moves @ np.linalg.pinv(moves)
    of_centres = kept @ (by_pose @ covariance @ by_pose.T) @ kept
    return float(np.sqrt(np.trace(of_centres) / count))


def cross(v: np.ndarray) -> np.ndarray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def bundle_matrix(problem: bundle.Problem, image: int) -> np.ndarray:
    from tests.rolling import matrices

    return matrices(problem)[image]


def position_error(problem: bundle.Problem, truth: bundle.Problem) -> float:
    """Root mean square distance of positions after the best similarity (Umeyama 1991)."""
    a, b = problem.projection_centers, truth.projection_centers
    from_a, from_b = a - a.mean(axis=0), b - b.mean(axis=0)
    u, d, vt = np.linalg.svd(from_b.T @ from_a)
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = (d * sign).sum() / (from_a**2).sum()
    moved = scale * from_a @ (u * sign @ vt).T
    return float(np.sqrt(((moved - from_b) ** 2).sum(axis=1).mean()))


def run(number: int, seed: int = 0, **changes: object) -> Outcome:
    made = make(number, seed, **changes)
    truth, start = made.ground_truth, made.problem
    bound = predicted(truth)
    options = {"refine": REFINE, **EXACT}
    plain = bundle.solve(start.replace(rolling_shutter=None), **options).problem
    free = bundle.solve(start, **options)
    on = bundle.solve(plain.replace(rolling_shutter=still(truth).rolling_shutter), **options)
    ideal = bundle.solve(truth, **options)
    rng = np.random.default_rng(seed + 1)
    sigma = PRIOR_SIGMA[SCENES[number % 3]]
    priors = [
        bundle.PositionPrior(int(key), centre + sigma * rng.standard_normal(3), sigma)
        for key, centre in zip(truth.image_ids, truth.projection_centers, strict=True)
    ]
    shutter = start.rolling_shutter
    guessed = start.replace(
        rolling_shutter=shutter.replace(readout=np.full(start.num_cameras, 0.5))
    )
    ties = {
        "twists": "tied",
        "twist_sigma": tuple(made.readout * np.asarray(made.shake)),
        "refine_readout": True,
    }
    tied = bundle.solve(guessed, priors=priors, **ties, **options)
    spread = bundle.covariance(
        tied.problem, tied.options, of="intrinsics", priors=priors
    ).readout_covariance
    last = tied.problem.rolling_shutter
    costs = [one.summary.final_cost for one in (free, on, ideal)]
    return Outcome(
        SCENES[number % 3],
        made.readout,
        position_error(free.problem, truth) / bound,
        position_error(on.problem, truth) / bound,
        position_error(ideal.problem, truth) / bound,
        position_error(plain, truth) / bound,
        float((last.readout[0] - made.readout) / np.sqrt(spread[0])),
        position_error(tied.problem, truth) / bound,
        bool(np.ptp(costs) < 1e-6 * min(costs)),
    )


def main(count: int = 50, seed: int = 0) -> None:
    outcomes = []
    for number in range(count):
        outcomes.append(run(number, seed))
        print(f"{number:3d} {outcomes[-1]}", flush=True)
    for scene in (*SCENES, ""):
        of = [one for one in outcomes if one.scene == scene or not scene]
        if not of:
            continue
        z = np.sqrt(np.mean([one.tied_z**2 for one in of]))
        print(
            f"{scene or 'all':11s} mean error / prediction {np.mean([o.free for o in of]):.3f}, "
            f"from global {np.mean([o.from_global for o in of]):.3f}, readout z rms {z:.2f}, "
            f"collapses {sum(o.collapses for o in of)} of {len(of)}"
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
