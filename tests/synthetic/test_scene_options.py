import dataclasses

import pytest

import bundle
from bundle import InputError, SceneOptions


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("scene", "castle"),
        ("num_images", 1),
        ("num_images", 2.5),
        ("num_images", None),
        ("num_images", 2**31),
        ("num_points", -3),
        ("num_points", "many"),
        ("mean_track_length", 1.9),
        ("mean_track_length", 41),
        ("mean_track_length", float("nan")),
        ("camera_model", "FOV"),
        ("cameras", True),
        ("image_size", (1280,)),
        ("image_size", 1280),
        ("image_size", (1280, 63)),
        ("pixel_noise", -0.1),
        ("pixel_noise", float("inf")),
        ("outlier_share", 1.0),
        ("rotation_noise", 180),
        ("focal_noise", 0.5),
        ("loop_closure", "yes"),
        ("num_rings", 41),
        ("gravity_sigma", -1.0),
        ("orientation_sigma", 180.0),
        ("seed", -1),
    ],
)
def test_bad_values_are_named_back(name, value):
    with pytest.raises(InputError, match=f"^{name}: expected .*, found ") as caught:
        SceneOptions(**{name: value}, **({"scene": "orbit"} if name == "num_rings" else {}))
    assert "\n" not in str(caught.value)


def test_choices_in_any_spelling():
    options = SceneOptions(scene="Photo-Collection", camera_model="simple-radial")
    assert (options.scene, options.camera_model) == ("photo_collection", "SIMPLE_RADIAL")


@pytest.mark.parametrize(
    ("scene", "cameras", "shared"),
    [
        ("street", "auto", True),
        ("orbit", "auto", True),
        ("photo_collection", "auto", False),
        ("photo_collection", "shared", True),
        ("street", "individual", False),
    ],
)
def test_who_shares_a_camera(scene, cameras, shared):
    assert SceneOptions(scene=scene, cameras=cameras).has_shared_camera is shared


def test_a_seed_may_be_long():
    assert SceneOptions(seed=2**100).seed == 2**100


def test_each_flag_sets_its_option_and_no_other():
    """The parser of `bundle synth` with one flag at a time, at another value than the default."""
    from bundle.cli.main import command_parser

    fields = {field.name: field for field in dataclasses.fields(SceneOptions)}
    flags = [field.metadata["flag"] for field in fields.values()]
    assert len(set(flags)) == len(flags)
    default = command_parser().parse_args(["synth", "out"])
    for name, field in fields.items():
        action = vars(SceneOptions())[name]
        text = {bool: [], str: ["street"], tuple: ["640", "480"]}.get(type(action), ["3"])
        text = {"camera_model": ["OPENCV"], "cameras": ["shared"]}.get(name, text)
        given = command_parser().parse_args(["synth", "out", field.metadata["flag"], *text])
        changed = {one for one in vars(given) if vars(given)[one] != vars(default)[one]}
        assert changed - {"kind", "taken"} == {name}  # what was given, for messages


@pytest.mark.parametrize(
    ("first", "change"),
    [
        ({"num_images": 12}, {"num_rings": 13, "scene": "orbit"}),
        ({"num_images": 12}, {"mean_track_length": 13}),
        ({"mean_track_length": 5}, {"scene": "drone_grid"}),
        ({"mean_track_length": 5}, {"rolling_shutter": 0.5}),
    ],
)
def test_changed_options_are_checked_together(first, change):
    options = bundle.SceneOptions(**first)
    with pytest.raises(bundle.InputError, match=r"num_rings|mean_track_length"):
        options.replace(**change)
    with pytest.raises(bundle.InputError, match=r"num_rings|mean_track_length"):
        bundle.synthesize(options, **change)
