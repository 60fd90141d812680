"""The text of rules: what it says, and one line for everything else."""

import copy
import pickle

import pytest

import bundle
from bundle.solving.constraints.rule_list import Constraints
from bundle.solving.constraints.rules import Bounds, Fixed, On, Prior, Ratio, Share, Target

RULES = {
    "camera 3: cx,cy fixed": Fixed("camera 3", "cx,cy"),
    "cameras *: f prior 2 %": Prior("cameras *", "f", percent=2),
    "cameras *:f prior 2%": Prior("cameras *", ["f"], percent=2),
    "camera 1: f prior 1200 2 %": Prior("camera 1", "f", 1200, percent=2),
    "camera 1: f prior 1200 sigma 2 %": Prior("camera 1", "f", 1200, percent=2),
    "camera 1: k1 prior 0 sigma 0.01": Prior("camera 1", "k1", 0, 0.01),
    "camera 1: k1,k2 prior sigma 1e-2": Prior("camera 1", "k1,k2", sigma=0.01),
    "cameras *: k1 in [-0.5, 0.5]": Bounds("cameras *", "k1", -0.5, 0.5),
    "cameras 2,5-6: f in [-inf, 900]": Bounds("cameras 2,5-6", "f", upper=900),
    "cameras 1-4: share f,k1": Share("cameras 1-4", "f,k1"),
    "camera 2: fx/fy fixed": Ratio("camera 2", ("fx", "fy")),
    'image "a/*.jpg": position fixed': Fixed('image "a/*.jpg"', "position"),
    "Image 7: rotation , position fixed # why": Fixed("image 7", "rotation,position"),
    'images \'a"b.jpg\',"c:d #1,é.jpg": rotation fixed': Fixed(
        Target("image", ('a"b.jpg', "c:d #1,é.jpg")), "rotation"
    ),
    "image 7: position prior [1, -2, 3e1] sigma 2/5": Prior(
        "image 7", "position", (1, -2, 30), (2, 5)
    ),
    "image 7: position prior sigma [1,2,3]": Prior("image 7", "position", sigma=(1, 2, 3)),
    "images 3000000000-3000000001: rotation prior sigma 0.5": Prior(
        "images 3000000000-3000000001", "rotation", sigma=0.5
    ),
    "point 12: position prior sigma 0.1": Prior("point 12", "position", sigma=0.1),
    "points 4-9,12: on plane 0 0 1 -2.5 sigma 5e-3": On(
        "points 4-9,12", "plane", (0, 0, 1, -2.5), 0.005
    ),
    "points *: on plane sigma 5e-3": On("points *", "plane", (), 0.005),
    "points 1-9: on level plane sigma 2": On("points 1-9", ["level plane"], [], 2),
    "point 3: on line 1 2 3  0 0 1 sigma 1": On("point 3", "line", [1, 2, 3, 0, 0, 1], 1),
}


@pytest.mark.parametrize("text", RULES)
def test_a_text_is_a_rule_and_a_rule_a_text(text):
    (rule,) = Constraints(text)
    assert rule == RULES[text]
    assert rule.place == "constraints[0]"
    (again,) = Constraints(str(rule))
    assert again == rule
    assert pickle.loads(pickle.dumps(rule)) == copy.deepcopy(rule) == rule


