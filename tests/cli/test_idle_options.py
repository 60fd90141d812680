"""Options without effect and paths without a name: refused before any work, with the flags."""

import pytest


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("refine", "IN", "-o", "OUT", "--loss-scale", "2"), ("--loss-scale:", "--loss trivial")),
        (("compare", "IN", "--loss-scale", "2"), ("--loss-scale:", "--loss trivial")),
        (("synth", "OUT", "--rings", "2"), ("--rings:", "--scene orbit", "--scene street")),
        (("synth", "OUT", "--scene", "orbit", "--no-loop-closure"), ("--loop-closure:",)),
        (("inspect", "--graph", "IN", "--refine", "poses"), ("--refine:", "INPUT")),
        (("inspect", "--graph", "IN", "--recalibrate"), ("--recalibrate:", "INPUT")),
        (("info", ""), ("INPUT", "expected a path, found an empty string")),
        (("refine", "", "-o", "OUT"), ("INPUT", "an empty string")),
        (("refine", "IN", "-o", ""), ("--output", "an empty string")),
        (("convert", "IN", " "), ("OUTPUT", "an empty string")),
        (("synth", ""), ("OUTPUT", "an empty string")),
        (("compare", "IN", ""), ("INPUT", "an empty string")),
        (("inspect", "--graph", ""), ("--graph", "an empty string")),
        (("info", "IN", "--json", ""), ("--json", "an empty string")),
    ],
)
def test_refused_in_one_line(run, tmp_path, arguments, words):
    named = {"IN": tmp_path / "in.txt", "OUT": tmp_path / "out"}
    (tmp_path / "in.txt").write_text("a b\n")
    code, out, err = run(*(named.get(word, word) for word in arguments))
    assert (code, out) == (2, "")
    last = err.splitlines()[-1]
    assert last.startswith("error: ")
    assert all(word in last for word in words), last
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("scene", ["street", "orbit", "photo-collection"])
def test_a_small_scene_needs_no_other_option(run, tmp_path, scene):
    small = ("--images", "3", "--points", "20", "--scene", scene)
    assert run("synth", tmp_path / "model", *small).code == 0
    assert run("info", tmp_path / "model").code == 0
