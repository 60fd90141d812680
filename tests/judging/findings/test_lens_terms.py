"""The lens of a finding: which field counts, and the smallest larger model that explains it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bundle import camera_models
from bundle.judging.findings.lens_terms import LARGER, START, LensField, larger_models, lens_model
from bundle.judging.findings.next_command import NextCommand
from tests.campaigns.findings import judge, make

MEASURED = SimpleNamespace(
    command=NextCommand("IN", "OUT", ()), scale=3.0, options=SimpleNamespace(refine=("extra",))
)


def field(radial, tangential, *, size=1.0, significant=True):
    """A field of orthonormal columns r2 and t1."""
    columns = np.eye(2).reshape(1, 2, 2)
    explained = np.array([[radial, tangential]])
    return LensField(
        model="SIMPLE_PINHOLE",
        camera_ids=(1,),
        terms=("r2", "t1"),
        columns=columns,
        residual=explained,
        field=explained,
        statistic=100.0,
        significant=significant,
        size=size,
    )


@pytest.mark.parametrize(
    ("radial", "tangential", "larger", "kind"),
    [
        (1.0, 0.0, "SIMPLE_RADIAL", "radial"),
        (1.0, 0.97, "SIMPLE_RADIAL", "radial"),  # 51 % of the field
        (1.0, 1.03, "OPENCV", "tangential"),  # 49 %
        (0.1, 1.0, "OPENCV", "tangential"),
    ],
)
def test_the_smallest_model_that_explains_the_field_is_proposed(radial, tangential, larger, kind):
    found = lens_model(MEASURED, [field(radial, tangential)])
    shares = found.evidence["shares"]
    assert found.evidence["larger_model"] == larger and larger in found.command
    assert max(shares, key=shares.get) == kind
    assert " 3 px rms" in found.sentence  # one noise of 3 px
    assert shares["radial"] == pytest.approx(radial**2 / (radial**2 + tangential**2))


def test_terms_of_the_present_model_explain_nothing():
    # Those of a strong distortion are left in part, but a larger model adds only the others.
    for radial, tangential, larger in ((1.0, 0.3, "FULL_OPENCV"), (0.3, 1.0, "OPENCV")):
        found = lens_model(MEASURED, [replace(field(radial, tangential), model="RADIAL")])
        assert found.evidence["larger_model"] == larger


@pytest.mark.parametrize("model", START)
def test_larger_models_have_more_parameters_and_keep_both_focal_lengths(model):
    def is_larger(other):
        given, found = (set(camera_models()[one]) for one in (model, other))
        return len(found) > len(given) and ("fy" in found or "fy" not in given)

    family = [name for name, _ in LARGER[START[model][0]]]
    assert [name for name, _ in larger_models(model)] == list(filter(is_larger, family))


def test_the_largest_significant_field_counts():
    small, large = field(1.0, 0.0, size=0.2), replace(field(0.0, 1.0), size=0.5)
    noise = field(1.0, 0.0, size=9.0, significant=False)
    assert lens_model(MEASURED, [small, noise, large]).evidence["size"] == 0.5
    assert lens_model(MEASURED, [noise, field(1.0, 0.0, size=0.1)]) is None


def test_the_term_that_is_missing_is_enough_if_poses_and_points_have_absorbed_a_part():
    (found,) = judge(make(45_072))
    assert found.evidence["shares"]["radial"] > 0.95 and found.evidence["size"] > 0.15
    assert found.evidence["larger_model"] == "RADIAL"  # FULL_OPENCV: positions 50 % worse
