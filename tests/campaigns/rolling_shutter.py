"""Solves of filmed scenes with rolling shutters against the Cramer-Rao bound.

python -m tests.campaigns.rolling_shutter [SCENES] [SEED]

Each scene (phone walk, drone grid, car, in turn; readout 10 to 30 ms of a frame of 33 ms) is solved
with free twists from its start, from the solution with global shutters, and from the truth, and
with tied twists, positions and an estimated readout. Errors of positions are after the best
similarity. Their prediction is dense: Jacobians by rows of the truth, points eliminated, the seven
similarities projected out.

The error of a drone's positions is nearly that of a single weak direction, a normal number: its
ratio to the prediction lies anywhere between 0 and 2.5, with a mean of 0.8. So the errors are also
measured by their own covariance: chi^2 per degree of freedom is near 1 if the prediction is right.

A line per scene; at the end the mean ratio of errors to predictions, the mean chi^2, the root mean
square of (readout - truth) / sigma, and the number of planar collapses: solves whose positions are
off by more than four predictions.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass

import numpy as np

import bundle
from bundle.interface.scene_options import SceneOptions
from bundle.model.residuals import linearize
from bundle.synthetic.video_scene import FilmedScene, film
from tests.rolling import matrices, still

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
    chi2: float
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
            f"shutters {self.of_global:.1f}; chi2 {self.chi2:.2f}; tied {self.tied:.2f}, readout z "
            f"{self.tied_z:+.2f}"
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


def predicted(truth: bundle.Problem) -> np.ndarray:
    """Covariance of positions by the Cramer-Rao bound, free twists, after the best similarity."""
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
    moving = kept_by_similarity(truth) @ centres_by_poses(truth)
    return moving @ covariance @ moving.T


def centres_by_poses(truth: bundle.Problem) -> np.ndarray:
    """Derivatives of positions by poses and twists, (3n, 12n)."""
    count = truth.num_images
    by_pose = np.zeros((3 * count, 12 * count))
    for image, pose in enumerate(matrices(truth)):
        rotation, t = pose[:3, :3], pose[:3, 3]
        block = slice(3 * image, 3 * image + 3)
        by_pose[block, 12 * image : 12 * image + 3] = -rotation.T @ cross(t)
        by_pose[block, 12 * image + 3 : 12 * image + 6] = -rotation.T
    return by_pose


def kept_by_similarity(truth: bundle.Problem) -> np.ndarray:
    """Projection of moves of positions to those that no similarity makes, (3n, 3n)."""
    centres = truth.projection_centers
    arm = centres - centres.mean(axis=0)
    moves = np.concatenate(
        [
            np.concatenate([np.eye(3), -cross(one), one[:, None]], axis=1)
            for one in arm / np.abs(arm).max()
        ]
    )
    return np.eye(len(moves)) - moves @ np.linalg.pinv(moves)


def cross(v: np.ndarray) -> np.ndarray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def position_errors(problem: bundle.Problem, truth: bundle.Problem) -> np.ndarray:
    """Differences (n, 3) of positions after the best similarity (Umeyama 1991)."""
    a, b = problem.projection_centers, truth.projection_centers
    from_a, from_b = a - a.mean(axis=0), b - b.mean(axis=0)
    u, d, vt = np.linalg.svd(from_b.T @ from_a)
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = (d * sign).sum() / (from_a**2).sum()
    return scale * from_a @ (u * sign @ vt).T - from_b


def position_error(problem: bundle.Problem, truth: bundle.Problem) -> float:
    """Root mean square distance of positions after the best similarity."""
    return float(np.sqrt((position_errors(problem, truth) ** 2).sum(axis=1).mean()))


def root_mean_square(covariance: np.ndarray) -> float:
    """Prediction of ``position_error``."""
    return float(np.sqrt(3 * np.trace(covariance) / len(covariance)))


def chi_squared(errors: np.ndarray, covariance: np.ndarray) -> float:
    """Squared errors by their covariance, per degree of freedom."""
    values, vectors = np.linalg.eigh(covariance)
    return float(((errors.ravel() @ vectors)[7:] ** 2 / values[7:]).mean())


def found_readout(solved: bundle.Result) -> float:
    """Refined readout, also where it ended outside the range of cameras and is only reported."""
    told = re.search(r"readout of camera \d+ ended at (\S+)", " ".join(solved.summary.warnings))
    return float(told.group(1) if told else solved.problem.rolling_shutter.readout[0])


def run(number: int, seed: int = 0, **changes: object) -> Outcome:
    made = make(number, seed, **changes)
    truth, start = made.ground_truth, made.problem
    covariance = predicted(truth)
    bound = root_mean_square(covariance)
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
    readout = found_readout(tied)
    last = tied.problem.rolling_shutter
    at = tied.problem.replace(rolling_shutter=last.replace(readout=np.clip([readout], 0.01, 1)))
    spread = bundle.covariance(at, tied.options, of="intrinsics", priors=priors).readout_covariance
    costs = [one.summary.final_cost for one in (free, on, ideal)]
    return Outcome(
        SCENES[number % 3],
        made.readout,
        position_error(free.problem, truth) / bound,
        position_error(on.problem, truth) / bound,
        position_error(ideal.problem, truth) / bound,
        position_error(plain, truth) / bound,
        chi_squared(position_errors(free.problem, truth), covariance),
        float((readout - made.readout) / np.sqrt(spread[0])),
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
            f"from global {np.mean([o.from_global for o in of]):.3f}, global shutters "
            f"{np.mean([o.of_global for o in of]):.1f}, chi2 {np.mean([o.chi2 for o in of]):.3f}, "
            f"readout z rms {z:.2f}, "
            f"collapses {sum(o.collapses for o in of)} of {len(of)}"
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
