"""Sigmas of their own, sigmas that are too small, weights that a loss takes away, rays behind."""

import dataclasses

import numpy as np
import pytest

import bundle
from bundle import GroundControlPoint
from bundle.georeference.gps_positions import GpsPositions
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.survey_priors import gcp_priors
from bundle.georeference.text_lines import ImageIndex
from bundle.georeference.triangulated_targets import triangulate
from tests.georeference.flights import flight

TARGETS = [[-20, -20, 0], [20, -20, 0.5], [20, 20, 0], [-20, 20, 1], [3, -8, 0.2]]


def test_points_keep_the_sigmas_that_they_have():
    scene = flight(TARGETS, num_images=9)
    gcps = [dataclasses.replace(scene.gcps[0], sigma=(0.5, 0.6)), *scene.gcps[1:]]
    found = gcp_priors(scene.problem, gcps, gcp_sigma=0.03).control_points
    assert [point.sigma for point in found] == [(0.5, 0.6)] + [(0.03, 0.03)] * 4


@pytest.mark.parametrize(("sigma", "notes"), [(0.002, 1), (0.05, 0)])
def test_sigmas_that_are_too_small_are_told(sigma, notes):
    scene = flight(TARGETS, num_images=9)
    found = bundle.align(scene.problem, gcps=scene.gcps, gcp_sigma=sigma, gcp_pixel_sigma=0.02)
    assert (found.sigma0 > 3) == bool(notes)
    assert len([note for note in found.notes if "expected from their sigmas" in note]) == notes


def test_a_position_without_weight_is_not_used():
    problem = flight([], num_images=9).problem
    origin = LocalFrame(46.8, -91.9, 200)
    enu = problem.projection_centers.copy()
    enu[4, 0] += 30
    given = GpsPositions(
        problem.image_names, origin.to_geodetic(enu), np.full((9, 2), np.nan), "EPSG:4326", "x"
    )
    for loss, used in (("tukey", [row != 4 for row in range(9)]), ("huber", [True] * 9)):
        found = bundle.align(problem, gps=given, gps_sigma=5.0, prior_loss=loss)
        assert [image.used for image in found.positions] == used


def test_rays_that_meet_behind_their_images():
    problem = flight([]).problem
    names = problem.image_names
    measured = [(names[0], 1000, 1400), (names[1], 1000, 100)]
    point = GroundControlPoint(name="t", position=(0, 0, 0), measurements=measured)
    (found,) = triangulate(problem, [point], ImageIndex(problem), pixel_sigma=0.5)
    assert "behind" in found.reason
    assert np.isnan(found.position).all()
