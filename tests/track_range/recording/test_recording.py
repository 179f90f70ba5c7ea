"""Tests of opening pairs and single videos, with folders of small textured images."""

from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from track_range.api.parts import load_rig
from track_range.recording.cameras.calibration import LensView, calibration_of
from track_range.recording.pairs import recorded_pair
from track_range.recording.recording import open_recording
from track_range.recording.video.frame import VideoError
from track_range.recording.video.threads import FRAMES_AHEAD
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import whole_image
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.geometry.rig import RigAccuracy, RigError, RoadCalibration, StereoRig
from track_range.stereo.rig_formats.rig_yaml import save_camera, save_rig

WIDTH_PX, HEIGHT_PX, SHIFT_PX = 320, 160, 12
CAMERA = PinholeCamera(300.0, 300.0, 159.5, 79.5, WIDTH_PX, HEIGHT_PX)


def write_view(
    folder: Path, shift_px: int, *, n=3, size_px=(WIDTH_PX, HEIGHT_PX), row_px=0, is_grey=False
) -> Path:
    """Write images of a wall with smooth coloured noise, shifted to the left by the disparity."""
    noise = np.random.default_rng(0).integers(0, 255, (400, 700, 3), np.uint8)
    wall = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)
    if is_grey:
        wall = np.repeat(wall[:, :, :1], 3, axis=2)
    folder.mkdir(parents=True)
    for number in range(n):
        rows, columns = (
            slice(40 + row_px, 40 + row_px + size_px[1]),
            slice(40 + shift_px, 40 + shift_px + size_px[0]),
        )
        cv2.imwrite(str(folder / f"{number:06d}.png"), wall[rows, columns])
    return folder


def write_road(folder: Path, sign: int, *, n=3) -> Path:
    """Write images of a road below the middle, on which disparities grow downwards, and of a wall
    above."""
    noise = np.random.default_rng(0).integers(0, 255, (HEIGHT_PX, 700, 3), np.uint8)
    wall = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)
    shift_px = 100 + sign * np.round(
        4 + 0.1 * np.maximum(np.arange(HEIGHT_PX) - HEIGHT_PX / 2, 0)
    ).astype(int)
    image = np.stack(
        [row[start : start + WIDTH_PX] for row, start in zip(wall, shift_px.tolist(), strict=True)]
    )
    folder.mkdir(parents=True)
    for number in range(n):
        cv2.imwrite(str(folder / f"{number:06d}.png"), image)
    return folder


@pytest.fixture
def pair(tmp_path):
    save_rig(StereoRig.rectified(CAMERA, 0.5), tmp_path / "rig.yaml")
    return write_view(tmp_path / "left", 0), write_view(tmp_path / "right", SHIFT_PX)


def test_rig_next_to_the_left_video_is_used(pair):
    recording = open_recording(*pair)
    frames = list(recording.frames)
    assert [(f.index, round(f.time_s, 6)) for f in frames] == [(0, 0.0), (1, 0.1), (2, 0.2)]
    assert (frames[0].left[:, SHIFT_PX:] == frames[0].right[:, :-SHIFT_PX]).all()
    assert (recording.n_frames, recording.size_px, recording.camera) == (
        3,
        (WIDTH_PX, HEIGHT_PX),
        CAMERA,
    )
    assert any("rig.yaml" in note for note in recording.notes)


def test_size_differs_by_one_row(pair, tmp_path):
    right = write_view(tmp_path / "cut", SHIFT_PX, size_px=(WIDTH_PX, HEIGHT_PX - 1))
    frame = next(open_recording(pair[0], right).frames)
    assert frame.left.shape == frame.right.shape == (HEIGHT_PX - 1, WIDTH_PX, 3)


def test_swapped_pair_is_an_error(tmp_path):
    rig = StereoRig.rectified(CAMERA, 0.5)
    left, right = write_road(tmp_path / "left", -1), write_road(tmp_path / "right", 1)
    assert open_recording(left, right, rig=rig).rig is not None
    with pytest.raises(RigError, match="swapped"):
        open_recording(right, left, rig=rig)


def test_negative_disparities_without_a_reason_are_not_ranged(pair):
    recording = open_recording(*pair[::-1], rig=pair[0].parent / "rig.yaml")
    (note,) = (note for note in recording.notes if "does not fit" in note)
    assert recording.rig is None
    assert all(cause in note for cause in ("swapped", "upside down", "turned"))


