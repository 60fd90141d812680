"""Write the pictures of docs/gravity.md, docs/imu_adjustment.md and docs/certificates.md.

usage: python -m tools.constraint_pictures [FOLDER]    (default: docs)
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from tests.inertial.offline.models import model_of, world_from_imu

import bundle
from bundle import pictures
from bundle.figures import Line, LineFigure
from bundle.inertial.offline.imu_adjustment import adjust_with_imu
from bundle.inertial.offline.inertial_result import ImuSamples
from bundle.model.rotations import rotation_matrices

SIGMA = 1.0  # degrees


def main(folder: Path) -> None:
    """Draw the three pictures."""
    gravity(folder)
    inertial(folder)
    certificates(folder)


def draw(axes: Any, name: str, title: str, x: str, y: str, *lines: Line) -> None:
    """Draw lines with the title and the labels of both axes."""
    figure = LineFigure(name=name, title=title, x_label=x, y_label=y, lines=lines)
    pictures.draw_lines(axes, figure)


def tilt_of(found: bundle.Problem, truth: bundle.Problem) -> float:
    """Return the angle in degrees between up of a model and true up, by the mean over images."""
    up, expected = (rotation_matrices(one.cam_from_world[:, :4])[:, :, 2] for one in (found, truth))
    back = rotation_matrices(found.cam_from_world[:, :4])
    mean = np.einsum("nji,nj->i", back, expected) / len(up)
    return float(np.degrees(np.arctan2(np.hypot(*mean[:2]), mean[2])))


def gravity(folder: Path) -> None:
    """Draw tilts over the number of measured images, and with a tenth of wrong directions."""
    counts, seeds = (1, 2, 4, 8, 16, 32), range(12)
    tilts = np.zeros((len(counts), len(seeds)))
    losses = ("trivial", "tukey")
    wrong = np.zeros((len(losses), len(seeds)))
    for seed in seeds:
        scene = bundle.synthesize(
            scene="orbit", num_images=32, num_points=300, gravity_sigma=SIGMA, seed=seed
        )
        for row, count in enumerate(counts):
            priors = scene.priors[:: len(scene.priors) // count]
            solved = bundle.solve(scene.problem, priors=priors).problem
            tilts[row, seed] = tilt_of(solved, scene.ground_truth)
        rng = np.random.default_rng(seed)
        for row, loss in enumerate(losses):
            mixed = [
                bundle.GravityPrior(
                    prior.image, prior.direction if k % 10 else rng.normal(size=3), SIGMA, loss=loss
                )
                for k, prior in enumerate(scene.priors)
            ]
            solved = bundle.solve(scene.problem, priors=mixed).problem
            wrong[row, seed] = tilt_of(solved, scene.ground_truth)
    made, axes = pictures.figure(1, 2, width=4.6, height=4.2)
    x = np.array(counts, float)
    draw(
        axes[0, 0], "tilt", "Tilt of the model", "images with a direction", "tilt [degrees], rms",
        Line("found in 12 scenes", x, np.sqrt((tilts**2).mean(axis=1))),
        Line("sigma times sqrt(2 / n)", x, SIGMA * np.sqrt(2 / x), is_limit=True),
    )  # fmt: skip
    numbers = np.arange(1.0, len(seeds) + 1)
    names = ("without a loss", "--prior-loss tukey")
    draw(
        axes[0, 1], "wrong", "A tenth of wrong directions", "scene", "tilt [degrees]",
        *(Line(name, numbers, np.sort(row)) for name, row in zip(names, wrong, strict=True)),
    )  # fmt: skip
    made.savefig(folder / "gravity.png", dpi=90)


def inertial(folder: Path) -> None:
    """Draw the path of a flight from images alone and with an IMU, and errors of positions."""
    flight = bundle.synthesize_flight(
        motion="loop", duration=20.0, num_tracks=60, seed=2, imu_samples="instant"
    )
    sequence, calibration = flight.sequence, flight.sequence.calibration
    model, stamps = model_of(sequence, flight.ground_truth, 4)
    options = bundle.SolveOptions(refine=("poses", "points"), max_num_iterations=200)
    alone = bundle.solve(model, options).problem
    alone = bundle.solve(bundle.filter_observations(alone, 4.0, 2.0, 3).problem, options).problem
    samples = ImuSamples(sequence.imu_timestamps_ns, sequence.gyro, sequence.accel)
    found = adjust_with_imu(
        alone, samples, stamps, calibration.camera_from_imu, calibration.noise, options,
        imu_noise_scale=2.0,
    )  # fmt: skip
    from bundle.georeference.pose_alignment import align_centers
    from bundle.inertial.vio.trajectory_comparison import states_at

    truth = states_at(flight.ground_truth, stamps)[:, 4:7]
    places = {
        "images alone": world_from_imu(alone, [*calibration.camera_from_imu[:4], 0, 0, 0])[:, 4:],
        "with the IMU": world_from_imu(found.result.problem, calibration.camera_from_imu)[:, 4:],
    }
    kinds = {"images alone": "similarity", "with the IMU": "yaw"}
    aligned = {n: align_centers(p, truth, kinds[n]).apply(p) for n, p in places.items()}
    corner = np.min([*aligned.values(), truth], axis=(0, 1))
    made, axes = pictures.figure(1, 2, width=4.6, height=4.2)
    draw(
        axes[0, 0], "path", "Path from above", "east [m]", "north [m]",
        *(Line(name, *(place - corner)[:, :2].T) for name, place in aligned.items()),
        Line("true", *(truth - corner)[:, :2].T, is_limit=True),
    )  # fmt: skip
    seconds = 1e-9 * (stamps - stamps[0])
    draw(
        axes[0, 1], "errors", "Errors of positions", "time [s]", "error [m]",
        *(
            Line(f"{name} ({kinds[name]} aligned)", seconds, np.linalg.norm(p - truth, axis=1))
            for name, p in aligned.items()
        ),
    )  # fmt: skip
    made.savefig(folder / "imu_adjustment.png", dpi=90)


def certificates(folder: Path) -> None:
    """Draw a ring wound once more, and the ring to which its certificate leads."""
    size, rng = 40, np.random.default_rng(1)
    angle = 2 * np.pi / size
    step = np.array([1.0, 0.0, 0.0]) + 0.02 * rng.normal(size=(size, 3))
    step[:, 2] += angle
    edges = np.array([[k, (k + 1) % size] for k in range(size)], np.int32)
    turn = 2 * angle * np.arange(size)  # twice as far as the edges measure
    radius = 1 / (2 * np.sin(angle))
    wound = np.stack([radius * np.sin(turn), radius * (1 - np.cos(turn)), turn], axis=1)
    graph = bundle.PoseGraph(
        poses=wound, edges=edges, measurements=step,
        information=np.tile(np.diag([100.0, 100.0, 100.0]), (size, 1, 1)),
    )  # fmt: skip
    first = bundle.solve(graph, init="file")
    second = bundle.solve(graph, init="file", certify=True)
    made, axes = pictures.figure(1, 1, width=6.4, height=5.0)
    lines = []
    verdicts = bundle.certify(first).verdict, bundle.certify(second.problem).verdict
    for one, verdict, dash in zip((first, second), verdicts, (1, 0), strict=True):
        x, y = (one.problem.poses[:, :2] - one.problem.poses[:, :2].min(axis=0)).T
        lines.append(Line(f"chi2 {one.summary.chi2_final:.3g}: {verdict}", x, y, dash=dash))
    draw(axes[0, 0], "ring", "A ring of 40 poses", "x", "y", *lines)
    made.savefig(folder / "certificates.png", dpi=90)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs"))
