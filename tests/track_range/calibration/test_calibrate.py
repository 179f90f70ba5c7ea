"""End-to-end tests of `track-range calibrate` on drawn boards: known cameras, written files,
invalid input."""

from __future__ import annotations

import dataclasses
import json
import shutil

import cv2
import numpy as np
import pytest

from tests.support.images.board_scenes import CAMERA, drawn, pose, rig, varied_poses
from track_range.stereo.calibration.boards import CharucoBoard
from track_range.stereo.rig_formats.reading import (
    load_calibration,
    load_camera,
    load_rig,
    read_calibration,
)

TRUE = rig()
N = 8
CHARUCO = CharucoBoard(8, 6, 0.04, 0.03)


@pytest.fixture(scope="module")
def boards(tmp_path_factory):
    """Folder with left0.png .. left7.png and right0.png .. right7.png of a board of 9x6 corners,
    squares of 30 mm."""
    folder = tmp_path_factory.mktemp("boards")
    for i, board_pose in enumerate(varied_poses(N, seed=3)):
        cv2.imwrite(str(folder / f"left{i}.png"), drawn(TRUE.left, board_pose, seed=i))
        cv2.imwrite(
            str(folder / f"right{i}.png"),
            drawn(TRUE.right, TRUE.right_from_left @ board_pose, seed=50 + i),
        )
    return folder


@pytest.fixture
def copied(boards, tmp_path):
    return shutil.copytree(boards, tmp_path / "boards")


def error_line(outcome: tuple[int, str, str], status: int = 1) -> str:
    """The one line of the error output of a command that failed with `status`."""
    assert outcome[0] == status, outcome
    assert outcome[2].count("\n") == 1, outcome[2]
    return outcome[2]


@pytest.mark.slow
def test_one_camera(boards, tmp_path, cli):
    out, figures = tmp_path / "new" / "rig.yaml", tmp_path / "f.json"
    status, printed, errors = cli(
        "calibrate",
        "--mono",
        boards / "left*.png",
        "--board",
        "9x6",
        "--square-mm",
        30,
        "--out",
        out,
        "--json",
        figures,
    )
    assert status == 0, errors
    assert "8 of 8 images" in printed
    assert "Warning: only 8 views" in printed
    camera, _ = load_camera(out, size_px=(640, 360))
    read = json.loads(figures.read_text())
    assert camera.fx_px == read["camera"]["fx_px"]
    assert abs(camera.fx_px - CAMERA.fx_px) < 3 * read["camera"]["sd"]["fx_px"]
    assert camera.fx_px == pytest.approx(CAMERA.fx_px, rel=0.01)
    assert len(camera.distortion) == 5
    assert (read["board"], read["square_mm"], len(read["views"]), read["rejected"]) == (
        "9x6",
        30.0,
        8,
        [],
    )
    assert 0.02 < read["rms_px"] < 0.12
    assert {"name", "rms_px", "x", "y", "size", "skew", "tilt_deg", "edge_px"} <= set(
        read["views"][0]
    )
    picture = cv2.imread(str(out.with_suffix(".png")))
    assert picture is not None
    assert picture.shape[1] > 1000
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 50  # arrows, shades, bars, text


@pytest.mark.slow
def test_pair(boards, tmp_path, cli):
    out, figures, picture = tmp_path / "rig.yaml", tmp_path / "f.json", tmp_path / "p.png"
    status, printed, errors = cli(
        "calibrate", "--stereo", boards / "left*.png", boards / "right*.png", "--board", "9x6", "--square-mm", 30,
        "--out", out, "--json", figures, "--picture", picture, "--lens-terms", 4,
    )  # fmt: skip
    assert status == 0, errors
    calibrated, _ = load_rig(out, size_px=(640, 360))
    read = json.loads(figures.read_text())
    assert calibrated.baseline_m == pytest.approx(TRUE.baseline_m, rel=0.005)
    assert read["baseline_m"] == pytest.approx(calibrated.baseline_m)
    assert 0 < read["baseline_sd_m"] < 0.002
    accuracy = read_calibration(out, is_grey=False, is_pair=True).accuracy
    assert accuracy.scale_sigma == pytest.approx(read["scale_sigma"], rel=0.01)
    assert 1e-5 < accuracy.focal_sigma < 0.005
    assert abs(
        calibrated.left.fx_px * calibrated.baseline_m / (TRUE.left.fx_px * TRUE.baseline_m) - 1
    ) < max(3 * accuracy.scale_sigma, 1e-3)
    assert read["rows_px"] < 0.1
    assert read["held_out_rows_px"] < 0.15
    assert "rectification" in printed
    assert len(calibrated.left.distortion) == 4
    assert cv2.imread(str(picture)).shape[0] > 1000  # both cameras
    assert not out.with_suffix(".png").exists()
    assert read["views"][0]["right_name"] == "right0.png"


