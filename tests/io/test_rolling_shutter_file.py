"""rolling_shutter.json: written with its model, read whole or refused in one line."""

import json

import numpy as np
import pytest

import bundle
from bundle.synthetic.video_scene import film
from tests.scenes import make_problem

OPTIONS = bundle.SceneOptions(
    scene="orbit", num_images=6, num_points=120, rolling_shutter=0.8, cameras="individual"
)


@pytest.fixture(scope="module")
def scene():
    return film(OPTIONS).ground_truth


@pytest.fixture
def model(scene, tmp_path):
    bundle.save(scene, tmp_path / "model")
    return tmp_path / "model"


def mixed(scene):
    """Return a problem with columns, an unknown readout, a global shutter, and lone images."""
    shutter = scene.rolling_shutter
    twist = shutter.twist.copy()
    twist[2] = 0
    readout = shutter.readout.copy()
    readout[1:3] = np.nan
    neighbours = shutter.neighbours.copy()
    neighbours[3] = -1
    frames = shutter.frames.copy()
    frames[4] = np.nan
    direction = ("rows", "columns", "global", "rows", "rows", "columns")
    return scene.replace(
        rolling_shutter=shutter.replace(
            direction=direction, readout=readout, twist=twist, neighbours=neighbours,
            frames=frames, row_time="observed", frame_rate=29.97,
        )
    )  # fmt: skip


