"""End-to-end runs of two cameras: without a rig, with an alignment, with a disparity video."""

import json
import shutil
import tarfile

import av
import cv2
import numpy as np
import pytest
import yaml

from track_range.results.formats.csv_file import read_tracks_csv
from track_range.stereo.alignment.file import save_alignment
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.rig_formats.reading import load_rig


@pytest.fixture
def run(cli, tmp_path):
    """Run on a pair: columns of tracks.csv, summary.json, and the printed text."""

    def run_pair(*arguments, name="out"):
        status, printed, errors = cli("run", *arguments, "--out", tmp_path / name)
        assert status == 0, errors
        summary = json.loads((tmp_path / name / "summary.json").read_text())
        return read_tracks_csv(tmp_path / name / "tracks.csv"), summary, " ".join(printed.split())

    return run_pair


def pair(drive):
    return (
        "--stereo",
        drive.left,
        drive.right,
        "--detections",
        drive.detections,
        "--truth",
        drive.truth,
    )


@pytest.mark.slow
def test_pair_without_a_rig_is_aligned_and_scaled_by_sizes(small_drive, run, tmp_path):
    for video in (small_drive.left, small_drive.right):
        shutil.copy(video, tmp_path / video.name)
    bare = (
        "--stereo",
        tmp_path / "left.mp4",
        tmp_path / "right.mp4",
        "--detections",
        small_drive.detections,
    )
    nothing = ("--known-distance", "0,1,1,9,9,car=5")  # no object is there
    columns, summary, printed = run(
        *bare, "--truth", small_drive.truth, "--disparity", "--no-overlay", *nothing
    )
    assert "--known-distance at 0 s does not show the scale" in printed
    assert summary["calibration"] == "estimated"
    assert summary["alignment"]["offset_sigma_px"] < 0.3
    scale, stereo = summary["learnt_scale"], summary["methods"]["stereo"]
    assert scale["n_tracks"] >= 5
    assert 0.1 < scale["relative_sigma"] < 0.35
    rig, _ = load_rig(small_drive.rig, size_px=(620, 188))
    expected = rig.left.fx_px * rig.baseline_m
    assert scale["focal_px"] * scale["baseline_m"] == pytest.approx(
        expected, rel=2 * scale["relative_sigma"]
    )
    assert 0.2 < stereo["median_relative_error_pct"] < 40
    assert stereo["within_2_sigma"] > 0.9
    fraction = columns["stereo_sigma_m"] / columns["stereo_m"]
    assert np.nanmin(fraction) > summary["focal_sigma"]
    assert "sgbm" not in summary["methods"]
    assert "track-range calibrate" in printed
    assert "no disparity.mp4" in printed
    assert "out: report.html" in printed
    assert summary["files"] == {}
    detected = yaml.safe_load((tmp_path / "out/settings.yaml").read_text())["found"]
    assert (detected["rig"], detected["baseline_m"]) == (None, None)


def test_real_drives_without_their_rig(shared_data, run, tmp_path):
    """The product of focal length and baseline, 384.4 px m, from the sizes of the cars alone."""
    for drive in ("0003", "0005"):
        folder = shared_data / "kitti_stereo" / drive
        (tmp_path / drive).mkdir()
        for name in ("left.mp4", "right.mp4"):
            shutil.copy(folder / name, tmp_path / drive / name)
        videos = ("--stereo", tmp_path / drive / "left.mp4", tmp_path / drive / "right.mp4")
        boxes = ("--detections", folder / "regionlets.txt", "--focal-px", 721.54, "--no-overlay")
        _, summary, _ = run(*videos, *boxes, name=f"{drive}_out")
        scale = summary["learnt_scale"]
        error = scale["focal_px"] * scale["baseline_m"] / 384.4 - 1
        assert 1e-4 < abs(error) < 0.25, drive
        assert abs(error) < 2 * scale["relative_sigma"], drive


