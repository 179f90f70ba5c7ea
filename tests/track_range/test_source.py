"""Opening pairs and single videos, on folders of small textured images."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from track_range.run.settings import RunSettings
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import whole_image
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.rig_formats.rig_yaml import save_rig
from track_range.video.reader import VideoError
from track_range.video.source import open_source

WIDTH_PX, HEIGHT_PX, SHIFT_PX = 320, 160, 12
CAMERA = PinholeCamera(300.0, 300.0, 159.5, 79.5, WIDTH_PX, HEIGHT_PX)


def write_eye(folder: Path, shift_px: int, *, n=3, size_px=(WIDTH_PX, HEIGHT_PX), row_px=0, is_grey=False) -> Path:
    """A wall of soft coloured noise, moved left by the disparity."""
    noise = np.random.default_rng(0).integers(0, 255, (400, 700, 3), np.uint8)
    wall = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)
    if is_grey:
        wall = np.repeat(wall[:, :, :1], 3, axis=2)
    folder.mkdir(parents=True)
    for number in range(n):
        rows, columns = slice(40 + row_px, 40 + row_px + size_px[1]), slice(40 + shift_px, 40 + shift_px + size_px[0])
        cv2.imwrite(str(folder / f"{number:06d}.png"), wall[rows, columns])
    return folder


@pytest.fixture
def pair(tmp_path):
    save_rig(StereoRig.rectified(CAMERA, 0.5), tmp_path / "rig.yaml")
    return write_eye(tmp_path / "left", 0), write_eye(tmp_path / "right", SHIFT_PX)


def settings(stereo, **more):
    return RunSettings(stereo=stereo, detections=Path("unused"), **more)


def test_a_pair_with_the_rig_beside_it(pair):
    source = open_source(settings(pair))
    frames = list(source.frames)
    assert [(f.index, round(f.time_s, 6)) for f in frames] == [(0, 0.0), (1, 0.1), (2, 0.2)]
    assert (frames[0].left[:, SHIFT_PX:] == frames[0].right[:, :-SHIFT_PX]).all()
    assert (source.n_frames, source.size_px, source.camera) == (3, (WIDTH_PX, HEIGHT_PX), CAMERA)
    assert any("rig.yaml beside the left video is used" in note for note in source.notes)


def test_a_codec_that_cut_a_row_off_one_eye_does_no_harm(pair, tmp_path):
    right = write_eye(tmp_path / "cut", SHIFT_PX, size_px=(WIDTH_PX, HEIGHT_PX - 1))
    frame = next(open_source(settings((pair[0], right))).frames)
    assert frame.left.shape == frame.right.shape == (HEIGHT_PX - 1, WIDTH_PX, 3)


def test_swapped_eyes_are_refused_before_anything_runs(pair):
    with pytest.raises(RigError, match=r"left and right are swapped: .* hand the videos over the other way round"):
        open_source(settings(pair[::-1], rig=pair[0].parent / "rig.yaml"))


def test_rows_that_are_apart_are_told(pair, tmp_path):
    right = write_eye(tmp_path / "low", SHIFT_PX, row_px=-4)
    source = open_source(settings((pair[0], right)))
    assert any("Rows of left and right are +4.0 px apart: corrected" in note for note in source.notes)
    assert source.alignment.measured.row_offset_px == pytest.approx(4.0, abs=0.1)
    frame = next(source.frames)
    grey = cv2.cvtColor(frame.left, cv2.COLOR_BGR2GRAY).astype(int)
    assert np.median(np.abs(grey[8:-8, SHIFT_PX:] - whole_image(frame.right)[8:-8, :-SHIFT_PX])) <= 4
    off = open_source(settings((pair[0], right), align="off"))
    assert any("Rows of left and right are +4.0 px apart: the rig does not fit" in note for note in off.notes)


def test_eyes_of_different_size_are_refused(pair, tmp_path):
    right = write_eye(tmp_path / "small", SHIFT_PX, size_px=(200, 100))
    with pytest.raises(VideoError, match=r"is 320x160 but .* 200x100: left and right must have one size"):
        open_source(settings((pair[0], right)))


def test_a_pair_without_a_rig_goes_on_uncalibrated(pair, tmp_path):
    (tmp_path / "rig.yaml").unlink()
    source = open_source(settings(pair))
    assert (source.rig, source.calibration, source.alignment) == (None, "estimated", None)
    assert source.camera.fx_px == pytest.approx(WIDTH_PX / 2 / np.tan(np.radians(75 / 2)))
    assert source.uncalibrated.has_equal_rows
    assert source.uncalibrated.focal_sigma == 0.25
    frame = next(source.frames)
    assert (frame.left[:, SHIFT_PX:] == frame.right[:, :-SHIFT_PX]).all()
    assert any("75 degrees is assumed" in note and "track-range calibrate" in note for note in source.notes)
    given = open_source(settings(pair, focal_px=280.0))
    assert (given.camera.fx_px, given.uncalibrated.focal_sigma) == (280.0, 0.02)
    assert any("the focal length is 280 px as given" in note for note in given.notes)


def test_rows_of_an_uncalibrated_pair_are_brought_together_or_stereo_is_left_out(pair, tmp_path):
    (tmp_path / "rig.yaml").unlink()
    source = open_source(settings((pair[0], write_eye(tmp_path / "low", SHIFT_PX, row_px=-4))))
    assert source.uncalibrated.row_offset_px == pytest.approx(4.0, abs=0.1)
    frame = next(source.frames)
    grey = cv2.cvtColor(frame.left, cv2.COLOR_BGR2GRAY).astype(int)
    apart = np.abs(grey[8:-8, SHIFT_PX:] - whole_image(frame.right)[8:-8, :-SHIFT_PX])
    assert np.median(apart) <= 4
    assert any("+4.0 px apart; corrected" in note for note in source.notes)
    turned = tmp_path / "turned"
    turned.mkdir()
    middle = ((WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2)
    for image in sorted(pair[1].iterdir()):
        turn = cv2.getRotationMatrix2D(middle, 12.0, 1.0)
        cv2.imwrite(str(turned / image.name), cv2.warpAffine(cv2.imread(str(image)), turn, (WIDTH_PX, HEIGHT_PX)))
    source = open_source(settings((pair[0], turned)))
    assert not source.uncalibrated.has_equal_rows
    assert any("without a rig stereo cannot be used" in note for note in source.notes)


def test_without_rig_and_focal_length_one_camera_tells_no_metres(pair, tmp_path):
    (tmp_path / "rig.yaml").unlink()
    with pytest.raises(RigError, match="no focal length, so no metres: give --focal-px F"):
        open_source(RunSettings(mono=pair[0], detections=Path("unused")))


def test_swapped_eyes_are_refused_without_a_rig_too(pair, tmp_path):
    (tmp_path / "rig.yaml").unlink()
    with pytest.raises(RigError, match="left and right are swapped"):
        open_source(settings(pair[::-1]))


def test_one_camera_by_focal_length_or_by_rig(pair):
    by_focal = open_source(RunSettings(mono=pair[0], detections=Path("unused"), focal_px=250.0))
    assert (by_focal.camera.fx_px, by_focal.camera.cx_px, by_focal.rig) == (250.0, 159.5, None)
    by_rig = open_source(RunSettings(mono=pair[0], detections=Path("unused")))
    assert by_rig.camera == CAMERA
    assert next(by_rig.frames).right is None


def test_grey_pairs_use_kittis_grey_cameras(tmp_path):
    lines = [f"P{i}: 300 0 159.5 {-300 * x} 0 300 79.5 0 0 0 1 0" for i, x in enumerate((0.0, 0.4, 0.06, 0.56))]
    (tmp_path / "calib.txt").write_text("\n".join(lines))
    colour = write_eye(tmp_path / "a" / "left", 0), write_eye(tmp_path / "a" / "right", SHIFT_PX)
    grey = (
        write_eye(tmp_path / "b" / "left", 0, is_grey=True),
        write_eye(tmp_path / "b" / "right", SHIFT_PX, is_grey=True),
    )
    rig = tmp_path / "calib.txt"
    assert open_source(settings(colour, rig=rig)).rig.baseline_m == pytest.approx(0.5)
    assert open_source(settings(grey, rig=rig)).rig.baseline_m == pytest.approx(0.4)
    assert open_source(settings(colour, rig=rig)).left_from_reference_m[0] == pytest.approx(-0.06)
    assert open_source(settings(grey, rig=rig)).left_from_reference_m[0] == 0.0


def test_start_and_duration_keep_the_files_own_numbers(pair, tmp_path):
    long = write_eye(tmp_path / "l", 0, n=8), write_eye(tmp_path / "r", SHIFT_PX, n=8)
    frames = list(open_source(settings(long, start_s=0.25, duration_s=0.3)).frames)
    assert [(f.index, round(f.time_s, 6)) for f in frames] == [(3, 0.3), (4, 0.4), (5, 0.5)]
