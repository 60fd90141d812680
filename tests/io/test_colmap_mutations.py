"""Damaged COLMAP models, text and binary: each loads or is refused in one line."""

import zlib
from pathlib import Path

import pycolmap
import pytest

from tests.io.colmap_models import synthesize, write_model
from tests.io.mutations import BYTE_MUTATORS, TOKEN_MUTATORS, load_all, mutate

CASES_PER_FILE = 24


def damaged_models(model: Path, folder: Path, cases_per_file: int) -> list[Path]:
    """Make copies of a model with one damaged file each; the others are links to the model's."""
    models = []
    for file in sorted(model.iterdir()):
        mutators = BYTE_MUTATORS if file.suffix == ".bin" else BYTE_MUTATORS + TOKEN_MUTATORS
        seed = zlib.crc32(f"{model.name}/{file.name}".encode())
        for name, data in mutate(file.read_bytes(), mutators, cases_per_file, seed):
            copy = folder / f"{file.name}-{name}"
            copy.mkdir(parents=True)
            for whole in model.iterdir():
                if whole != file:
                    (copy / whole.name).symlink_to(whole)
            (copy / file.name).write_bytes(data)
            models.append(copy)
    return models


def check(models: list[Path], num_expected: int) -> None:
    assert len(models) == num_expected
    outcomes = load_all(models)
    assert [outcome for outcome in outcomes if not outcome.orderly] == []
    kinds = {outcome.kind for outcome in outcomes}
    assert kinds == {"loaded", "InputError"}  # neither a checker that passes nor one that bars all


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
def test_damaged_synthetic_model(tmp_path: Path, binary: bool) -> None:
    model = write_model(synthesize(20, num_points=15), tmp_path / "synthetic", binary=binary)
    models = damaged_models(model, tmp_path / "damaged", 2 * CASES_PER_FILE)
    check(models, 5 * 2 * CASES_PER_FILE)


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
def test_damaged_real_model(bundle_data: Path, tmp_path: Path, binary: bool) -> None:
    real = pycolmap.Reconstruction(bundle_data / "colmap" / "batmo_rigs")
    model = write_model(real, tmp_path / f"real-{binary}", binary=binary)
    models = damaged_models(model, tmp_path / "damaged", CASES_PER_FILE)
    check(models, 5 * CASES_PER_FILE)


def test_damaged_model_without_rigs(tmp_path: Path) -> None:
    model = write_model(synthesize(21, num_points=15), tmp_path / "legacy", binary=False)
    (model / "rigs.txt").unlink()
    (model / "frames.txt").unlink()
    check(damaged_models(model, tmp_path / "damaged", CASES_PER_FILE), 3 * CASES_PER_FILE)
