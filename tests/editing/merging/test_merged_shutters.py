"""Rolling shutters of merged models: those of the whole, whatever its halves are called."""

import numpy as np
import pytest

import bundle
from tests.editing.merging.halves import TO_B, halves, whole


def with_shutter(problem, *, direction="rows", scale=1.0, **more):
    """Give each image the twist that its name decides; the video has an image every 5 frames."""
    number = np.array([int("".join(filter(str.isdigit, one))) for one in problem.image_names])
    twist = 0.01 * (number[:, None] + 1) * np.arange(1, 7) * np.repeat([1, scale], 3)
    count = problem.num_images
    order = np.argsort(number)
    neighbours = np.full((count, 2), -1)
    neighbours[order, 0] = order[np.maximum(np.arange(count) - 1, 0)]
    neighbours[order, 1] = order[np.minimum(np.arange(count) + 1, count - 1)]
    fields = {
        "direction": (direction,) * problem.num_cameras,
        "readout": np.full(problem.num_cameras, 0.5),
        "frames": 5.0 * number,
        "neighbours": neighbours,
        "frame_rate": 30.0,
    }
    shutter = bundle.RollingShutter(twist=twist, **{**fields, **more})
    return problem.replace(rolling_shutter=shutter)


@pytest.fixture(scope="module")
def model():
    return with_shutter(whole())


@pytest.fixture(scope="module")
def parts():
    a, b = halves(whole())
    return with_shutter(a), with_shutter(b, scale=TO_B.scale)


def test_the_merged_model_has_the_shutters_of_the_whole(model, parts):
    found, expected = bundle.merge(*parts).problem, model.rolling_shutter
    assert found.image_names == model.image_names
    shutter = found.rolling_shutter
    assert shutter.direction == expected.direction
    for name in ("readout", "frames", "frame_rate"):
        np.testing.assert_array_equal(getattr(shutter, name), getattr(expected, name))
    np.testing.assert_allclose(shutter.twist, expected.twist, rtol=1e-9)
    # Neighbours at the ends of A are the ends of its own video; all others are the whole's.
    own = set(parts[0].image_names)
    inside = [k for k, name in enumerate(found.image_names) if name not in own]
    np.testing.assert_array_equal(shutter.neighbours[inside], expected.neighbours[inside])
    a_last = len(own) - 1
    assert shutter.neighbours[: a_last + 1].tolist() == [
        [max(k - 1, 0), min(k + 1, a_last)] for k in range(a_last + 1)
    ]


def test_images_of_both_keep_the_twist_of_the_first(parts):
    a, b = parts
    other = b.rolling_shutter.replace(twist=b.rolling_shutter.twist * 3, readout=[0.7])
    merged = bundle.merge(a, b.replace(rolling_shutter=other)).problem
    shutter, count = merged.rolling_shutter, a.num_images
    np.testing.assert_array_equal(shutter.twist[:count], a.rolling_shutter.twist)
    assert shutter.readout.tolist() == [0.5]
    added = np.isin(b.image_names, merged.image_names[count:])
    scale = np.repeat([3, 3 / TO_B.scale], 3)
    expected = b.rolling_shutter.twist[added] * scale
    np.testing.assert_allclose(shutter.twist[count:], expected, rtol=1e-9)


@pytest.mark.parametrize("first", [True, False])
def test_one_model_may_have_global_shutters(parts, first):
    a, b = (one if rolls else one.replace(rolling_shutter=None) for one, rolls in
            zip(parts, (first, not first), strict=True))  # fmt: skip
    merged = bundle.merge(a, b)
    shutter, count = merged.problem.rolling_shutter, a.num_images
    # The camera of B stays beside that of A, because its shutter differs.
    assert shutter.direction == (("rows", "global") if first else ("global", "rows"))
    assert any("its shutter differs" in note for note in merged.notes)
    rolls = shutter.twist.any(axis=1)
    assert rolls[:count].all() == first and rolls[count:].all() == (not first)
    assert rolls[:count].any() == first and rolls[count:].any() == (not first)


def test_other_directions_and_row_times(parts):
    a, b = parts
    columns = b.replace(rolling_shutter=b.rolling_shutter.replace(direction=("columns",)))
    merged = bundle.merge(a, columns).problem
    assert merged.rolling_shutter.direction == ("rows", "columns")
    observed = b.replace(rolling_shutter=b.rolling_shutter.replace(row_time="observed"))
    with pytest.raises(bundle.InputError, match=r"^b: expected rolling shutters with the row time"):
        bundle.merge(a, observed)
    both = a.replace(rolling_shutter=a.rolling_shutter.replace(row_time="observed")), observed
    assert bundle.merge(*both).problem.rolling_shutter.row_time == "observed"


def test_models_without_any_stay_without():
    assert bundle.merge(*halves(whole())).problem.rolling_shutter is None
