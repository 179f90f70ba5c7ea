"""Tests of the files of a drive, read by the readers of the rest of the program."""

import csv

import cv2
import numpy as np
import pytest

from track_range.detection.boxes import iou
from track_range.detection.formats.video_labels.kitti import read_kitti
from track_range.recording.sources.open_video import open_video
from track_range.recording.telemetry.speed_files import open_ego_speed
from track_range.simulation.drive import N_THREADS, write_drive
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.settings import DriveOptions
from track_range.simulation.tables import kitti_text
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.scene import make_scene
from track_range.simulation.world.truth import joined, label_scene, visible_objects
from track_range.stereo.evaluation.kitti_2015 import read_pair
from track_range.stereo.rig_formats.reading import load_rig

SMALL = kitti_like_rig(width_px=310, height_px=94)


@pytest.fixture(scope="module")
def drive_and_calls(tmp_path_factory):
    calls = []
    folder = tmp_path_factory.mktemp("drive") / "new"
    written = write_drive(
        folder,
        seed=3,
        seconds=0.4,
        rig=SMALL,
        progress=lambda done, total: calls.append((done, total)),
    )
    return written, calls


def test_progress_counts_every_frame(drive_and_calls):
    assert drive_and_calls[1] == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_videos_show_the_scene(drive_and_calls):
    renderer = Renderer(make_scene(3, seconds=0.4), SMALL)
    for path, side in ((drive_and_calls[0].left, "left"), (drive_and_calls[0].right, "right")):
        frames = list(open_video(path))
        np.testing.assert_allclose(
            [frame.time_s for frame in frames], [0.0, 0.1, 0.2, 0.3], atol=1e-4
        )
        image = frames[3].image.astype(float)
        expected = renderer.render(0.3, side=side)
        # Compared in grey, since the codec halves the resolution of colour.
        assert np.abs(image.mean(axis=2) - expected.mean(axis=2)).mean() < 3.0


def test_rig_round_trip(drive_and_calls):
    rig, _ = load_rig(drive_and_calls[0].rig, size_px=(310, 94))
    assert rig.left == SMALL.left
    assert rig.baseline_m == pytest.approx(0.54)
    assert rig.is_rectified


@pytest.mark.slow
def test_truth_round_trip(drive_and_calls):
    labels = read_kitti(drive_and_calls[0].truth)
    renderer = Renderer(make_scene(3, seconds=0.4), SMALL)
    frames = [
        visible_objects(
            renderer.scene,
            time_s,
            frame=frame,
            camera=SMALL.left,
            inverse_depth=renderer.render_with_depth(time_s)[1],
        )
        for frame, time_s in enumerate([0.0, 0.1, 0.2, 0.3])
    ]
    expected = joined([visible.labels for visible in frames])
    assert labels.kitti_type.tolist() == expected.kitti_type.tolist()
    np.testing.assert_array_equal(labels.track_id, expected.track_id)
    np.testing.assert_allclose(labels.xyxy_px, expected.xyxy_px, atol=1e-6)
    np.testing.assert_allclose(labels.location_m, expected.location_m, atol=1e-6)
    assert set(labels.frame.tolist()) == {0, 1, 2, 3}


def test_detections_round_trip(drive_and_calls):
    detections = read_kitti(drive_and_calls[0].detections)
    assert len(detections) > 10
    assert np.isfinite(detections.score).all()
    assert not detections.has_3d_box.any()
    words = drive_and_calls[0].detections.read_text().split("\n")[0].split()
    assert words[3:6] == ["-1", "-1", "-10"]
    assert words[10:17] == ["-1", "-1", "-1", "-1000", "-1000", "-1000", "-10"]


@pytest.mark.slow
def test_same_seed_gives_the_same_bytes(drive_and_calls, tmp_path):
    again = write_drive(tmp_path, seed=3, seconds=0.4, rig=SMALL)
    for name in ("truth", "table", "ego_speed", "detections", "rig", "left", "right"):
        assert (
            getattr(again, name).read_bytes() == getattr(drive_and_calls[0], name).read_bytes()
        ), name
    other = label_scene(make_scene(4, seconds=0.4), [0.0], camera=SMALL.left)
    assert kitti_text(other) not in drive_and_calls[0].truth.read_text()


@pytest.mark.slow
def test_files_do_not_depend_on_the_number_of_threads(drive_and_calls, tmp_path, monkeypatch):
    monkeypatch.setattr("track_range.simulation.drive.N_THREADS", 1 if N_THREADS > 1 else 3)
    again = write_drive(tmp_path, seed=3, seconds=0.4, rig=SMALL)
    for name in ("left", "right", "truth", "table"):
        assert getattr(again, name).read_bytes() == getattr(drive_and_calls[0], name).read_bytes()


