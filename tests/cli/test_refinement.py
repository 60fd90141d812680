"""A refinement is plain where slices serve it, too: each other flag makes it more than that."""

from __future__ import annotations

import pytest

from bundle.cli.main import command_parser
from bundle.cli.refinement import Refinement


def asked(*words):
    return Refinement.of(command_parser().parse_args(["refine", "in", "-o", "out.txt", *words]))


@pytest.mark.parametrize(
    "words",
    [
        (),
        ("--loss", "cauchy", "--fix-images", "1"),
        ("--json", "-", "--format", "bal", "--overwrite"),
        ("--checkpoint", "a.ckpt", "--checkpoint-interval", "3"),
    ],
)
def test_plain(words):
    assert asked(*words).is_plain


@pytest.mark.parametrize(
    "words",
    [
        ("--rounds", "2"),
        ("--hold-out", "10"),
        ("--only-images", "1"),
        ("--gps", "geo.txt"),
        ("--gcp", "gcp_list.txt"),
        ("--loops", "closures.csv"),
        ("--camera-model", "OPENCV"),
        ("--set", "camera 1: f fixed"),
        ("--rig-config", "rigs.json"),
        ("--html", "page.html"),
        ("--check-gradients",),
    ],
)
def test_more_than_plain(words):
    assert not asked(*words).is_plain
