"""Health of rigs: distance errors, noticed errors, movements, and rig files with errors on
synthetic points."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest

from track_range.foundation.arrays import FloatArray
from track_range.stereo.alignment.feature_tracks import PairPoints, TrackedFrame
from track_range.stereo.alignment.from_drive import DriveAlignment
from track_range.stereo.alignment.health import Move, RigHealth, Window
from track_range.stereo.alignment.right_view import RightView, fit_right_view
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rectification import Rectifier
from track_range.stereo.geometry.rig import StereoRig

CAMERA = PinholeCamera(720.0, 720.0, 600.0, 180.0, 1200, 360)
RIG = StereoRig.rectified(CAMERA, 0.5)
"""12 px of disparity at 30 m."""


def measured(offset_px: float, sigma_px: float = 0.02, **values: float) -> Alignment:
    return Alignment(
        offset_px=offset_px,
        offset_sigma_px=sigma_px,
        residual_px=0.06,
        source="this drive",
        **values,
    )


def health(alignment: Alignment, *windows: Window) -> RigHealth:
    return RigHealth(RIG, alignment, alignment.if_clear(), windows)


def test_distance_errors_before_and_after() -> None:
    state = health(measured(0.6))
    assert state.before_pct(30.0) == pytest.approx(3 * [100 * (12 / 11.4 - 1)])
    assert state.before_pct(10.0)[1] == pytest.approx(100 * (36 / 35.4 - 1))
    assert state.sigma_pct(30.0) == pytest.approx(100 * 0.02 / 12)
    assert state.after_pct(30.0) == pytest.approx(100 * 0.06 / 12)
    assert [row["distance_m"] for row in state.to_dict()["distances"]] == [10.0, 20.0, 30.0, 50.0]
    left, middle, right = health(measured(0.0, slope_px=1.2, slope_sigma_px=0.05)).before_pct(30.0)
    assert (left < -4, middle, right > 4) == (True, 0.0, True)


def test_unmeasurable_distances_are_null() -> None:
    row = health(measured(8.0)).to_dict()["distances"][3]
    assert (row["distance_m"], row["before_pct"]) == (50.0, None)
    assert "more than 100 %" in health(measured(13.0)).sentence()


@pytest.mark.parametrize(
    ("alignment", "state"),
    [
        (measured(0.13), "off"),
        (measured(-0.13), "off"),
        (measured(0.05), "good"),  # significant, but 0.4 % at 30 m
        (measured(0.13, 0.06), "good"),  # not significant
        (measured(0.0, slope_px=0.4, slope_sigma_px=0.05), "off"),
        (Alignment(offset_px=0.5), "unknown"),
        (Alignment(row_offset_px=0.4), "off"),
        (measured(0.0, roll_deg=0.1), "off"),
        (measured(0.0, focal_ratio=1.004), "off"),
    ],
)
def test_noticed_errors(alignment: Alignment, state: str) -> None:
    assert health(alignment).state == state
    assert health(alignment).is_noticed is (state == "off")


def test_unmeasured_errors_are_null() -> None:
    row = health(Alignment(offset_px=0.5)).to_dict()["distances"][0]
    assert row["before_pct"] is row["before_left_pct"] is row["before_right_pct"] is None
    assert row["after_sigma_pct"] > 0


def windows(*offsets_px: float, sigma_px: float = 0.03) -> list[Window]:
    return [
        Window(0, 2.0 * k, 2.0 * k + 1.6, offset, sigma_px) for k, offset in enumerate(offsets_px)
    ]


def test_movement_during_a_drive() -> None:
    steady = health(measured(0.0), *windows(0.02, -0.03, 0.01))
    assert steady.move is None
    assert "3 parts of the drive agree" in steady.move_sentence()
    moved = health(measured(0.2), *windows(0.0, 0.02, 0.41, 0.39))
    assert moved.move is not None
    assert moved.move.time_s == pytest.approx(3.8)
    assert moved.move.change_px == pytest.approx(0.39, abs=0.01)
    assert "3.8 s" in moved.move_sentence()
    # disparities became smaller, so more has to be added to them
    assert "changed disparities by -0.39" in moved.move_sentence()
    assert health(measured(0.0)).move_sentence() == ""
    later = replace(steady, later=Move(40.0, 1.5, 0.1))
    assert "40.0 s" in later.move_sentence()
    assert later.to_dict()["moved"]["change_px"] == 1.5


def test_large_offsets_shift_the_right_image() -> None:
    alignment = measured(6.3)
    assert (alignment.shift_px, measured(0.9).shift_px) == (6.0, 0.0)
    assert alignment.after_shift().offset_px == pytest.approx(0.3)
    left_px = np.array([[700.0, 200.0]])
    rectifier = Rectifier(RIG, shift_px=alignment.shift_px)
    assert rectifier.points(left_px, left_px - [5.7, 0.0])[1] == pytest.approx(
        left_px - [11.7, 0.0]
    )


def rotated(pitch_deg: float = 0.0, yaw_deg: float = 0.0, roll_deg: float = 0.0) -> StereoRig:
    """The rig file with a wrong angle of the right camera."""
    rotation = np.eye(4)
    rotation[:3, :3] = cv2.Rodrigues(np.radians([pitch_deg, yaw_deg, roll_deg]))[0]
    return StereoRig(CAMERA, CAMERA, rotation @ RIG.right_from_left)


def tracked_street(
    rig_file: StereoRig, *, seed: int = 1, n_frames: int = 12
) -> Iterator[TrackedFrame]:
    """Points of a drive past random static points, rectified with a rig file."""
    rng = np.random.default_rng(seed)
    world_m = np.column_stack(
        [
            rng.uniform(3.0, 20.0, 500) * rng.choice([-1.0, 1.0], 500),
            rng.uniform(-5.0, 1.6, 500),
            rng.uniform(5.0, 90.0, 500),
        ]
    )
    rectifier = Rectifier(rig_file)
    for frame in range(n_frames):
        points_m = world_m - [0.0, 0.0, 1.0 * frame]
        left_px, right_px = (
            CAMERA.project(points_m),
            CAMERA.project(points_m - [RIG.baseline_m, 0.0, 0.0]),
        )
        with np.errstate(invalid="ignore"):
            inside = ((left_px > 0) & (left_px < [1200, 360]) & (right_px > 0)).all(axis=1) & (
                points_m[:, 2] > 4.0
            )
        seen = np.flatnonzero(inside)
        noise_px = rng.normal(0.0, 0.15, (2, len(seen), 2))
        points = rectifier.points(left_px[seen] + noise_px[0], right_px[seen] + noise_px[1])
        yield TrackedFrame(0.1 * frame, PairPoints(seen, *points), 5.0, 1.0)


def test_sigmas_of_the_right_view_cover_its_errors() -> None:
    drive = DriveAlignment(RIG)
    for frame in tracked_street(rotated(roll_deg=0.3), n_frames=3):
        drive.add_points(frame)
    sigma = drive.view_sigma
    view = RightView.of(drive.estimate())
    error = np.array([view.row_offset_px, view.roll_deg - 0.3, view.focal_ratio - 1.0])
    assert np.all(np.abs(error) < 3 * sigma)
    assert np.all(sigma < [0.1, 0.02, 1e-3])


def estimated(rig_file: StereoRig, **options: int) -> tuple[RigHealth, Alignment]:
    rig = Rectifier(rig_file).rig
    drive = DriveAlignment(rig)
    for frame in tracked_street(rig_file, **options):
        drive.add_points(frame)
    alignment = drive.estimate()
    return RigHealth(rig, alignment, alignment.if_clear(), drive.windows()), alignment


def error_px(rig_file: StereoRig, alignment: Alignment) -> FloatArray:
    """(3,) disparity error at 30 m after the correction, across the image."""
    points_m = np.column_stack([np.array([-10.0, 0.0, 10.0]), np.full(3, 0.5), np.full(3, 30.0)])
    rectifier = Rectifier(rig_file)
    left_px, right_px = rectifier.points(
        CAMERA.project(points_m), CAMERA.project(points_m - [RIG.baseline_m, 0, 0])
    )
    camera = rectifier.rig.left
    right_px = RightView.of(alignment).if_needed(camera).corrected(right_px, camera)
    disparity_px, _ = alignment.corrected(
        left_px[:, 0] - right_px[:, 0], np.zeros(3), x_px=left_px[:, 0], camera=camera
    )
    return disparity_px - camera.fx_px * RIG.baseline_m / 30.0


def test_true_rig_file_is_good() -> None:
    state, alignment = estimated(RIG)
    assert (state.state, len(state.windows)) == ("good", 1)
    assert np.abs(error_px(RIG, alignment)).max() < 0.12


@pytest.mark.parametrize(
    "rig_file",
    [
        rotated(yaw_deg=0.05),
        pytest.param(rotated(yaw_deg=-0.5), marks=pytest.mark.slow),
        pytest.param(rotated(pitch_deg=0.3), marks=pytest.mark.slow),
        pytest.param(rotated(roll_deg=-0.5), marks=pytest.mark.slow),
    ],
)
def test_wrong_angles_are_noticed_and_corrected(rig_file: StereoRig) -> None:
    state, alignment = estimated(rig_file)
    assert state.state == "off"
    assert np.abs(error_px(rig_file, alignment)).max() < 0.24  # 2 %


@pytest.mark.parametrize(
    ("shift_px", "zoom", "n_frames"), [(1.5, 1.0, 16), (0.0, 1.01, 16), (0.0, 1.0, 32)]
)
def test_alignment_of_a_drive_is_that_before_the_camera_moved(
    shift_px: float, zoom: float, n_frames: int
) -> None:
    """The right image is moved or magnified in the 17th and later ones of 32 frames; the rest of a
    drive whose rows changed is not used.
    """
    drive = DriveAlignment(RIG)
    centre_px = np.array([CAMERA.cx_px, CAMERA.cy_px])
    for number, frame in enumerate(tracked_street(RIG, n_frames=32)):
        points = frame.points
        if number >= 16:
            right_px = centre_px + zoom * (points.right_px - centre_px) + [shift_px, 0.0]
            points = points._replace(right_px=right_px)
        drive.add_points(frame._replace(points=points))
    assert drive.is_full is (zoom != 1.0)
    alignment = drive.estimate()
    assert alignment.source == f"this drive, {n_frames} frames"
    assert abs(alignment.offset_px) < 3 * alignment.offset_sigma_px < 0.15
    assert alignment.focal_ratio == pytest.approx(1.0, abs=1e-3)
    move = RigHealth(RIG, alignment, alignment, drive.windows()).move
    assert shift_px == 0.0 or (move and move.change_px == pytest.approx(shift_px, abs=0.2))


def test_right_view_from_rows() -> None:
    (frame,) = tracked_street(rotated(pitch_deg=0.2, roll_deg=0.3), n_frames=1)
    points = frame.points
    view = fit_right_view(points.left_px, points.right_px, CAMERA)
    assert view.roll_deg == pytest.approx(0.3, abs=0.02)
    assert abs(view.row_offset_px) == pytest.approx(math.radians(0.2) * CAMERA.fx_px, abs=0.15)
    assert view.focal_ratio == pytest.approx(1.0, abs=2e-3)
    rows_px = (view.corrected(points.right_px, CAMERA) - points.left_px)[:, 1]
    assert abs(float(np.median(rows_px))) < 0.05
    assert RightView(0.1).if_needed(CAMERA) == RightView()
    assert fit_right_view(points.left_px[:50], points.right_px[:50], CAMERA).focal_ratio == 1.0
