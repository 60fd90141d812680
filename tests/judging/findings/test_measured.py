"""Scales of errors: of the model, of an image, and of a cell of the images of one camera model."""

from types import SimpleNamespace

import numpy as np
import pytest

from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from bundle.model.residuals import RAYLEIGH_MEDIAN

WIDTH, HEIGHT = 800, 400
NEAR, FAR = 5.0, 1.0
"""Errors in the first cell of an image and elsewhere [px]."""


def local_scales(counts, shares, errors, image=None, models=("PINHOLE",), image_camera=(0, 0)):
    """Return the local scales of groups of observations with one place and one error each."""

    def each(values):
        return np.repeat(np.array(values), counts, axis=0)

    xy = each(shares) * [WIDTH, HEIGHT]
    image = each(image or [0] * len(counts))
    whole = SimpleNamespace(
        num_images=len(image_camera), num_observations=len(xy), observation_xy=xy,
        observation_image=image, image_camera=np.array(image_camera), camera_models=models,
        camera_sizes=np.full((len(models), 2), [WIDTH, HEIGHT]),
    )  # fmt: skip
    measured = Measured(whole=whole, command=NextCommand())
    residuals = np.stack([each(errors), np.zeros(len(xy))], axis=1)
    counted = np.ones(len(xy), bool)
    measured.__dict__["_residuals"] = SimpleNamespace(xy=residuals, counted=counted)
    starts = np.cumsum(counts) - counts
    return measured.local_scale[starts] * RAYLEIGH_MEDIAN


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("count", "own"), [(30, NEAR), (29, FAR)])
def test_a_cell_is_an_eighth_of_a_side(axis, count, own):
    """The cells end at 1/8 and 7/8; beyond the border, the last cell goes on."""
    along = [0.1249, 0.1251, 0.5, 0.8749, 0.8751, 1.1]
    shares = np.full((6, 2), 0.5)
    shares[:, axis] = along
    found = local_scales(
        [count, 31, 200, 31, 20, count - 20], shares, [NEAR, *[FAR] * 3, NEAR, NEAR]
    )
    np.testing.assert_allclose(found, [own, FAR, FAR, FAR, own, own])


def test_an_image_and_a_camera_model_have_their_scales():
    shares = [[0.5, 0.5]] * 3
    same = {"counts": [100, 30, 30], "shares": shares, "errors": [FAR, FAR, NEAR]}
    images = {"image": [0, 1, 2], "image_camera": (0, 1, 2)}
    one = local_scales(**same, **images, models=("PINHOLE",) * 3)
    np.testing.assert_allclose(one, [FAR, FAR, NEAR])
    few = local_scales(**same | {"counts": [100, 30, 29]}, **images, models=("PINHOLE",) * 3)
    np.testing.assert_allclose(few, FAR)
    # Three images of ten observations: none has its own scale, the cell of their model has one.
    ten = {"counts": [200, 10, 10, 10], "shares": shares[:1] * 4, "errors": [FAR, NEAR, NEAR, NEAR]}
    ten |= {"image": [0, 1, 2, 3], "image_camera": (0, 1, 1, 1)}
    for models, own in ((("PINHOLE", "RADIAL"), NEAR), (("PINHOLE", "PINHOLE"), FAR)):
        np.testing.assert_allclose(local_scales(**ten, models=models), [FAR, own, own, own])