def test_alpha_is_heading_minus_bearing():
    labels = label_scene(make_scene(0), [0.0], camera=kitti_like_rig().left)
    labels = labels.select(labels.has_3d_box)
    alpha = [float(line.split()[5]) for line in kitti_text(labels).splitlines()]
    x, _, z = labels.location_m.T
    # Compared on the unit circle, since angles wrap.
    np.testing.assert_allclose(
        np.exp(1j * np.array(alpha)),
        np.exp(1j * (labels.rotation_y_rad - np.arctan2(x, z))),
        atol=1e-5,
    )
    assert np.abs(alpha).max() <= np.pi + 1e-6


def test_ego_speed_round_trip(drive_and_calls):
    speed = open_ego_speed(str(drive_and_calls[0].ego_speed))
    np.testing.assert_allclose(speed.time_s, [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(speed.speed_mps, 10.0)


@pytest.mark.slow
def test_both_cameras_in_one_recording(tmp_path):
    options = {
        layout: DriveOptions(lossless=True, stereo_layout=layout) for layout in (None, "bottom-top")
    }
    two, one = (
        write_drive(tmp_path / str(layout), seed=3, seconds=0.2, rig=SMALL, options=given)
        for layout, given in options.items()
    )
    assert one.left == one.right == tmp_path / "bottom-top" / "both"
    for number in range(2):
        left, right, both = (
            cv2.imread(str(path / f"{number:06}.png")) for path in (two.left, two.right, one.left)
        )
        assert (both == np.vstack((right, left))).all()
    assert one.table.read_text() == two.table.read_text()


def test_lossless_folders_contain_the_exact_pixels(tmp_path):
    (tmp_path / "left").mkdir()
    (tmp_path / "left" / "000007.png").write_bytes(b"of an earlier, longer drive")
    written = write_drive(
        tmp_path, seed=3, seconds=0.2, rig=SMALL, options=DriveOptions(lossless=True)
    )
    renderer = Renderer(make_scene(3, seconds=0.2), SMALL)
    for folder, side in ((written.left, "left"), (written.right, "right")):
        assert sorted(path.name for path in folder.iterdir()) == ["000000.png", "000001.png"]
        image = cv2.imread(str(folder / "000001.png"))
        np.testing.assert_array_equal(image, renderer.render(0.1, side=side))


def test_disparity_map_of_the_road(tmp_path):
    write_drive(
        tmp_path,
        seed=3,
        seconds=0.1,
        rig=SMALL,
        scenario="empty",
        options=DriveOptions(disparity=True),
    )
    truth = cv2.imread(str(tmp_path / "disp_occ_0" / "000000_10.png"), cv2.IMREAD_UNCHANGED)
    assert truth.dtype == np.uint16
    assert truth.shape == (94, 310)
    scene = make_scenario("empty", seed=3, seconds=0.1)
    depth_m = Renderer(scene, SMALL).depth_m(0.0)
    expected = SMALL.left.fx_px * 0.54 / depth_m
    is_known = truth > 0
    assert 0.3 < is_known.mean() < 0.9
    assert np.abs(truth[is_known] / 256 - expected[is_known]).max() < 1 / 256
    assert (truth[np.isnan(depth_m)] == 0).all()


@pytest.mark.slow
def test_kitti_2015_layout(tmp_path):
    rig = kitti_like_rig(width_px=620, height_px=188)
    write_drive(tmp_path, seed=1, seconds=0.1, rig=rig, options=DriveOptions(disparity=True))
    pair = read_pair(tmp_path, "000000_10", rig=tmp_path / "rig.yaml")
    with (tmp_path / "truth.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if float(row["visible_share"]) > 0.95]
    boxes = np.array([[float(row[name]) for name in ("x1", "y1", "x2", "y2")] for row in rows])
    overlap = iou(boxes, pair.xyxy_px)
    is_match = overlap.max(axis=1) > 0.8
    assert is_match.sum() >= 4
    distance_m = pair.rig.distance_m(pair.true_px[overlap.argmax(axis=1)])[is_match]
    expected_m = np.array([float(row["distance_m"]) for row in rows])[is_match]
    # The median over the centre of an object differs from the ray through it if the side of a car
    # is visible.
    assert np.median(np.abs(distance_m / expected_m - 1)) < 0.02


@pytest.mark.slow
def test_odd_sizes_grow_by_one(tmp_path):
    written = write_drive(tmp_path, seconds=0.1, rig=kitti_like_rig(width_px=311, height_px=95))
    frame = next(iter(open_video(written.left)))
    assert frame.image.shape == (96, 312, 3)
    rig, _ = load_rig(written.rig, size_px=(312, 96))
    assert rig.left.fx_px == pytest.approx(721.5 * 311 / 1240)


def test_drive_without_a_frame_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="seconds: expected"):
        write_drive(tmp_path, seconds=0.01)
