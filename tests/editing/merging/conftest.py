"""A model, and what its halves become."""

import pytest

import bundle
from tests.editing.merging.halves import halves, whole


@pytest.fixture(scope="session")
def model():
    return whole()


@pytest.fixture(scope="session")
def merged(model):
    return bundle.merge(*halves(model))