@pytest.mark.slow
def test_alignment_file_changes_every_distance(small_drive, run, tmp_path):
    save_alignment(
        Alignment(offset_px=2.0, residual_px=0.1, source="a test"), tmp_path / "align.yaml"
    )
    plain, without, _ = run(*pair(small_drive), "--no-overlay", "--align", "off", name="off")
    moved, with_file, printed = run(
        *pair(small_drive), "--no-overlay", "--align", tmp_path / "align.yaml", name="file"
    )
    assert (without["alignment"]["is_applied"], with_file["alignment"]["is_applied"]) == (
        False,
        True,
    )
    assert with_file["alignment"]["offset_px"] == 2.0
    assert "a test" in printed
    assert with_file["calibration"] == "rig"
    rig, _ = load_rig(small_drive.rig, size_px=(620, 188))
    focal_baseline = rig.left.fx_px * rig.baseline_m
    for method in ("stereo_m", "sgbm_m"):
        both = np.isfinite(plain[method]) & np.isfinite(moved[method])
        assert both.sum() > 20
        shift_px = focal_baseline / moved[method][both] - focal_baseline / plain[method][both]
        assert np.median(shift_px) == pytest.approx(2.0, abs=0.01)
    saved = yaml.safe_load((tmp_path / "file/settings.yaml").read_text())["run"]
    assert saved["align"] == str(tmp_path / "align.yaml")


@pytest.mark.slow
def test_disparity_video_with_options_from_a_file(small_drive, run, tmp_path):
    plain = {
        "track_range_settings": 1,
        "run": {"sgbm_options": {"mode": "sgbm", "block_size": 7}, "align": "off"},
    }
    (tmp_path / "dense.yaml").write_text(yaml.safe_dump(plain))
    _, summary, printed = run(
        *pair(small_drive), "--settings", tmp_path / "dense.yaml", "--disparity", "--no-overlay"
    )
    assert summary["files"] == {"disparity": "disparity.mp4"}
    assert "disparity.mp4, report.html" in printed
    with av.open(str(tmp_path / "out/disparity.mp4")) as film:
        pictures = [frame.to_ndarray(format="bgr24") for frame in film.decode(video=0)]
    assert len(pictures) == 12
    assert pictures[0].shape == (188, 620, 3)
    spread = pictures[0].astype(int).max(axis=2) - pictures[0].astype(int).min(axis=2)
    assert (spread > 60).mean() > 0.3  # coloured where the disparity is known,
    assert (pictures[0].max(axis=2) < 30).mean() > 0.05  # and black elsewhere
    saved = yaml.safe_load((tmp_path / "out/settings.yaml").read_text())["run"]
    assert saved["sgbm_options"] == {"mode": "sgbm", "block_size": 7}
    assert saved["disparity"] is True


@pytest.mark.slow
def test_depth_of_all_pixels_has_the_distances_of_the_boxes(small_drive, run, tmp_path):
    alignment = Alignment(offset_px=2.0, residual_px=0.1, source="a test")
    save_alignment(alignment, tmp_path / "align.yaml")
    rows, _, printed = run(
        *pair(small_drive),
        *("--align", tmp_path / "align.yaml", "--write", "csv,depth", "--no-overlay"),
    )
    assert "no depths" not in printed
    with tarfile.open(tmp_path / "out/depth.tar") as tar:
        assert tar.getnames() == [f"sgbm/{index:06d}.png" for index in range(12)]
        files = [tar.extractfile(member).read() for member in tar]
    counts = [cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) for data in files]
    assert counts[0].shape == (188, 620)
    ratios = []
    for frame, x1, y1, x2, y2, distance_m in zip(
        *(rows[name] for name in ("frame", "x1_px", "y1_px", "x2_px", "y2_px", "sgbm_m")),
        strict=True,
    ):
        x, y = int((x1 + x2) / 2), int((y1 + y2) / 2)
        depth_m = counts[int(frame)][y - 1 : y + 2, x - 1 : x + 2] / 256
        if np.isfinite(distance_m) and (depth_m > 0).all():
            ratios.append(np.median(depth_m) / distance_m)
    assert len(ratios) > 20
    assert np.median(ratios) == pytest.approx(1.0, abs=0.01)
    status = run(*pair(small_drive), "--no-sgbm", "--write", "csv,depth", "--no-overlay")
    assert "depth.tar has no depths" in status[2]
