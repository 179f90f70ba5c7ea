import os

import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.detection_files import read_detections
from track_range.detection.formats.tables.box_table import VideoFacts
from track_range.detection.formats.tables.errors import LabelFileError

KITTI = "{frame} -1 {kind} -1 -1 -10 1 2 11 12 -1 -1 -1 -1000 -1000 -1000 -10 {score}\n"


def test_kitti_rows_by_frame(tmp_path):
    file = tmp_path / "det.txt"
    file.write_text(
        KITTI.format(frame=2, kind="Car", score=0.9)
        + KITTI.format(frame=0, kind="Pedestrian", score=0.8)
        + KITTI.format(frame=0, kind="DontCare", score=0.8)
    )
    recorded = read_detections(file)
    assert [ROAD_CLASSES[i] for i in recorded.at(0).class_id] == ["person"]
    assert len(recorded.at(1)) == 0
    assert recorded.at(2).xyxy_px.tolist() == [[1, 2, 11, 12]]
    assert ["2 boxes" in recorded.notes[0], "1 rows" in recorded.notes[1]] == [True, True]


def test_mot_rows_count_from_one(tmp_path):
    file = tmp_path / "det.txt"
    file.write_text(
        "1,-1,11,21,5,6,0.5,-1,-1,-1\n3,-1,1,1,2,2,-1,-1,-1,-1\n3,-1,1,1,0,2,0.9,-1,-1,-1\n"
    )
    recorded = read_detections(file, default_class_id=2)
    assert recorded.at(0).xyxy_px.tolist() == [[10, 20, 15, 26]]
    assert recorded.at(0).class_id.tolist() == [2]
    assert recorded.at(2).score.tolist() == [1.0]  # -1 = no score; the empty box is ignored


def test_plain_rows_and_our_own_tracks(tmp_path):
    plain = tmp_path / "rrc.txt"
    plain.write_text("0,1,2,3,4,0.5\n")
    assert read_detections(plain).at(0).xyxy_px.tolist() == [[1, 2, 3, 4]]
    tracks = tmp_path / "tracks.csv"
    tracks.write_text(
        "frame,class,x1_px,y1_px,x2_px,y2_px,score,observed\n4,truck,1,2,3,4,0.5,1\n4,truck,1,2,3,4,0.5,0\n"
    )
    recorded = read_detections(tracks)
    assert [ROAD_CLASSES[i] for i in recorded.at(4).class_id] == ["truck"]


def test_margins_become_probabilities_with_note(tmp_path):
    file = tmp_path / "det.txt"
    file.write_text(
        KITTI.format(frame=0, kind="Car", score=-2) + KITTI.format(frame=0, kind="Car", score=2)
    )
    recorded = read_detections(file)
    np.testing.assert_allclose(recorded.at(0).score, [1 / (1 + np.e**2), 1 / (1 + np.e**-2)])
    assert "sigmoid" in recorded.notes[1]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\xff\xfe\xfd\n", "text"),
        (b"1,2,3\n", "got 3"),
        (b"1,a,3,4,5,6\n", "between commas"),
        (b"frame,class\n1,car\n", "x1_px"),
        (b"hello world\n", "17 columns"),
    ],
)
def test_invalid_detection_files(tmp_path, content, message):
    file = tmp_path / "det.txt"
    file.write_bytes(content)
    with pytest.raises(LabelFileError, match=rf"det\.txt.*{message}"):
        read_detections(file)


@pytest.mark.parametrize("content", [b"", b"\n \n", b"\n" * 70_000])
def test_empty_file_has_no_boxes(tmp_path, content):
    file = tmp_path / "det.txt"
    file.write_bytes(content)
    recorded = read_detections(file, form="mot")
    assert (len(recorded.frame), recorded.form) == (0, "mot")
    assert "empty" in recorded.notes[1]
    assert len(recorded.at(3)) == 0


def test_missing_file(tmp_path):
    with pytest.raises(LabelFileError, match=r"none\.txt: no such file"):
        read_detections(tmp_path / "none.txt")


def test_real_files(shared_data):
    regionlets = read_detections(shared_data / "kitti_stereo/0003/regionlets.txt")
    assert 0 <= regionlets.detections.score.min() <= regionlets.detections.score.max() <= 1
    assert len(read_detections(shared_data / "kitti_labels/rrc/Car/0000.txt").at(0)) > 0
    assert len(read_detections(shared_data / "mot/MOT15/TUD-Campus/det/det.txt").at(0)) > 0


@pytest.mark.parametrize("cell", ["nan", "inf", "1e400", "-4", "200000"])
def test_implausible_boxes_are_ignored_with_a_note(tmp_path, cell):
    file = tmp_path / "det.txt"
    file.write_text(f"1,-1,11,21,5,6,0.5,-1,-1,-1\n2,-1,11,21,5,{cell},0.5,-1,-1,-1\n")
    recorded = read_detections(file)
    assert recorded.frame.tolist() == [0]
    assert any("ignored 1 row" in note for note in recorded.notes)