def test_row_offset_is_corrected_and_reported(pair, tmp_path):
    right = write_view(tmp_path / "low", SHIFT_PX, row_px=-4)
    recording = open_recording(pair[0], right)
    assert any("+4.0 px" in note and "corrected" in note for note in recording.notes)
    assert recording.calibration.alignment.measured.row_offset_px == pytest.approx(4.0, abs=0.1)
    assert recording.rig.alignment is recording.alignment
    frame = next(recording.frames)
    grey = cv2.cvtColor(frame.left, cv2.COLOR_BGR2GRAY).astype(int)
    assert (
        np.median(np.abs(grey[8:-8, SHIFT_PX:] - whole_image(frame.right)[8:-8, :-SHIFT_PX])) <= 4
    )
    off = open_recording(pair[0], right, align="off")
    assert any("+4.0 px" in note and "corrected" not in note for note in off.notes)


def test_different_sizes_are_an_error(pair, tmp_path):
    right = write_view(tmp_path / "small", SHIFT_PX, size_px=(200, 100))
    with pytest.raises(RigError, match=r"rig\.yaml: expected .*200x100"):
        open_recording(pair[0], right)
    (tmp_path / "rig.yaml").unlink()
    with pytest.raises(VideoError, match=r"small: expected .*200x100"):
        open_recording(pair[0], right)


@pytest.mark.parametrize("scale", [1, 2])
def test_cameras_of_unequal_sizes(pair, tmp_path, scale):
    small = PinholeCamera(CAMERA.fx_px, CAMERA.fy_px, 79.5, 59.5, 200, 120)
    right_from_left = np.eye(4)
    right_from_left[0, 3] = -0.5
    cameras = [
        PinholeCamera(
            c.fx_px * scale,
            c.fy_px * scale,
            *((o + 0.5) * scale - 0.5 for o in (c.cx_px, c.cy_px)),
            *size,
        )
        for c, size in ((CAMERA, (320 * scale, 160 * scale)), (small, (200 * scale, 120 * scale)))
    ]
    save_rig(StereoRig(*cameras, right_from_left), tmp_path / "rig.yaml")
    right = write_view(tmp_path / "small", SHIFT_PX + 80, size_px=(200, 120), row_px=20)
    recording = open_recording(pair[0], right, align="off")
    frame = next(recording.frames)
    assert frame.left.shape[:2] == whole_image(frame.right).shape == (HEIGHT_PX, WIDTH_PX)
    assert recording.camera.fx_px == pytest.approx(CAMERA.fx_px, rel=0.01)
    assert any("the right camera sees" in note for note in recording.notes)
    grey = cv2.cvtColor(frame.left, cv2.COLOR_BGR2GRAY).astype(int)
    rows, columns = slice(40, 120), slice(110, 240)
    shifted = slice(columns.start - SHIFT_PX, columns.stop - SHIFT_PX)
    assert np.median(np.abs(grey[rows, columns] - whole_image(frame.right)[rows, shifted])) <= 4


def test_pair_without_rig_is_uncalibrated(pair, tmp_path):
    (tmp_path / "rig.yaml").unlink()
    recording = open_recording(*pair)
    assert (recording.calibrated_rig, recording.calibration.kind) == (None, "estimated")
    assert recording.rig is not None
    assert recording.rig.is_assumed
    usual_px = np.hypot(WIDTH_PX, HEIGHT_PX) / np.hypot(16, 9) * 8 / np.tan(np.radians(75 / 2))
    assert recording.camera.fx_px == pytest.approx(usual_px, rel=2e-3)  # of the diagonal
    assert recording.calibration.focal_sigma == 0.3
    frame = next(recording.frames)
    assert (frame.left[:, SHIFT_PX:] == frame.right[:, :-SHIFT_PX]).all()
    assert any("75 degrees" in note and "track-range calibrate" in note for note in recording.notes)
    given = open_recording(*pair, focal_px=280.0)
    assert (given.camera.fx_px, given.calibration.focal_sigma) == (280.0, 0.02)
    assert any("280 px" in note for note in given.notes)


def test_baseline_of_a_given_rig_may_be_assumed(pair, tmp_path):
    rig = replace(load_rig(tmp_path / "rig.yaml"), baseline_sigma=0.3)
    recording = open_recording(*pair, rig=rig, align="off")
    assert recording.rig is not None
    assert (recording.rig.baseline_sigma, recording.calibrated_rig) == (0.3, None)
    assert recording.rig.unaligned.residual_px == 3.0


