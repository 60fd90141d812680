"""Cameras that were changed before the solve, in the reports of commands."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bundle.base.words import pixels, plural

if TYPE_CHECKING:
    from bundle.editing.edit_record import CameraEdits

MOST_IDS = 8


def edit_rows(edits: CameraEdits | None) -> list[tuple[str, str]]:
    """Return rows of facts; empty without changes."""
    if edits is None:
        return []
    sentences = [*_models(edits)]
    for group in edits.shared_groups:
        ids = ", ".join(map(str, group[:MOST_IDS]))
        more = len(group) - MOST_IDS
        and_more = f" and {more} more" if more > 0 else ""
        sentences.append(f"{ids}{and_more} become camera {group[0]}")
    if edits.num_copies is not None:
        sentences.append(f"one for each image: {plural(edits.num_copies, 'new camera')}")
    if edits.before.num_observations:
        sentences.append(
            f"reprojection RMSE {pixels(edits.before.rmse)} -> {pixels(edits.after.rmse)} px"
        )
    return [("cameras" if not row else "", text) for row, text in enumerate(sentences)]


def edit_data(edits: CameraEdits | None) -> dict[str, Any]:
    """Return the entries for programs; empty without changes."""
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
