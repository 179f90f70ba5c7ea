import numpy as np
import pytest

from track_range.detection.formats.label_formats import read_labels
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.video_labels.kitti import read_kitti

CAR = "3 7 Car 0 1 -1.5 10 20 30 40 1.5 1.6 4.0 1.0 1.7 12.0 0.1"
DONT_CARE = "3 -1 DontCare -1 -1 -10 1 2 3 4 -1000 -1000 -1000 -10 -1 -1 -1"


def test_tracking_file(tmp_path):
    file = tmp_path / "label.txt"
    file.write_text(f"{CAR}\n\n{DONT_CARE}\n{CAR} 0.75\n")
    labels = read_kitti(file)
    assert labels.frame.tolist() == [3, 3, 3]
    assert labels.track_id.tolist() == [7, -1, 7]
    assert labels.kitti_type.tolist() == ["Car", "DontCare", "Car"]
    assert labels.xyxy_px[0].tolist() == [10, 20, 30, 40]
    assert labels.size_hwl_m[0].tolist() == [1.5, 1.6, 4.0]
    assert labels.location_m[0].tolist() == [1.0, 1.7, 12.0]
    assert labels.rotation_y_rad[0] == 0.1
    assert labels.has_3d_box.tolist() == [True, False, True]
    np.testing.assert_equal(labels.score, [np.nan, np.nan, 0.75])


def test_folder_of_kitti_object_files(tmp_path):
    for number, rest in (("000002", CAR[4:]), ("000010", DONT_CARE[5:])):
        (tmp_path / f"{number}.txt").write_text(rest + "\n")
    labels = read_kitti(tmp_path)
    assert labels.frame.tolist() == [2, 10]
    assert labels.track_id.tolist() == [-1, -1]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"\xff\xfe\x00\x01", "text"),
        (b"1 2 Car 0\n", "line 1: .*17 columns.*got 4"),
        (CAR.replace("12.0", "far").encode(), "line 1: .*numbers"),
        (CAR.replace("12.0", "nan").encode(), "line 1: .*finite"),
        (CAR.replace("12.0", "1_2").encode(), "line 1: .*'1_2'"),
        (CAR.replace("12.0", "1e18").encode(), "line 1: .*'1e18'"),
        (f"1e18 {CAR.partition(' ')[2]}".encode(), "line 1: .*frame number"),
        (CAR.replace("Car", "x" * 99).encode(), "line 1: .*type"),
    ],
)
def test_invalid_label_files(tmp_path, content, message):
    file = tmp_path / "label.txt"
    file.write_bytes(content)
    with pytest.raises(LabelFileError, match=rf"label\.txt.*{message}"):
        read_kitti(file)


def test_missing_file_and_empty_folder(tmp_path):
    with pytest.raises(LabelFileError, match=r"none\.txt: no such file"):
        read_kitti(tmp_path / "none.txt")
    with pytest.raises(LabelFileError, match="label files"):
        read_kitti(tmp_path)


def test_real_labels(shared_data):
    labels = read_kitti(shared_data / "kitti_stereo/0003/label.txt")
    assert set(labels.kitti_type) >= {"Car", "DontCare"}
    assert labels.has_3d_box.sum() > 40


def test_labels_checked_together_equal_single_rows(tmp_path):
    rows = [
        "3 1 Car 0 0 -1.5 10 20 30 40 1.5 1.7 4 1 2 20 0.1",
        "4 -1 Person_sitting 0 1 0 1e1 2 3 4 1 1 1 1 2 3 0",
    ]
    whole = tmp_path / "0000.txt"
    whole.write_text("\n".join(rows) + "\n")
    mixed = tmp_path / "0001.txt"
    mixed.write_text(
        "\n".join([*rows, "5 2 Truck\u00e9 0 0 0 1 2 3 4 1 1 1 1 2 3 0 0.5"]) + "\n",
        encoding="utf-8",
    )
    first, second = read_kitti(whole), read_kitti(mixed).select(np.array([0, 1]))
    assert first.kitti_type.tolist() == second.kitti_type.tolist()
    np.testing.assert_array_equal(first.xyxy_px, second.xyxy_px)
    np.testing.assert_array_equal(first.location_m, second.location_m)
    assert np.isnan(first.score).all()


@pytest.mark.parametrize("cell", ["1_0", "\u0663", "nan", "1e7", "x"])
def test_numbers_are_checked(tmp_path, cell):
    file = tmp_path / "0000.txt"
    row = "3 1 Car 0 0 -1.5 10 20 30 40 1.5 1.7 4 1 2 20 0.1"
    file.write_text(f"{row}\n{row[:-3]}{cell}\n", encoding="utf-8")
    with pytest.raises(LabelFileError, match=r"0000\.txt, line 2"):
        read_kitti(file)


@pytest.mark.parametrize(
    "unknown",
    [
        "0.0 0.0 0.0 0.0 0.0 0.0 0.0",
        "-1 -1 -1 -1 -1 -1 -1",
        "1.5 1.6 4.0 0.0 0.0 0.0 0.0",
        "1.5 1.6 4.0 -1 -1 -1 0.0",
    ],
)
def test_unknown_boxes_of_other_programs_have_no_distance(tmp_path, unknown):
    path = tmp_path / "labels.txt"
    known = "1.5 1.6 4.0 1.0 1.7 20.0 0.0"
    result = "-1 -1 -1 2.0 1.5 30.0 -10"  # of track-range: no size, but a place
    rows = [
        f"0 {i} Car 0 0 0.0 10 20 30 40 {box}" for i, box in enumerate((unknown, known, result))
    ]
    path.write_text("\n".join(rows))
    table = read_labels(path)
    assert np.isnan(table.distance_m).tolist() == [True, True, False]
    assert np.isnan(table.location_m[:, 2]).tolist() == [True, False, False]


def test_files_of_deepstream_are_named_after_the_camera_and_the_frame(tmp_path):
    row = "car 0.0 0 0.0 10 20 30 40 0.0 0.0 0.0 0.0 0.0 0.0 0.0 0.9\n"
    for name in ("00_000_000000.txt", "00_000_000002.txt"):
        (tmp_path / name).write_text(row)
    table = read_labels(tmp_path)
    assert (table.frame.tolist(), table.score.tolist()) == ([0, 2], [0.9, 0.9])
    (tmp_path / "00_001_000000.txt").write_text(row)
    with pytest.raises(LabelFileError, match="one video"):
        read_labels(tmp_path)


def test_trackers_of_deepstream_write_the_identity_after_the_type(tmp_path):
    for frame in range(2):
        row = "car 12 0.0 0 0.0 10 20 30 40 0.0 0.0 0.0 0.0 0.0 0.0 0.0 0.9\n"
        (tmp_path / f"00_000_{frame:06d}.txt").write_text(row)
    table = read_labels(tmp_path)
    assert (table.track_id.tolist(), table.score.tolist()) == ([12, 12], [0.9, 0.9])
    assert table.xyxy_px[0].tolist() == [10, 20, 30, 40]
