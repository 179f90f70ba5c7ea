"""KITTI's calib.txt in all its variants, and wrong files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.stereo.rig_texts import SIZE, refused, written
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.rig_formats.reading import left_from_reference_m, load_camera, load_rig

KITTI = """P0: 700 0 640 0 0 700 360 0 0 0 1 0
P1: 700 0 640 -350 0 700 360 0 0 0 1 0
P2: 1000 0 650 50 0 1000 350 2 0 0 1 0.004
P3: 1000 0 650 -450 0 1000 350 3 0 0 1 0.004
Tr_velo_cam 1 0 0 0 0 1 0 0 0 0 1 0
"""


def test_kitti_by_hand(tmp_path: Path) -> None:
    path = written(tmp_path, KITTI, "calib.txt")
    rig, notes = load_rig(path, size_px=SIZE)
    assert rig.left.fx_px == 1000
    assert (rig.left.cx_px, rig.left.cy_px, rig.left.width_px, rig.left.height_px) == (
        650,
        350,
        1280,
        720,
    )
    assert rig.baseline_m == pytest.approx(0.5)
    assert rig.is_rectified
    assert len(notes) == 1
    assert "no image size; it is taken to be 1280x720 px" in notes[0]
    grey, _ = load_rig(path, size_px=SIZE, is_grey=True)
    assert (grey.left.fx_px, grey.baseline_m) == (700, pytest.approx(0.5))
    # t = K^-1 P[:, 3]: z = 0.004, x = (50 - 650 z) / 1000, y = (2 - 350 z) / 1000
    assert np.allclose(left_from_reference_m(path, is_grey=False), [0.0474, 0.0006, 0.004])
    assert np.allclose(left_from_reference_m(path, is_grey=True), 0.0)


@pytest.mark.parametrize("form", ["P{n}: {m}", "P{n} {m}", "P_rect_0{n}: {m}", "  P{n}:{m}"])
def test_kitti_line_formats(tmp_path: Path, form: str) -> None:
    left, right = (f"1000 0 640 {x} 0 1000 360 0 0 0 1 0" for x in (0, -540))
    text = "\n".join(form.format(n=n, m=m) for n, m in ((2, left), (3, right)))
    rig, _ = load_rig(written(tmp_path, text, "calib.txt"), size_px=SIZE)
    assert rig.baseline_m == pytest.approx(0.54)


def test_grey_pair_is_used_if_it_is_the_only_one(tmp_path: Path) -> None:
    path = written(tmp_path, "".join(KITTI.splitlines(keepends=True)[:2]), "calib.txt")
    rig, notes = load_rig(path, size_px=SIZE)
    assert rig.left.fx_px == 700
    assert len(notes) == 2
    assert "cameras, 0 and 1" in notes[0]


def test_kitti_raw_has_the_image_size(tmp_path: Path) -> None:
    text = "S_rect_02: 1.280000e+03 7.200000e+02\nP_rect_02: 1000 0 650 0 0 1000 350 0 0 0 1 0\n"
    camera, notes = load_camera(written(tmp_path, text, "calib.txt"), size_px=(640, 360))
    assert camera.fx_px == 500
    assert "scaled from 1280x720" in notes[0]


@pytest.mark.parametrize(
    ("name", "size_px", "baseline_m"),
    [
        ("kitti_stereo/0003", (1242, 374), 0.53273),
        ("kitti_odometry/gray51", (1226, 370), 0.53715),
        ("kitti2015", (1242, 375), 0.53273),
    ],
)
def test_real_kitti_files(
    shared_data: Path, name: str, size_px: tuple[int, int], baseline_m: float
) -> None:
    rig, _ = load_rig(shared_data / name / "calib.txt", size_px=size_px)
    assert rig.baseline_m == pytest.approx(baseline_m, abs=1e-4)
    assert rig.is_rectified


def test_all_kitti_label_calibrations_are_read(shared_data: Path) -> None:
    paths = sorted((shared_data / "kitti_labels" / "calib").glob("*.txt"))
    assert len(paths) >= 10
    for path in paths:
        assert load_rig(path, size_px=(1242, 375))[0].baseline_m == pytest.approx(0.534, abs=0.005)
        assert left_from_reference_m(path, is_grey=False)[0] == pytest.approx(0.06, abs=0.002)


def test_principal_point_check_without_image_size(tmp_path: Path) -> None:
    path = written(tmp_path, KITTI, "calib.txt")
    load_rig(path, size_px=(1300, 700))
    message = refused(path, size_px=(640, 480))
    assert "(650.0, 350.0)" in message
    assert "640x480" in message


@pytest.mark.parametrize(
    ("text", "key_word"),
    [
        ("P2: 1000 0 640 0 0 1000 360 0 0 0 1 0\n", "P3"),
        ("P0: 1000 0 640 0 0 1000 360 0 0 0 1 0\n", "P1"),
        ("P3: 1000 0 640 0 0 1000 360 0 0 0 1 0\n", "P2"),
        ("P2: 1000 0 640 0 0 1000\n", "found 6"),
        ("P2: 1000 0 640 x 0 1000 360 0 0 0 1 0\n", "640 x"),
        ("P2: 0 0 640 0 0 1000 360 0 0 0 1 0\n", "projection"),
        ("P2: nan 0 640 0 0 1000 360 0 0 0 1 0\n", "projection"),
        (KITTI.replace("-450", "-499950"), "500 m"),
        (KITTI.replace("-450", "50"), "found 0 m"),
        (KITTI.replace("-450", "50").replace("350 3", "350 -500"), "above"),
        (KITTI.replace("-450", "550"), "swap"),
        # also lines that a later one overrides
        ("P2: 1000 0 640\n" + KITTI, "P2: expected 12 numbers, found 3"),
        ("S_rect_02: 0 0\nS_rect_02: 1280 720\n" + KITTI, "S_rect_02: expected a width"),
    ],
)
def test_wrong_kitti_files(tmp_path: Path, text: str, key_word: str) -> None:
    assert key_word in refused(written(tmp_path, text, "calib.txt"))


LEFT_LINE, RIGHT_LINE = (f"1000 0 640 {x} 0 1000 360 0 0 0 1 0\n" for x in (0, -540))


@pytest.mark.parametrize(
    ("text", "line"), [(LEFT_LINE + RIGHT_LINE, 1), ("\n" + RIGHT_LINE + LEFT_LINE, 2)]
)
def test_two_lines_without_names(tmp_path: Path, text: str, line: int) -> None:
    rig, notes = load_rig(written(tmp_path, text), size_px=SIZE)
    assert rig.is_rectified
    assert rig.baseline_m == pytest.approx(0.54)
    assert len(notes) == 2
    assert f"line {line} is the left" in notes[0]


def test_real_lines_without_names(tmp_path: Path, shared_data: Path) -> None:
    text = (shared_data / "kitti_odometry/gray51/calib.txt").read_text()
    nameless = "".join(line.partition(":")[2] + "\n" for line in text.splitlines())
    rig, _ = load_rig(written(tmp_path, nameless), size_px=(1226, 370))
    expected, _ = load_rig(written(tmp_path, text, "named.txt"), size_px=(1226, 370))
    assert (rig.left, rig.baseline_m) == (expected.left, expected.baseline_m)


@pytest.mark.parametrize(
    ("text", "key_word"),
    [
        (LEFT_LINE, "second line"),
        (LEFT_LINE * 2, "baseline"),
        (LEFT_LINE + "1000 0 640 0 0 1000 360 -500 0 0 1 0\n", "above"),
        (LEFT_LINE * 3, "found 3"),
        (LEFT_LINE + RIGHT_LINE.replace("640", "x"), "known format"),
        (LEFT_LINE + RIGHT_LINE.replace("640", "6-40"), "6-40"),
        (LEFT_LINE + "0.9 0 0.1 2 0 1 0 3 -0.1 0 0.9 4\n", "projection"),  # a pose
    ],
)
def test_wrong_lines_without_names(tmp_path: Path, text: str, key_word: str) -> None:
    assert key_word in refused(written(tmp_path, text))


def raw_file(rig: StereoRig) -> str:
    """KITTI raw's calib_cam_to_cam.txt of a pair, where camera 0 is 0.06 m to the right of camera
    2."""
    reference = np.eye(4)
    reference[0, 3] = 0.06
    lines = ["calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.950000e-02"]
    for number, camera, motion, offset in (
        (2, rig.left, reference, 40.0),
        (3, rig.right, rig.right_from_left @ reference, -310.0),
    ):
        lines += [
            f"{key}_0{number}: {' '.join(f'{value:.9e}' for value in np.ravel(values))}"
            for key, values in {
                "S": (camera.width_px, camera.height_px),
                "K": camera.matrix,
                "D": camera.distortion,
                "R": motion[:3, :3],
                "T": motion[:3, 3],
                "S_rect": (1242, 375),
                "R_rect": np.eye(3),
                "P_rect": [700, 0, 610, offset, 0, 700, 173, 0, 0, 0, 1, 0],
            }.items()
        ]
    return "\n".join(lines) + "\n"


def raw_pair() -> StereoRig:
    right_from_left = np.eye(4)
    right_from_left[:3, :3], _ = cv2.Rodrigues(np.array([0.001, -0.02, 0.022]))
    right_from_left[:3, 3] = (-0.53, 0.006, -0.009)
    left = PinholeCamera(960.0, 957.0, 696.0, 224.0, 1392, 512, (-0.37, 0.2, 0.001, 0.0006, -0.07))
    right = PinholeCamera(
        904.0, 902.0, 696.0, 224.0, 1392, 512, (-0.36, 0.18, 0.0006, -0.0004, -0.05)
    )
    return StereoRig(left, right, right_from_left)


def test_raw_file_by_image_size(tmp_path: Path) -> None:
    path = written(tmp_path, raw_file(raw_pair()), "calib_cam_to_cam.txt")
    rig, notes = load_rig(path, size_px=(1242, 375))
    assert rig.is_rectified
    assert rig.baseline_m == pytest.approx(0.5)
    assert len(notes) == 1
    assert "P_rect_02" in notes[0]
    assert left_from_reference_m(path, is_grey=False, size_px=(1242, 375))[0] == pytest.approx(
        40 / 700
    )
    rig, notes = load_rig(path, size_px=(1392, 512))
    assert (rig.left, rig.right) == (raw_pair().left, raw_pair().right)
    assert np.allclose(rig.right_from_left, raw_pair().right_from_left, atol=1e-8)
    assert len(notes) == 1
    assert "1392x512" in notes[0]
    assert not left_from_reference_m(path, is_grey=False, size_px=(1392, 512)).any()
    assert load_rig(path, size_px=(696, 256))[0].left.fx_px == pytest.approx(480)
    assert load_camera(path, size_px=(1392, 512))[0] == raw_pair().left
    assert "aspect" in refused(path, size_px=(640, 480))


@pytest.mark.parametrize(
    ("old", "new", "key_word"),
    [
        ("K_03: ", "K_03: x ", "K_03"),
        ("D_02: ", "D_02: 1 ", "found 6"),
        ("T_03: ", "T_03: 1e99 0 0 #", "T_03"),
        ("S_02: 1.392", "S_02: 0.000", "S_02"),
    ],
)
def test_wrong_raw_files(tmp_path: Path, old: str, new: str, key_word: str) -> None:
    path = written(tmp_path, raw_file(raw_pair()).replace(old, new), "calib_cam_to_cam.txt")
    assert key_word in refused(path, size_px=(1392, 512))


LEFT = "721.5 0 609.5 44.85 0 721.5 172.85 0.2163 0 0 1 0.002745"
RIGHT = "721.5 0 609.5 -339.5 0 721.5 172.85 2.199 0 0 1 0.002729"


@pytest.mark.parametrize(
    "text",
    [
        f"# left and right\n{LEFT} # camera 2\n{RIGHT}\n",
        f"[{LEFT}]\n[{RIGHT}]\n",
        f"{LEFT.replace(' ', ', ')};\n{RIGHT.replace(' ', ', ')};\n",
    ],
)
def test_copied_matrices_with_comments_and_brackets(tmp_path: Path, text: str) -> None:
    rig, _ = load_rig(written(tmp_path, text), size_px=(1242, 375))
    assert rig.baseline_m == pytest.approx((339.5 + 44.85) / 721.5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{LEFT.rpartition(' ')[0]}\n{RIGHT}", "line 1: expected 12 numbers, found 11"),
        (
            f"{LEFT}\n{RIGHT.replace('2.199', 'nan')}",
            "line 2: expected a projection matrix of 12 finite numbers",
        ),
        (
            "R_02: 1 0 0 0 1 0 0 0 1\nT_02: 0 0 0\n",
            "expected the projection matrices P_rect_02 and P_rect_03",
        ),
    ],
)
def test_damaged_lines_without_names(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(RigError, match=message):
        load_rig(written(tmp_path, text), size_px=(1242, 375))
