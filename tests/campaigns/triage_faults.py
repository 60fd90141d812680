"""Faults of inputs for the triage campaign: each changes a graph, a model or a flight."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import bundle
from tests.campaigns.triage_inputs import relative

NANOSECONDS_OF_START = 4e9
"""Time after which faults of image points begin."""


def wrong_closures(graph: bundle.PoseGraph, rng: Any) -> bundle.PoseGraph:
    """Ten closures between places that are far from each other."""
    pairs = rng.choice(graph.num_poses, (10, 2), replace=False).astype(np.int32)
    return graph.replace(
        edges=np.vstack([graph.edges, pairs]),
        measurements=np.vstack([graph.measurements, np.zeros((10, 3))]),
        information=np.concatenate([graph.information, graph.information[:10]]),
        edge_lines=None,
    )


def optimistic_closure(graph: bundle.PoseGraph, _: Any) -> bundle.PoseGraph:
    """One closure that is wrong by metres and claims a millimetre."""
    information, measured = graph.information.copy(), graph.measurements.copy()
    information[-1] *= 400
    measured[-1, :2] += 3
    return graph.replace(information=information, measurements=measured)


def turned_measurement(graph: bundle.PoseGraph, _: Any) -> bundle.PoseGraph:
    """Edges whose angle has the wrong sign, as with another convention."""
    measured = graph.measurements.copy()
    measured[:, 2] *= -1
    return graph.replace(measurements=measured)


def cautious(graph: bundle.PoseGraph, _: Any) -> bundle.PoseGraph:
    """Information of all edges 52 times too small."""
    return graph.replace(information=graph.information / 52)


def dense_prior(graph: bundle.PoseGraph, rng: Any) -> bundle.PoseGraph:
    """A landmark seen from 40 poses, marginalised: each of them is coupled with all others."""
    seen = np.sort(rng.choice(graph.num_poses, 40, replace=False))
    low, high = np.triu_indices(40, 1)
    pairs = np.stack([seen[low], seen[high]], 1).astype(np.int32)
    best = bundle.solve(graph).problem.poses
    between = relative(best[pairs[:, 0]], best[pairs[:, 1]])
    weights = np.tile(graph.information[0] / 40, (len(pairs), 1, 1))
    return graph.replace(
        edges=np.vstack([graph.edges, pairs]),
        measurements=np.vstack([graph.measurements, between]),
        information=np.concatenate([graph.information, weights]),
        edge_lines=None,
    )


def outliers(problem: bundle.Problem, rng: Any) -> bundle.Problem:
    """Wrong matches: 3 % of the observations are anywhere."""
    xy = problem.observation_xy.copy()
    wrong = rng.random(len(xy)) < 0.03
    xy[wrong] += 60 * rng.standard_normal((int(wrong.sum()), 2))
    return problem.replace(observation_xy=xy)


def noisy(problem: bundle.Problem, rng: Any) -> bundle.Problem:
    """Keypoints with twice the noise."""
    xy = problem.observation_xy
    return problem.replace(observation_xy=xy + rng.standard_normal(xy.shape))


def far_start(problem: bundle.Problem, rng: Any) -> bundle.Problem:
    """A start far away: points and cameras moved by half of the scene."""
    points = problem.points + 2.5 * rng.standard_normal(problem.points.shape)
    return problem.replace(points=points)


def wrong_tracks(sequence: Any, rng: Any) -> Any:
    """A fifth of the image points are anywhere, after the seconds that a start needs.

    Odometry refuses to begin with such points.
    """
    xy, stamps = sequence.xy.copy(), sequence.image_timestamps_ns
    is_late = stamps - stamps.min() > NANOSECONDS_OF_START
    wrong = is_late & (rng.random(len(xy)) < 0.2)
    xy[wrong] += 60 * rng.standard_normal((int(wrong.sum()), 2))
    return replace(sequence, xy=xy)


def wrong_mount(sequence: Any, _: Any) -> Any:
    """camera_from_imu is turned by 5 degrees."""
    calibration = sequence.calibration
    q = np.array(calibration.camera_from_imu[:4])
    turn = np.array([np.sin(0.044), 0, 0, np.cos(0.044)])
    x, y, z, w = turn[0], turn[1], turn[2], turn[3]
    left = np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]])
    mount = (*(left @ q).tolist(), *calibration.camera_from_imu[4:])
    return replace(sequence, calibration=replace(calibration, camera_from_imu=mount))


def noisy_imu(sequence: Any, rng: Any) -> Any:
    """An accelerometer with a loose mount: 1 m/s^2 of noise."""
    return replace(sequence, accel=sequence.accel + rng.standard_normal(sequence.accel.shape))
