"""The ring between threads, and motions about the vertical."""

import math
import threading

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle import InputError
from bundle.inertial.two_loops.loop_thread import Ring
from bundle.inertial.two_loops.pose_publisher import YawMotion


def test_a_full_ring_forgets_its_oldest():
    ring = Ring()
    for k in range(100):
        ring.put(k)
    assert len(ring) == 64
    assert ring.take_all() == list(range(36, 100))
    assert ring.num_lost == 36
    assert ring.take_all() == []
    assert ring.take_newest() is None
    for k in range(3):
        ring.put(k)
    assert ring.take_newest() == 2
    assert len(ring) == 0
    assert ring.num_lost == 36
    with pytest.raises(InputError, match="capacity"):
        Ring(0)


def test_two_threads_lose_nothing_that_is_not_counted():
    ring, count, taken = Ring(8), 20_000, []
    done = threading.Event()

    def put():
        for k in range(count):
            ring.put(k)
        done.set()

    thread = threading.Thread(target=put)
    thread.start()
    while not done.is_set() or len(ring):
        taken.extend(ring.take_all())
    thread.join()
    assert taken == sorted(set(taken))
    assert taken[-1] == count - 1
    assert len(taken) + ring.num_lost == count


def matrix(motion):
    out = np.eye(4)
    out[:3, :3] = Rotation.from_euler("z", motion.yaw).as_matrix()
    out[:3, 3] = motion.translation
    return out


def random_motion(rng):
    return YawMotion(rng.uniform(-3, 3), rng.standard_normal(3))


def test_motions_are_a_group_that_moves_states():
    rng = np.random.default_rng(0)
    a, b = random_motion(rng), random_motion(rng)
    assert matrix(a @ b) == pytest.approx(matrix(a) @ matrix(b))
    assert matrix(a.inverse()) == pytest.approx(np.linalg.inv(matrix(a)))
    state = np.r_[Rotation.random(random_state=1).as_quat(), rng.standard_normal(12)]
    moved = a.moved(state)
    turn = Rotation.from_euler("z", a.yaw)
    expected = (turn * Rotation.from_quat(state[:4])).as_matrix()
    assert Rotation.from_quat(moved[:4]).as_matrix() == pytest.approx(expected)
    assert moved[4:7] == pytest.approx(turn.apply(state[4:7]) + a.translation)
    assert moved[7:10] == pytest.approx(turn.apply(state[7:10]))
    assert (moved[10:] == state[10:]).all()
    found = YawMotion.between(state, moved)
    assert matrix(found) == pytest.approx(matrix(a))
    # What is not about the vertical is left: the place still fits.
    tilted = np.r_[
        (Rotation.from_rotvec([0.1, 0, 0]) * Rotation.from_quat(moved[:4])).as_quat(), moved[4:7]
    ]
    assert YawMotion.between(state, tilted).moved(state)[4:7] == pytest.approx(moved[4:7])
    assert len(a.moved(state[:7])) == 7


def test_a_share_is_that_of_heading_and_place_there():
    rng = np.random.default_rng(2)
    start, end = random_motion(rng), random_motion(rng)
    place = np.array([1e4, -2e4, 5])
    before, after = (m.moved(np.r_[0, 0, 0, 1, place])[4:7] for m in (start, end))
    for share in (0, 0.25, 1):
        motion = start.towards(end, place, share)
        turned = math.remainder(motion.yaw - start.yaw, 2 * math.pi)
        assert turned == pytest.approx(share * math.remainder(end.yaw - start.yaw, 2 * math.pi))
        there = motion.moved(np.r_[0, 0, 0, 1, place])[4:7]
        assert there == pytest.approx(before + share * (after - before), rel=1e-12)


def test_motions_refuse_what_is_none():
    for wrong in ((np.nan, [0, 0, 0]), (0, [0, 0]), (0, [0, 0, np.inf]), ("a", [0, 0, 0])):
        with pytest.raises(InputError, match="YawMotion"):
            YawMotion(*wrong)
    assert "degrees" in repr(YawMotion(1.0))
