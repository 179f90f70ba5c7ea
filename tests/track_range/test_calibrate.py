"""`calibrate` end to end on drawn boards: known cameras found, files written, bad input named in one sentence."""

from __future__ import annotations

import dataclasses
import json
import shutil

import cv2
import numpy as np
import pytest

from tests.stereo.board_scenes import CAMERA, drawn, pose, rig, varied_poses
from track_range.stereo.calibration.boards import CharucoBoard
from track_range.stereo.rig_formats.reading import load_calibration, load_camera, load_rig

TRUE = rig()
N = 8
CHARUCO = CharucoBoard(8, 6, 0.04, 0.03)


@pytest.fixture(scope="module")
def boards(tmp_path_factory):
    """left0.png .. left7.png and right0.png ..: squares of 30 mm, 9x6 corners."""
    folder = tmp_path_factory.mktemp("boards")
    for i, at in enumerate(varied_poses(N, seed=3)):
        cv2.imwrite(str(folder / f"left{i}.png"), drawn(TRUE.left, at, seed=i))
        cv2.imwrite(str(folder / f"right{i}.png"), drawn(TRUE.right, TRUE.right_from_left @ at, seed=50 + i))
    return folder


@pytest.fixture
def copied(boards, tmp_path):
    return shutil.copytree(boards, tmp_path / "boards")


def one_sentence(told: tuple[int, str, str], status: int = 1) -> str:
    assert told[0] == status, told
    assert told[2].count("\n") == 1, told[2]
    return told[2]


