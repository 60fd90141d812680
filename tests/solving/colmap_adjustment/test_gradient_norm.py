"""The gradient's maximum norm in the drop-in, against pycolmap's and Ceres' definition."""

import functools
import re

import numpy as np
import pycolmap
import pytest
from pycolmap import BundleAdjustmentGauge as Gauge

import bundle
from tests.solving.colmap_adjustment.option_space import images_alone, request, rigs

MODELS = {"alone": images_alone, "rigs": rigs}
ONLY_POSES = tuple(f"refine_{name}=False" for name in ("points3D", "focal_length", "extra_params"))


def adjusted(reconstruction, names=(), steps=0, seed=0):
    """Take steps with our adjuster, in place; return the gradient's norm after the last."""
    options, config = asked(reconstruction, names, seed)
    options.ceres.solver_options.max_num_iterations = steps
    records = []
    bundle.bundle_adjustment(reconstruction, options, config, progress=records.append)
    assert len(records) == steps + 1
    assert all(record["step_is_successful"] for record in records[1:])
    return records[-1]["gradient_max_norm"]


def asked(reconstruction, names, seed):
    options, config = request(reconstruction, names, seed)
    config.fix_gauge(Gauge.UNSPECIFIED)
    return options, config


def pycolmap_norm(reconstruction, names=(), seed=0):
    """Return the norm with which pycolmap stops at once."""
    options, config = asked(reconstruction, names, seed)
    options.ceres.solver_options.gradient_tolerance = 1e300
    adjuster = pycolmap.create_default_bundle_adjuster(options, config, reconstruction)
    message = adjuster.solve().ceres_summary.message
    return float(re.fullmatch(r"Gradient tolerance.*norm: (\S+) <= .*", message)[1])


@pytest.mark.parametrize("kind", MODELS)
@pytest.mark.parametrize("names", [(), ONLY_POSES, ("CAUCHY 0.5",), ("frames 2", "cameras")])
@pytest.mark.parametrize("steps", [0, 2])  # charts begin at their anchors
@pytest.mark.parametrize("seed", range(3))
def test_the_norm_is_that_of_pycolmap(kind, names, steps, seed):
    reconstruction = MODELS[kind](seed)
    norm = adjusted(reconstruction, names, steps, seed)
    assert norm == pytest.approx(pycolmap_norm(reconstruction, names, seed), rel=2e-6)


def cost(reconstruction):
    """Return half the sum of squared errors, by pycolmap's cameras."""
    total = 0.0
    for image in reconstruction.images.values():
        seen = image.get_observation_points2D()
        points = np.array([reconstruction.point3D(one.point3D_id).xyz for one in seen])
        in_camera = np.array([image.cam_from_world() * point for point in points])
        pixels = reconstruction.camera(image.camera_id).img_from_cam(in_camera)
        total += 0.5 * ((pixels - [one.xy for one in seen]) ** 2).sum()
    return total


def plus(quaternion, delta):
    """Ceres' EigenQuaternionManifold: (x, y, z, w) turned from the left by twice |delta|."""
    half = np.linalg.norm(delta)
    x, y, z = np.sinc(half / np.pi) * delta
    w = np.cos(half)
    left = np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]])
    return left @ quaternion


def moved_norm(reconstruction, pose, set_pose):
    """Return max |x - Plus(x, -g)| of one pose x, with g by central differences."""
    q, t = pose.rotation.quat.copy(), pose.translation.copy()

    def cost_at(delta):
        set_pose(pycolmap.Rigid3d(pycolmap.Rotation3d(plus(q, delta[:3])), t + delta[3:]))
        return cost(reconstruction)

    size = 1e-6
    steps = size * np.eye(6)
    gradient = np.array([cost_at(step) - cost_at(-step) for step in steps]) / (2 * size)
    cost_at(np.zeros(6))
    return np.abs(q - plus(q, -gradient[:3])).max(), np.abs(gradient[3:]).max()


def variable_poses(reconstruction):
    """Return value and setter of each frame's pose and each sensor's pose on its rig."""
    for frame in reconstruction.frames.values():
        yield frame.rig_from_world, functools.partial(setattr, frame, "rig_from_world")
    for rig in reconstruction.rigs.values():
        for sensor in rig.non_ref_sensors:
            yield rig.sensor_from_rig(sensor), functools.partial(rig.set_sensor_from_rig, sensor)


@pytest.mark.parametrize("steps", [0, 2])
@pytest.mark.parametrize("kind", MODELS)
def test_the_norm_follows_from_ceres_definition(kind, steps):
    reconstruction = MODELS[kind](0)
    norm = adjusted(reconstruction, ONLY_POSES, steps)
    moves = np.array([moved_norm(reconstruction, *pose) for pose in variable_poses(reconstruction)])
    assert norm == pytest.approx(moves.max(), rel=1e-4)