def test_uncalibrated_rows_corrected_or_stereo_off(pair, tmp_path):
    (tmp_path / "rig.yaml").unlink()
    recording = open_recording(pair[0], write_view(tmp_path / "low", SHIFT_PX, row_px=-4))
    assert recording.alignment is not None
    assert recording.alignment.row_offset_px == pytest.approx(4.0, abs=0.3)
    frame = next(recording.frames)
    grey = cv2.cvtColor(frame.left, cv2.COLOR_BGR2GRAY).astype(int)
    difference = np.abs(grey[8:-8, SHIFT_PX:] - whole_image(frame.right)[8:-8, :-SHIFT_PX])
    assert np.median(difference) <= 4
    assert any("vertical offset of +" in note and "corrected" in note for note in recording.notes)
    rotated = tmp_path / "rotated"
    rotated.mkdir()
    middle = ((WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2)
    for image in sorted(pair[1].iterdir()):
        rotation = cv2.getRotationMatrix2D(middle, 12.0, 1.0)
        cv2.imwrite(
            str(rotated / image.name),
            cv2.warpAffine(cv2.imread(str(image)), rotation, (WIDTH_PX, HEIGHT_PX)),
        )
    recording = open_recording(pair[0], rotated)
    assert recording.rig is None
    assert any("needs a rig" in note for note in recording.notes)


def test_one_camera_without_rig_or_focal_length(pair, tmp_path):
    (tmp_path / "rig.yaml").unlink()
    recording = open_recording(pair[0])
    calibration = recording.calibration
    assert (calibration.kind, calibration.focal_sigma, len(calibration.guesses)) == (
        "estimated",
        0.3,
        1,
    )
    assert any("75 degrees" in note and "calibrate drive" in note for note in recording.notes)
    recording.close()


def test_uncertain_focal_length_of_a_file(pair, tmp_path):
    camera = PinholeCamera.of_focal_length(300.0, (WIDTH_PX, HEIGHT_PX))
    road = RoadCalibration(
        focal_sigma=0.04,
        camera_height_m=1.4,
        camera_height_sigma_m=0.05,
        pitch_deg=1.5,
        pitch_sigma_deg=0.2,
    )
    save_camera(camera, tmp_path / "rig.yaml", road=road)
    recording = open_recording(pair[0])
    assert (recording.calibration.focal_sigma, recording.calibration.camera_height_m) == (0.04, 1.4)
    assert any("4.0 %" in note for note in recording.notes)
    recording.close()


def test_sigmas_of_a_calibration_with_a_board(pair, tmp_path):
    camera = PinholeCamera.of_focal_length(300.0, (WIDTH_PX, HEIGHT_PX))
    accuracy = RigAccuracy(focal_sigma=0.01, scale_sigma=0.02)
    save_rig(StereoRig.rectified(camera, 0.5), tmp_path / "rig.yaml", accuracy=accuracy)
    rig = load_rig(tmp_path / "rig.yaml")
    save_rig(rig, tmp_path / "again.yaml")
    assert load_rig(tmp_path / "again.yaml").accuracy == rig.accuracy == accuracy
    by_file = open_recording(*pair[:2], align="off").rig  # rectified
    for videos, given, scale_sigma in (
        *((pair[:1], given, 0.01) for given in (None, rig)),
        *((pair[:2], given, 0.02) for given in (None, rig, by_file)),
    ):
        recording = open_recording(*videos, rig=given, align="off")
        calibration = recording.calibration
        assert (calibration.scale_sigma, calibration.focal_sigma) == (scale_sigma, 0.0)
        assert any("within 2 %" in note for note in recording.notes)
        recording.close()


def test_swapped_uncalibrated_pair_is_an_error(tmp_path):
    left, right = write_road(tmp_path / "left", -1), write_road(tmp_path / "right", 1)
    with pytest.raises(RigError, match="swapped"):
        open_recording(right, left)


def test_one_camera(pair):
    by_focal = open_recording(pair[0], focal_px=250.0)
    assert (by_focal.camera.fx_px, by_focal.camera.cx_px, by_focal.rig) == (250.0, 159.5, None)
    by_rig = open_recording(pair[0])
    assert by_rig.camera == CAMERA
    assert next(by_rig.frames).right is None


@pytest.mark.parametrize(
    ("factor", "is_named"), [(1.0, False), (1.2, False), (1.5, True), (0.7, True)]
)
def test_given_focal_length_against_metadata(tmp_path, factor, is_named):
    image = pytest.importorskip("PIL.Image").new("RGB", (64, 48))
    exif = image.getexif()
    exif.get_ifd(0x8769)[0xA405] = 28
    for i in range(3):
        image.save(tmp_path / f"{i:06}.jpg", exif=exif)
    recording = open_recording(tmp_path, focal_px=factor * 28 * 80 / 43.27)
    assert any("28 mm for 35 mm film means 52 px" in note for note in recording.notes) == is_named
    recording.close()


def test_grey_pairs_use_kittis_grey_cameras(tmp_path):
    lines = [
        f"P{i}: 300 0 159.5 {-300 * x} 0 300 79.5 0 0 0 1 0"
        for i, x in enumerate((0.0, 0.4, 0.06, 0.56))
    ]
    (tmp_path / "calib.txt").write_text("\n".join(lines))
    colour = write_view(tmp_path / "a" / "left", 0), write_view(tmp_path / "a" / "right", SHIFT_PX)
    grey = (
        write_view(tmp_path / "b" / "left", 0, is_grey=True),
        write_view(tmp_path / "b" / "right", SHIFT_PX, is_grey=True),
    )
    rig = tmp_path / "calib.txt"
    assert open_recording(*colour, rig=rig).rig.baseline_m == pytest.approx(0.5)
    assert open_recording(*grey, rig=rig).rig.baseline_m == pytest.approx(0.4)
    assert open_recording(*colour, rig=rig).calibration.left_from_reference_m[0] == pytest.approx(
        -0.06
    )
    assert open_recording(*grey, rig=rig).calibration.left_from_reference_m[0] == 0.0


def test_start_and_duration_keep_frame_numbers(pair, tmp_path):
    long = write_view(tmp_path / "l", 0, n=8), write_view(tmp_path / "r", SHIFT_PX, n=8)
    frames = list(open_recording(*long, start_s=0.25, duration_s=0.3).frames)
    assert [(f.index, round(f.time_s, 6)) for f in frames] == [(3, 0.3), (4, 0.4), (5, 0.5)]


@pytest.fixture
def opened_files(monkeypatch):
    """The files that FFmpeg opens."""
    names, av_open = [], av.open

    def counting(name, *arguments, **options):
        if options.get("mode") == "r":
            names.append(Path(name.removeprefix("file:")).name)
        return av_open(name, *arguments, **options)

    monkeypatch.setattr(av, "open", counting)
    return names


def films(folder, film, *, n=14, rate_hz=10):
    """Write a pair of videos of the wall, with a rig file next to them."""
    folder.mkdir(exist_ok=True)
    save_rig(StereoRig.rectified(CAMERA, 0.5), folder / "rig.yaml")
    for name, shift_px in (("left", 0), ("right", SHIFT_PX)):
        image = cv2.imread(str(write_view(folder / f"{name}_wall", shift_px, n=1) / "000000.png"))
        images = [np.roll(image, number, axis=0) for number in range(n)]
        film(folder / f"{name}.mp4", [number / rate_hz for number in range(n)], images=images)
    return folder / "left.mp4", folder / "right.mp4"


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"align": "off"}, {"start_s": 0.5}, {"focal_px": 300.0}])
def test_each_video_is_opened_once(tmp_path, film, opened_files, options):
    left, right = films(tmp_path, film)
    frames = list(open_recording(left, right, **options).frames)
    assert [frame.index for frame in frames] == list(range(5 if "start_s" in options else 0, 14))
    assert sorted(opened_files) == ["left.mp4", "right.mp4"]