@pytest.mark.slow
def test_charuco_board(tmp_path, cli):
    for i, board_pose in enumerate(varied_poses(7, seed=1, board=CHARUCO)):
        cv2.imwrite(str(tmp_path / f"c{i}.png"), drawn(CAMERA, board_pose, board=CHARUCO, seed=i))
    out = tmp_path / "rig.yaml"
    status, printed, errors = cli(
        "calibrate", "--mono", tmp_path / "c*.png", "--board", "charuco:8x6:40:30", "--out", out
    )
    assert status == 0, errors
    assert "7 of 7 images" in printed
    assert load_camera(out, size_px=(640, 360))[0].fx_px == pytest.approx(CAMERA.fx_px, rel=0.015)
    for board, words in (
        ("charuco:8x6:40:30:5X5_50", "dictionary 4X4_50"),
        ("charuco:6x9:40:30", "numbers of squares"),
    ):
        outcome = cli("calibrate", "--mono", tmp_path / "c*.png", "--board", board, "--out", out)
        assert words in error_line(outcome)


@pytest.mark.slow
def test_bad_views_are_rejected(copied, tmp_path, cli):
    grey = cv2.imread(str(copied / "left7.png"))
    cv2.imwrite(
        str(copied / "left7.png"), cv2.copyMakeBorder(grey, 0, 1, 0, 2, cv2.BORDER_REPLICATE)
    )
    cv2.imwrite(
        str(copied / "left90.png"),
        cv2.GaussianBlur(cv2.imread(str(copied / "left1.png")), (0, 0), 3),
    )
    cv2.imwrite(str(copied / "left91.png"), cv2.resize(grey, None, fx=2, fy=2))
    cv2.imwrite(str(copied / "left92.png"), np.full((360, 640), 90, np.uint8))
    (copied / "left93.png").write_bytes(b"no image")
    figures = tmp_path / "f.json"
    status, printed, _ = cli(
        "calibrate", "--mono", copied / "left*.png", "--board", "9x6", "--square-mm", 30, "--out", tmp_path / "r.yaml",
        "--json", figures,
    )  # fmt: skip
    assert status == 0
    assert "8 of 12 images" in printed
    assert "640x360 px at the right and lower edges: left7.png" in printed
    reasons = {view["name"]: view["reason"] for view in json.loads(figures.read_text())["rejected"]}
    assert "blurred" in reasons["left90.png"]
    assert "1280x720 px" in reasons["left91.png"]
    assert "board" in reasons["left92.png"]
    assert "damaged" in reasons["left93.png"]
    assert "left92.png: " in printed


@pytest.mark.slow
def test_images_without_a_partner_are_rejected(copied, tmp_path, cli):
    (copied / "right2.png").unlink()
    cv2.imwrite(str(copied / "left5.png"), np.full((360, 640), 90, np.uint8))
    status, printed, _ = cli(
        "calibrate", "--stereo", copied / "left*.png", copied / "right*.png", "--board", "9x6", "--square-mm", 30,
        "--out", tmp_path / "rig.yaml",
    )  # fmt: skip
    assert status == 0
    assert "left2.png: the other camera" in printed
    assert "left5.png: no " in printed
    assert "6 of 7 pairs" in printed


@pytest.mark.slow
def test_cameras_of_different_image_size(boards, tmp_path, cli):
    """Left and right files have the same names, and one right image has the left camera's size."""
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        for i in range(6):
            image = cv2.imread(str(boards / f"{side}{i}.png"))
            if side == "right" and i != 3:
                image = cv2.resize(image, (480, 270), interpolation=cv2.INTER_AREA)
            cv2.imwrite(str(tmp_path / side / f"{i}.png"), image)
    status, printed, errors = cli(
        "calibrate", "--stereo", tmp_path / "left", tmp_path / "right", "--board", "9x6", "--square-mm", 30,
        "--out", tmp_path / "rig.yaml", "--lens-terms", 4,
    )  # fmt: skip
    assert status == 0, errors
    assert "right/3.png: 640x360 px" in printed
    calibrated, _ = load_calibration(tmp_path / "rig.yaml")
    assert (calibrated.left.width_px, calibrated.right.width_px) == (640, 480)
    assert "480x270 px, 640x360 px" in printed
    assert calibrated.baseline_m == pytest.approx(TRUE.baseline_m, rel=0.02)