BAD = (
    "",
    "camera",
    "camera 3",
    "camera 3:",
    "camera 3: f",
    "camera x: f fixed",
    "camera : f fixed",
    "camera 1,,2: f fixed",
    "cam 3: f fixed",
    "camera 3: f fix",
    "camera 3: f prior",
    "camera 3: f prior 5",
    "camera 3: f prior 5 sigma",
    "camera 3: f prior 5 sigma nan",
    "camera 3: f prior inf sigma 1",
    "camera 3: f prior sigma -1",
    "camera 3: f prior sigma 0",
    "camera 3: f prior sigma inf",
    "camera 3: f prior -2 %",
    "camera 3: f prior 1 2 3 sigma 4",
    "camera 3: f prior 1 2 3 %",
    "camera 3: f prior %",
    "camera 3: f prior 1_0 sigma 1",
    "camera 3: f prior [1,2,3] sigma 1",
    "camera 3: f prior 1 sigma 1/2",
    "camera 3: f in 3",
    "camera 3: f in [3, 2]",
    "camera 3: f in [nan, 2]",
    "camera 3: f in [inf, inf]",
    "camera 3: f in [3,]",
    "camera 3: f in [1,2,3]",
    "camera 3: f/f fixed",
    "camera 3: fx/fy share",
    "camera 3: ,f fixed",
    "camera 3: f fixed now",
    "camera 3: share",
    "camera 5-3: f fixed",
    'camera "x": f fixed',
    "camera 99999999999999999999: f fixed",
    "camera 1-99999999999: f fixed",
    "camera -1: f fixed",
    "image 3: f fixed",
    "image 3: share position",
    "image 3: position in [0, 1]",
    "image a.jpg: position fixed",
    'image "": position fixed',
    "image 3: rotation prior [1,2,3] sigma 1",
    "image 3: rotation prior sigma [1,2,3]",
    "image 3: position prior 1 sigma 1",
    "image 3: position prior 2 %",
    "image 3: position,rotation prior sigma 1",
    "point 3: rotation fixed",
    "point 3: on",
    "point 3: on cube 0 0 1 1 sigma 1",
    "point 3: on plane",
    "point 3: on plane 0 0 1 1",
    "point 3: on plane 0 0 1 1 sigma",
    "point 3: on plane 0 0 1 1 sigma nan",
    "point 3: on plane 0 0 1 1 sigma 0",
    "point 3: on plane 0 0 1 1 sigma -1",
    "point 3: on plane 0 0 1 1 sigma 1 2",
    "point 3: on plane 0 0 1 1 sigma 1/2",
    "point 3: on plane 0 0 1 nan sigma 1",
    "point 3: on plane 0 0 inf 1 sigma 1",
    "point 3: on plane 0 0 0 1 sigma 1",
    "point 3: on plane 0 0 1e-101 1 sigma 1",
    "point 3: on plane 1e308 1e308 0 1 sigma 1",
    "point 3: on plane 0 0 1 sigma 1",
    "point 3: on line sigma 1",
    "point 3: on level sigma 1",
    "point 3: on level line sigma 1",
    "point 3: on level plane 1 sigma 1",
    "point 3: on level plane 0 0 1 1 sigma 1",
    "point 3: on plane 0 0 1 1 1 sigma 1",
    "point 3: on line 0 0 1 1 sigma 1",
    "point 3: on line 1 2 3 0 0 0 sigma 1",
    "point 3: on plane,line 0 0 1 1 sigma 1",
    "image 3: on plane 0 0 1 1 sigma 1",
    "camera 3: on plane 0 0 1 1 sigma 1",
)


@pytest.mark.parametrize("text", BAD)
def test_anything_else_is_one_line_with_its_place(text):
    with pytest.raises(bundle.InputError) as error:
        Constraints("cameras *: f fixed", text)
    message = str(error.value)
    assert message.startswith("constraints[1]: ")
    assert message.count("constraints[1]") == 1
    assert "\n" not in message
    assert "expected" in message or "before it starts" in message


@pytest.mark.parametrize("rules", [3, [3], [None], [Fixed], b"camera 1: f fixed", [["x"]]])
def test_what_is_no_rule_at_all(rules):
    with pytest.raises(bundle.InputError, match="constraints"):
        Constraints(rules)


def test_objects_refuse_what_texts_do():
    for wrong in (
        lambda: Fixed("camera 1", ""),
        lambda: Fixed("camera 1", 3),
        lambda: Fixed(3, "f"),
        lambda: Prior("camera 1", "f"),
        lambda: Prior("camera 1", "f", 1, 2, 3),
        lambda: Prior("camera 1", "f", sigma="x"),
        lambda: Prior("camera 1", "f", sigma=True),
        lambda: Bounds("camera 1", "f", 2, 1),
        lambda: Ratio("camera 1", "fx"),
        lambda: On("point 1", "plane", 3, 1),
        lambda: On("point 1", "plane", (0, 0, 1, 1), (1, 2)),
        lambda: On("point 1", "plane", "0 0 1 1", 1),
        lambda: On("point 1", "plane,line", (0, 0, 1, 1), 1),
    ):
        with pytest.raises(bundle.InputError):
            wrong()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_rules_of_a_file_have_its_lines(tmp_path, encoding, newline):
    lines = [
        "# of the lens",
        "",
        "cameras *: f prior 2 %",
        '\timage "é #1.jpg": position fixed # x',
    ]
    path = tmp_path / "rules.txt"
    path.write_bytes((newline.join(lines) + newline).encode(encoding))
    rules = Constraints.read(path)
    assert [rule.place for rule in rules] == [f"{path}:3", f"{path}:4"]
    assert rules.rules[1] == Fixed(Target("image", ("é #1.jpg",)), "position")
    assert len(rules + "camera 1: f fixed") == 3


def test_a_file_with_a_wrong_line_or_no_text(tmp_path):
    path = tmp_path / "rules.txt"
    path.write_text("cameras *: f fixed\ncameras *: f fixt\n")
    with pytest.raises(bundle.InputError, match=r"rules\.txt:2: expected"):
        Constraints.read(path)
    path.write_bytes(b"\xff\xfe\xff")
    with pytest.raises(bundle.InputError, match="expected text"):
        Constraints.read(path)
    with pytest.raises(OSError):
        Constraints.read(tmp_path / "none.txt")