def test_one_camera(boards, tmp_path, cli):
    out, figures = tmp_path / "new" / "rig.yaml", tmp_path / "f.json"
    status, told, complaint = cli(
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
    assert status == 0, complaint
    assert "Board found in 8 of 8 images." in told
    assert "Warning: only 8 views: 15 to 30 are good." in told
    camera, _ = load_camera(out, size_px=(640, 360))
    read = json.loads(figures.read_text())
    assert camera.fx_px == read["camera"]["fx_px"]
    assert abs(camera.fx_px - CAMERA.fx_px) < 3 * read["camera"]["sd"]["fx_px"]
    assert camera.fx_px == pytest.approx(CAMERA.fx_px, rel=0.01)
    assert len(camera.distortion) == 5
    assert (read["board"], read["square_mm"], len(read["views"]), read["rejected"]) == ("9x6", 30.0, 8, [])
    assert 0.02 < read["rms_px"] < 0.12
    assert {"name", "rms_px", "x", "y", "size", "skew", "tilt_deg", "edge_px"} <= set(read["views"][0])
    picture = cv2.imread(str(out.with_suffix(".png")))
    assert picture is not None
    assert picture.shape[1] > 1000
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 50  # arrows, shades, bars, words


def test_a_pair(boards, tmp_path, cli):
    out, figures, picture = tmp_path / "rig.yaml", tmp_path / "f.json", tmp_path / "p.png"
    status, told, complaint = cli(
        "calibrate", "--stereo", boards / "left*.png", boards / "right*.png", "--board", "9x6", "--square-mm", 30,
        "--out", out, "--json", figures, "--picture", picture, "--lens-terms", 4,
    )  # fmt: skip
    assert status == 0, complaint
    found, _ = load_rig(out, size_px=(640, 360))
    read = json.loads(figures.read_text())
    assert found.baseline_m == pytest.approx(TRUE.baseline_m, rel=0.005)
    assert read["baseline_m"] == pytest.approx(found.baseline_m)
    assert 0 < read["baseline_sd_m"] < 0.002
    assert read["rows_px"] < 0.1
    assert read["held_out_rows_px"] < 0.15
    assert "Rows after rectification differ by" in told
    assert len(found.left.distortion) == 4
    assert cv2.imread(str(picture)).shape[0] > 1000  # both eyes
    assert not out.with_suffix(".png").exists()
    assert read["views"][0]["right_name"] == "right0.png"


def test_a_charuco_board(tmp_path, cli):
    for i, at in enumerate(varied_poses(7, seed=1, board=CHARUCO)):
        cv2.imwrite(str(tmp_path / f"c{i}.png"), drawn(CAMERA, at, board=CHARUCO, seed=i))
    out = tmp_path / "rig.yaml"
    status, told, complaint = cli(
        "calibrate", "--mono", tmp_path / "c*.png", "--board", "charuco:8x6:40:30", "--out", out
    )
    assert status == 0, complaint
    assert "Board found in 7 of 7 images." in told
    assert load_camera(out, size_px=(640, 360))[0].fx_px == pytest.approx(CAMERA.fx_px, rel=0.015)
    for board, said in (
        ("charuco:8x6:40:30:5X5_50", "their markers are of the dictionary 4X4_50"),
        ("charuco:6x9:40:30", "there are markers of 4X4_50: check the numbers of squares"),
    ):
        told = cli("calibrate", "--mono", tmp_path / "c*.png", "--board", board, "--out", out)
        assert said in one_sentence(told)


def test_bad_views_are_left_out_and_named(copied, tmp_path, cli):
    grey = cv2.imread(str(copied / "left7.png"))
    cv2.imwrite(str(copied / "left7.png"), cv2.copyMakeBorder(grey, 0, 1, 0, 2, cv2.BORDER_REPLICATE))
    cv2.imwrite(str(copied / "left90.png"), cv2.GaussianBlur(cv2.imread(str(copied / "left1.png")), (0, 0), 3))
    cv2.imwrite(str(copied / "left91.png"), cv2.resize(grey, None, fx=2, fy=2))
    cv2.imwrite(str(copied / "left92.png"), np.full((360, 640), 90, np.uint8))
    (copied / "left93.png").write_bytes(b"no image")
    figures = tmp_path / "f.json"
    status, told, _ = cli(
        "calibrate", "--mono", copied / "left*.png", "--board", "9x6", "--square-mm", 30, "--out", tmp_path / "r.yaml",
        "--json", figures,
    )  # fmt: skip
    assert status == 0
    assert "Board found in 8 of 12 images." in told
    assert "Cut to the others' 640x360 px at their right and lower edges: left7.png." in told
    reasons = {each["name"]: each["reason"] for each in json.loads(figures.read_text())["rejected"]}
    assert reasons["left90.png"].startswith("blurred: its edges are ")
    assert reasons["left91.png"] == "1280x720 px, where most have 640x360 px"
    assert reasons["left92.png"] == "no whole board found"
    assert reasons["left93.png"] == "not an image, or a damaged one"
    assert "Left out: left92.png: no whole board found." in told


def test_pairs_without_a_partner_are_left_out(copied, tmp_path, cli):
    (copied / "right2.png").unlink()
    cv2.imwrite(str(copied / "left5.png"), np.full((360, 640), 90, np.uint8))
    status, told, _ = cli(
        "calibrate", "--stereo", copied / "left*.png", copied / "right*.png", "--board", "9x6", "--square-mm", 30,
        "--out", tmp_path / "rig.yaml",
    )  # fmt: skip
    assert status == 0
    assert "Left out: left2.png: the other eye's image is missing." in told
    assert "Left out: left5.png: no whole board found." in told
    assert "Board found in 6 of 7 pairs." in told


def test_the_odd_one_of_two_cameras_of_different_sizes(boards, tmp_path, cli):
    """Files of both eyes are called alike, and the odd one has the other eye's size."""
    for eye in ("left", "right"):
        (tmp_path / eye).mkdir()
        for i in range(6):
            image = cv2.imread(str(boards / f"{eye}{i}.png"))
            if eye == "right" and i != 3:
                image = cv2.resize(image, (480, 270), interpolation=cv2.INTER_AREA)
            cv2.imwrite(str(tmp_path / eye / f"{i}.png"), image)
    status, told, complaint = cli(
        "calibrate", "--stereo", tmp_path / "left", tmp_path / "right", "--board", "9x6", "--square-mm", 30,
        "--out", tmp_path / "rig.yaml", "--lens-terms", 4,
    )  # fmt: skip
    assert status == 0, complaint
    assert "Left out: right/3.png: 640x360 px, where most have 480x270 px." in told
    found, _ = load_calibration(tmp_path / "rig.yaml")
    assert (found.left.width_px, found.right.width_px) == (640, 480)
    assert "differ in size (480x270 px, 640x360 px)" in told
    assert found.baseline_m == pytest.approx(TRUE.baseline_m, rel=0.02)


def test_a_film(tmp_path, cli, film):
    images = []
    for i, at in enumerate(varied_poses(9, seed=4)):
        grey = drawn(CAMERA, at, seed=i)
        images += [grey, cv2.GaussianBlur(grey, (0, 0), 4), np.full_like(grey, 99)]
    coloured = [cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR) for grey in images]
    path = film(tmp_path / "film.mp4", [i * 0.25 for i in range(len(images))], images=coloured, options={})
    out = tmp_path / "rig.yaml"
    status, told, complaint = cli("calibrate", "--mono", path, "--board", "9x6", "--square-mm", 30, "--out", out)
    assert status == 0, complaint
    assert "Board found in 9 of 27 images." in told
    assert "film.mp4 at 2.00 s" in told.split(": no whole board found.")[0]
    assert "film.mp4 at 1.00 s" in told.split(": blurred.")[0]
    assert load_camera(out, size_px=(640, 360))[0].fx_px == pytest.approx(CAMERA.fx_px, rel=0.02)


@pytest.mark.parametrize("board", ["8x6", "9x5", "9x7", "10x7"])
def test_a_board_that_is_counted_wrongly(boards, tmp_path, cli, board):
    out = tmp_path / "rig.yaml"
    told = cli("calibrate", "--mono", boards / "left*.png", "--board", board, "--square-mm", 30, "--out", out)
    said = one_sentence(told)
    assert f"show a board of 9x6 inner corners, not {board}; give --board 9x6" in said
    assert not out.exists()


