"""Report of `bundle synth`: the written files and their statistics."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence as Sentences

from bundle.base.words import format_name, number, pixels, plural
from bundle.errors import shown
from bundle.interface.scene_options import FlightOptions, SceneOptions
from bundle.model.sequence.sequence import Sequence
from bundle.reports.sections import Column, Report, Section, Table
from bundle.reports.terminal.inputs import about_sequence, contents_of_sequence, written
from bundle.synthetic.streamed import SceneTally

EMPTY: Mapping[str, str] = {}
ERRORS = ("rmse", "median", "p95", "max")


def synthesized(
    options: SceneOptions,
    num_cameras: int,
    tally: SceneTally,
    output: dict[str, str],
    truth: dict[str, str],
    measured: Mapping[str, str] = EMPTY,
    lost: Sentences[str] = (),
) -> Report:
    """Return the report on a scene.

    Args:
        options: options of the scene.
        num_cameras: number of cameras in the scene.
        tally: statistics of its observations.
        output: path and format of the start.
        truth: path and format of the ground truth.
        measured: paths of the measured attitudes, by kind.
        lost: sentences on information that the format does not hold.
    """
    counts = {
        "num_cameras": num_cameras,
        "num_images": options.num_images,
        "num_points": options.num_points,
        "num_observations": tally.num_observations,
        "num_outliers": tally.num_outliers,
    }
    things = ("image", "camera", "point", "observation", "outlier")
    contents = ", ".join(plural(counts[f"num_{thing}s"], thing) for thing in things)
    where = f"{shown(truth['path'])} ({format_name(truth['format'])})"
    start, goal = tally.errors["start"], tally.errors["ground_truth"]
    headline = [
        f"Wrote {written(output)[1]}: {contents}.",
        f"The ground truth is {where}. RMSE {pixels(start.rmse)} px at the start, "
        f"{pixels(goal.rmse)} px at the truth.",
    ]
    headline += [f"Measured {kind}: {shown(path)}." for kind, path in measured.items()]
    sizes = {"track_length": tally.track_length(), "observations_per_image": tally.image_size()}
    names = [("track length", "track_length"), ("observations per image", "observations_per_image")]
    spread = [(label, sizes[name]) for label, name in names]
    errors = [
        (label, tally.errors[name])
        for label, name in (("start", "start"), ("ground truth", "ground_truth"))
    ]
    return Report(
        command="synth",
        headline=headline,
        warnings=lost,
        sections=[
            Section(
                is_detail=True,
                tables=[
                    Table([Column("", 0), *map(_spread, ("min", "median", "mean", "max"))], spread),
                    Table([Column("error in pixels", 0), *map(_error, ERRORS)], errors),
                ],
            )
        ],
        data={
            "options": options.asdict(),
            "output": output,
            "ground_truth": truth,
            **({"measured": dict(measured)} if measured else {}),
            **counts,
            **sizes,
            "reprojection_error": tally.errors,
        },
    )


def _spread(key: str) -> Column:
    def find(row: tuple[str, Mapping[str, float]]) -> float:
        return row[1][key]

    return Column(key, find, number)


def _error(key: str) -> Column:
    return Column(key, lambda row: getattr(row[1], key), pixels)


def made_flight(path: str, sequence: Sequence, options: FlightOptions) -> Report:
    """Return the report on a flight."""
    counts = about_sequence(path, "sequence", sequence)
    wrote = f"Wrote {shown(path)} (visual-inertial sequence)"
    return Report(
        command="synth",
        headline=[
            f"{wrote}: {contents_of_sequence(sequence)}.",
            "Its ground_truth.csv has the true poses at the stamps of the images.",
        ],
        data={
            "options": options.asdict(),
            "output": {"path": path, "format": "sequence"},
            "ground_truth": {"path": f"{path.rstrip('/')}/ground_truth.csv", "format": "euroc"},
            "contents": {
                key: value for key, value in counts.items() if key not in ("path", "format")
            },
        },
    )
