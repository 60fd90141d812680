"""Each of thirty planted deficiencies is found and named, and nothing else is."""

import pytest

import bundle
from tests.analysis.diagnosis import blocks


def names(made):
    maker, seed = made
    return f"{maker.__name__}-{seed}"


@pytest.mark.parametrize("made", blocks.PLANTED, ids=names)
def test_planted_deficiency_is_named(made):
    maker, seed = made
    planted = maker(seed)
    found = bundle.diagnose(planted.problem, **planted.options)
    kinds = {finding.kind for finding in found.findings if finding.is_problem}
    if planted.kind == "collapsed_scale":
        assert planted.kind in kinds
        assert set(planted.ids) <= set(found.collapsed[0].point_ids)
        return
    if planted.kind == "pure_rotation":
        assert kinds == {"pure_rotation", "points_without_parallax"}
        assert len(found.points_without_parallax) == planted.problem.num_points
    else:
        assert kinds == {planted.kind}
    assert found.nullity == planted.nullity
    assert found.expected_nullity == planted.expected
    assert found.max_null_eigenvalue < 1e-12
    if planted.what == "points_without_parallax":
        assert found.points_without_parallax.tolist() == list(planted.ids)
    elif planted.kind == "component":
        (mode,) = found.weak_modes
        assert (mode.kind, mode.image_ids, mode.dimension) == ("component", planted.ids, 7)
        sizes = [len(component.image_ids) for component in found.components]
        assert sorted(sizes) == sorted([len(planted.ids), 8 - len(planted.ids)])
        assert planted.ids in {component.image_ids for component in found.components}
    elif planted.what == "camera_ids":
        (mode,) = found.weak_modes
        assert mode.camera_ids == planted.ids
        assert mode.kind == planted.kind
        assert mode.eigenvalue == 0
        assert mode.dimension == planted.nullity - planted.expected


def test_a_healthy_block_is_not_accused():
    found = bundle.diagnose(blocks.block())
    assert found.ok
    assert (found.nullity, found.expected_nullity) == (7, 7)
    assert found.weak_modes == ()
