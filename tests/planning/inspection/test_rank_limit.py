"""Where processes stop to pay, from times that are given."""

import dataclasses

import pytest

from bundle.planning.inspection.rank_prediction import RankPrediction, find_rank_limit


def row(count, *, points, first, messages=0.0, evenly=True):
    """Prediction of a step whose divided part takes `points` seconds of one process."""
    own = points / count if evenly else points / 2
    time = own + first + messages
    return RankPrediction(
        num_processes=count,
        method="SPARSE_SCHUR",
        most_observations=1000 // count,
        bytes_per_step=0 if count == 1 else 8_000_000,
        time_per_step_in_seconds=time,
        points_time_per_step_in_seconds=own,
        first_time_per_step_in_seconds=first,
        network_time_per_step_in_seconds=messages,
        efficiency=(points + first) / (count * time),
        memory_of_first_in_bytes=1e9,
        memory_of_others_in_bytes=5e8,
    )


def test_all_pay_while_points_are_the_work():
    limit = find_rank_limit([row(n, points=10.0, first=0.01) for n in (1, 4, 16)])
    assert (limit.num_processes, limit.next_num_processes, limit.reason) == (16, 0, "")


@pytest.mark.parametrize("shuffled", [False, True])
def test_the_first_process_alone(shuffled):
    """t(1) = 10 + 1: of 16 processes 16 x (10/16 + 1) = 26 s, efficiency 11/26, waste 15/26."""
    rows = [row(n, points=10.0, first=1.0) for n in (1, 4, 16, 64)]
    limit = find_rank_limit(rows[::-1] if shuffled else rows)
    assert (limit.num_processes, limit.next_num_processes, limit.reason) == (4, 16, "first")
    assert limit.share == pytest.approx(15 / 26)


def test_messages():
    rows = [row(1, points=1.0, first=0.1), row(2, points=1.0, first=0.1, messages=2.0)]
    limit = find_rank_limit(rows)
    assert (limit.num_processes, limit.next_num_processes, limit.reason) == (1, 2, "messages")
    assert limit.share == pytest.approx(4 / (2 * 2.6))


def test_points_that_cannot_be_divided():
    rows = [row(1, points=1.0, first=0.0), row(8, points=1.0, first=0.0, evenly=False)]
    limit = find_rank_limit(rows)
    assert (limit.num_processes, limit.reason) == (1, "imbalance")
    assert limit.share == pytest.approx(3 / 4)


def test_half_is_enough_and_less_is_not():
    rows = [row(1, points=1.0, first=0.0), row(2, points=1.0, first=0.0)]
    half = dataclasses.replace(rows[1], efficiency=0.5)
    less = dataclasses.replace(rows[1], efficiency=0.49)
    assert find_rank_limit([rows[0], half]).num_processes == 2
    assert find_rank_limit([rows[0], less]).num_processes == 1


def test_nothing_is_said_of_one_process():
    assert find_rank_limit([]) is None
    assert find_rank_limit([row(1, points=1.0, first=0.1)]) is None
