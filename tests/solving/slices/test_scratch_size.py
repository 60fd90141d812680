"""The disk that a refinement needs: its bytes by hand, and its check before anything is read."""

import shutil

import pytest

import bundle
from bundle.solving.slices import sliced_refinement
from bundle.solving.slices.scratch_size import RESIDENT_BYTES, refuse_small_disk, scratch_bytes

CASES = [
    # observations, points: bytes an observation (50 + 1.1 * 4 bytes of each pair) and 132 a point
    (6000, 1000, 6000 * (50 + 1.1 * 4 * 2.5) + 132_000),
    (1000, 1000, 1000 * 50 + 132_000),  # tracks of one observation have no pairs
    (500, 1000, 500 * 50 + 132_000),
    (0, 0, 0),
]


@pytest.mark.parametrize(("observations", "points", "expected"), CASES)
def test_the_bytes(observations, points, expected):
    assert scratch_bytes(observations, points) == pytest.approx(expected, rel=1e-12)


def disk(monkeypatch, free):
    usage = shutil.disk_usage("/")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=free))


def test_the_disk_may_be_full_to_the_last_byte(monkeypatch):
    needed = 498_000
    disk(monkeypatch, needed)
    refuse_small_disk("here", 6000, 1000)
    disk(monkeypatch, needed - 1)
    with pytest.raises(bundle.InputError, match=r"^--out-of-core: expected .* 6000 .* 1000 .*here"):
        refuse_small_disk("here", 6000, 1000)


def test_a_small_disk_is_refused_before_the_model_is_read(monkeypatch, tmp_path):
    made = bundle.synthesize(num_images=5, num_points=50, seed=1, camera_model="RADIAL")
    bundle.save(made.problem, tmp_path / "m.txt", "bal")

    def read(*_):
        raise AssertionError("the model was read")

    monkeypatch.setattr(sliced_refinement, "LoneProcess", read)
    disk(monkeypatch, 1000)
    with pytest.raises(bundle.InputError, match=r"^--out-of-core: expected"):
        sliced_refinement.OutOfCoreRefinement(tmp_path / "m.txt", str(tmp_path))
    disk(monkeypatch, 1 << 40)
    with pytest.raises(AssertionError, match="the model was read"):
        sliced_refinement.OutOfCoreRefinement(tmp_path / "m.txt", str(tmp_path))


def test_a_gibibyte_stays_in_memory():
    assert RESIDENT_BYTES == 1 << 30
