"""Velocities as priors of filmed scenes, against the Cramer-Rao bound.

python -m tests.campaigns.velocities [SCENES] [SEED] [SIGMA]

Each scene (phone walk, drone grid, car, in turn) has measured positions, and velocities with SIGMA
m/s. It is solved from its start with free twists and a known readout, without and with velocities;
then with tied twists and an estimated readout that starts at 0.5. For each kind of scene: root mean
square errors of the speed that twists give [m/s] and of positions [m], both over their predictions
by the covariance at the truth; 2 cost / dof; mean and root mean square of (readout - truth) /
sigma, and the mean sigma over the truth.
"""

from __future__ import annotations

import sys

import numpy as np

import bundle
from tests.campaigns.rolling_shutter import EXACT, PRIOR_SIGMA, REFINE, SCENES, found_readout, make
from tests.rolling import matrices

RATE = 30.0


def with_rate(problem: bundle.Problem, **changes: object) -> bundle.Problem:
    shutter = problem.rolling_shutter
    return problem.replace(rolling_shutter=shutter.replace(frame_rate=RATE, **changes))


def priors_of(truth: bundle.Problem, readout: float, places: float, sigma: float, seed: int):
    """Measured positions, and measured velocities."""
    rng = np.random.default_rng([seed, 77])
    ids, shape = truth.image_ids.tolist(), (truth.num_images, 3)
    rotations = matrices(truth)[:, :3, :3]
    along = np.einsum("nji,nj->ni", rotations, truth.rolling_shutter.twist[:, 3:])
    speeds = -RATE / readout * along + sigma * rng.standard_normal(shape)
    centres = truth.projection_centers + places * rng.standard_normal(shape)
    positions = [bundle.PositionPrior(i, at, places) for i, at in zip(ids, centres, strict=True)]
    return positions, [bundle.VelocityPrior(i, v, sigma) for i, v in zip(ids, speeds, strict=True)]


def errors(found: bundle.Problem, truth: bundle.Problem, readout: float) -> np.ndarray:
    """Root mean square errors of the speed and of positions."""
    twists = (found.rolling_shutter.twist - truth.rolling_shutter.twist)[:, 3:] * RATE / readout
    places = found.projection_centers - truth.projection_centers
    return np.array([np.sqrt((of**2).sum(axis=1).mean()) for of in (twists, places)])


def predictions(truth: bundle.Problem, readout: float, priors: list[object]) -> np.ndarray:
    """The same by the covariance at the truth; positions by that of the translations."""
    found = bundle.covariance(truth, of="poses", priors=priors, refine=REFINE, scale="unit")
    twists = np.trace(found.twist_covariance[:, 3:, 3:], axis1=1, axis2=2).mean()
    places = 0.0
    for pose, block in zip(matrices(truth), found.pose_covariance, strict=True):
        x, y, z = pose[:3, 3]
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        by_pose = pose[:3, :3].T @ np.hstack([-cross, -np.eye(3)])
        places += np.trace(by_pose @ block @ by_pose.T) / len(found.pose_covariance)
    return np.sqrt([twists * (RATE / readout) ** 2, places])


def run(number: int, seed: int, sigma: float) -> dict[str, np.ndarray]:
    made = make(number, seed)
    truth, start, readout = with_rate(made.ground_truth), with_rate(made.problem), made.readout
    places = PRIOR_SIGMA[SCENES[number % 3]]
    positions, velocities = priors_of(truth, readout, places, sigma, number)
    result = {}
    for name, priors in (("without", positions), ("with", positions + velocities)):
        options = {"priors": priors, "refine": REFINE, **EXACT}
        solved = bundle.solve(start, **options)
        dof = 2 * truth.num_observations + 3 * len(priors)
        dof -= 12 * truth.num_images + 3 * truth.num_points
        found = errors(solved.problem, truth, readout)
        tied = bundle.solve(
            with_rate(start, readout=np.full(start.num_cameras, 0.5)),
            twists="tied",
            twist_sigma=tuple(readout * np.asarray(made.shake)),
            refine_readout=True,
            **options,
        )
        value = found_readout(tied)
        at = with_rate(tied.problem, readout=np.full(start.num_cameras, np.clip(value, 0.01, 1)))
        spread = bundle.covariance(at, tied.options, of="intrinsics", priors=priors, scale="unit")
        deviation = float(np.sqrt(spread.readout_covariance[0]))
        result[name] = np.array(
            [
                *found,
                *(found / predictions(truth, readout, priors)),
                2 * solved.summary.final_cost / dof,
                (value - readout) / deviation,
                deviation / readout,
            ]
        )
    return result


def main(count: int = 30, seed: int = 0, sigma: float = 0.1) -> None:
    outcomes = [run(number, seed, sigma) for number in range(count)]
    for kind, scene in enumerate(SCENES):
        for name in ("without", "with"):
            rows = np.array([outcome[name] for outcome in outcomes[kind::3]])
            speed, place, by_speed, by_place, chi2, z, spread = rows.T
            print(
                f"{scene:11s}{name:8s} speed {np.sqrt((speed**2).mean()):.4f} m/s, "
                f"{by_speed.mean():.2f} predictions; positions {np.sqrt((place**2).mean()):.4f} m, "
                f"{by_place.mean():.2f} predictions; chi2 / dof {chi2.mean():.3f}; readout z mean "
                f"{z.mean():+.2f}, rms {np.sqrt((z**2).mean()):.2f}, "
                f"sigma {100 * spread.mean():.1f} %"
            )


if __name__ == "__main__":
    given = sys.argv[1:]
    main(*map(int, given[:2]), *map(float, given[2:]))
