"""Files without points, observations, images or anything: the same in every format."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import bundle
from bundle.cli.main import main
from tests.io.formats.foreign_files import small

NAMES = {
    "bal": "b.txt",
    "bundler": "b.out",
    "colmap": "c",
    "colmap-text": "t",
    "nvm": "n.nvm",
    "openmvg": "sfm_data.json",
    "opensfm": "s",
}
NOTHING = np.empty(0, int)
LACKS = {
    "points": ({"points": NOTHING}, r"found 4 images, \d cameras?, 0 points, .*triangulate points"),
    "observations": ({"observations": NOTHING}, r"found 4 images, \d cameras?, 30 points, 0 obs"),
}
ALL = {"images": NOTHING, "cameras": NOTHING, "points": NOTHING}


@pytest.fixture(params=NAMES)
def format(request) -> str:
    return request.param


def write(folder: Path, format: str, parts: dict[str, np.ndarray]) -> Path:
    """Write a model that lacks something, in files of its format."""
    problem = small("SIMPLE_PINHOLE" if format == "nvm" else "RADIAL")
    path = folder / NAMES[format]
    bundle.save(problem.select(**parts).problem, path, format)
    return path


@pytest.fixture(params=LACKS)
def lacks(request, format) -> str:
    if (format, request.param) == ("opensfm", "observations"):
        pytest.skip("tracks.csv without an observation is refused")
    return request.param


def size(format: str) -> list[str]:
    return ["--image-size", "800,600"] if format in ("bundler", "nvm") else []


def test_info_says_so_and_refine_refuses(tmp_path, capsys, format, lacks) -> None:
    parts, message = LACKS[lacks]
    path = write(tmp_path, format, parts)
    report = tmp_path / "i.json"
    assert main(["info", str(path), "--json", str(report), *size(format)]) == 0
    assert "no_observations" in report.read_text()
    assert "no observations to refine" in " ".join(capsys.readouterr().out.split())
    before = sorted(tmp_path.iterdir())
    for more in ([], ["--rounds", "2"]):
        words = ["refine", str(path), "-o", f"{tmp_path}/out/", "--quiet", *size(format), *more]
        assert main(words) == 2
        error = capsys.readouterr().err.strip()
        assert "\n" not in error
        assert re.search(message, error), error
    assert sorted(tmp_path.iterdir()) == before


def test_convert_warns(tmp_path, capsys, format, lacks) -> None:
    path = write(tmp_path, format, LACKS[lacks][0])
    assert main(["convert", str(path), f"{tmp_path}/out/", *size(format)]) == 0
    assert "no observations to refine" in " ".join(capsys.readouterr().out.split())
    assert bundle.load(tmp_path / "out").num_images == 4


def test_a_model_without_a_camera_is_neither_refined_nor_written(tmp_path, capsys, format) -> None:
    if format.startswith("colmap"):
        with pytest.raises(bundle.InputError, match="expected a camera"):
            write(tmp_path, format, ALL)
        return
    path = write(tmp_path, format, ALL)
    before = sorted(tmp_path.iterdir())
    for words in (["refine", str(path), "-o"], ["convert", str(path)]):
        assert main([*words, f"{tmp_path}/out/", "--quiet"]) == 2
        error = capsys.readouterr().err.strip()
        assert "\n" not in error
        assert re.search("expected .*found 0", error)
    assert main(["info", str(path)]) == 0
    assert "no observations to refine" in " ".join(capsys.readouterr().out.split())
    assert sorted(tmp_path.iterdir()) == before


def test_opensfm_without_points_needs_no_tracks(tmp_path) -> None:
    path = write(tmp_path, "opensfm", LACKS["points"][0])
    (path / "tracks.csv").unlink()
    assert bundle.load(path).num_images == 4


def test_openmvg_before_its_reconstruction(tmp_path, capsys) -> None:
    """The listing of images has views and intrinsics, but neither poses nor structure."""
    path = write(tmp_path, "openmvg", {})
    content = json.loads(path.read_text())
    path.write_text(json.dumps({**content, "extrinsics": [], "structure": []}))
    assert main(["info", str(path), "--verbose"]) == 0
    found = " ".join(capsys.readouterr().out.split())
    assert "4 views of 4 are not registered" in found
    assert "only 0 images, 4 cameras, 0 points" in found