def test_one_video_is_opened_once(tmp_path, film, opened_files):
    left, _ = films(tmp_path, film)
    assert len(list(open_recording(left).frames)) == 14
    assert opened_files == ["left.mp4"]


@pytest.mark.slow
def test_frames_do_not_depend_on_the_buffer_size(tmp_path, film, opened_files, monkeypatch):
    left, right = films(tmp_path, film, n=30, rate_hz=30)
    buffered = open_recording(left, right)
    expected = list(buffered.frames)
    n_opened = len(opened_files)
    monkeypatch.setattr(recorded_pair, "MAX_LOOK_AHEAD_BYTES", 3 * 2 * 1.5 * WIDTH_PX * HEIGHT_PX)
    reread = open_recording(left, right)
    frames = list(reread.frames)
    # the frames do not fit in the buffer: read twice
    assert (n_opened, len(opened_files) - n_opened) == (2, 4)
    assert buffered.calibration.alignment.measured == reread.calibration.alignment.measured
    for a, b in zip(expected, frames, strict=True):
        assert (a.index, a.time_s) == (b.index, b.time_s)
        assert (a.left == b.left).all()
        assert (a.right == b.right).all()
    assert buffered.notes == reread.notes


@pytest.mark.slow
def test_buffered_frames_are_freed_one_by_one(tmp_path, film):
    recording = open_recording(*films(tmp_path, film))
    n_buffered = len(recording.pair._ahead)
    next(recording.frames)
    # those that wait for later ones
    assert (n_buffered, len(recording.pair._ahead)) == (14, 13 - 2 * FRAMES_AHEAD)
    recording.close()
    assert len(recording.pair._ahead) == 0


