"""CSV labels: values of the columns, and errors with their line."""

import numpy as np
import pytest

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.video_labels.csv_labels import is_label_csv, read_csv_labels

HEADER = "frame,id,class,x1,y1,x2,y2,distance_m"
FULL = HEADER + ",visible_share,closing_mps"


def written(path, *lines):
    path.write_text("\n".join(lines) + "\n")
    return path


def test_columns_in_any_order(tmp_path):
    file = written(
        tmp_path / "t.csv",
        "lane,Class, distance_m,y2,x2,y1,x1,ID,frame,time_s,closing_mps",
        "0,Car,12.5,40,30,20,10,7,3,0.3,-1.5",
        "",
        ",Pedestrian,,4,3,2,1,8,3,0.3,",
    )
    labels = read_csv_labels(file)
    assert labels.frame.tolist() == [3, 3]
    assert labels.track_id.tolist() == [7, 8]
    assert labels.class_name.tolist() == ["car", "pedestrian"]
    assert labels.class_id.tolist() == [2, 0]
    assert labels.xyxy_px.tolist() == [[10, 20, 30, 40], [1, 2, 3, 4]]
    np.testing.assert_equal(labels.distance_m, [12.5, np.nan])
    np.testing.assert_equal(labels.closing_mps, [-1.5, np.nan])
    assert labels.visible_share.tolist() == [1.0, 1.0]


def test_unknown_values_are_empty_or_nan(tmp_path):
    labels = read_csv_labels(
        written(tmp_path / "t.csv", FULL, "0,1,bus,1,2,3,4,NaN,,nan", "0,2,bus,1,2,3,4,9,0.5,0")
    )
    np.testing.assert_equal(labels.distance_m, [np.nan, 9.0])
    np.testing.assert_equal(labels.closing_mps, [np.nan, 0.0])
    assert labels.visible_share.tolist() == [1.0, 0.5]


def test_regions_have_no_identity(tmp_path):
    rows = ("0,,DontCare,1,2,3,4,,,", "0,-1,dontcare,5,6,7,8,-1,-1,x", "0,1,dontcare,5,6,7,8,3,1,4")
    labels = read_csv_labels(written(tmp_path / "t.csv", FULL, *rows))
    assert labels.track_id.tolist() == [-1, -1, -1]
    assert labels.class_id.tolist() == [-1, -1, -1]
    assert np.isnan(labels.distance_m).all()
    assert np.isnan(labels.closing_mps).all()


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("0,1,car,10,20,30,40", r"line 3: .*8 cells.*got 7"),
        ("0,1,car,10,20,30,40,5,6", r"line 3: .*8 cells.*got 9"),
        ("-1,1,car,10,20,30,40,5", "line 3: .*frame, got '-1'"),
        ("1.5,1,car,10,20,30,40,5", "line 3: .*frame, got '1.5'"),
        ("1e7,1,car,10,20,30,40,5", "line 3: .*frame, got '1e7'"),
        (",1,car,10,20,30,40,5", "line 3: .*frame, got ''"),
        ("0,-1,car,10,20,30,40,5", "line 3: .*id, got '-1'"),
        ("0,,car,10,20,30,40,5", "line 3: .*id, got ''"),
        ("0,a,car,10,20,30,40,5", "line 3: .*id, got 'a'"),
        ("0,1,,10,20,30,40,5", "line 3: .*dontcare.*got ''"),
        ("0,1,car,nan,20,30,40,5", "line 3: .*x1, got 'nan'"),
        ("0,1,car,10,inf,30,40,5", "line 3: .*y1, got 'inf'"),
        ("0,1,car,10,20,30,,5", "line 3: .*y2, got ''"),
        ("0,1,car,30,20,10,40,5", "line 3: .*x1 < x2"),
        ("0,1,dontcare,10,40,30,40,", "line 3: .*x1 < x2"),
        ("0,1,car,10,20,30,40,-5", "distance_m, got '-5'"),
        ("0,1,car,10,20,30,40,0", "distance_m, got '0'"),
        ("0,1,car,10,20,30,40,inf", "distance_m, got 'inf'"),
        ("0,1,car,10,20,30,40,far", "distance_m, got 'far'"),
        ("0,9,car,10,20,30,40,5", "line 3: .*id 9 twice"),
    ],
)
def test_invalid_row_names_its_line(tmp_path, row, message):
    file = written(tmp_path / "t.csv", HEADER, "0,9,car,10,20,30,40,5", row)
    with pytest.raises(LabelFileError, match=rf"t\.csv.*{message}"):
        read_csv_labels(file)


