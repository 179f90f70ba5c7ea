"""Simulated fisheye cameras: images undistort to those of the pinhole, labels keep their boxes, and
invalid rigs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from track_range.detection.formats.video_labels.kitti import read_kitti
from track_range.simulation.camera.wide_lens import WideLens
from track_range.simulation.drive import write_drive
from track_range.simulation.render.renderer import Renderer
from track_range.simulation.settings import DriveOptions
from track_range.simulation.world.scene import make_scene
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import whole_image
from track_range.stereo.geometry.rectification import Rectifier, Undistorter
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.reading import load_rig

LENS = PinholeCamera(130.0, 130.0, 159.5, 79.5, 320, 160, (0.01, 0.0, 0.0, 0.0), "kannala-brandt")
RIG = StereoRig.rectified(LENS, 0.54)


def test_undistorted_images_are_those_of_the_pinhole():
    lens, scene = WideLens.of(RIG), make_scene(3, seconds=0.4)
    wide = Renderer(scene, lens.pinholes, noise_grey=0.0, wide_lens=lens)
    pinhole = Renderer(scene, lens.pinholes, noise_grey=0.0)
    images = [wide.render(0.2, side=side) for side in ("left", "right")]
    assert images[0].shape == (160, 320, 3)
    undistorted = [whole_image(image).astype(float) for image in Rectifier(RIG).rectify(*images)]
    expected = [pinhole.render(0.2, side=side).astype(float) for side in ("left", "right")]
    inside = np.s_[10:-10, 10:-10]
    assert np.abs(undistorted[0] - expected[0])[inside].mean() < 3.0
    grey = expected[1] @ [0.114, 0.587, 0.299]
    assert np.abs(undistorted[1] - grey)[inside].mean() < 3.0


def test_lens_that_sees_to_the_sides():
    # 183 degrees
    camera = PinholeCamera(100.0, 100.0, 159.5, 79.5, 320, 160, (0.0,) * 4, "kannala-brandt")
    lens, scene = WideLens.of(StereoRig.rectified(camera, 0.54)), make_scene(3, seconds=0.4)
    assert [side.yaw_deg for side in lens.sides] == [-75.0, 75.0]
    # the middle shows the pinhole ahead
    assert not any((side.is_shown[240, 240:720] > 0).any() for side in lens.sides)
    wide = Renderer(scene, lens.pinholes, noise_grey=0.0, wide_lens=lens).render(0.2)
    assert (wide[40:120] > 0).all()
    # a view across the seam at 60 degrees shows the same as the views beside it
    ahead = Undistorter(camera, fov_deg=100)
    across = Undistorter(camera, fov_deg=60, yaw_deg=35)
    images = [
        undistorter.undistort(wide).astype(float).mean(axis=2) for undistorter in (ahead, across)
    ]
    shown_px = (
        np.stack(np.meshgrid(np.arange(5, 30), np.arange(20, 80)), axis=2)
        .reshape(-1, 2)
        .astype(float)
    )
    recorded_px = across.recorded_points(shown_px)
    in_ahead_px = ahead.camera.project(camera.recorded_rays(recorded_px)).round().astype(int)
    first = images[1][shown_px[:, 1].astype(int), shown_px[:, 0].astype(int)]
    second = images[0][in_ahead_px[:, 1], in_ahead_px[:, 0]]
    assert np.abs(first - second).mean() < 6


def test_road_continues_across_the_seam():
    camera = PinholeCamera(100.0, 100.0, 159.5, 79.5, 320, 160, (0.0,) * 4, "kannala-brandt")
    lens = WideLens.of(StereoRig.rectified(camera, 0.54))
    image = Renderer(
        make_scene(3, seconds=0.4), lens.pinholes, noise_grey=0.0, wide_lens=lens
    ).render(0.2)
    grey = image.astype(float).mean(axis=2)[95:125]  # the road below the horizon
    seam = round(
        camera.recorded_px(np.array([[np.sin(np.radians(60)), 0.1, np.cos(np.radians(60))]]))[0, 0]
    )
    steps = np.abs(np.diff(grey, axis=1)).mean(axis=0)
    assert steps[seam - 2 : seam + 2].max() < 3 * np.median(steps) + 3


def test_night_and_rain_are_seen_through_the_lens():
    lens = WideLens.of(RIG)
    night = Renderer(
        replace(make_scene(3, seconds=0.4), is_night=True), lens.pinholes, wide_lens=lens
    )
    day = Renderer(make_scene(3, seconds=0.4), lens.pinholes, wide_lens=lens)
    assert night.render(0.0).shape == day.render(0.0).shape == (160, 320, 3)
    assert night.render(0.0).mean() < 0.8 * day.render(0.0).mean()


@pytest.fixture(scope="module")
def wide_drive(tmp_path_factory):
    return write_drive(tmp_path_factory.mktemp("wide"), seed=3, seconds=0.4, rig=RIG)


def test_files_of_a_drive(wide_drive):
    rig, _ = load_rig(wide_drive.rig, size_px=(320, 160))
    assert rig.left == LENS
    truth, detections = read_kitti(wide_drive.truth), read_kitti(wide_drive.detections)
    pinhole = Undistorter(LENS).camera
    assert truth.xyxy_px[:, 2].max() <= pinhole.width_px - 1
    assert (detections.xyxy_px >= 0).all()
    assert (detections.xyxy_px[:, 2:] <= (319, 159)).all()
    undistorted = Undistorter(LENS).left_boxes(detections.xyxy_px)
    nearest_px = [
        np.abs(truth.xyxy_px[truth.frame == frame] - box).max(axis=1).min()
        for frame, box in zip(detections.frame, undistorted, strict=True)
    ]
    assert np.median(nearest_px) < 4


def test_what_is_refused(tmp_path):
    other = replace(LENS, fx_px=140.0)
    with pytest.raises(ValueError, match="identical"):
        WideLens.of(StereoRig(LENS, other, RIG.right_from_left))
    with pytest.raises(ValueError, match="wide"):
        write_drive(tmp_path, rig=RIG, options=DriveOptions(disparity=True))
