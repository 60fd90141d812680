"""Solves tiny problems under the option sets on standard input, one JSON list of flags a line.

Answers one JSON object a line: the number of the set when it begins, then how it ended. Whoever
reads sees which set was running when the process died.
"""

import argparse
import json
import sys

import numpy as np

import bundle
from bundle.cli.option_flags import add_fields, options_given
from bundle.cli.parser import Parser
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.reports.sections import plain
from bundle.reports.terminal.solve_data import result_data
from tests.scenes import scene


def behind() -> Problem:
    problem = scene(3, 8)
    poses = problem.cam_from_world.copy()
    poses[:, 6] = -6.0
    return problem.replace(cam_from_world=poses)


def disconnected() -> Problem:
    problem = scene(4, 10)
    keep = (problem.observation_image < 2) == (problem.observation_point < 5)
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    return problem.replace(**{name: getattr(problem, name)[keep] for name in names})


def mixed_cameras() -> Problem:
    """Two images share a PINHOLE camera, one has an OPENCV of its own, one camera is unused."""
    params = np.zeros((3, 8))
    params[0, :2], params[1, :2], params[2, :1] = 505.0, 505.0, 500.0
    return scene(
        3,
        10,
        kind="colmap",
        image_camera=np.array([0, 1, 0]),
        camera_ids=np.array([4, 2, 9]),
        camera_models=("PINHOLE", "OPENCV", "SIMPLE_PINHOLE"),
        camera_params=params,
        camera_sizes=np.zeros((3, 2)),
    )


SCENES = {
    "own cameras": lambda: scene(4, 12),
    "shared camera": lambda: scene(4, 12, kind="colmap", shared_camera=True),
    "mixed cameras": mixed_cameras,
    "one image": lambda: scene(1, 5),
    "behind": behind,
    "disconnected": disconnected,
}


def solve(problem: Problem, flags: list[str]) -> dict[str, object]:
    parser = Parser(prog="bundle refine")
    add_fields(parser, SolveOptions)
    try:
        options = options_given(parser.parse_args(flags, argparse.Namespace()), SolveOptions)
        solved = bundle.solve(problem, options)
    except bundle.InputError as error:
        return {"refused": str(error)}
    summary = solved.summary
    plain(result_data(solved))
    return {
        "termination": summary.termination_type,
        "usable": summary.is_solution_usable,
        "initial": summary.initial_cost,
        "final": summary.final_cost,
        "words": solved.outcome,
    }


def main() -> None:
    problems = {name: make() for name, make in SCENES.items()}
    for number, line in enumerate(sys.stdin):
        print(json.dumps({"begins": number}), flush=True)
        name, flags = json.loads(line)
        print(json.dumps(solve(problems[name], flags)), flush=True)


if __name__ == "__main__":
    main()
