"""Bad input of other programs' files: one line with the place, and nothing is written."""

import json
import re

import numpy as np
import pytest

import bundle
from bundle.cli.main import main
from bundle.io.formats.registry import BUILT_IN
from tests.io.formats import foreign_files as foreign
from tests.io.formats.foreign_files import small


@pytest.fixture(scope="module")
def texts(tmp_path_factory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("good")
    problem = small(shared=True)
    foreign.write_bundler(small(), folder / "b.out")
    foreign.write_nvm(small("SIMPLE_PINHOLE"), folder / "n.nvm")
    foreign.write_openmvg(problem, folder / "m.json")
    foreign.write_opensfm(problem, folder)
    return {path.name: path.read_text() for path in folder.iterdir()}


def first(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


def moved(text: str, start: str) -> str:
    """The first list of numbers gets a number that the next such list loses."""
    found = [m.end() for m in re.finditer(re.escape(start), text)][:2]
    second = text[found[1] :].split(",", 1)
    return text[: found[0]] + "0.5," + text[found[0] : found[1]] + second[1]


BUNDLER = {
    "truncated": (lambda t: t[: len(t) // 2], r"b.out:\d+: expected .* found"),
    "version": (lambda t: first(t, "v0.3", "v0.9"), "b.out:1: expected # Bundle file v0.3"),
    "count": (lambda t: first(t, "4 30", "4 99"), "end of the file"),
    "huge": (lambda t: first(t, "4 30", "99999999 30"), "whole number from 0 to 10000000"),
    "more": (lambda t: t + "1 2 3\n", "expected the end of the file after 30 points, found '1'"),
    "nan": (lambda t: first(t, "800.0", "nan"), r"b.out:3: expected .*finite number"),
    "underscores": (lambda t: first(t, "800.0", "8_00.0"), r"found '8_00.0'"),
    "image": (lambda t: first(t, "\n3 0 ", "\n3 9 "), r"whole number from 0 to 3\), found '9'"),
    "rotation": (lambda t: first(t, "\n0.8264", "\n0.1264"), "expected a rotation matrix"),
    "binary": (lambda t: t[:40] + "\0\0\0" + t[40:], "expected"),
}
NVM = {
    "truncated": (lambda t: t[: len(t) // 3], r"n.nvm:\d+: expected"),
    "second model": (
        lambda t: t.replace("\n\n0\n", "\n\n4\nx 1 1 0 0 0 0 0 0 0 0"),
        "another model",
    ),
    "camera": (lambda t: first(t, "\t800.0", "\tfoo"), "name f qw qx qy qz"),
    "focal": (lambda t: first(t, "\t800.0", "\t-800.0"), "focal length above 0"),
    "twice": (lambda t: first(t, "image1.jpg", "image0.jpg"), "each image once"),
}
OPENMVG = {
    "truncated": (lambda t: t[: len(t) // 2], r"m.json:\d+: expected JSON"),
    "key": (lambda t: first(t, '"center"', '"centre"'), "expected a member center, found"),
    "kind": (lambda t: first(t, "pinhole_radial_k3", "pinhole_x"), "one of pinhole, "),
    "nan": (lambda t: first(t, '"focal_length": 800.0', '"focal_length": NaN'), "finite number"),
    "text": (lambda t: first(t, '"focal_length": 800.0', '"focal_length": "8"'), "a number, found"),
    "deep": (lambda t: first(t, '"control_points": []', '"c": ' + "[" * 99999), "expected JSON"),
    "pose": (lambda t: json.dumps({**json.loads(t), "extrinsics": []}), "has no pose"),
    "moved": (lambda t: moved(t, '"X": ['), r"X: expected 3 finite numbers"),
    "bool": (lambda t: first(t, '"id_feat": 0', '"id_feat": true'), "whole number"),
}
OPENSFM = {
    "truncated": (lambda t: t[: len(t) // 2], r"expected JSON"),
    "camera": (lambda t: first(t, '"camera": "camera 0"', '"camera": "x"'), "one of the cameras"),
    "type": (lambda t: first(t, '"perspective"', '"cubist"'), "one of perspective"),
    "focal": (lambda t: first(t, '"focal": 1', '"focal": -1'), "a number above 0"),
    "size": (lambda t: first(t, '"width": 800', '"width": 0'), "width and a height above 0"),
    "point": (lambda t: first(t, '"coordinates": [', '"coordinates": [1,'), "3 finite numbers"),
    "empty": (lambda _: "[]", "an empty list"),
    "moved": (
        lambda t: moved(t, '"coordinates": ['),
        "points: 1: coordinates: expected 3 finite numbers",
    ),
}
TRACKS = {
    "version": (lambda t: first(t, "_v2", "_v3"), "tracks.csv:1: expected version 1 or 2"),
    "mixed": (lambda t: first(t, "_v2", "_v1"), "9 fields between tabs"),
    "word": (lambda t: first(t, "\t0.004", "\tx"), "the scale"),
    "foreign": (lambda _: "a,b,c\n", "8 fields between tabs"),
    "empty": (lambda _: "", "expected observations of the 4 shots"),
}
CASES = [
    (name, fault, *case)
    for name, table in (
        ("b.out", BUNDLER),
        ("n.nvm", NVM),
        ("m.json", OPENMVG),
        ("reconstruction.json", OPENSFM),
        ("tracks.csv", TRACKS),
    )
    for fault, case in table.items()
]


@pytest.mark.parametrize(
    ("name", "fault", "damage", "message"), CASES, ids=[f"{c[0]}-{c[1]}" for c in CASES]
)
def test_one_line_and_nothing_is_written(
    tmp_path, capsys, texts, name, fault, damage, message
) -> None:
    for other in ("reconstruction.json", "tracks.csv") if name in texts else ():
        (tmp_path / other).write_text(texts[other])
    path = tmp_path / name
    path.write_text(damage(texts[name]))
    source = path if name.endswith(("out", "nvm", "m.json")) else tmp_path
    before = sorted(tmp_path.iterdir())
    with pytest.raises(bundle.InputError, match=message) as caught:
        bundle.load(source)
    assert "\n" not in str(caught.value), fault
    assert main(["convert", str(source), str(tmp_path / "out") + "/", "--quiet"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert sorted(tmp_path.iterdir()) == before


def test_empty_and_foreign_files(tmp_path) -> None:
    for name, content in (("a.out", b""), ("b.nvm", b"\x89PNG"), ("c.json", b'{"a": 1}')):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(bundle.InputError) as caught:
            bundle.load(tmp_path / name)
        if content:
            for known in ("COLMAP", "BAL", *(f.what for f in BUILT_IN if f.reads)):
                assert known in str(caught.value)
        for format in ("bundler", "nvm", "openmvg", "opensfm"):
            with pytest.raises(bundle.InputError):
                bundle.load(tmp_path / name, format=format)
    with pytest.raises(bundle.InputError, match=r"format: expected one of .*found 'ply'"):
        bundle.load(tmp_path / "a.out", format="ply")
    with pytest.raises(bundle.InputError, match=r'width,height in pixels or "unknown"'):
        bundle.load(tmp_path / "a.out", image_size="8x")


def test_members_of_json_have_any_order(tmp_path) -> None:
    foreign.write_openmvg(small(num_points=400), tmp_path / "scene.json")
    scene = json.loads((tmp_path / "scene.json").read_text())
    other = tmp_path / "other.json"
    other.write_text(json.dumps({"structure": scene.pop("structure"), **scene}))
    assert b"sfm_data_version" not in other.read_bytes()[:4096]
    expected, found = bundle.load(tmp_path / "scene.json"), bundle.load(other)
    assert found.format == "openmvg"
    np.testing.assert_array_equal(found.observation_xy, expected.observation_xy)
    for text in ('{"views": [}', '{"a": 1}', "{" + "[" * 100_000):
        other.write_text(text)
        with pytest.raises(bundle.InputError, match=r"an OpenMVG scene.*found JSON"):
            bundle.load(other)


def test_a_project_without_tracks(tmp_path, texts) -> None:
    (tmp_path / "reconstruction.json").write_text(texts["reconstruction.json"])
    with pytest.raises(bundle.InputError, match=r"expected tracks.csv, which has the observations"):
        bundle.load(tmp_path)


def test_a_view_of_an_image_that_is_not_registered(tmp_path) -> None:
    problem = small()
    foreign.write_bundler(problem, tmp_path / "a.out", unregistered=(1,))
    text = (tmp_path / "a.out").read_text()
    lines = text.split("\n")
    row = next(i for i, line in enumerate(lines) if line.startswith("3 ") and i > 27)
    words = lines[row].split()
    words[1] = "1"
    lines[row] = " ".join(words)
    (tmp_path / "a.out").write_text("\n".join(lines))
    with pytest.raises(bundle.InputError, match="expected views in registered images"):
        bundle.load(tmp_path / "a.out")


def test_points_behind_the_camera_do_not_hide_a_difference(tmp_path) -> None:
    """Errors of points behind and in the plane of the camera are compared, too."""
    problem = small()
    points = problem.points.copy()
    points[0] = problem.projection_centers[0]
    points[1] = 3 * problem.projection_centers[1]
    foreign.write_bundler(problem.replace(points=points), tmp_path / "a.out")
    loaded = bundle.load(tmp_path / "a.out")
    assert np.isfinite(loaded.source.source_rmse)
    assert loaded.source.rmse == pytest.approx(loaded.source.source_rmse, rel=1e-6)


def test_the_next_command_repeats_what_the_file_lacks(tmp_path) -> None:
    problem = small(num_points=200)
    xy = problem.observation_xy.copy()
    xy[::40] += 60  # outliers
    foreign.write_bundler(problem.replace(observation_xy=xy), tmp_path / "a.out")
    report = tmp_path / "info.json"
    words = ["info", str(tmp_path / "a.out"), "--image-size", "800,600", "--quiet"]
    assert main([*words, "--json", str(report)]) == 0
    found = json.loads(report.read_text())["findings"]
    commands = [finding["command"] for finding in found if finding["command"]]
    assert commands and all("--image-size 800,600" in command for command in commands)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("cameras.xml", '<?xml version="1.0"?>\n<document version="1.4.0">', "Metashape"),
        ("bundler.xml", '<?xml version="1.0"?><BlocksExchange version="3">', "BlocksExchange"),
        ("a.xmp", '<x:xmpmeta xmlns:x="adobe:ns:meta/">', "RealityCapture"),
        ("registration.csv", "#name,x,y,alt,heading\n", "no tie points; export COLMAP or Bundler"),
        ("scene.xml", '<?xml version="1.0" encoding="utf-8"?>\n<cereal>', "ConvertSfM_DataFormat"),
        ("sfm_data.bin", "\0\1\2", "OpenMVG's, but not JSON"),
        ("cameras.sfm", '{"version": ["1", "2"], "views": []}', "AliceVision or Meshroom"),
        ("frames.json", '{"frames": []}', "found JSON"),
    ],
)
def test_files_of_other_programs_are_named(tmp_path, name, content, message) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(bundle.InputError, match=message) as caught:
        bundle.load(tmp_path / name)
    assert "\n" not in str(caught.value)
