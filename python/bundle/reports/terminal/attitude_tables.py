"""Gravity, orientations and headings in the report of `bundle refine`."""

from __future__ import annotations

from collections.abc import Sequence

from bundle.base.words import plural
from bundle.errors import shown
from bundle.georeference.attitudes import AttitudeErrors
from bundle.reports.sections import Section, Table

MOST_IMAGES = 5
"""Number of listed images that disagree."""


def attitude_sections(attitudes: Sequence[AttitudeErrors]) -> list[Section]:
    """Return the residuals by kind, and the images whose measurement contradicts the others."""
    head = ("", "images", "median [degrees]", "rms [sigmas]", "mean off by [degrees]", "disagree")
    rows = [
        (
            errors.noun,
            str(len(errors.images)),
            f"{errors.median:.3g}",
            f"{errors.rms_sigmas:.2f}",
            f"{errors.off:.2g}",
            str(len(errors.suspects)),
        )
        for errors in attitudes
    ]
    sections = [Section(tables=[Table.of(head, rows)])]
    for errors in attitudes:
        if not errors.suspects:
            continue
        cells = [
            (shown(image.image), f"{image.degrees:.1f}", f"{image.sigmas:.1f}")
            for image in errors.suspects
        ]
        names = (f"{errors.noun} against most others", "degrees", "sigmas")
        table = Table.of(names, cells, most=MOST_IMAGES, others=_others)
        sections.append(Section(tables=[table]))
    return sections


def _others(count: int) -> str:
    return f"{plural(count, 'other image')} as well; --json FILE lists all"
