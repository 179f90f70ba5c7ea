"""Calibrations of images of another size: what is assumed, what speaks against it, and by which
factor."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from track_range.recording.cameras.calibration import calibration_of
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.image_size import fit_to_size
from track_range.stereo.geometry.rectification import Rectifier, Undistorter
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import check_camera
from track_range.stereo.geometry.size_notes import field_notes, fitted_to_size
from track_range.stereo.rig_formats.reading import load_calibration

KITTI = PinholeCamera(721.5377, 721.5377, 609.5593, 172.854, 0, 0)  # calib.txt has no image size
HD = PinholeCamera(1150.0, 1150.0, 655.0, 349.0, 1280, 720)  # 1 % of the width off centre


@pytest.mark.parametrize(
    ("camera", "size_px", "reading", "fx_px"),
    [
        (HD, (1280, 720), "stated", 1150.0),
        (HD, (1278, 720), "stated", 1150.0),  # cropped by a codec
        (HD, (1276, 720), "scaled", 1150.0 * 1276 / 1280),
        (HD, (640, 360), "scaled", 575.0),
        (HD, (640, 480), "other aspect", None),
        (KITTI, (1242, 375), "assumed", 721.5377),
        (KITTI, (915, 375), "assumed", 721.5377),  # cx 609.6, two thirds of the width are 610
        (KITTI, (914, 375), "off centre", None),  # 609.3
        (KITTI, (1242, 519), "off centre", None),  # cy 172.9, a third of the height is 173
    ],
)
def test_how_images_belong_to_a_camera(camera, size_px, reading, fx_px):
    fit = fit_to_size(camera, size_px)
    assert fit.reading == reading
    if fx_px is not None:
        assert (fit.camera.size_px, fit.camera.fx_px) == (size_px, pytest.approx(fx_px))


@pytest.mark.parametrize(
    ("size_px", "factor"),
    [
        ((1242, 375), None),
        ((1241, 376), None),
        ((1242, 374), None),
        ((931, 281), 1242 / 931),
        ((1024, 320), 1242 / 1024),
    ],
)
def test_a_calibration_without_a_size(size_px, factor):
    camera, notes = fitted_to_size(KITTI, size_px, "calib.txt")
    assert camera == dataclasses.replace(KITTI, width_px=size_px[0], height_px=size_px[1])
    assert f"no image size; it is taken to be {size_px[0]}x{size_px[1]} px" in notes[0]
    assert [other.factor for other in fit_to_size(KITTI, size_px).alternatives][:1] == (
        [] if factor is None else [factor]
    )
    assert len(notes) == (1 if factor is None else 2)
    if factor is not None:
        shown = ("1242x375", f"{721.5377 / factor:.0f} px instead of 722 px", f"{factor:.2f} times")
        # 1024x320 has another aspect
        advice = "--size 1242x375" if size_px == (931, 281) else "fy 616 px"
        assert all(text in notes[1] for text in (*shown, advice))


def test_half_of_kitti_is_refused_with_the_size_that_fits():
    with pytest.raises(RigError, match=r"middle third.*1242x375"):
        fitted_to_size(KITTI, (621, 188), "calib.txt")


@pytest.mark.parametrize(("scale", "factor"), [(0.5, 0.5), (0.75, 0.75), (1.5, 1.5)])
def test_a_matrix_that_did_not_follow_the_resolution(scale, factor):
    wrong = PinholeCamera(
        HD.fx_px * scale,
        HD.fy_px * scale,
        (HD.cx_px + 0.5) * scale - 0.5,
        (HD.cy_px + 0.5) * scale - 0.5,
        1280,
        720,
    )
    shown = [other.factor for other in fit_to_size(wrong, (1280, 720)).alternatives]
    assert shown[0] == pytest.approx(factor)
    assert "focal length is in doubt" in fitted_to_size(wrong, (1280, 720), "info.yaml")[1][0]
    # the images are resized, too
    assert fit_to_size(wrong, (640, 360)).alternatives[0].factor == pytest.approx(factor)
    loaded = calibration_of(StereoRig.rectified(wrong, 0.5), ((1280, 720),))
    assert loaded.focal_sigma == pytest.approx(max(abs(1 - 1 / other) for other in shown))


def test_a_matrix_of_twice_the_resolution_is_refused_with_the_size_that_fits():
    # camera_info with the size of resized images
    wrong = dataclasses.replace(HD, width_px=640, height_px=360)
    with pytest.raises(RigError, match="1310x698 px"):
        check_camera(wrong, "info.yaml")


def test_resized_or_cropped_is_stated_and_not_in_doubt():
    camera, notes = fitted_to_size(HD, (640, 360), "rig.yaml")
    assert camera.fx_px == 575.0
    assert "575 px" in notes[0]
    assert "the focal length is 1150 px, and distances are 2.00 times" in notes[0]
    loaded = calibration_of(HD, ((640, 360),))
    assert (loaded.focal_sigma, loaded.alternatives) == (0.0, ())


@pytest.mark.parametrize(
    ("focal_px", "n_notes"), [(250.0, 1), (300.0, 0), (1150.0, 0), (3600.0, 0), (3700.0, 1)]
)
def test_unusual_fields_of_view(focal_px, n_notes):
    notes = field_notes(
        PinholeCamera.of_focal_length(focal_px, (1280, 720)), "--focal-px"
    )  # 137, 130, 20, 19.6 degrees
    assert len(notes) == n_notes


# 1080N: every other column is left out
SQUEEZED = PinholeCamera(575.0, 1150.0, 470.0, 530.0, 960, 1080)
# pixel edges map to pixel edges: 2 (470 + 0.5) - 0.5
SQUARE = PinholeCamera(1150.0, 1150.0, 940.5, 530.0, 1920, 1080)


def test_images_of_other_than_square_pixels_are_resampled():
    assert SQUEEZED.squared() == SQUARE
    assert SQUARE.squared() == SQUARE
    high = PinholeCamera(1000.0, 800.0, 479.5, 287.5, 960, 576).squared()  # 960H shown as 4:3
    assert high == PinholeCamera(1000.0, 1000.0, 479.5, 359.5, 960, 720)
    one, pair = Undistorter(SQUEEZED), Rectifier(StereoRig.rectified(SQUEEZED, 0.5))
    assert one.camera == pair.rig.left == pair.rig.right == SQUARE
    assert pair.rig.baseline_m == 0.5
    assert np.allclose(
        one.left_boxes(np.array([[100.0, 50.0, 200.0, 90.0]])), [[200.5, 50.0, 400.5, 90.0]]
    )
    image = np.zeros((1080, 960, 3), np.uint8)
    image[:, 300:302] = 200
    assert one.undistort(image)[500, [600, 601, 602, 603], 0].min() > 100
    left, right = pair.rectify(image, np.roll(image, -20, axis=1))
    assert np.flatnonzero(left[500, :, 0] > 100).mean() == 601.5
    # a disparity of 20 stored pixels is one of 40
    assert np.flatnonzero(right[500:501, :][0] > 100).mean() == 561.5


@pytest.mark.parametrize("distortion", [(), (-0.2, 0.05, 0.0, 0.0, 0.0)])
def test_rectification_of_squeezed_pairs_keeps_the_view(distortion):
    rig = StereoRig.rectified(dataclasses.replace(SQUEEZED, distortion=distortion), 0.5)
    rectified = Rectifier(rig).rig
    assert rectified.left.size_px == (1920, 1080)
    assert rectified.left.fx_px == rectified.left.fy_px == pytest.approx(1150.0, rel=0.06)
    assert rectified.baseline_m == pytest.approx(0.5)


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "size_px"),
    [
        ("kitti_stereo/0003/calib.txt", (1242, 375)),
        ("kitti_odometry/gray51/calib.txt", (1226, 370)),
        ("calibrations/kitti_more/perspective.txt", (1408, 376)),
        ("calibrations/opencv_more/T_row.yml", (640, 480)),
        ("fisheye/kalibr/tum_vi.yaml", (512, 512)),
        ("fisheye/kalibr/euroc_mav.yaml", (752, 480)),
    ],
)
def test_principal_points_of_real_calibrations_are_not_doubted(shared_data: Path, name, size_px):
    cameras, _ = load_calibration(shared_data / name)
    assert isinstance(cameras, StereoRig)
    assert (
        fit_to_size(cameras.left, size_px).alternatives
        == fit_to_size(cameras.right, size_px).alternatives
        == ()
    )
