"""Seeded random lenses and points for the tests of camera models."""

import numpy as np
import pycolmap

from tests.formulas import PARAMS


def camera(model, params):
    return pycolmap.Camera(model=model, width=800, height=600, params=params)


def colmap_lacks(model):
    return model not in pycolmap.CameraModelId.__members__ and not hasattr(
        pycolmap.CameraModelId, model
    )


def random_params(model, rng):
    """A lens around that of PARAMS, with distortion of either sign."""
    params = np.array(PARAMS[model])
    params *= rng.uniform(0.5, 1.5, params.shape)
    if model == "EQUIRECTANGULAR":
        return params
    if model == "FOV":
        params[-1] = rng.choice([rng.uniform(1e-3, 0.05), rng.uniform(0.05, 3.0)])
    elif model == "EUCM":
        params[-2:] = rng.uniform(0.0, 1.0), rng.uniform(0.3, 2.0)
    else:
        first = 3 if params[1] < 650 else 4
        params[first:] *= rng.choice([-1.0, 1.0], len(params) - first)
    return params


def directions(rng, count):
    """Unit vectors: half uniform on the whole sphere, half ever closer to the axis, before it."""
    whole = rng.standard_normal((count - count // 2, 3))
    angle = 10 ** rng.uniform(-12, 0, count // 2)
    azimuth = rng.uniform(0, 2 * np.pi, count // 2)
    near = np.stack(
        [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], 1
    )
    return np.vstack([whole / np.linalg.norm(whole, axis=1)[:, None], near])


def random_points(rng, count=2000):
    """Points in all directions, at distances over six orders of magnitude."""
    return directions(rng, count) * 10 ** rng.uniform(-3, 3, (count, 1))


def rounding(result, params, points):
    """Effect of the last bit of parameters and points, in pixels: (N, 2)."""
    worth = np.abs(result.d_point) @ np.abs(points)[:, :, None]
    return np.finfo(float).eps * (worth[:, :, 0] + np.abs(result.d_params) @ np.abs(params))
