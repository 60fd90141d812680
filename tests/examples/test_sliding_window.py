"""The example of a window that slides: marginalising is exact, dropping is not; its picture."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import bundle

FOLDER = Path(__file__).parents[2] / "examples" / "sliding_window"


@pytest.fixture(scope="module")
def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("sliding_window", FOLDER / "sliding_window.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_marginalising_a_chain_is_exact_and_dropping_drifts(example: ModuleType) -> None:
    differences = example.run(seed=0)
    assert differences["marginalize"].shape == (60,)
    assert differences["marginalize"].max() < 2e-12
    assert differences["drop"][:4].max() < 1e-12  # nothing has left yet
    assert 0.1 < np.median(differences["drop"]) < 1 < 2 < 10 * differences["drop"].max()


def test_the_prior_of_a_chain_is_healthy(example: ModuleType) -> None:
    measured = example.measurements(0)
    _, window = example.slide(measured, "marginalize")
    (prior,) = (f for f in window.factors if isinstance(f, bundle.LinearPrior))
    assert len(window.keys) == example.WINDOW - 1
    assert prior.spectrum.nullity == 0 and prior.spectrum.ratio > 1e-3
    assert not prior.spectrum.warning


def test_the_picture_is_drawn(example: ModuleType, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    path = tmp_path / "window.png"
    example.draw({"marginalize": np.full(60, 1e-13), "drop": np.full(60, 0.3)}, path)
    assert path.read_bytes().startswith(b"\x89PNG")
