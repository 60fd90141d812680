"""Knowledge of the other processes from the environment."""

import os

import pytest

from bundle.solving.ranks import launch

NAMES = (*launch._SIZES, *launch._RANKS, *launch._LOCAL_SIZES)


@pytest.fixture(autouse=True)
def alone(monkeypatch):
    for name in NAMES:
        monkeypatch.delenv(name, raising=False)


def started(monkeypatch, size, local_size=None, bound=8):
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", str(size))
    monkeypatch.setenv("OMPI_COMM_WORLD_LOCAL_SIZE", str(local_size or size))
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(bound)), raising=False)


@pytest.mark.parametrize(
    ("size", "local_size", "bound", "threads"),
    [
        (1, None, 8, 8),  # not by mpirun
        (4, None, 8, 2),  # the cores of the machine, shared
        (16, 2, 8, 4),  # on several machines
        (16, None, 8, 1),  # more processes than cores
        (4, None, 3, 3),  # bound to some by mpirun
    ],
)
def test_threads_of_one_process(monkeypatch, size, local_size, bound, threads):
    started(monkeypatch, size, local_size, bound)
    assert launch.threads_of_one_process(8) == threads


@pytest.mark.parametrize("value", ["", "many", "-2"])
def test_an_environment_that_means_nothing_is_one_process(monkeypatch, value):
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", value)
    monkeypatch.setenv("PMI_RANK", value)
    assert (launch.size_by_launcher(), launch.rank_by_launcher()) == (1, 0)