def test_other_classes_are_objects_that_are_not_scored(tmp_path):
    rows = "0,9,car,10,20,30,40,5", "0,1,tractor,10,20,30,40,5"
    labels = read_csv_labels(written(tmp_path / "t.csv", HEADER, *rows))
    assert labels.class_id.tolist() == [2, -1]
    assert labels.track_id.tolist() == [9, 1]
    with pytest.raises(LabelFileError, match="all rows have other classes, such as 'tractor'"):
        read_csv_labels(written(tmp_path / "t.csv", HEADER, rows[1]))


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        ("1.01,", r"visible_share, got '1\.01'"),
        ("-0.1,", "visible_share, got '-0.1'"),
        (",fast", "closing_mps, got 'fast'"),
        (",1e4", "closing_mps, got '1e4'"),
    ],
)
def test_optional_columns_are_checked(tmp_path, cells, message):
    with pytest.raises(LabelFileError, match=message):
        read_csv_labels(written(tmp_path / "t.csv", FULL, f"0,1,car,10,20,30,40,5,{cells}"))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"\n \n", "empty"),
        (b"\xff\xfe\x00\x01", "CSV"),
        (HEADER.replace(",distance_m", "").replace("id,", "").encode(), "id, distance_m"),
        (f"{HEADER},id\n".encode(), "id"),
        (b"1,1,10,20,30,40,1,1,1\n", "first line"),
    ],
)
def test_invalid_label_files(tmp_path, content, message):
    file = tmp_path / "labels.csv"
    file.write_bytes(content)
    with pytest.raises(LabelFileError, match=rf"labels\.csv.*{message}"):
        read_csv_labels(file)


def test_missing_file(tmp_path):
    with pytest.raises(LabelFileError, match=r"none\.csv: no such file"):
        read_csv_labels(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("name", "content", "is_csv"),
    [
        ("truth.txt", f"\ufeff\n{HEADER}\n", True),
        ("truth.txt", HEADER.replace(",", ";"), True),
        ("gt.txt", "1,1,10,20,30,40,1\n", True),
        ("label.txt", "0 1 Car 0 0 0 1 2 3 4 1.5 1.6 4.0 0 0.75 20.0 -1.5\n", False),
        ("label.csv", "0 1 Car 0 0 0 1 2 3 4 1.5 1.6 4.0 0 0.75 20.0 -1.5\n", False),
        ("empty.csv", "\n", True),
        ("empty.txt", "\n", False),
    ],
)
def test_csv_is_recognised_by_its_header(tmp_path, name, content, is_csv):
    (tmp_path / name).write_text(content, encoding="utf-8")
    assert is_label_csv(tmp_path / name) == is_csv


def test_is_csv_of_folder_missing_and_binary_file(tmp_path):
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    assert [is_label_csv(tmp_path / name) for name in ("", "none.csv", "binary.csv")] == [
        False,
        False,
        False,
    ]


def test_csv_with_header_only(tmp_path):
    path = tmp_path / "truth.csv"
    path.write_text(HEADER)
    labels = read_csv_labels(path)
    assert len(labels.frame) == len(labels.track_id) == 0
    assert labels.xyxy_px.shape == (0, 4)