@pytest.mark.slow
def test_video(tmp_path, cli, film):
    images = []
    for i, board_pose in enumerate(varied_poses(9, seed=4)):
        grey = drawn(CAMERA, board_pose, seed=i)
        images += [grey, cv2.GaussianBlur(grey, (0, 0), 4), np.full_like(grey, 99)]
    coloured = [cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR) for grey in images]
    path = film(
        tmp_path / "film.mp4", [i * 0.25 for i in range(len(images))], images=coloured, options={}
    )
    out = tmp_path / "rig.yaml"
    status, printed, errors = cli(
        "calibrate", "--mono", path, "--board", "9x6", "--square-mm", 30, "--out", out
    )
    assert status == 0, errors
    assert "9 of 27 images" in printed
    assert "film.mp4 at 2.00 s" in printed
    assert "film.mp4 at 1.00 s" in printed.split(": blurred")[0]
    assert load_camera(out, size_px=(640, 360))[0].fx_px == pytest.approx(CAMERA.fx_px, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("board", ["8x6", "9x5", "9x7", "10x7"])
def test_wrong_number_of_corners(boards, tmp_path, cli, board):
    out = tmp_path / "rig.yaml"
    outcome = cli(
        "calibrate",
        "--mono",
        boards / "left*.png",
        "--board",
        board,
        "--square-mm",
        30,
        "--out",
        out,
    )
    assert "--board 9x6" in error_line(outcome)
    assert not out.exists()


@pytest.mark.slow
def test_cameras_swapped_and_upside_down(copied, tmp_path, cli):
    def stereo(left, right):
        return cli(
            "calibrate", "--stereo", copied / left, copied / right, "--board", "9x6", "--square-mm", 30, "--out",
            tmp_path / "rig.yaml",
        )  # fmt: skip

    assert "swap" in error_line(stereo("right*.png", "left*.png"))
    for path in copied.glob("right*.png"):
        cv2.imwrite(str(path), cv2.rotate(cv2.imread(str(path)), cv2.ROTATE_180))
    assert "upside down" in error_line(stereo("left*.png", "right*.png"))


def test_sets_without_enough_views(boards, copied, tmp_path, cli):
    for folder, words in (("blank", "9x6"), ("few", "found it in 3")):
        (tmp_path / folder).mkdir()
        for i in range(3):
            target = tmp_path / folder / f"{i}.png"
            if folder == "few":
                shutil.copy(boards / f"left{i}.png", target)
            else:
                cv2.imwrite(str(target), np.full((360, 640), 90, np.uint8))
        outcome = cli(
            "calibrate",
            "--mono",
            tmp_path / folder,
            "--board",
            "9x6",
            "--square-mm",
            30,
            "--out",
            tmp_path / "r",
        )
        assert words in error_line(outcome)
    (tmp_path / "nothing").mkdir()
    cv2.imwrite(str(tmp_path / "nothing" / "1.png"), np.full((360, 640), 90, np.uint8))
    outcome = cli(
        "calibrate",
        "--mono",
        tmp_path / "nothing",
        "--board",
        "charuco:5x7:40:20",
        "--out",
        tmp_path / "r",
    )
    assert "ArUco" in error_line(outcome)


@pytest.mark.slow
def test_warnings_about_square_size_and_focus(tmp_path, cli):
    plain = dataclasses.replace(CAMERA, distortion=())
    tilts = ((30, 0, 0), (-30, 0, 0), (0, 30, 0), (0, -30, 0), (25, 25, 0), (0, 0, 10))
    for i, tilt in enumerate(tilts):
        soft = cv2.GaussianBlur(drawn(plain, pose(tilt, (0, 0, 0.5)), seed=i), (0, 0), 2.5)
        cv2.imwrite(str(tmp_path / f"{i}.png"), soft)
    status, printed, errors = cli(
        "calibrate", "--mono", tmp_path / "*.png", "--board", "9x6", "--square-mm", 3, "--out", tmp_path / "rig.yaml",
        "--lens-terms", 0,
    )  # fmt: skip
    assert status == 0, errors
    assert "--square-mm" in printed
    assert "out of focus" in printed


def test_wrong_usage(boards, tmp_path, cli):
    out = ("--out", tmp_path / "rig.yaml")
    mono = ("--mono", boards / "left*.png")
    for options, word in (
        ((*out, "--board", "9x6", "--square-mm", 20), "--mono"),
        ((*out, *mono, "--stereo", "a", "b", "--board", "9x6"), "--mono"),
        ((*out, *mono, "--board", "nine"), "nine"),
        ((*out, *mono, "--board", "9x6"), "--square-mm"),
        ((*out, *mono, "--board", "9x6", "--square-mm", 0.03), "0.03 mm"),
        ((*out, *mono, "--board", "9x6", "--square-mm", 30, "--lens-terms", 6), "--lens-terms"),
        ((*out, *mono, "--board", "9x6", "--square-mm", 30, "--lens", "wide"), "--lens wide"),
        (
            (
                *out,
                *mono,
                "--board",
                "9x6",
                "--square-mm",
                30,
                "--lens",
                "fisheye",
                "--lens-terms",
                4,
            ),
            "--lens pinhole",
        ),
    ):
        assert word in error_line(cli("calibrate", *options), status=2)


def test_invalid_output_paths(boards, tmp_path, cli):
    (tmp_path / "file").write_text("")
    before = (boards / "left3.png").read_bytes()
    for out, word in (
        (tmp_path, "folder"),
        (".", "folder"),
        (tmp_path / "file" / "rig.yaml", "found a file"),
        (tmp_path / "rig.png", "two outputs"),
        (boards / "left3.yaml", "left3.png"),
    ):
        outcome = cli(
            "calibrate",
            "--mono",
            boards / "left*.png",
            "--board",
            "9x6",
            "--square-mm",
            30,
            "--out",
            out,
        )
        assert word in error_line(outcome)
    assert (boards / "left3.png").read_bytes() == before


def test_no_matching_image(tmp_path, cli):
    options = ("--board", "9x6", "--square-mm", 30, "--out", tmp_path / "r")
    assert "*.png: no image" in error_line(cli("calibrate", "--mono", tmp_path / "*.png", *options))
