"""Headline of a comparison: the verdict in at most four sentences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bundle.base.words import number, plural
from bundle.judging.evaluation.lens_difference import LensDifference
from bundle.judging.evaluation.movement_in_sigmas import SigmaMovement

FAR = 3
"""Sigmas beyond which a movement is not explained by the uncertainty."""

WORDS = {
    "identical": "A and B are identical",
    "agrees": "A agrees with B",
    "close": "A is close to B",
    "differs": "A differs from B",
    "contradicts": "A contradicts B",
}


def headline_of(result: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the sentences for the fields of an :class:`Evaluation`."""
    sentences = [_poses(result)]
    movement: SigmaMovement | None = result["movement"]
    if movement is not None and np.isfinite(movement.median):
        sentences.append(_moved(movement))
    if result["lenses"]:
        sentences.append(_lenses(result["lenses"]))
    return tuple(sentences)


def _poses(result: Mapping[str, Any]) -> str:
    pairs, position, rotation = (result[name] for name in ("association", "position", "rotation"))
    # A truth may have many times more stamps than A.
    missing = pairs.only_a if pairs.by == "time" else pairs.only_b
    whole = len(pairs) + len(missing)
    noun = "image" if pairs.by in ("name", "base name", "stem") else "pose"
    of = f"{len(pairs)} of {plural(whole, noun)}" if missing else f"all {plural(whole, noun)}"
    if result["verdict"] == "identical":
        rounded = " up to rounding errors" if max(position.max, rotation.max) > 0 else ""
        return f"{WORDS['identical']} on {of}{rounded}."
    share = 100 * position.rmse / result["size"] if result["size"] > 0 else np.inf
    return (
        f"{WORDS[result['verdict']]} on {of}: {number(position.rmse)} {result['unit']} rms in "
        f"position ({number(share)} % of the size of B), {number(rotation.rmse)} degrees rms in "
        "rotation."
    )


def _moved(movement: SigmaMovement) -> str:
    far = int((movement.sigmas > FAR).sum())
    if not movement.is_minimum:
        meaning = "no measure of quality, because A is not at a minimum of least squares"
    elif movement.median <= 1:
        meaning = "within the uncertainty of A"
        meaning += f", except {plural(far, 'image')} beyond {FAR}" if far else ""
    elif movement.median <= FAR:
        meaning = "about the uncertainty of A"
    else:
        meaning = "more than the uncertainty of A explains"
    if movement.assumed and movement.is_minimum:
        meaning += f", if its solve held {movement.assumed}"
    return (
        f"Relative poses differ by {number(movement.median)} sigmas of A's covariance (median; at "
        f"most {number(movement.largest)}): {meaning}."
    )


def _lenses(lenses: tuple[LensDifference, ...]) -> str:
    known = [lens for lens in lenses if np.isfinite(lens.pixels.rmse)]
    if not known:
        return "Lenses share no rays, so that they cannot be compared."
    if all(lens.pixels.max == 0 for lens in known):
        return "Lenses are identical."
    worst = max(known, key=lambda lens: lens.pixels.rmse)
    typical = float(np.median([lens.pixels.rmse for lens in known]))
    if len(known) == 1:
        return (
            f"Lenses differ by {number(typical)} px (rms over the image; at most "
            f"{number(worst.pixels.max)})."
        )
    return (
        f"Lenses differ by {number(typical)} px (median of {len(known)} cameras, rms over the "
        f"image; most in camera {worst.camera_a}: {number(worst.pixels.rmse)} px)."
    )
