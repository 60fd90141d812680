"""The short report in Markdown, and its place in the README."""

from __future__ import annotations

import statistics
from pathlib import Path

from benchmarks import table, targets
from benchmarks.results import Results
from benchmarks.rows import Row
from benchmarks.series import REPEAT_BELOW
from benchmarks.solvers import REFERENCE

SHOWN = ("16-22106", "lund_door", "vr_opencv", "street-1000", "photo-collection-1000")
BEGIN, END = "<!-- bench:begin -->", "<!-- bench:end -->"


def heading(results: Results) -> str:
    """Return what was measured, on what, and how often."""
    machine, settings = results.machine, results.settings
    versions: dict[str, str] = {}
    for run in results.runs:
        versions |= run["outcome"]["versions"] if run["outcome"] else {}
    listed = ", ".join(f"{name} {version}" for name, version in versions.items())
    stopping = ", ".join(f"{name} {value:g}" for name, value in settings["stopping"].items())
    return (
        f"Measured {machine['date']} on {machine['cpu']}, {machine['cores']} cores, "
        f"{machine['system']}, load {machine['load before']} before; "
        f"{settings['threads']} threads, median of {settings['repeat']} interleaved runs (a run "
        f"above {REPEAT_BELOW:g} s is not repeated). {listed}. Stopping rule of all: {stopping}. "
        f"`{results.command}`"
    )


def _measured(results: Results) -> str:
    """Return when and on what, in a line."""
    machine = results.machine
    return (
        f"Measured {machine['date']} on {machine['cpu']}, {machine['cores']} cores, "
        f"{results.settings['threads']} threads."
    )


def answer(results: Results) -> str:
    """Return how fast, for whom, and where not: a list, before all tables."""
    lines = []
    for what, field in (
        ("A step", "step"),
        ("A total, build and solve,", "total"),
        ("Peak memory", "memory"),
    ):
        for peer in (targets.PEER, targets.CERES):
            ratios = {
                name: ratio
                for name in results.kinds
                if (ours := results.row(name, REFERENCE))
                and (row := results.row(name, peer))
                and (ratio := targets.quotient(getattr(row, field), getattr(ours, field)))
            }
            if ratios:
                least = min(ratios, key=ratios.__getitem__)
                most = max(ratios, key=ratios.__getitem__)
                lines.append(
                    f"- **{what}** of `{peer}` is {statistics.median(ratios.values()):.1f} times "
                    f"bundle's (median of {len(ratios)} problems; least {ratios[least]:.2f}, "
                    f"{least}; most {ratios[most]:.1f}, {most})."
                )
    missed = [goal for goal in targets.of(results) if not goal.met]
    lines += [f"- **Not met**: {targets.in_words(goal)}." for goal in missed]
    return "\n".join(lines)


def chosen(results: Results) -> list[tuple[Row, Row]]:
    """Return the rows (ours, the peer's) of the problems that the short table shows.

    They are those of SHOWN, real and synthetic, small and large; of a run that measured fewer than
    two of them, the first problems that it has.
    """
    have = [name for name in results.kinds if results.row(name, targets.PEER)]
    names = [name for name in SHOWN if name in have]
    names = names if len(names) > 1 else have[: len(SHOWN)]
    pairs = [(results.row(name, REFERENCE), results.row(name, targets.PEER)) for name in names]
    return [(ours, theirs) for ours, theirs in pairs if ours and theirs]


def bar(results: Results, ours: Row, peer: Row) -> tuple[str, float, float | None]:
    """Return a problem and the totals of the peer and of our Ceres backend over ours."""
    ceres = results.row(ours.problem, targets.CERES)
    return (
        ours.problem,
        targets.quotient(peer.total, ours.total) or 0.0,
        targets.quotient(ceres.total, ours.total) if ceres else None,
    )


def short_table(results: Results) -> str:
    """Return one line per problem: our total, and what the peers need as multiples of it."""
    lines = []
    for ours, peer in chosen(results):
        ceres = results.row(ours.problem, targets.CERES)
        lines.append(
            [
                ours.problem,
                f"{results.size(ours.problem).get('observations', 0):,}",
                table.seconds(ours.total.median) if ours.total else "",
                table.ratio(peer.total, ours.total),
                table.ratio(ceres.total, ours.total) if ceres else "",
                table.ratio(peer.memory, ours.memory, table.megabytes),
            ]
        )
    header = [
        "problem",
        "observations",
        "bundle, total",
        "pycolmap, total",
        "bundle's Ceres, total",
    ]
    return table.grid([*header, "pycolmap, peak memory"], lines) if lines else ""


def markdown(results: Results, page: str, image: str) -> str:
    """Return the report; ``page`` and ``image`` are paths as its links have them, or ""."""
    parts = [
        short_table(results),
        "Totals are build and solve under one stopping rule. 2.00x: twice as long, or twice as "
        "large, as bundle; in brackets the spread of the runs.",
        _measured(results),
    ]
    if image:
        parts.insert(0, f"![Total time of pycolmap and of Ceres, divided by bundle's]({image})")
    if page:
        parts.append(f"Versions, commands, every solver on every problem: [{page}]({page}).")
    return "\n\n".join(part for part in parts if part) + "\n"


def put_into(readme: Path, text: str) -> None:
    """Replace what stands between the markers of the README.

    Raises:
        ValueError: the file has not exactly one pair of markers, in order.
    """
    content = readme.read_text()
    before, begin, rest = content.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end or BEGIN in rest or END in before or END in after:
        raise ValueError(f"{readme}: expected one {BEGIN} followed by one {END}")
    readme.write_text(f"{before}{BEGIN}\n{text}{END}{after}")