@pytest.mark.parametrize("frame", ["1000000000000000000", "1e18", "nan", "1.5", "1e400"])
def test_implausible_frame_numbers(tmp_path, frame):
    file = tmp_path / "det.txt"
    file.write_text(f"1,-1,11,21,5,6,0.5\n{frame},-1,11,21,5,6,0.5\n")
    with pytest.raises(LabelFileError, match=r"det\.txt, line 2: .*frame numbers"):
        read_detections(file)


def test_embeddings_that_are_no_array_of_numbers(tmp_path):
    (tmp_path / "det.txt").write_text("1,-1,11,21,5,6,0.5\n")
    for make in (
        lambda path: path.write_bytes(b"PK\x03\x04" + bytes(99)),
        lambda path: path.write_bytes(b""),
        lambda path: np.save(path, np.array([[1, -1, 11, 21, 5, 6, 0.5, 1e300]])),
        lambda path: path.symlink_to("/dev/zero"),
        os.mkfifo,
    ):
        (tmp_path / "feat.npy").unlink(missing_ok=True)
        make(tmp_path / "feat.npy")
        with pytest.raises(LabelFileError, match=r"feat\.npy: "):
            read_detections(tmp_path / "det.txt")


def test_scores_in_per_cent(tmp_path):
    file = tmp_path / "det.txt"
    file.write_text("1,-1,11,21,5,6,87,-1,-1,-1\n2,-1,11,21,5,6,9.5,-1,-1,-1\n")
    recorded = read_detections(file)
    np.testing.assert_allclose(recorded.detections.score, [0.87, 0.095])
    assert "per cent" in recorded.notes[1]
    file.write_text("1,-1,11,21,5,6,4,-1,-1,-1\n2,-1,11,21,5,6,0,-1,-1,-1\n")  # margins
    np.testing.assert_allclose(read_detections(file).detections.score, [1 / (1 + np.exp(-4)), 0.5])


def test_mostly_invalid_rows_are_refused(tmp_path):
    file = tmp_path / "det.txt"
    file.write_text("1,-1,100,100,90,80,0.9\n" + "2,-1,100,100,-5,-20,0.9\n" * 2)
    with pytest.raises(LabelFileError, match=r"det\.txt.*2 of 3 rows"):
        read_detections(file)
    file.write_text("1,-1,100,100,90,80,0.9\n" * 2 + "2,-1,100,100,-5,-20,0.9\n" * 2)
    assert len(read_detections(file).frame) == 2


def test_classes_of_rows_of_numbers(tmp_path):
    file = tmp_path / "det.txt"
    file.write_text("1,3,11,21,50,60,1,4,0,0\n1,4,11,21,50,60,1,10,0,0\n1,5,11,21,50,60,1,11,0,0\n")
    recorded = read_detections(file, default_class_id=0)
    # VisDrone: car, motor
    assert (recorded.detections.class_id.tolist(), recorded.has_classes) == ([2, 3], True)
    assert "others (1)" in recorded.notes[1]


def test_frames_of_kitti_that_end_with_the_number_of_images(tmp_path):
    file = tmp_path / "det.txt"
    file.write_text("".join(KITTI.format(frame=f, kind="Car", score=0.9) for f in (1, 2, 3)))
    assert read_detections(file).frame.tolist() == [1, 2, 3]
    recorded = read_detections(file, video=VideoFacts(n_frames=3))
    assert recorded.frame.tolist() == [0, 1, 2]
    assert any("start at 1" in note for note in recorded.notes)


def test_two_classes_on_one_object(tmp_path):
    """Boxes of classes that are easily confused are one object; others, and those of one class, are
    not."""
    file = tmp_path / "det.txt"
    rows = [
        ("Car", 1, 0.5),
        ("Truck", 2, 0.9),
        ("Car", 1, 0.4),
        ("Pedestrian", 1, 0.3),
        ("Car", 40, 0.2),
    ]
    lines = [
        f"0 1 {kind} 0 0 0 {x} 2 {x + 30} 30 -1 -1 -1 -1000 -1000 -1000 -10 {s}\n"
        for kind, x, s in rows
    ]
    file.write_text("".join(lines))
    recorded = read_detections(file)
    assert len(recorded.frame) == 5
    assert recorded.at(0).score.tolist() == [0.9, 0.3, 0.2]
    file.write_text("".join(lines[:1] + lines[2:]))
    assert len(recorded.at(1)) == 0
    assert read_detections(file).at(0).score.tolist() == [0.5, 0.4, 0.3, 0.2]


def test_a_car_and_a_truck_on_each_vehicle(shared_data):
    recorded = read_detections(shared_data / "cases/trk_car_and_truck/dup_run.txt")
    assert len(recorded.frame) == 60
    assert [recorded.at(frame).class_id.tolist() for frame in range(15)] == [[2, 2]] * 15
