"""Fit of a camera model to a lens that it cannot equal: parameters and the reported error."""

import numpy as np
import pytest

from bundle.io.formats.imported_model import fitted_lens


def test_the_error_is_the_largest_distance_to_the_lens():
    focal, center = 500.0, np.array([400.0, 300.0])
    angles = np.linspace(0, 1.0, 49)[1:]
    radii = focal * np.sin(angles)  # orthographic, which no RADIAL lens equals
    fit = fitted_lens("RADIAL", focal, center, angles, radii)
    assert fit is not None
    f, cx, cy, k1, k2 = fit.params
    assert (cx, cy) == tuple(center)
    u = np.tan(angles)
    distances = np.abs(f * u * (1 + k1 * u**2 + k2 * u**4) - radii)
    assert distances.max() > 2 * distances.mean()
    assert fit.error == pytest.approx(distances.max(), rel=1e-9)