def assert_same(found, expected):
    assert found.direction == expected.direction
    assert found.row_time == expected.row_time
    for name in ("readout", "twist", "frames", "neighbours", "frame_rate"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


@pytest.mark.parametrize("format", ["colmap", "colmap-text"])
@pytest.mark.parametrize("change", [lambda scene: scene, mixed])
def test_all_fields_come_back_bit_for_bit(scene, tmp_path, format, change):
    expected = change(scene)
    assert not bundle.save(expected, tmp_path / "model", format)
    found = bundle.load(tmp_path / "model")
    assert_same(found.rolling_shutter, expected.rolling_shutter)
    bundle.save(found, tmp_path / "again", format)
    text = (tmp_path / "model" / "rolling_shutter.json").read_bytes()
    assert (tmp_path / "again" / "rolling_shutter.json").read_bytes() == text


def test_the_file_has_the_members_of_the_contract(model, scene):
    record = json.loads((model / "rolling_shutter.json").read_text())
    assert list(record) == ["cameras", "images"]
    assert record["cameras"][0] == {"camera_id": 1, "direction": "rows", "readout": 0.8}
    assert record["images"][2]["image_id"] == 3
    assert record["images"][2]["twist"] == scene.rolling_shutter.twist[2].tolist()


def test_a_neighbour_with_a_global_shutter_keeps_its_time(tmp_path, scene):
    """Twists that are tied to it need its time; a twist of its own is refused."""
    expected = mixed(scene)
    bundle.save(expected, tmp_path / "model")
    path = tmp_path / "model" / "rolling_shutter.json"
    record = json.loads(path.read_text())
    before, after = expected.rolling_shutter.neighbours[2] + 1
    still = {"image_id": 3, "frame": expected.rolling_shutter.frames[2]}
    assert record["images"][2] == still | {"neighbours": [before, after]}
    assert 2 in bundle.load(path.parent).rolling_shutter.neighbours[1]
    record["images"][2]["twist"] = [0.0] * 6
    path.write_text(json.dumps(record))
    with pytest.raises(bundle.InputError, match=r"images\[2\]: image_id: .* in cameras, found 3"):
        bundle.load(path.parent)


def test_an_image_with_a_global_shutter_and_no_time_has_no_entry(tmp_path, scene):
    shutter = mixed(scene).rolling_shutter.replace(frames=None, neighbours=None)
    bundle.save(scene.replace(rolling_shutter=shutter), tmp_path / "model")
    record = json.loads((tmp_path / "model" / "rolling_shutter.json").read_text())
    assert [one["image_id"] for one in record["images"]] == [1, 2, 4, 5, 6]


def test_a_model_without_rolling_shutter_removes_the_file(model, scene):
    bundle.save(scene.replace(rolling_shutter=None), model)
    assert not (model / "rolling_shutter.json").exists()
    assert bundle.load(model).rolling_shutter is None


def test_only_global_shutters_need_no_file(tmp_path, scene):
    shutter = bundle.RollingShutter(direction=("global",) * 6, twist=np.zeros((6, 6)))
    bundle.save(scene.replace(rolling_shutter=shutter), tmp_path / "model")
    assert not (tmp_path / "model" / "rolling_shutter.json").exists()


def test_a_declaration_without_twists_starts_at_zero(model):
    path = model / "rolling_shutter.json"
    record = json.loads(path.read_text())
    del record["images"]
    record["cameras"] = record["cameras"][1:]
    record["cameras"][0]["readout"] = None
    path.write_text(json.dumps(record))
    shutter = bundle.load(model).rolling_shutter
    assert shutter.direction[0] == "global" and shutter.direction[1] == "rows"
    assert np.isnan(shutter.readout[:2]).all()
    assert not shutter.twist.any() and shutter.frames is shutter.neighbours is None


@pytest.mark.parametrize("target", ["x.txt", "x.out", "x.nvm", "sfm_data.json", "x.ply"])
def test_other_formats_state_the_loss(scene, tmp_path, target):
    assert any("rolling shutter" in note for note in bundle.save(scene, tmp_path / target))
    plain = scene.replace(rolling_shutter=None)
    assert not any("rolling shutter" in note for note in bundle.save(plain, tmp_path / target))


def set_at(*keys, value):
    def edit(record):
        for key in keys[:-1]:
            record = record[key]
        record[keys[-1]] = value

    return edit


def removed(*keys):
    def edit(record):
        for key in keys[:-1]:
            record = record[key]
        del record[keys[-1]]

    return edit


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (removed("cameras"), r"json: expected a member cameras"),
        (set_at("cameras", value=3), r"cameras: expected an array, found 3"),
        (set_at("cameras", 1, "camera_id", value=77), r"cameras\[1\]: camera_id: .* found 77"),
        (set_at("cameras", 1, "camera_id", value=1), r"cameras\[1\].*per camera, found 1"),
        (set_at("cameras", 1, "camera_id", value="a"), r"cameras\[1\]: camera_id: .*whole number"),
        (set_at("cameras", 0, "direction", value="up"), r"cameras\[0\]: direction: expected rows"),
        (set_at("cameras", 0, "direction", value=[]), r"direction: expected rows or columns"),
        (set_at("cameras", 0, "readout", value=0), r"cameras\[0\]: readout: .* found 0"),
        (set_at("cameras", 0, "readout", value=1.01), r"readout: .*at most 1, or null, found 1.01"),
        (set_at("cameras", 0, "readout", value="x"), r"readout: expected a number"),
        (removed("cameras", 0, "readout"), r"cameras\[0\]: expected a member readout"),
        (removed("cameras", 5), r"images\[5\]: image_id: expected an image of a camera in cameras"),
        (set_at("cameras", 0, "speed", value=1), r"cameras\[0\]: .* members .*found speed"),
        (set_at("images", 2, "image_id", value=99), r"images\[2\]: image_id: .*found 99"),
        (set_at("images", 2, "image_id", value=1), r"images\[2\].*one entry per image, found 1"),
        (set_at("images", 2, "twist", value=[1] * 5), r"images\[2\]: twist: expected 6 finite"),
        (set_at("images", 2, "twist", 3, value=float("nan")), r"twist: expected 6 finite numbers"),
        (set_at("images", 2, "twist", 3, value=1e400), r"twist: expected 6 finite numbers"),
        (removed("images", 2, "twist"), r"images\[2\]: expected a member twist"),
        (removed("images", 2), r"images: expected a twist for each image .* none for image 3"),
        (set_at("images", 0, "frame", value="1"), r"images\[0\]: frame: expected a number"),
        (set_at("images", 0, "neighbours", value=[1]), r"neighbours: expected the ids of two"),
        (set_at("images", 0, "neighbours", value=[1, 9]), r"neighbours\[1\]: .* found 9"),
        (set_at("frame_rate", value=0), r"frame_rate: expected frames per second above 0, found 0"),
        (set_at("frame_rate", value="30"), r"frame_rate: expected a number, found '30'"),
        (set_at("row_time", value="late"), r"row_time: expected fixed-point or observed"),
        (set_at("extra", value=1), r"expected the members .*row_time, frame_rate, found extra"),
    ],
)  # fmt: skip
def test_wrong_content_is_refused_in_one_line(model, edit, words):
    path = model / "rolling_shutter.json"
    record = json.loads(path.read_text())
    edit(record)
    path.write_text(json.dumps(record))
    with pytest.raises(bundle.InputError, match=words) as raised:
        bundle.load(model)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("text", ["", "{", "[1]", '{"cameras": [1], "images": []}', "\x00"])
def test_broken_json_is_refused(model, text):
    (model / "rolling_shutter.json").write_text(text)
    with pytest.raises(bundle.InputError, match=r"rolling_shutter\.json"):
        bundle.load(model)


def test_images_without_a_size_are_refused(tmp_path):
    problem = make_problem(num_images=4, num_points=30, shared=True)
    bundle.save(problem.replace(camera_sizes=np.zeros((1, 2), int)), tmp_path / "model")
    camera = int(problem.camera_ids[0])
    record = {"cameras": [{"camera_id": camera, "direction": "rows", "readout": 0.5}]}
    (tmp_path / "model" / "rolling_shutter.json").write_text(json.dumps(record))
    with pytest.raises(bundle.InputError, match=r"rolling_shutter\.json: camera .* size"):
        bundle.load(tmp_path / "model")


def test_slices_refuse_a_rolling_shutter(model):
    from bundle.solving.slices.slice_reading import survey

    with pytest.raises(bundle.InputError, match="slices"):
        survey(model, 2)