def test_rig_holds_the_alignment_of_its_images(pair):
    given = Alignment(offset_px=7.4, residual_px=0.1)
    recording = open_recording(*pair, align=given)
    assert recording.rig.alignment == given.after_shift()  # the images are shifted by 7 px
    assert next(recording.frames).alignment == given.after_shift()
    single = open_recording(pair[0])
    assert (single.alignment, next(single.frames).alignment) == (None, None)
    off = open_recording(*pair, align="off")
    assert off.alignment.offset_px == next(off.frames).alignment.offset_px == 0.0


def test_progress_of_the_estimate_is_shown(pair):
    tasks, steps = [], []

    @contextmanager
    def progress(task):
        tasks.append(task)
        yield lambda done, total: steps.append((done, total))

    open_recording(*pair, progress=progress).close()
    assert tasks == ["estimating the alignment"]
    assert {total for _, total in steps} <= {80}  # tenths of a second
    open_recording(*pair, align="off", progress=progress).close()
    assert len(tasks) == 1


def test_alignment_given(pair):
    rows = Alignment(row_offset_px=4.0)
    recording = open_recording(pair[0], pair[1], align=rows, has_checks=False)
    assert recording.calibration.alignment.measured is rows
    assert (recording.finding, recording.sync) == (None, None)


def test_files_are_closed_when_opening_fails(tmp_path, film):
    for side, sign in (("left", -1), ("right", 1)):
        image = cv2.imread(str(write_road(tmp_path / side, sign) / "000000.png"))
        film(tmp_path / f"{side}.mp4", [0.0, 0.1, 0.2], images=[image] * 3)
    before = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(RigError, match="swapped"):
        open_recording(tmp_path / "right.mp4", tmp_path / "left.mp4", focal_px=300.0)
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_direction_of_a_view_in_the_vehicle():
    """A mounting is turned by the view, to the right; the given one is used before that of a file."""
    ahead = calibration_of(CAMERA, (CAMERA.size_px,))
    assert ahead.view_mounting() is None
    aside = replace(ahead, view=LensView(yaw_deg=20.0))
    assert aside.view_mounting().yaw_deg == pytest.approx(-20.0)  # of a lens that looks ahead
    mounted = replace(aside, mounting=Mounting(yaw_deg=-30.0, x_m=1.5))
    assert mounted.view_mounting().yaw_deg == pytest.approx(-50.0)
    assert mounted.view_mounting().x_m == 1.5
    assert mounted.view_mounting(Mounting(yaw_deg=90.0)).yaw_deg == pytest.approx(70.0)


def test_a_mounting_has_its_source():
    """The section of summary.json; the angles are those of the view."""
    assumed = calibration_of(CAMERA, (CAMERA.size_px,))
    angles = {"yaw_deg": 0.0, "pitch_deg": 0.0, "roll_deg": 0.0}
    assert assumed.mounting_summary(None) == {**angles, "sigma_deg": None, "source": "assumed"}
    aside = replace(assumed, view=LensView(yaw_deg=20.0))
    assert aside.mounting_summary(None)["source"] == "assumed"
    stated = replace(aside, mounting=Mounting(yaw_deg=-30.0, sigma_deg=1.0))
    section = stated.mounting_summary(None)
    assert (section["yaw_deg"], section["sigma_deg"], section["source"]) == (-50.0, 1.0, "rig")
    shown = replace(assumed, mounting=Mounting(yaw_deg=-30.0), mounting_source="images")
    assert shown.mounting_summary(None)["source"] == "images"
    section = shown.mounting_summary(Mounting(yaw_deg=5.0))
    assert (section["yaw_deg"], section["source"]) == (5.0, "given")
