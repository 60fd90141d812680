"""Inputs of reports, and their rigs, shutters and changed cameras."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bundle.base.words import contents, few, format_name, number, pixels, plural
from bundle.errors import shown
from bundle.model.problem import Problem
from bundle.model.pycolmap.problem_source import imported_source
from bundle.reports.sections import Column, Section, Table
from bundle.solving.parameter_changes import SensorChange, shutter_gain

if TYPE_CHECKING:
    from bundle.analysis.statistics.description import RigSummary
    from bundle.editing.camera_sharing import CameraEdits
    from bundle.editing.rolling_shutters import GlobalShutterModel
    from bundle.model.pose_graph_arrays import PoseGraph
    from bundle.solving.result import Result

Facts = list[tuple[str, str]]

IMPORTED = ("source_rmse", "rmse", "notes")
"""Attributes of an import from a file of another program."""


def input_facts(path: str, given: Problem | PoseGraph | None, *, rigs: bool = False) -> Facts:
    """Return path, format and contents; None is an object of a Python file."""
    if given is None:
        return [("input", f"{shown(path)} (Python)")]
    if not isinstance(given, Problem):
        return [("input", f"{shown(path)} (g2o)"), ("", contents_of(given))]
    return [
        ("input", f"{shown(path)} ({format_name(given.format)})"),
        ("", contents(given)),
        *(("", note) for note in import_notes(given)),
        *(rig_fact(given) if rigs else []),
        *shutter_fact(given),
    ]


def about_input(path: str, given: Problem | PoseGraph | None) -> dict[str, Any]:
    """Return path, format and counts of an input as JSON entries, and the notes on its file."""
    if given is None:
        return {"path": path, "format": "python"}
    if not isinstance(given, Problem):
        return {
            "path": path,
            "format": "g2o",
            "dimension": given.dimension,
            "num_poses": given.num_poses,
            "num_edges": given.num_edges,
            "num_closures": int(given.is_closure.sum()),
            "num_fixed_poses": int(given.fixed.sum()),
            "has_poses": given.has_poses,
            "notes": list(given.notes),
        }
    names = ("num_rigs", "num_frames", "num_sensors") if given.num_frames else ()
    counts = ("num_cameras", "num_images", "num_points", "num_observations", *names)
    source = imported_source(given)
    return {
        "path": path,
        "format": given.format,
        **{name: getattr(given, name) for name in counts},
        **about_shutter(given),
        **({name: getattr(source, name) for name in IMPORTED} if source is not None else {}),
    }


def contents_of(given: Problem | PoseGraph) -> str:
    """Return text such as "16 images, ..." or "12 poses, 17 edges, 6 closures, 1 pose fixed"."""
    if isinstance(given, Problem):
        return contents(given)
    counts = (given.num_poses, given.num_edges, int(given.is_closure.sum()))
    fixed = int(given.fixed.sum())
    words = ", ".join(map(plural, counts, ("pose", "edge", "closure")))
    return words + (f", {plural(fixed, 'pose')} fixed" if fixed else "")


def import_notes(problem: Problem) -> list[str]:
    """Return sentences about the import from a file of another program; () for other problems."""
    source = imported_source(problem)
    if source is None:
        return []
    agreement = (
        f"RMSE {pixels(source.source_rmse)} px by the formula of {format_name(problem.format)}, "
        f"{pixels(source.rmse)} px by COLMAP's."
    )
    return [agreement, *source.notes]


def rig_fact(problem: Problem) -> Facts:
    """Return a fact such as "1 rig of 2 sensors, 26 frames"; empty without rigs."""
    if problem.num_frames == 0:
        return []
    # Import late: most problems have no rigs, and this import takes time.
    from bundle.analysis.statistics.description import rig_summaries

    rigs = rig_summaries(problem)
    counts = [len(rig.sensors) for rig in rigs]
    low, high = min(counts), max(counts)
    sensors = plural(high, "sensor") if low == high else f"{low} to {high} sensors"
    frames = sum(rig.num_frames for rig in rigs)
    return [("rigs", f"{plural(len(rigs), 'rig')} of {sensors}, {plural(frames, 'frame')}")]


def written(output: dict[str, str] | None, source: str = "") -> tuple[str, str]:
    """Return the fact about the output; None: nothing was written. ``source``: the input."""
    if output is None:
        return "output", "nothing was written"
    path = output["path"]
    is_input = source and Path(path).resolve() == Path(source).resolve()
    replaced = ", in place of the input" if is_input else ""
    return "output", f"{shown(path)} ({format_name(output['format'])}){replaced}"


MOST_ROWS = 20  # number of listed sensors

MOST_SENSORS = 8  # number of sensors whose changes are shown


SENSORS = (
    Column("sensor", lambda change: f"{change.rig_id}:{change.camera_id}"),
    Column("baseline before", "baseline_before", "{:.6g}".format),
    Column("after", "baseline_after", "{:.6g}".format),
    Column("turned [deg]", "rotation", "{:.3g}".format),
)


def rig_sections(rigs: Sequence[RigSummary]) -> list[Section]:
    """Return the sensors of every rig; empty without rigs."""
    if not rigs:
        return []
    cells = [
        (
            f"{rig.rig_id} ({plural(rig.num_frames, 'frame')})" if index == 0 else "",
            f"{sensor.camera_id}",
            "reference" if sensor.is_reference else number(sensor.baseline),
            str(sensor.num_images),
            str(sensor.num_observations) if sensor.num_observations else "unobserved",
        )
        for rig in rigs
        for index, sensor in enumerate(rig.sensors)
    ]
    head = ("rig", "camera", "baseline", "images", "observations")
    table = Table.of(
        head, cells, keys=2, most=MOST_ROWS,
        others=lambda count: f"and {plural(count, 'more sensor')}; --json FILE lists all",
    )  # fmt: skip
    return [Section(tables=[table])]


def sensor_sections(changes: Sequence[SensorChange]) -> list[Section]:
    """Return the motion of sensors on their rigs; empty if no sensor moved."""
    table = Table(
        SENSORS, changes, most=MOST_SENSORS,
        others=lambda count: f"{plural(count, 'other sensor')} moved less; --json FILE lists all",
    )  # fmt: skip
    return [Section(tables=[table])] if changes else []


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
    """Return the rolling shutters of a problem as JSON entries; empty without any."""
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
    """Return the same as JSON entries; empty for None."""
    if moved is None:
        return {}
    names = ("num_moved", "num_left", "median", "largest", "motion")
    return {"global_shutter": {name: getattr(moved, name) for name in names}}


def solved_data(solved: Result, readout_sigma: dict[int, float]) -> dict[str, Any]:
    """Return JSON entries of rolling shutters, sigmas by camera id; empty without any."""
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
    if refined:
        words += f"; readout in frames of {few(refined)}"
    if solved.options.twists == "hard":
        words += " (hard twists: standard deviations are too small)"
    return [f"{words}."]


MOST_IDS = 8


def edit_rows(edits: CameraEdits | None) -> list[tuple[str, str]]:
    """Return rows of facts; empty without changes."""
    if edits is None:
        return []
    sentences = [*_models(edits)]
    for group in edits.shared_groups:
        sentences.append(f"{few(group, MOST_IDS)} become camera {group[0]}")
    if edits.num_copies is not None:
        sentences.append(f"one for each image: {plural(edits.num_copies, 'new camera')}")
    if edits.before.num_observations:
        sentences.append(
            f"reprojection RMSE {pixels(edits.before.rmse)} -> {pixels(edits.after.rmse)} px"
        )
    return [("cameras" if not row else "", text) for row, text in enumerate(sentences)]


def edit_data(edits: CameraEdits | None) -> dict[str, Any]:
    """Return the JSON entries of the changes; empty without changes."""
    return {} if edits is None else {"camera_edits": edits.asdict()}


def _models(edits: CameraEdits) -> list[str]:
    if edits.model is None:
        return []
    if not edits.changes:
        return [f"all were {edits.model} before"]
    fitted = [change for change in edits.changes if not change.exact]
    model = edits.changes[0].new_model
    exact = len(edits.changes) - len(fitted)
    sentences = [f"{plural(exact, 'camera')} became {model}, the same lens"] if exact else []
    if fitted:
        worst = max(fitted, key=lambda change: change.max)
        rms = max(change.rms for change in fitted)
        sentences.append(
            f"{plural(len(fitted), 'camera')} became {model} by a fit: off by up to "
            f"{pixels(worst.max)} px (camera {worst.camera_id}), rms up to {pixels(rms)} px"
        )
    return sentences
