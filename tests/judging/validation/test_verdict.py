"""Verdict of a validation on the lenses of the input, which has SIMPLE_RADIAL per image."""

import pytest

from tests.judging.validation.validations import validation


def lenses(*levels):
    rows = (("SIMPLE_RADIAL", "size", 2), ("OPENCV", "size", 6), ("SIMPLE_RADIAL", "each", 40))
    return [(*row, level, "motion", "") for row, level in zip(rows, levels, strict=True)]


@pytest.mark.parametrize(
    ("levels", "verdict", "recommended"),
    [
        ((1.0, 1.0, 1.0), "no difference", 0),
        ((1.0, 1.2, 1.0), "simpler", 0),
        ((1.2, 1.0, 1.2), "better", 1),
        ((1.2, 1.2, 1.0), "keep", 2),
    ],
)
def test_words(levels, verdict, recommended):
    _, found = validation(lenses(*levels), fires=False)
    assert (found.verdict, found.recommended) == (verdict, recommended)
    assert found.present == 2
    assert found.candidates[recommended].name in found.headline[0]


def test_vetoed_lenses_of_the_input():
    rows = [(*row[:4], "motion" if row[1] == "each" else "", "") for row in lenses(1.0, 1.3, 0.9)]
    _, found = validation(rows, fires=True)
    assert (found.verdict, found.recommended) == ("vetoed", 0)
    assert "rolling shutter" in found.headline[1]


def test_input_that_is_no_candidate():
    rows = [("RADIAL", "size", 3, 1.0, "", ""), ("OPENCV", "size", 6, 1.2, "", "")]
    _, found = validation(rows, fires=False)
    assert (found.verdict, found.present) == ("unknown", -1)


def test_headline_has_the_price_of_the_change():
    """The fake sigma of positions grows with the index of the candidate."""
    rows = [("SIMPLE_RADIAL", "each", 40, 1.2, "", ""), *lenses(1.2, 1.2, 1.0)[:2]]
    rows.append(("OPENCV", "each", 120, 1.0, "", ""))
    _, found = validation(rows, fires=False)
    assert found.verdict == "better"
    assert "4.0 x" in found.headline[-1]
    _, found = validation(lenses(1.0, 1.2, 1.2), fires=False)
    assert "3.0 x less certain with SIMPLE_RADIAL, per image" in found.headline[-1]


def test_notes_name_what_the_reader_must_know():
    _, found = validation()
    assert any("FOV" in note and "cannot start" in note for note in found.notes)
