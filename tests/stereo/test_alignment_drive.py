"""The alignment from drives alone: rendered ones with a known error, vehicles that do not drive, and KITTI's."""

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
from track_range.stereo.alignment.model import UNCORRECTED_SIGMA_PX, Alignment
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.reading import load_rig

RIG = kitti_like_rig(width_px=620, height_px=188)
N_RENDERED = 13


@cache
def rendered() -> tuple[tuple[Image, Image], ...]:
    renderer = Renderer(make_scene(0, seconds=2.0), RIG)
    return tuple((renderer.render(i / 10), renderer.render(i / 10, side="right")) for i in range(N_RENDERED))


def moved(image: Image, x_px: float, y_px: float) -> Image:
    """The image with its content further right and down."""
    shift = np.array([[1.0, 0.0, x_px], [0.0, 1.0, y_px]])
    size = (image.shape[1], image.shape[0])
    return np.asarray(
        cv2.warpAffine(image, shift, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


def frames(*, x_px: float = 0.0, y_px: float = 0.0, step_s: float = 0.1) -> Iterator[Frame]:
    for index, (left, right) in enumerate(rendered()):
        yield Frame(index, index * step_s, left, moved(right, x_px, y_px) if x_px or y_px else right)


def estimated(shown: Iterator[Frame], rig: StereoRig = RIG) -> Alignment:
    drive = DriveAlignment(rig)
    for frame in shown:
        drive.add(frame)
    return drive.estimate()


@pytest.mark.parametrize(("x_px", "y_px"), [pytest.param(0.0, 0.0, marks=pytest.mark.slow), (0.5, 0.4)])
def test_known_error_of_a_rendered_drive(x_px: float, y_px: float) -> None:
    found = estimated(frames(x_px=x_px, y_px=y_px))
    assert found.offset_px == pytest.approx(x_px, abs=2 * found.offset_sigma_px)
    assert 0.005 < found.offset_sigma_px < 0.12
    assert found.bow_px == pytest.approx(0.0, abs=0.3)
    assert found.is_clear is (x_px > 0)
    assert found.row_offset_px == pytest.approx(y_px, abs=0.03)
    assert found.source == "this drive, 13 frames"


def test_frames_too_close_in_time_are_skipped() -> None:
    found = estimated(frames(step_s=0.05))  # half of them: too few
    assert not found.is_measured
    assert found.source == "this drive tells nothing (fewer than 10 frames in motion)"
    assert (found.offset_px, found.residual_px) == (0.0, UNCORRECTED_SIGMA_PX)


def test_a_gap_in_time_ends_a_segment() -> None:
    shown = [Frame(f.index, f.time_s + (2.0 if f.index >= 6 else 0.0), f.left, f.right) for f in frames()]
    assert not estimated(iter(shown)).is_measured


def test_stationary_vehicle_gives_only_row_offset() -> None:
    left, right = rendered()[0]
    rng = np.random.default_rng(1)

    def noisy(image: Image) -> Image:
        return np.clip(image + rng.normal(0.0, 2.0, image.shape), 0, 255).astype(np.uint8)

    found = estimated(Frame(i, i / 10, noisy(left), noisy(moved(right, 0.0, 0.6))) for i in range(12))
    assert found.source == "this drive tells nothing (the vehicle stands still)"
    assert found.row_offset_px == pytest.approx(0.6, abs=0.05)
    assert not found.is_clear


def test_missing_right_images_and_texture() -> None:
    left, _ = rendered()[0]
    assert "no pairs of images" in estimated(Frame(i, i / 10, left, None) for i in range(3)).source
    grey = np.full((188, 620, 3), 90, np.uint8)
    found = estimated(Frame(i, i / 10, grey, grey) for i in range(MIN_FRAMES))
    assert "too few points that stay in view" in found.source
    assert found.row_offset_px == 0.0
    assert row_offset_px(grey, grey) is None


def test_a_cut_starts_a_new_segment() -> None:
    """A cut between two drives that nobody told of: neither half is long enough, and they are not glued together."""
    shown = list(frames())[:6]
    rng = np.random.default_rng(2)
    noise = [cv2.GaussianBlur(rng.integers(0, 256, (188, 620, 3), dtype=np.uint8), (0, 0), 2.0) for _ in range(6)]
    found = estimated(iter([*shown, *(Frame(6 + i, 0.6 + i / 10, n, n) for i, n in enumerate(noise))]))
    assert found.source.startswith("this drive tells nothing")


@pytest.mark.slow
def test_number_of_frames_is_limited() -> None:
    drive = DriveAlignment(RIG)
    pictures = [*rendered(), *rendered()[-2:0:-1]]  # there and back, time and again
    n_added = 0
    while not drive.is_full and n_added < 200:
        drive.add(Frame(n_added, n_added / 10, *pictures[n_added % len(pictures)]))
        n_added += 1
    assert n_added == 48
    before = drive.estimate()
    drive.add(Frame(n_added, n_added / 10, *pictures[0]))
    assert drive.estimate() == before
    drive.start_drive()
    assert not drive.is_full


def test_feature_tracks() -> None:
    tracks = FeatureTracks()
    first, second = (tracks.add(*(cv2.cvtColor(eye, cv2.COLOR_BGR2GRAY) for eye in pair)) for pair in rendered()[:2])
    both = np.intersect1d(first.number, second.number)
    assert len(both) > 0.3 * len(first.number) > 50
    assert 0.5 < tracks.flow_px < 20
    assert len(set(second.number.tolist())) == len(second.number)
    assert ((first.left_px - first.right_px)[:, 0] > -0.5).mean() > 0.99
    assert np.abs(first.row_offsets_px).max() < 2.0


def video_frames(folder: Path) -> tuple[Iterator[Frame], StereoRig]:
    eyes = [cv2.VideoCapture(str(folder / f"{side}.mp4")) for side in ("left", "right")]
    size = tuple(int(eyes[0].get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    rig, _ = load_rig(folder / "calib.txt", size_px=(size[0], size[1]), is_grey="odometry" in str(folder))

    def shown() -> Iterator[Frame]:
        for index in range(16):
            (_, left), (_, right) = (eye.read() for eye in eyes)
            yield Frame(index, index / 10, left, right)

    return shown(), rig


@pytest.mark.parametrize(
    ("name", "offset_px", "bow_px"),
    [("kitti_stereo/0003", 0.45, 1.6), ("kitti_stereo/0005", 0.45, 1.5), ("kitti_odometry/gray51", 0.1, 1.0)],
)
def test_kitti_drives(shared_data: Path, name: str, offset_px: float, bow_px: float) -> None:
    """0003 and 0005 are of one camera on one day: labels and lidar say 0.4 to 0.5 px; the third is another day's."""
    found = estimated(*video_frames(shared_data / name))
    assert found.offset_px == pytest.approx(offset_px, abs=0.1)
    assert found.bow_px == pytest.approx(bow_px, abs=0.4)
    assert 0.02 < found.offset_sigma_px < 0.12
    assert 0.1 < found.residual_px < 0.35
    assert found.bow_sigma_px < 0.35
    assert abs(found.row_offset_px) < 0.3
