"""The short report in Markdown, and its place in the README."""

from __future__ import annotations

from pathlib import Path

from benchmarks import table, targets
from benchmarks.results import Results
from benchmarks.series import REPEAT_BELOW
from benchmarks.solvers import REFERENCE

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


def markdown(results: Results, page: str, image: str) -> str:
    """Return the report; ``page`` and ``image`` are paths as its links have them, or ""."""
    parts = [heading(results)]
    goals = targets.of(results)
    if goals:
        parts.append(targets.as_table(goals))
    if image:
        parts.append(f"![Cost gap against time]({image})")
    for peer in (targets.PEER, targets.CERES):
        tables = [{row.solver: row for row in results.rows_of(name)} for name in results.kinds]
        pairs = [(rows[REFERENCE], rows[peer]) for rows in tables if {REFERENCE, peer} <= set(rows)]
        if pairs:
            parts += [
                f"`{peer}` as a ratio to `{REFERENCE}` (above 1: it needs more; in brackets the "
                "spread of the runs):",
                table.of_pair(pairs),
            ]
    if page:
        parts.append(f"Every solver on every problem, growth, threads: [{page}]({page}).")
    return "\n\n".join(parts) + "\n"


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
