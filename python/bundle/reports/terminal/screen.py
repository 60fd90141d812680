"""Layout of a report on a terminal: headline, sections, findings with their commands.

Without --verbose, details and all but the first warnings and findings are hidden.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence

from bundle.base.tables import Block, Line, Paragraph, Piece, columns, facts, notes, render
from bundle.base.words import plural
from bundle.interface.finding import DETAILS, Finding
from bundle.reports.sections import Report, Section, Table

MOST_FINDINGS, MOST_WARNINGS = 3, 2
"""Numbers of findings and of warnings that are shown without --verbose."""

MOST_LINES = 25  # number of lines without --verbose, beyond which fewer findings are shown


def laid_out(
    report: Report | Iterable[Section], verbose: bool = False, most_findings: int = MOST_FINDINGS
) -> list[Block | str]:
    """Return a report, or sections alone, with an empty line between the parts."""
    if not isinstance(report, Report):
        return _sections(report, verbose)
    headline: list[Block | str] = [Paragraph(sentence, "bold") for sentence in report.headline]
    headline += _warnings(report.warnings, verbose)
    findings = _findings(report.findings, None if verbose else most_findings)
    parts: list[Block | str] = []
    for part in (headline, _sections(report.sections, verbose), findings):
        parts += ["", *part] if parts and part else part
    return parts


def fitted(report: Report, width: int) -> list[Block | str]:
    """Return a report without details, with as few findings as its lines need, but one at least."""
    parts: list[Block | str] = []
    for most in range(MOST_FINDINGS, 0, -1):
        parts = laid_out(report, most_findings=most)
        if render(*parts, width=width).count("\n") <= MOST_LINES:
            break
    return parts


def _sections(sections: Iterable[Section], verbose: bool) -> list[Block | str]:
    parts: list[Block | str] = []
    for section in sections:
        if section.is_page_only or (section.is_detail and not verbose):
            continue
        if parts and not section.is_joined:
            parts.append("")
        if section.facts:
            parts.append(facts(section.facts))
        for table in section.tables:
            parts += _table(table)
        parts += section.text
        if section.command:
            parts.append(CommandLine(section.command))
        parts += notes(section.notes, style="yellow" if section.is_warning else "")
    return parts


def _warnings(sentences: Sequence[str], verbose: bool) -> list[Block | str]:
    shown = sentences if verbose else sentences[:MOST_WARNINGS]
    hidden = len(sentences) - len(shown)
    more = [f"{plural(hidden, 'more warning')} (--verbose)"] if hidden else []
    return notes([*shown, *more], style="yellow")


def _findings(findings: Sequence[Finding], most: int | None) -> list[Block | str]:
    if most is not None:
        findings = [finding for finding in findings if finding.kind not in DETAILS]
    shown = findings[:most]
    parts: list[Block | str] = []
    for finding in shown:
        parts += notes([finding.sentence], style="yellow")
        parts += [CommandLine(finding.command, indent=2)] if finding.command else []
    hidden = len(findings) - len(shown)
    more = [f"{plural(hidden, 'more finding')} (--verbose)"] if hidden else []
    return [*parts, *notes(more)]


def _table(table: Table) -> list[Block | str]:
    made = columns(table.head, table.cells(), left=table.left, keys=table.keys)
    legend = [Paragraph(table.legend, "dim")] if table.legend else []
    return [made, *legend, *notes(table.rest())]


class CommandLine:
    """Command line with backslashes at line breaks, so that it can be copied unchanged."""

    def __init__(self, command: str, indent: int = 0) -> None:
        self.command, self.indent = command, indent

    def lines(self, width: int) -> Iterable[Line]:
        """Return the indented lines; a long word is not divided."""
        lines: list[str] = []
        for word in map(shlex.quote, shlex.split(self.command)):
            if lines and len(lines[-1]) + len(word) + 3 <= width:
                lines[-1] += f" {word}"
            else:
                lines.append(" " * (self.indent + 4 * bool(lines)) + word)
        return [[Piece(line)] for line in " \\\n".join(lines).split("\n")]
