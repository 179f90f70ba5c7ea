"""Alignment from drives: rendered drives with a known error, stationary vehicles, and KITTI's
drives."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from track_range.foundation.arrays import Image
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scene import make_scene
from track_range.stereo.alignment.feature_tracks import FeatureTracks, row_offset_px
from track_range.stereo.alignment.from_drive import MIN_FRAMES, DriveAlignment
from track_range.stereo.geometry.alignment import UNCORRECTED_SIGMA_PX, Alignment
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.reading import load_rig

RIG = kitti_like_rig(width_px=620, height_px=188)
N_RENDERED = 13


@cache
def rendered() -> tuple[tuple[Image, Image], ...]:
    renderer = Renderer(make_scene(0, seconds=2.0), RIG)
    return tuple(
        (renderer.render(i / 10), renderer.render(i / 10, side="right")) for i in range(N_RENDERED)
    )


def moved(image: Image, x_px: float, y_px: float) -> Image:
    """The image shifted to the right and down."""
    shift = np.array([[1.0, 0.0, x_px], [0.0, 1.0, y_px]])
    size = (image.shape[1], image.shape[0])
    return np.asarray(
        cv2.warpAffine(image, shift, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE),
        np.uint8,
    )


def frames(*, x_px: float = 0.0, y_px: float = 0.0, step_s: float = 0.1) -> Iterator[Frame]:
    for index, (left, right) in enumerate(rendered()):
        yield Frame(
            index, index * step_s, left, moved(right, x_px, y_px) if x_px or y_px else right
        )


def estimated(drive_frames: Iterator[Frame], rig: StereoRig = RIG) -> Alignment:
    drive = DriveAlignment(rig)
    for frame in drive_frames:
        drive.add(frame)
    return drive.estimate()


@pytest.mark.slow
@pytest.mark.parametrize(("x_px", "y_px"), [(0.0, 0.0), (0.5, 0.4)])
def test_known_error_of_a_rendered_drive(x_px: float, y_px: float) -> None:
    alignment = estimated(frames(x_px=x_px, y_px=y_px))
    assert alignment.offset_px == pytest.approx(x_px, abs=2 * alignment.offset_sigma_px)
    assert 0.005 < alignment.offset_sigma_px < 0.12
    assert alignment.curvature_px == pytest.approx(0.0, abs=0.3)
    assert alignment.is_clear is (x_px > 0)
    assert alignment.row_offset_px == pytest.approx(y_px, abs=0.03)
    assert alignment.source == "this drive, 13 frames"


def test_frames_too_close_in_time_are_skipped() -> None:
    alignment = estimated(frames(step_s=0.05))  # every other frame is skipped: too few
    assert not alignment.is_measured
    assert alignment.source == "not enough data in this drive (fewer than 10 frames in motion)"
    assert (alignment.offset_px, alignment.residual_px) == (0.0, UNCORRECTED_SIGMA_PX)


def test_a_gap_in_time_ends_a_segment() -> None:
    frame_list = [
        Frame(f.index, f.time_s + (2.0 if f.index >= 6 else 0.0), f.left, f.right) for f in frames()
    ]
    assert not estimated(iter(frame_list)).is_measured


def test_stationary_vehicle_gives_only_row_offset() -> None:
    left, right = rendered()[0]
    rng = np.random.default_rng(1)

    def noisy(image: Image) -> Image:
        return np.clip(image + rng.normal(0.0, 2.0, image.shape), 0, 255).astype(np.uint8)

    alignment = estimated(
        Frame(i, i / 10, noisy(left), noisy(moved(right, 0.0, 0.6))) for i in range(12)
    )
    assert alignment.source == "not enough data in this drive (the vehicle is stationary)"
    assert alignment.row_offset_px == pytest.approx(0.6, abs=0.05)
    assert not alignment.is_clear


def test_missing_right_images_and_texture() -> None:
    left, _ = rendered()[0]
    assert "no stereo frames" in estimated(Frame(i, i / 10, left, None) for i in range(3)).source
    grey = np.full((188, 620, 3), 90, np.uint8)
    alignment = estimated(Frame(i, i / 10, grey, grey) for i in range(MIN_FRAMES))
    assert "too few points" in alignment.source
    assert alignment.row_offset_px == 0.0
    assert row_offset_px(grey, grey) is None


def test_a_cut_starts_a_new_segment() -> None:
    """An unannounced cut between two drives: each half is too short, and they are not joined."""
    frame_list = list(frames())[:6]
    rng = np.random.default_rng(2)
    noise = [
        cv2.GaussianBlur(rng.integers(0, 256, (188, 620, 3), dtype=np.uint8), (0, 0), 2.0)
        for _ in range(6)
    ]
    alignment = estimated(
        iter([*frame_list, *(Frame(6 + i, 0.6 + i / 10, n, n) for i, n in enumerate(noise))])
    )
    assert alignment.source.startswith("not enough data")


@pytest.mark.slow
def test_number_of_frames_is_limited() -> None:
    drive = DriveAlignment(RIG)
    pairs = [*rendered(), *rendered()[-2:0:-1]]  # back and forth
    n_added = 0
    while not drive.is_full and n_added < 200:
        drive.add(Frame(n_added, n_added / 10, *pairs[n_added % len(pairs)]))
        n_added += 1
    assert n_added == 48
    before = drive.estimate()
    drive.add(Frame(n_added, n_added / 10, *pairs[0]))
    assert drive.estimate() == before
    drive.start_drive()
    assert not drive.is_full


def test_feature_tracks() -> None:
    tracks = FeatureTracks()
    first, second_frame = tracks.add(*rendered()[0]).points, tracks.add(*rendered()[1])
    second = second_frame.points
    both = np.intersect1d(first.number, second.number)
    assert len(both) > 0.3 * len(first.number) > 50
    assert 0.5 < second_frame.flow_px < 20
    assert len(set(second.number.tolist())) == len(second.number)
    assert ((first.left_px - first.right_px)[:, 0] > -0.5).mean() > 0.99
    assert np.abs(first.row_offsets_px).max() < 2.0


def video_frames(folder: Path) -> tuple[Iterator[Frame], StereoRig]:
    videos = [cv2.VideoCapture(str(folder / f"{side}.mp4")) for side in ("left", "right")]
    size = tuple(
        int(videos[0].get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
    )
    rig, _ = load_rig(
        folder / "calib.txt", size_px=(size[0], size[1]), is_grey="odometry" in str(folder)
    )

    def frame_list() -> Iterator[Frame]:
        for index in range(16):
            (_, left), (_, right) = (video.read() for video in videos)
            yield Frame(index, index / 10, left, right)

    return frame_list(), rig


@pytest.mark.parametrize(
    ("name", "offset_px", "curvature_px"),
    [
        ("kitti_stereo/0003", 0.45, 1.6),
        ("kitti_stereo/0005", 0.45, 1.5),
        ("kitti_odometry/gray51", 0.1, 1.0),
    ],
)
def test_kitti_drives(shared_data: Path, name: str, offset_px: float, curvature_px: float) -> None:
    """0003 and 0005 are from one day, with 0.4 to 0.5 px by labels and lidar; the third is from
    another day."""
    alignment = estimated(*video_frames(shared_data / name))
    assert alignment.offset_px == pytest.approx(offset_px, abs=0.1)
    assert alignment.curvature_px == pytest.approx(curvature_px, abs=0.4)
    assert 0.02 < alignment.offset_sigma_px < 0.12
    assert 0.1 < alignment.residual_px < 0.35
    assert alignment.curvature_sigma_px < 0.35
    assert abs(alignment.row_offset_px) < 0.3