def test_eyes_swapped_and_upside_down(copied, tmp_path, cli):
    def stereo(left, right):
        return cli(
            "calibrate", "--stereo", copied / left, copied / right, "--board", "9x6", "--square-mm", 30, "--out",
            tmp_path / "rig.yaml",
        )  # fmt: skip

    assert "left and right are swapped" in one_sentence(stereo("right*.png", "left*.png"))
    for path in copied.glob("right*.png"):
        cv2.imwrite(str(path), cv2.rotate(cv2.imread(str(path)), cv2.ROTATE_180))
    assert "one eye is upside down against the other" in one_sentence(stereo("left*.png", "right*.png"))


def test_sets_without_what_is_needed(boards, copied, tmp_path, cli):
    for folder, said in (
        ("blank", "no board of 9x6 inner corners found in any of 3 images"),
        ("few", "found in 3 views only"),
    ):
        (tmp_path / folder).mkdir()
        for i in range(3):
            target = tmp_path / folder / f"{i}.png"
            if folder == "few":
                shutil.copy(boards / f"left{i}.png", target)
            else:
                cv2.imwrite(str(target), np.full((360, 640), 90, np.uint8))
        told = cli(
            "calibrate", "--mono", tmp_path / folder, "--board", "9x6", "--square-mm", 30, "--out", tmp_path / "r"
        )
        assert said in one_sentence(told)
    (tmp_path / "nothing").mkdir()
    cv2.imwrite(str(tmp_path / "nothing" / "1.png"), np.full((360, 640), 90, np.uint8))
    told = cli("calibrate", "--mono", tmp_path / "nothing", "--board", "charuco:5x7:40:20", "--out", tmp_path / "r")
    assert "in any of 1 image, nor any ArUco marker" in one_sentence(told)


def test_squares_that_make_an_odd_scene_are_doubted(tmp_path, cli):
    plain = dataclasses.replace(CAMERA, distortion=())
    tilts = ((30, 0, 0), (-30, 0, 0), (0, 30, 0), (0, -30, 0), (25, 25, 0), (0, 0, 10))
    for i, tilt in enumerate(tilts):
        soft = cv2.GaussianBlur(drawn(plain, pose(tilt, (0, 0, 0.5)), seed=i), (0, 0), 2.5)
        cv2.imwrite(str(tmp_path / f"{i}.png"), soft)
    status, told, complaint = cli(
        "calibrate", "--mono", tmp_path / "*.png", "--board", "9x6", "--square-mm", 3, "--out", tmp_path / "rig.yaml",
        "--lens-terms", 0,
    )  # fmt: skip
    assert status == 0, complaint
    assert "Warning: the boards stand 0.0" in told
    assert "Warning: most images are out of focus" in told


def test_wrong_usage(boards, tmp_path, cli):
    out = ("--out", tmp_path / "rig.yaml")
    mono = ("--mono", boards / "left*.png")
    for options, said in (
        ((*out, "--board", "9x6", "--square-mm", 20), "give --mono IMAGES, or --stereo LEFT RIGHT"),
        ((*out, *mono, "--stereo", "a", "b", "--board", "9x6"), "give --mono IMAGES, or --stereo LEFT RIGHT"),
        ((*out, *mono, "--board", "nine"), "'nine' is no board"),
        ((*out, *mono, "--board", "9x6"), "--square-mm 20"),
        ((*out, *mono, "--board", "9x6", "--square-mm", 0.03), "squares of 0.03 mm are not plausible"),
        (
            (*out, *mono, "--board", "9x6", "--square-mm", 30, "--lens-terms", 6),
            "--lens-terms 6: expected one of 0, 4, 5, 8",
        ),
    ):
        assert said in one_sentence(cli("calibrate", *options), status=2)


def test_places_that_cannot_be_written(boards, tmp_path, cli):
    (tmp_path / "file").write_text("")
    before = (boards / "left3.png").read_bytes()
    for out, said in (
        (tmp_path, "it is a folder; name a file in it"),
        (".", "it is a folder; name a file in it"),
        (tmp_path / "file" / "rig.yaml", "no results can be"),
        (tmp_path / "rig.png", "rig.png is to be written twice"),
        (boards / "left3.yaml", "left3.png is an input or a result and would be overwritten"),
    ):
        told = cli("calibrate", "--mono", boards / "left*.png", "--board", "9x6", "--square-mm", 30, "--out", out)
        assert said in one_sentence(told)
    assert (boards / "left3.png").read_bytes() == before


def test_images_that_are_not_there(tmp_path, cli):
    told = cli("calibrate", "--mono", tmp_path / "*.png", "--board", "9x6", "--square-mm", 30, "--out", tmp_path / "r")
    assert "no image has such a name" in one_sentence(told)
