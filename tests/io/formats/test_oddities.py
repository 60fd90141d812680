"""Files as editors and other tools leave them: the same problem, or one line with the fault."""

import re
from codecs import BOM_UTF8
from pathlib import Path

import numpy as np
import pytest

import bundle
from tests.io.formats import foreign_files as foreign
from tests.io.formats.foreign_files import small

FILES = ("bundle.out", "m.nvm", "sfm_data.json", "reconstruction.json", "text", "b.txt")


def write(name: str, folder: Path) -> Path:
    """Write a file of each format; return the input."""
    problem = small("SIMPLE_PINHOLE" if name == "m.nvm" else "RADIAL", shared=True)
    if name == "bundle.out":
        foreign.write_bundler(small(), folder / name, names=["a b.jpg", "ä.jpg", "c:\\x.jpg", "d"])
    elif name == "m.nvm":
        foreign.write_nvm(problem, folder / name)
    elif name == "sfm_data.json":
        foreign.write_openmvg(problem, folder / name)
    elif name == "reconstruction.json":
        foreign.write_opensfm(problem, folder)
        return folder
    elif name == "text":
        bundle.save(problem, folder / name, "colmap-text")
    else:
        bundle.save(small("RADIAL"), folder / name, "bal")
    return folder / name


def load(path: Path) -> bundle.Problem:
    sizes = {} if path.suffix == ".txt" or path.name == "text" else {"image_size": (800, 600)}
    return bundle.load(path, **sizes)


CHANGES = {
    "byte order mark": lambda text: BOM_UTF8 + text,
    "line ends of Windows": lambda text: text.replace(b"\n", b"\r\n"),
    "blanks at line ends": lambda text: re.sub(rb"(?<=[^\n])\n", b"  \n", text),
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", FILES)
def test_editors_change_nothing(tmp_path, name, change) -> None:
    path = write(name, tmp_path)
    expected = load(path)
    for file in [one for one in tmp_path.rglob("*") if one.is_file()]:
        if name == "reconstruction.json" and change == "blanks at line ends":
            continue  # tracks.csv is separated by tabs: a blank is part of the last field
        file.write_bytes(CHANGES[change](file.read_bytes()))
    found = load(path)
    for field in ("cam_from_world", "points", "observation_xy", "camera_params"):
        np.testing.assert_array_equal(getattr(found, field), getattr(expected, field))
    assert found.image_names == expected.image_names
    assert found.format == expected.format


def test_a_text_model_with_byte_order_marks_is_refined_in_its_files(tmp_path) -> None:
    path = write("text", tmp_path)
    for file in path.iterdir():
        file.write_bytes(BOM_UTF8 + file.read_bytes())
    result = bundle.solve(path)
    bundle.save(result.problem, path)
    np.testing.assert_array_equal(bundle.load(path).points, result.problem.points)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.nvm", "nvm_v3 \n\n0\n", "a.nvm:1: expected NVM_V3 or NVM_V3_R9T, found 'nvm_v3'"),
        ("a.out", "# bundle v0.3\n", "a.out:1: expected # Bundle file v0.3, found '# bundle"),
        ("sfm_data.json", "{}", "expected a member structure|expected a member"),
    ],
)
def test_the_reader_of_the_name_states_what_is_wrong(tmp_path, name, text, message) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(bundle.InputError, match=message):
        bundle.load(tmp_path / name)


def test_a_fixed_calibration_that_contradicts_the_cameras(tmp_path) -> None:
    foreign.write_nvm(
        small("SIMPLE_PINHOLE"), tmp_path / "a.nvm", first="NVM_V3 FixedK 700 4 700 3"
    )
    with pytest.raises(bundle.InputError, match=r"focal length f = 700 .* found 800"):
        bundle.load(tmp_path / "a.nvm")


def test_a_point_without_views_and_a_repeated_view(tmp_path) -> None:
    problem = small()
    foreign.write_bundler(problem, tmp_path / "a.out")
    lines = (tmp_path / "a.out").read_text().replace("4 30", "4 31", 1).rstrip("\n").split("\n")
    words = lines[2 + 5 * 4 + 2].split()
    lines[2 + 5 * 4 + 2] = " ".join([str(int(words[0]) + 1), *words[1:], *words[1:5]])
    (tmp_path / "a.out").write_text("\n".join([*lines, "1 2 3", "0 0 0", "0", ""]))
    found = bundle.load(tmp_path / "a.out", image_size="unknown")
    assert (found.num_points, found.num_observations) == (31, problem.num_observations + 1)
    assert any("numbers are not used" in note for note in found.source.notes)
    assert found.source.rmse == pytest.approx(found.source.source_rmse, abs=1e-9)


def test_metashapes_list_has_paths_of_another_machine(tmp_path) -> None:
    truth = small()
    foreign.write_metashape(truth, tmp_path)
    with pytest.raises(bundle.InputError, match=r"list.txt: .*DJI_0000.JPG; give --image-size"):
        bundle.load(tmp_path / "cameras.out")
    problem = bundle.load(tmp_path / "cameras.out", image_size=(800, 600))
    assert problem.image_names == tuple(f"D:/survey one/DJI_{k:04}.JPG" for k in (0, 2, 3, 4))
    assert problem.source.rmse == pytest.approx(problem.source.source_rmse, abs=1e-9)
    assert problem.num_observations == truth.num_observations


def test_realitycapture_has_two_directions_of_z(tmp_path) -> None:
    truth = small()
    foreign.write_realitycapture(truth, tmp_path)
    images = tmp_path / "images.imagelist"
    problem = bundle.load(tmp_path / "negative_z.out", image_size=(800, 600), image_list=images)
    assert problem.image_names == truth.image_names
    np.testing.assert_allclose(problem.points, truth.points, atol=1e-9)
    with pytest.raises(bundle.InputError, match=r"90 of 90 observed points behind; .*negative Z"):
        bundle.load(tmp_path / "positive_z.out", image_size=(800, 600), image_list=images)


@pytest.mark.parametrize(("behind", "is_refused"), [(15, False), (16, True)])
def test_half_of_the_points_may_be_behind(tmp_path, behind, is_refused) -> None:
    """A bad start, which a refinement can mend, is no other convention."""
    truth = small()
    points = truth.points.copy()
    points[:behind] = 2 * truth.projection_centers.mean(axis=0) - points[:behind]
    moved = truth.replace(points=points)
    share = bundle.reprojection_errors(moved)[1].mean()
    assert (share > 0.5) == is_refused
    foreign.write_openmvg(moved, tmp_path / "m.json")
    if is_refused:
        with pytest.raises(bundle.InputError, match=r"48 of 90 observed points behind$"):
            bundle.load(tmp_path / "m.json")
    else:
        assert bundle.load(tmp_path / "m.json").num_points == 30
