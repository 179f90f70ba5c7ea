"""The table of kinds of recordings: every frame of both cameras in its order, at its time."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.recordings.recording_files import RECORDINGS, Pair, Recording
from track_range.recording.recording import open_recording
from track_range.recording.sources.open_video import open_video
from track_range.simulation.drive import Drive
from track_range.stereo.geometry.frames import whole_image


def thumbnail(image: np.ndarray) -> np.ndarray:
    """(47, 155) grey levels, which tell the frames of a drive from each other."""
    small = cv2.resize(image, (155, 47), interpolation=cv2.INTER_AREA).astype(np.float32)
    return small if small.ndim == 2 else small.mean(axis=2)


@pytest.fixture(scope="module")
def pair(small_drive: Drive) -> Pair:
    return Pair(
        *(
            [frame.image for frame in open_video(path)]
            for path in (small_drive.left, small_drive.right)
        )
    )


@pytest.fixture(scope="module")
def small(pair: Pair) -> Pair:
    return Pair(*([thumbnail(image) for image in images] for images in pair))


def nearest(image: np.ndarray, images: list[np.ndarray]) -> int:
    small = thumbnail(image)
    return int(np.argmin([np.abs(small - other).mean() for other in images]))


@pytest.mark.parametrize("row", RECORDINGS, ids=lambda row: row.kind)
def test_frames(
    tmp_path: Path, small_drive: Drive, pair: Pair, small: Pair, row: Recording
) -> None:
    names, options = row.write(tmp_path, pair)
    recording = open_recording(
        *names, rig=small_drive.rig, align="off", has_checks=False, **options
    )
    frames = list(recording.frames)
    recording.close()
    n = 3 if "3 frames" in row.kind else len(pair.left)
    assert n - row.n_lost <= len(frames) <= n
    assert {frame.left.shape for frame in frames} == {pair.left[0].shape}
    found = np.array([nearest(frame.left, small.left) for frame in frames])
    right = [
        nearest(whole_image(frame.right), small.right)
        for frame in frames
        if frame.right is not None
    ]
    assert right == found.tolist()
    assert (np.diff(found) >= 1).all()
    times_s = np.array([frame.time_s for frame in frames])
    assert times_s - times_s[0] == pytest.approx(
        (found - found[0]) / row.rate_hz, abs=0.02 if row.n_lost else 1e-6
    )
