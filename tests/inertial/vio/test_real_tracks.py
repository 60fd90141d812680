"""The MSCKF update on tracks of EuRoC V1_01, from the true poses and from poses that are off."""

import numpy as np
import pytest

import bundle
from bundle import InputError
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.io.sequences.sequence_folder import read_track_csv
from bundle.io.sequences.trajectory_files import load_ground_truth
from tests.inertial.vio.test_msckf import moved

VIEWS, EVERY = 6, 10  # half a second apart
SIGMA = 1.5 / 460


@pytest.fixture(scope="module")
def tracks(bundle_data):
    """True poses of 6 frames in flight, and rows of all tracks that at least 4 of them see."""
    folder = bundle_data / "vio"
    sequence = read_track_csv(folder / "euroc_V1_01_tracks_imu_30s.csv")
    truth = load_ground_truth(folder / "euroc_V1_01_ground_truth.csv")
    stamps = np.unique(sequence.image_timestamps_ns)[300 : 300 + VIEWS * EVERY : EVERY]
    poses = states_at(truth, stamps)[:, :7]
    seen = np.isin(sequence.image_timestamps_ns, stamps)
    found = []
    for track in np.unique(sequence.track_ids[seen]):
        rows = np.flatnonzero(seen & (sequence.track_ids == track))
        if len(rows) >= 4:
            frames = np.searchsorted(stamps, sequence.image_timestamps_ns[rows])
            found.append((frames, sequence.xy[rows]))
    extrinsics = sequence.calibration.camera_from_imu
    assert len(found) >= 5

    def linearised(at):
        rows = []
        for frames, xy in found:
            columns, settings = 6 * frames, {"camera_from_imu": extrinsics, "sigma": SIGMA}
            try:
                rows.append(bundle.track_rows(at[frames], xy, columns, 6 * VIEWS, **settings))
            except InputError as error:  # a track that jumps has its landmark anywhere
                assert "parallax" in str(error)
        assert len(rows) >= len(found) - 2
        return rows

    return poses, linearised


def test_equals_schurs_complement(tracks):
    poses, linearised = tracks
    before = np.diag(np.tile([1e-3] * 3 + [1e-2] * 3, VIEWS)) ** 2
    rows = linearised(poses)
    update = bundle.msckf_update(before, rows)
    information = np.linalg.inv(before)
    for track in rows:
        h, f = track.by_state, track.by_point
        information += h.T @ h - h.T @ f @ np.linalg.solve(f.T @ f, f.T @ h)
    after = np.linalg.inv(information)
    sigmas = np.sqrt(np.diag(after))
    assert (np.abs(update.covariance - after) / np.outer(sigmas, sigmas)).max() < 1e-8
    assert update.rejected == ()


def test_tracks_bring_poses_back(tracks):
    """The motion between frames, which tracks see; where all of them are, they do not."""
    poses, linearised = tracks
    sigmas = np.tile([5e-3] * 3 + [2e-2] * 3, VIEWS)
    sigmas[:6] = 1e-5  # the first pose is known
    errors = [[], []]
    for seed in range(5):
        off = sigmas * np.random.default_rng(seed).standard_normal(6 * VIEWS)
        rows = linearised(moved(poses, -off))
        update = bundle.msckf_update(np.diag(sigmas**2), rows, max_nis=4)
        assert len(update.rejected) <= len(rows) / 4
        for kept, error in zip(errors, (off, off - update.step), strict=True):
            kept.append(error / sigmas)
    before, after = (np.sqrt(np.mean(np.square(kept))) for kept in errors)
    assert before == pytest.approx(1, abs=0.3)
    assert after < 0.75 * before
