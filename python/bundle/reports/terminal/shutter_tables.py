"""Rolling shutters in reports: facts about a model, and observations moved to a global shutter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bundle.base.words import number, pixels, plural
from bundle.model.problem import Problem
from bundle.solving.parameter_changes import shutter_gain

if TYPE_CHECKING:
    from bundle.editing.rolling_shutters import GlobalShutterModel
    from bundle.solving.result import Result


def shutter_fact(problem: Problem) -> list[tuple[str, str]]:
    """Return a fact about the rolling shutters of a problem; empty without any."""
    shutter = problem.rolling_shutter
    if shutter is None or not shutter.is_rolling.any():
        return []
    rolls = np.flatnonzero(shutter.is_rolling)
    words = " and ".join(sorted({shutter.direction[camera] for camera in rolls.tolist()}))
    known = shutter.readout[rolls][np.isfinite(shutter.readout[rolls])]
    readout = "readout unknown"
    if len(known):
        low, high = float(known.min()), float(known.max())
        value = number(low) if low == high else f"{number(low)} to {number(high)}"
        readout = f"readout {value} of a frame"
    if len(rolls) < problem.num_cameras:
        words += f" of {len(rolls)} of {problem.num_cameras} cameras"
    facts = [("rolling shutter", f"{words}, {readout}")]
    twist = shutter.twist[shutter.is_rolling[problem.image_camera]]
    if not len(twist):
        return facts
    turn = np.degrees(np.linalg.norm(twist[:, :3], axis=1))
    shift = np.linalg.norm(twist[:, 3:], axis=1)
    median = f"median turn {number(float(np.median(turn)))} degrees"
    median += f", shift {number(float(np.median(shift)))} length units per readout"
    return [*facts, ("", median if twist.any() else "all twists are zero: not yet estimated")]


def about_shutter(problem: Problem) -> dict[str, Any]:
    """Return the rolling shutters of a problem for programs; empty without any."""
    shutter = problem.rolling_shutter
    if shutter is None or not shutter.is_rolling.any():
        return {}
    rolls = np.flatnonzero(shutter.is_rolling).tolist()
    twist = shutter.twist[shutter.is_rolling[problem.image_camera]]
    return {
        "rolling_shutter": {
            "cameras": [
                {
                    "camera_id": int(problem.camera_ids[camera]),
                    "direction": shutter.direction[camera],
                    "readout": float(shutter.readout[camera]),
                }
                for camera in rolls
            ],
            "num_images": len(twist),
            "is_estimated": bool(twist.any()),
        }
    }


def shutter_moves(moved: GlobalShutterModel | None) -> list[str]:
    """Return sentences about observations moved to a global shutter; empty for None."""
    if moved is None:
        return []
    sentences = [
        f"{plural(moved.num_moved, 'observation')} moved to a global shutter, by "
        f"{pixels(moved.median)} px (median) and up to {pixels(moved.largest)} px; residuals stay. "
        f"Images moved by {100 * moved.motion:.2g} % of their height during the readout: a "
        "refinement without the rolling shutter differs by at most about this share of a sigma."
    ]
    if moved.num_left:
        sentences.append(f"{plural(moved.num_left, 'observation')} without a projection stay.")
    return sentences


def shutter_data(moved: GlobalShutterModel | None) -> dict[str, Any]:
    """Return the same for programs; empty for None."""
    if moved is None:
        return {}
    names = ("num_moved", "num_left", "median", "largest", "motion")
    return {"global_shutter": {name: getattr(moved, name) for name in names}}


def solved_data(solved: Result, readout_sigma: dict[int, float]) -> dict[str, Any]:
    """Return the outcome of a solve with rolling shutters for programs; empty without any.

    Args:
        solved: the result.
        readout_sigma: standard deviation of each refined readout, by camera id.
    """
    gain = shutter_gain(solved)
    if gain is None:
        return {}
    about = about_shutter(solved.problem)["rolling_shutter"]
    for camera in about["cameras"]:
        camera["readout_sigma"] = readout_sigma.get(camera["camera_id"])
    return {
        "rolling_shutter": about
        | {
            "twists": solved.options.twists,
            "twist_rms": {"rotation": gain.turn, "translation": gain.shift},
            "rmse_global_shutter": gain.rmse_global,
            "rmse": gain.rmse,
        }
    }


def solved_sentences(solved: Result, readout_sigma: dict[int, float]) -> list[str]:
    """Return what rolling shutters gained; empty without any."""
    gain = shutter_gain(solved)
    if gain is None or not solved.summary.is_solution_usable:
        return []
    shutter, problem = solved.problem.rolling_shutter, solved.problem
    assert shutter is not None
    words = (
        f"Rolling shutter: RMSE {pixels(gain.rmse_global)} px with the input's poses and global "
        f"shutters, {pixels(gain.rmse)} px now; images turn by {number(gain.turn)} degrees (rms) "
        "per readout of their height"
    )
    refined = [
        f"camera {key}: {shutter.readout[problem.camera_ids == key][0]:.4g} +- {sigma:.2g}"
        for key, sigma in readout_sigma.items()
    ]
    more = f" and {len(refined) - 3} more" if len(refined) > 3 else ""
    if refined:
        words += f"; readout in frames of {', '.join(refined[:3])}{more}"
    if solved.options.twists == "hard":
        words += " (hard twists: standard deviations are too small)"
    return [f"{words}."]
