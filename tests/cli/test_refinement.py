"""A refinement is plain where slices serve it, too: each other flag makes it more than that."""

from __future__ import annotations

import pytest

from bundle.cli.commands import COMMANDS
from bundle.cli.main import command_parser
from bundle.cli.output import Progress
from bundle.cli.refinement import Refinement
from bundle.interface.round_options import CheckpointOptions
from bundle.io.recognition import Kind

CHECKPOINTS = CheckpointOptions.names()


def flags_beyond(*words, plain=CHECKPOINTS):
    given = command_parser().parse_args(["refine", "in", "-o", "out.txt", *words])
    progress = Progress(quiet=True)
    run = Refinement(COMMANDS["refine"], Kind.RECONSTRUCTION, given, progress, given.input)
    run.check()
    return run.flags_beyond(*plain)


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
    assert flags_beyond(*words) == []


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
        ("--input-format", "nvm"),
        ("--reconstruction", "0"),
        ("--imu", "imu.csv", "--frame-times", "times.csv", "--calibration", "calibration.yaml"),
    ],
)
def test_more_than_plain(words):
    assert flags_beyond(*words) == [words[0]]


def test_files_of_checkpoints_are_beyond_where_they_are_not_named():
    assert flags_beyond("--checkpoint", "a.ckpt", "--rounds", "2", plain=()) == [
        "--checkpoint", "--rounds",
    ]  # fmt: skip
