"""Signs of the accelerometer's axes, by the linear start of several spans.

The linear start determines velocity, gravity and depths in metres from tracks and samples. It does
not know that points are in front of the camera. If all forces have the wrong sign, or those along
gravity, the same motion mirrored at the first image explains gravity and parallax: velocities and
depths are negative, those of nearly all points in every span. Clean spans have hardly any.

If other axes are reversed, no motion explains the samples: depths have both signs, or the bias is
implausible. Signs that pass all tests of a start in spans where the given ones fail name the axes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from bundle.inertial.vio.initialize import SPAN, Span, find_span, objection_to, span_start
from bundle.inertial.vio.sequence_images import SequenceImages

BEHIND, BEFORE = 0.95, 0.5  # shares of points behind the camera: reversed above, right below
SPANS = 6
AGREE = 2  # spans that decide
STANDARD_GRAVITY = 9.81


def is_reversed(images: SequenceImages) -> bool:
    """Return True if the samples fit the negative of the accelerometer's values."""
    count = 0
    for span in _spans(images):
        behind, objection = _start(images, span)
        if objection == "no parallax" or BEFORE < behind < BEHIND:
            continue
        if behind <= BEFORE:
            return False
        count += 1
        if count == AGREE:
            return True
    return False


def right_signs(images: SequenceImages) -> tuple[int, ...] | None:
    """Return signs of the accelerometer's axes that explain spans; None without a clear answer."""
    starts = [(span, _start(images, span)[1]) for span in _spans(images)]
    spans = [span for span, objection in starts if objection not in ("", "no parallax")][:AGREE]
    if len(spans) < AGREE:
        return None
    found = []
    for signs in product((1, -1), repeat=3):
        accel = images.sequence.accel * np.array(signs, np.float64)
        changed = SequenceImages(replace(images.sequence, accel=accel))
        if all(not _start(changed, span)[1] for span in spans):
            found.append(signs)
    return found[0] if len(found) == 1 else None


def _spans(images: SequenceImages) -> Iterator[Span]:
    """Yield spans spread over the sequence, the last one first: vehicles begin at rest."""
    stamps, covered = images.stamps, np.flatnonzero(images.covered)
    first, last = int(stamps[covered[0]]), int(stamps[covered[-1]] - 1e9 * SPAN)
    for stamp in np.linspace(last, first, SPANS).round() if last > first else ():
        span = find_span(images, int(np.searchsorted(stamps, stamp)), int(covered[-1]))
        if span is not None:
            yield span


def _start(images: SequenceImages, span: Span) -> tuple[float, str]:
    """Return the share of points behind the camera, and the objection to the start of a span."""
    found = span_start(images, span, STANDARD_GRAVITY, "zero_order_hold")
    return float(np.mean(found.depths <= 0)), objection_to(found, span, images.sequence.calibration)
