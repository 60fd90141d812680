"""Image sizes of COLMAP's database for formats without sizes."""

import numpy as np
import pytest

import bundle
from tests.io.formats import foreign_files as foreign
from tests.io.formats.foreign_files import small

NAMES = ("a b.jpg", "ä.jpg", "c/1.jpg", "d.jpg")


@pytest.fixture
def folder(tmp_path):
    foreign.write_bundler(small(), tmp_path / "bundle.out", names=NAMES)
    problem = small("SIMPLE_PINHOLE").replace(image_names=NAMES)
    foreign.write_nvm(problem, tmp_path / "model.nvm")
    foreign.write_database(NAMES, tmp_path / "database.db")
    return tmp_path


@pytest.mark.parametrize("name", ["bundle.out", "model.nvm"])
def test_sizes_by_name(folder, name) -> None:
    expected = bundle.load(folder / name, image_size=(800, 600))
    found = bundle.load(folder / name, image_size=folder / "database.db")
    np.testing.assert_array_equal(found.camera_sizes, [[800, 600]] * 4)
    np.testing.assert_array_equal(found.observation_xy, expected.observation_xy)
    assert bundle.load(folder / name, image_size=str(folder / "database.db")).num_images == 4


def test_a_database_of_pycolmap(folder) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    database = pycolmap.Database.open(folder / "other.db")
    for number, name in enumerate(NAMES, 1):
        camera = pycolmap.Camera(
            camera_id=number,
            model="SIMPLE_PINHOLE",
            width=100 * number,
            height=90,
            params=[9, 5, 4],
        )
        database.write_camera(camera, use_camera_id=True)
        database.write_image(pycolmap.Image(name=name, camera_id=number))
    database.close()
    found = bundle.load(folder / "bundle.out", image_size=folder / "other.db")
    assert found.camera_sizes.tolist() == [[100, 90], [200, 90], [300, 90], [400, 90]]


def test_a_database_that_does_not_fit(folder) -> None:
    foreign.write_database(NAMES[:3], folder / "three.db")
    with pytest.raises(bundle.InputError, match=r"three.db: expected the image d.jpg, which has "):
        bundle.load(folder / "bundle.out", image_size=folder / "three.db")
    foreign.write_database(NAMES, folder / "flat.db", size=(800, 0))
    with pytest.raises(bundle.InputError, match=r"a width and a height above 0 .* found 800 x 0"):
        bundle.load(folder / "bundle.out", image_size=folder / "flat.db")
    (folder / "list.txt").unlink()
    with pytest.raises(bundle.InputError, match=r"expected image names, to find"):
        bundle.load(folder / "bundle.out", image_size=folder / "database.db")
    (folder / "damaged.db").write_bytes((folder / "database.db").read_bytes()[:3000])
    with pytest.raises(bundle.InputError, match=r"damaged.db: expected COLMAP's database"):
        bundle.load(folder / "model.nvm", image_size=folder / "damaged.db")
    with pytest.raises(bundle.InputError, match=r"image_size: expected width,height .* found"):
        bundle.load(folder / "model.nvm", image_size="missing.db")
