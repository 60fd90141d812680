"""Derivatives by the point and by every parameter against complex steps and 70 digits.

The error of an entry is relative to itself, but no smaller than 1e-6 of the largest in its row:
what is zero by symmetry comes out as a rounding error of its neighbours.
"""

import mpmath
import numpy as np
import pytest

import bundle
from tests import formulas, scenes
from tests.model.cameras.draws import random_params, random_points

MODELS = sorted(bundle.camera_models())
TOLERANCE = 1e-9
COLUMNS = ("X", "Y", "Z")


def relative_errors(computed, expected):
    """Largest error of Jacobians (..., 2, columns), entry by entry."""
    floor = 1e-6 * np.abs(expected).max(axis=-1, keepdims=True)
    scale = np.maximum(np.abs(expected), np.maximum(floor, np.finfo(float).tiny))
    return np.abs(computed - expected) / scale


def complex_step(model, params, points):
    """d_point (N, 2, 3) and d_params (N, 2, num_params) by steps along the imaginary axis."""
    step, columns = 1e-200, []
    for j in range(3):
        columns.append(scenes.project(model, params, points + 1j * step * np.eye(3)[j]).imag / step)
    for j in range(len(params)):
        moved = params + 1j * step * np.eye(len(params))[j]
        columns.append(scenes.project(model, moved, points.astype(complex)).imag / step)
    derivatives = np.stack(columns, 2)
    return derivatives[:, :, :3], derivatives[:, :, 3:]


def exact(model, params, point, digits=70):
    """The same at one point by central differences in 70 digits: (2, 3), (2, num_params)."""
    with mpmath.workdps(digits):
        x = [mpmath.mpf(float(value)) for value in (*point, *params)]

        def pixels(values):
            return formulas.project(model, values[3:], *values[:3], formulas.MPMATH)

        columns = []
        size = mpmath.norm(x[:3])
        for j in range(len(x)):
            # The error of a central difference is of the order of the squared relative step.
            step = mpmath.mpf("1e-25") * (size if j < 3 else max(abs(x[j]), mpmath.mpf(1)))
            ahead = pixels([*x[:j], x[j] + step, *x[j + 1 :]])
            back = pixels([*x[:j], x[j] - step, *x[j + 1 :]])
            columns.append([float((a - b) / (2 * step)) for a, b in zip(ahead, back, strict=True)])
    derivatives = np.array(columns).T
    return derivatives[:, :3], derivatives[:, 3:]


def worst_of(model, pairs):
    """The largest relative error and the column where it stands."""
    names = COLUMNS + bundle.camera_models()[model]
    errors = np.concatenate(
        [
            np.concatenate([relative_errors(*point), relative_errors(*params)], -1).reshape(
                -1, len(names)
            )
            for point, params in pairs
        ]
    )
    column = int(errors.max(axis=0).argmax())
    return float(errors.max()), names[column]


@pytest.mark.parametrize("model", MODELS)
def test_jacobians_agree_with_complex_steps(model):
    """Away from the axis, where the formula itself is sound."""
    rng = np.random.default_rng(3)
    pairs = []
    for _ in range(5):
        params, points = random_params(model, rng), random_points(rng, 400)[:200]
        result = bundle.project(model, params, points, jacobians=True)
        seen = result.valid if "EQUIRECTANGULAR" in model else result.valid & (points[:, 2] > 0)
        d_point, d_params = complex_step(model, params, points[seen])
        pairs.append(((result.d_point[seen], d_point), (result.d_params[seen], d_params)))
    worst, column = worst_of(model, pairs)
    assert worst <= TOLERANCE, column


@pytest.mark.parametrize("model", MODELS)
def test_jacobians_agree_with_70_digits(model, record_property):
    """In all directions, on the way to the axis, and behind the camera."""
    rng = np.random.default_rng(4)
    pairs, beyond = [], 0
    for _ in range(12):
        params, points = random_params(model, rng), random_points(rng, 6)
        result = bundle.project(model, params, points, jacobians=True)
        for n in np.flatnonzero(~np.isnan(result.xy).any(axis=1)):
            d_point, d_params = exact(model, params, points[n])
            pairs.append(((result.d_point[n], d_point), (result.d_params[n], d_params)))
            beyond += points[n, 2] < 0
    worst, column = worst_of(model, pairs)
    record_property("worst_relative_error", float(worst))
    print(f"{model}: {worst:.1e} ({column}) over {len(pairs)} points, {beyond} of them behind")
    assert len(pairs) > 40
    assert beyond > 5
    assert worst <= TOLERANCE, column
