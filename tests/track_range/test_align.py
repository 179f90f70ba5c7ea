"""`align` from the command line: a simulated drive, its labels, tables by hand, KITTI's data, and what can be wrong."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from track_range.detection.formats.kitti import read_kitti
from track_range.simulation.drive import write_drive
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.stereo.alignment.file import load_alignment
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.reading import load_rig
from track_range.stereo.rig_formats.rig_yaml import save_rig

SIZE_PX = (620, 188)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    write_drive(folder, seed=0, seconds=1.3, rig=kitti_like_rig(width_px=SIZE_PX[0], height_px=SIZE_PX[1]))
    return folder


@pytest.fixture
def videos(drive):
    return "--stereo", drive / "left.mp4", drive / "right.mp4"


def near_boxes(drive):
    """Frame, box and id of the cars that are whole and near, with the depth of their middles."""
    labels = read_kitti(drive / "truth.txt")
    clear = (labels.kitti_type == "Car") & (labels.truncated == 0) & (labels.occluded == 0)
    clear &= labels.location_m[:, 2] < 40
    return labels.frame[clear], labels.xyxy_px[clear], labels.track_id[clear], labels.location_m[clear, 2]


def test_a_drive_without_error_is_left_alone(videos, tmp_path, cli):
    out, figures = tmp_path / "align.yaml", tmp_path / "figures.json"
    status, told, _ = cli("align", *videos, "--out", out, "--json", figures)
    assert status == 0
    assert "Alignment: no clear error of the disparities, +- 0.0" in told
    assert f"Written to {out}" in told
    read = json.loads(figures.read_text())
    assert read["is_clear"] is False
    assert abs(read["measured"]["offset_px"]) < 2 * read["measured"]["offset_sigma_px"] < 0.2
    assert (read["alignment"]["offset_px"], read["alignment"]["bow_px"]) == (0.0, 0.0)
    assert load_alignment(out).residual_px == read["alignment"]["residual_px"]


def test_two_drives_are_put_together(drive, tmp_path, cli):
    figures = tmp_path / "figures.json"
    options = ("--drive", drive, "--drive", drive, "--out", tmp_path / "align.yaml", "--json", figures)
    status, told, _ = cli("align", *options)
    assert status == 0
    assert f"(from {drive.name}, {drive.name}, 26 frames)" in told  # the file may be used for another one


def test_labels_of_a_drive_and_of_its_folder_say_the_same(drive, videos, tmp_path, cli):
    by_folder, by_file = tmp_path / "folder.yaml", tmp_path / "file.yaml"
    assert cli("align", "--reference", drive, "--out", by_folder)[0] == 0
    assert cli("align", "--reference", drive / "truth.csv", *videos, "--out", by_file)[0] == 0
    folder, file = load_alignment(by_folder), load_alignment(by_file)
    assert abs(folder.offset_px) < 0.1
    assert file.offset_px == pytest.approx(folder.offset_px, abs=0.1)  # they differ in the range of distances


def test_a_table_of_disparities_half_a_pixel_off(drive, videos, tmp_path, cli):
    rig, _ = load_rig(drive / "rig.yaml", size_px=SIZE_PX)
    frame, box, number, depth_m = near_boxes(drive)
    front_px = rig.left.fx_px * rig.baseline_m / (depth_m - 2.0)
    assert len(frame) > 10
    rows = [[*row] for row in np.column_stack([frame, box, front_px + 2.0, number]).tolist()]
    table = tmp_path / "known.CSV"
    table.write_text("frame,x1,y1,x2,y2,disparity_px,id\n" + "\n".join(",".join(map(str, row)) for row in rows))
    out = tmp_path / "align.yaml"
    status, _, complained = cli("align", "--reference", table, *videos, "--out", out)
    assert status == 0, complained
    far = load_alignment(out).offset_px
    table.write_text(
        "frame,x1,y1,x2,y2,distance_m,id\n"
        + "\n".join(",".join(map(str, [*row[:5], rig.left.fx_px * rig.baseline_m / row[5], row[6]])) for row in rows)
    )
    assert cli("align", "--reference", table, *videos, "--out", out)[0] == 0
    assert load_alignment(out).offset_px == pytest.approx(far, abs=0.05)
    assert 1.0 < far < 3.0


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("1,2,3\n", "frame,x1,y1,x2,y2 and either distance_m or disparity_px"),
        ("frame,x1,y1,x2,y2\n0,1,2,3,4\n", "a header and rows of"),
        ("frame,x1,y1,x2,y2,distance_m,disparity_px\n0,1,2,3,4,5,6\n", "a header and rows of"),
        ("frame,x1,y1,x2,y2,distance_m\n0,1,2,3,4,far\n", "line 2: expected a finite number for distance_m"),
        ("frame,x1,y1,x2,y2,distance_m\n0,1,2,3,4,nan\n", "line 2: expected a finite number for distance_m"),
        ("frame,x1,y1,x2,y2,distance_m\n0,1,2,3,4,-5\n", "expected 0.1 .. 10000 for distance_m"),
        ("frame,x1,y1,x2,y2,disparity_px\n0,1,2,3,4,1e-320\n", "expected 0.01 .. 10000 for disparity_px"),
        ("frame,x1,y1,x2,y2,distance_m\n1e300,1,2,3,4,5\n", "a whole number from 0 for frame"),
        ("frame,x1,y1,x2,y2,distance_m,id\n0,1,2,3,4,5,1e300\n", "a whole number from -1 for id"),
        ("frame,x1,y1,x2,y2,distance_m\n0.5,1,2,3,4,5\n", "a whole number from 0 for frame"),
        ("frame,x1,y1,x2,y2,distance_m\n900,1,2,3,4,5\n", "none of its objects is in a frame of the videos"),
        ("frame,x1,y1,x2,y2,distance_m\n0,100,20,160,60,9\n", "at least 5 objects of known distance"),
        ("frame,x1,y1,x2,y2,distance_m\n0,1,2\n", "expected a finite number"),
    ],
)
def test_tables_that_are_wrong(videos, tmp_path, cli, text, complaint):
    table = tmp_path / "known.csv"
    table.write_text(text)
    status, _, complained = cli("align", "--reference", table, *videos, "--out", tmp_path / "align.yaml")
    assert status == 1
    assert complaint in complained
    assert not (tmp_path / "align.yaml").exists()


def test_a_table_that_is_no_text(videos, tmp_path, cli):
    table = tmp_path / "known.csv"
    table.write_bytes(b"\xff\xfe\x00")
    status, _, complained = cli("align", "--reference", table, *videos, "--out", tmp_path / "align.yaml")
    assert (status, "cannot be read as CSV" in complained) == (1, True)


@pytest.mark.parametrize(
    ("options", "status", "complaint"),
    [
        ((), 2, "nothing to align by: give --stereo LEFT RIGHT, --drive DIR or --reference DIR|FILE"),
        (("--reference", "{drive}", "--drive", "{drive}"), 2, "give --reference or --drive, not both"),
        (("--reference", "{drive}/truth.txt"), 2, "give them with --stereo LEFT RIGHT"),
        (("--reference", "{drive}", "--stereo", "{drive}/left.mp4", "{drive}/right.mp4"), 2, "leave --stereo out"),
        (("--reference", "{drive}/none.csv"), 1, "there is no such file or folder"),
        (("--drive", "{drive}/none"), 1, "there is no such file or folder"),
        (("--stereo", "{drive}/right.mp4", "{drive}/left.mp4"), 1, "left and right are swapped"),
    ],
)
def test_what_can_be_asked_wrongly(drive, tmp_path, cli, options, status, complaint):
    filled = [option.format(drive=drive) for option in options]
    ended, _, complained = cli("align", *filled, "--out", tmp_path / "align.yaml")
    assert ended == status, complained
    assert complaint in complained


def test_without_a_rig_or_with_another_one(drive, videos, tmp_path, cli):
    alone = tmp_path / "alone"
    alone.mkdir()
    for side in ("left", "right"):
        shutil.copy(drive / f"{side}.mp4", alone)
    out = ("--out", tmp_path / "align.yaml")
    status, _, complained = cli("align", "--drive", alone, *out)
    assert (status, "give the cameras with --rig FILE" in complained) == (1, True)
    assert cli("align", "--drive", alone, "--rig", drive / "rig.yaml", *out)[0] == 0
    rig, _ = load_rig(drive / "rig.yaml", size_px=SIZE_PX)
    save_rig(StereoRig.rectified(rig.left, 0.4), alone / "rig.yaml")
    status, _, complained = cli("align", "--drive", alone, "--drive", drive, *out)
    assert (status, "the drives are of different rigs" in complained) == (1, True)


def test_a_drive_too_short_writes_nothing(tmp_path, cli):
    short = tmp_path / "short"
    write_drive(short, seconds=0.4, rig=kitti_like_rig(width_px=SIZE_PX[0], height_px=SIZE_PX[1]))
    status, _, complained = cli("align", "--drive", short, "--out", tmp_path / "align.yaml")
    assert status == 1
    assert "this drive tells nothing (fewer than 10 frames in motion); give a longer drive" in complained
    assert not (tmp_path / "align.yaml").exists()


def test_nowhere_to_write(drive, videos, tmp_path, cli):
    (tmp_path / "file").write_text("")
    before = (drive / "rig.yaml").read_text()
    for out, said in (
        (tmp_path / "file" / "align.yaml", "no results can be written there"),
        (tmp_path, "it is a folder; name a file in it"),
        (drive / "rig.yaml", "rig.yaml is an input or a result and would be overwritten"),
    ):
        status, _, complained = cli("align", *videos, "--out", out)
        assert (status, said in complained) == (1, True), complained
    assert (drive / "rig.yaml").read_text() == before
    same = ("--out", tmp_path / "a.yaml", "--json", tmp_path / "a.yaml")
    assert "a.yaml is to be written twice" in cli("align", *videos, *same)[2]


def test_kitti_drives_put_its_pairs_right(shared_data, tmp_path, cli):
    """The alignment of two drives, from nothing but their images, on 16 pairs of other drives with that camera."""
    out, before, after = tmp_path / "align.yaml", tmp_path / "off.json", tmp_path / "on.json"
    drives = [shared_data / "kitti_stereo" / name for name in ("0003", "0005")]
    status, told, _ = cli("align", "--drive", drives[0], "--drive", drives[1], "--out", out)
    assert status == 0
    assert "px low" in told
    assert 0.35 < load_alignment(out).offset_px < 0.55
    for align, figures in (("off", before), (out, after)):
        options = ("--matcher", "patch", "--align", align, "--json", figures)
        assert cli("evaluate", "stereo", "--pairs", shared_data / "kitti2015", *options)[0] == 0
    plain, put_right = (json.loads(file.read_text())["matchers"]["patch"] for file in (before, after))
    assert plain["median_relative_error_pct"] > 2.0
    assert 0.8 < put_right["median_relative_error_pct"] < 2.1
    assert abs(put_right["bias_pct"]) < 2.0


def test_kitti_pairs_as_reference(shared_data, tmp_path, cli):
    out = tmp_path / "align.yaml"
    status, told, _ = cli("align", "--reference", shared_data / "kitti2015", "--out", out)
    assert status == 0
    assert "36 known distances of 16 scenes or objects" in told
    found = load_alignment(out)
    assert 0.2 < found.offset_px < 0.6
    assert found.bow_px == 0.0
    assert abs(found.row_offset_px) < 0.5
