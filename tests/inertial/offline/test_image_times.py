"""Times of images from a file."""

import pytest

from bundle import InputError
from bundle.inertial.offline.image_intervals import read_image_times
from tests.scenes import make_problem


def test_images_of_a_rig_may_have_one_time_and_none_goes_back(tmp_path):
    problem = make_problem(num_images=4)
    path = tmp_path / "times.txt"
    names = problem.image_names

    def write(stamps):
        path.write_text("".join(f"{n} {t}\n" for n, t in zip(names, stamps, strict=True)))

    write([5, 5, 8, 8])
    assert read_image_times(path, problem).tolist() == [5, 5, 8, 8]
    write([5, 5, 4, 8])
    with pytest.raises(InputError, match=r"times\.txt.*3"):
        read_image_times(path, problem)
