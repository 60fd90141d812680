"""Names of outputs: unknown suffixes, and transforms.json under any name."""

import json

import pytest

import bundle
from bundle.io.formats.registry import BUILT_IN, format_written
from bundle.io.open import output_format
from bundle.io.recognition import OUTPUT_FORMATS
from tests.scenes import make_problem


@pytest.mark.parametrize("source", ["bal", "colmap", "memory"])
def test_a_suffix_of_letters_names_a_format_or_is_refused(tmp_path, source):
    for name in ("x.foo", "x.FOO", "x.gz", "a.b.refined"):
        with pytest.raises(bundle.InputError, match=r"expected a name of a folder.*--format"):
            output_format(source, tmp_path / name)
    own = "bal" if source == "bal" else "colmap"
    for name in ("x", "x.v2", "x.2024", ".x", "x.bz2"):
        assert output_format(source, tmp_path / name) == own
    assert output_format(source, f"{tmp_path}/x.foo/") == "colmap"
    assert output_format(source, tmp_path / "x.foo", "colmap-text") == "colmap-text"
    assert output_format("opensfm", tmp_path / "opensfm.refined") == "opensfm"
    with pytest.raises(bundle.InputError, match="expected a name of a folder"):
        output_format("nvm", tmp_path / "x.foo")
    (tmp_path / "old.foo").mkdir()
    (tmp_path / "file.foo").touch()  # perhaps INPUT itself
    assert output_format(source, tmp_path / "old.foo") == "colmap"
    assert output_format(source, tmp_path / "file.foo") == own


def test_the_name_of_a_format_is_no_path_of_another_format(tmp_path):
    for source, own in (("bal", "bal"), ("colmap", "colmap"), ("nvm", "nvm"), ("memory", "colmap")):
        for name in OUTPUT_FORMATS:
            for path in (name, tmp_path / name):
                if own == name:
                    assert output_format(source, path) == own
                else:
                    with pytest.raises(bundle.InputError, match=f"--format {name} gives"):
                        output_format(source, path)
                assert output_format(source, path, "ply") == "ply"
        assert output_format(source, f"{tmp_path}/nvm/") == "colmap"
    bundle.save(make_problem(), tmp_path / "text", "colmap-text")
    assert output_format("colmap", "colmap", source=tmp_path / "text") == "colmap-text"
    (tmp_path / "ply").touch()  # perhaps INPUT itself
    assert output_format("bal", tmp_path / "ply") == "bal"


def test_the_refusal_lists_what_is_written(tmp_path):
    for name in ("x.foo", "x.json", "x.sfm"):
        with pytest.raises(bundle.InputError) as caught:
            bundle.save(make_problem(), tmp_path / name)
        for suffix in (".txt.gz", *(s for f in BUILT_IN if f.writes for s in f.suffixes)):
            assert suffix in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_convert_writes_no_folder_of_such_a_name(tmp_path, capsys):
    from bundle.cli.main import main

    bundle.save(make_problem(), tmp_path / "model")
    for words in (["convert", f"{tmp_path}/model"], ["refine", f"{tmp_path}/model", "-o"]):
        assert main([*words, str(tmp_path / "new/x.foo"), "--quiet"]) == 2
        error = capsys.readouterr().err
        assert error.startswith("error: ") and error.count("\n") == 1 and "x.foo" in error
    assert [one.name for one in tmp_path.iterdir()] == ["model"]


INSTANT_NGP = {"camera_angle_x": 0.7, "frames": [{"file_path": "a", "transform_matrix": [[1.0]]}]}
NERFSTUDIO = {"fl_x": 900.0, "w": 1280, "frames": []}
LATE = {"frames": [{"file_path": "a" * 200, "transform_matrix": [[1.0]]}]}


@pytest.mark.parametrize("content", [INSTANT_NGP, NERFSTUDIO, LATE])
@pytest.mark.parametrize("name", ["scene.json", "transforms.json", "scene"])
def test_a_transforms_json_is_known_by_its_content(tmp_path, content, name):
    path = tmp_path / name
    path.write_text(json.dumps(content, indent=1))
    with pytest.raises(bundle.InputError, match=r"found nerfstudio's transforms.json, which has"):
        bundle.load(path)
    assert output_format("colmap", path) == "transforms"
    for known in ("NVM_V3 \n", "# Bundle file v0.3\n"):  # formats with a reader have their own way
        path.write_text(known)
        assert format_written(path) is None
    path.write_text('{"views": []}')
    with pytest.raises(bundle.InputError, match=r"found JSON"):
        bundle.load(path)


def test_it_is_written_again_under_its_name(tmp_path):
    problem = make_problem()
    bundle.save(problem, tmp_path / "scene.json", "transforms")
    before = (tmp_path / "scene.json").read_bytes()
    bundle.save(problem, tmp_path / "scene.json")
    assert (tmp_path / "scene.json").read_bytes() == before
    with pytest.raises(bundle.InputError, match=r"found a name of JSON"):
        bundle.save(problem, tmp_path / "other.json")
