from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.detection.classes import CLASS_LISTS
from track_range.detection.formats.label_formats import label_format_of
from track_range.detection.formats.video_labels.mot import (
    MotFormatError,
    MotRows,
    mot_lines,
    read_mot,
)


def lines_of(boxes: list[list[float]], frame: int) -> list[str]:
    n = len(boxes)
    return mot_lines(
        frame, np.arange(1, n + 1), np.array(boxes, np.float64).reshape(-1, 4), np.full(n, 0.875)
    )


def test_a_line_by_hand() -> None:
    # the centre of the first pixel is 0, 0 in track-range and 1, 1 in MOTChallenge
    assert lines_of([[2.5, 0.0, 5.5, 10.0]], 0) == ["1,1,3.50,1.00,3.00,10.00,0.8750,-1,-1,-1\n"]


def test_no_tracks_no_lines() -> None:
    assert lines_of([], 3) == []


@given(
    box=st.tuples(*[st.floats(-100, 3000)] * 2, *[st.floats(0.1, 2000)] * 2),
    frame=st.integers(0, 10**6 - 1),
)
@settings(deadline=None)
def test_written_then_read_is_the_same_box(
    box: tuple[float, ...], frame: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    x, y, w, h = box
    path = tmp_path_factory.getbasetemp() / "mot.txt"
    text = "".join(lines_of([[x, y, x + w, y + h]], frame))
    path.write_text(text)
    if max(abs(float(value)) for value in text.split(",")[2:6]) < 1:
        # smaller than a pixel, in the first pixel: fractions of an image look like this
        with pytest.raises(MotFormatError, match="fractions"):
            read_mot(path)
        return
    rows = read_mot(path)
    assert rows.frame.tolist() == [frame]
    np.testing.assert_allclose(rows.xyxy_px, [[x, y, x + w, y + h]], atol=0.0101)


def test_ground_truth_of_mot16(tmp_path: Path) -> None:
    path = tmp_path / "gt.txt"
    path.write_text("1,5,4,1,3,10,1,1,0.25\n\n2,5,5,1,3,10,0,7,1\n")
    rows = read_mot(path)
    assert rows.frame.tolist() == [0, 1]
    assert rows.track_id.tolist() == [5, 5]
    np.testing.assert_allclose(rows.xyxy_px[0], [3.0, 0.0, 6.0, 10.0])
    assert rows.score.tolist() == [1.0, 0.0]
    assert rows.mot_class.tolist() == [1, 7]


def test_mot15_world_coordinates_are_not_a_class(tmp_path: Path) -> None:
    path = tmp_path / "gt.txt"
    path.write_text("1,1,212,204,20,57,0,-3.1784,16.34,0.45739\n")
    rows = read_mot(path)
    assert rows.mot_class.tolist() == [-1]


def test_an_empty_file_has_no_rows(tmp_path: Path) -> None:
    path = tmp_path / "gt.txt"
    path.write_text("")
    assert len(read_mot(path)) == 0


@pytest.mark.parametrize(
    ("line", "key_word"),
    [
        ("1,1,2,3,4,5", "7 to 10"),
        ("1 1 2 3 4 5 1", "duplicate of id 1"),
        ("1,1,x,3,4,5,1", "'x'"),
        ("1,1,nan,3,4,5,1", "finite"),
        ("-1,1,2,3,4,5,1", "frame"),
        ("1.5,1,2,3,4,5,1", "frame"),
        ("1,1.5,2,3,4,5,1", "id"),
        ("1,1,2,3,-4,5,1", "width"),
        ("1,2,2,3,4,nan,1", "'nan'"),
        ("1,2,2,3,1e400,5,1", "finite"),
        ("1,2,2,3,200000,5,1", "100000 pixels"),
        ("1,2,-2e5,3,4,5,1", "100000 pixels"),
        ("1000000000000000000,2,2,3,4,5,1", "frame"),
        ("1,1e300,2,3,4,5,1", "id"),
        ("1,2,2_0,3,4,5,1", "2_0"),
        ("1,2,2,3,4,5,1,1e300,1", "class"),
        ("1,1,2,3,4,5,1", "duplicate of id 1 in frame 1"),
    ],
)
def test_bad_lines(line: str, key_word: str, tmp_path: Path) -> None:
    path = tmp_path / "gt.txt"
    path.write_text(f"1,1,2,3,4,5,1\n{line}\n")
    with pytest.raises(MotFormatError, match=f"gt.txt, line 2.*{key_word}"):
        read_mot(path)


def test_files_that_are_not_text(tmp_path: Path) -> None:
    with pytest.raises(MotFormatError, match=r"none\.txt"):
        read_mot(tmp_path / "none.txt")
    (tmp_path / "video.mp4").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(MotFormatError, match=r"video\.mp4.*text"):
        read_mot(tmp_path / "video.mp4")


def test_columns_of_different_lengths() -> None:
    ids = np.zeros(2, np.int64)
    with pytest.raises(ValueError, match=r"score.*shape"):
        MotRows(ids, ids, np.zeros((2, 4)), np.zeros(1), ids)


# -- layouts that look alike
# ------------------------------------------------------------------------------------------

# of one object that moves 4 px to the right in each frame, in pixels from 0
BOX = [100.0, 50.0, 130.0, 90.0]


def rows_in(layout: str, n: int = 12) -> str:
    """The object in frames 0 to n - 1 in the columns of a layout, as f-string."""
    lines = []
    for f in range(n):
        x, y, right, bottom = BOX[0] + 4 * f, BOX[1], BOX[2] + 4 * f, BOX[3]
        place = {"f": f, "g": f + 1, "x": x + 1, "y": y + 1, "w": right - x, "h": bottom - y}
        lines.append(layout.format(**place, l=x, t=y, r=right, b=bottom) + "\n")
    return "".join(lines)


LAYOUTS = {
    "spaces": ("{g} 7 {x} {y} {w} {h} 0.9", 7, ""),
    "tabs and a comment": ("{g}\t7\t{x}\t{y}\t{w}\t{h}\t1\t-1\t-1\t-1  # a", 7, ""),
    "semicolons": ("{g};7;{x};{y};{w};{h};1", 7, ""),
    "frames from 0": ("{f},7,{x},{y},{w},{h},0.9,-1,-1,-1", 7, ""),
    "without scores": ("{g},7,{x},{y},{w},{h}", 7, ""),
    "corners": ("{f},{l},{t},{r},{b},0.4", -1, ""),
    "visdrone": ("{g},7,{x},{y},{w},{h},1,4,0,1", 7, "car"),
    "boxmot": ("{g} 7 {x:.0f} {y:.0f} {w:.0f} {h:.0f} 0 2 -1", 7, "car"),
    "boxmot evaluation": ("{g},7,{x},{y},{w},{h},1,2,0.{g}8", 7, "car"),
    "boxmot from 1": ("{g},7,{x},{y},{w},{h},0.{g}8,3,{g}", 7, "car"),
    "class for score": ("{g},7,{x},{y},{w},{h},2", 7, "car"),
    "score and class": ("{g},7,{x},{y},{w},{h},0.{g}8,2", 7, "car"),
    "one and class": ("{g},7,{x},{y},{w},{h},1,2", 7, "car"),
    "class and score": ("{g},7,{x},{y},{w},{h},2,0.{g}8", 7, "car"),
    "no class in 8 columns": ("{g},7,{x},{y},{w},{h},1,-1", 7, ""),
    "no class in 9 columns": ("{g},7,{x},{y},{w},{h},0.8,-1,-1", 7, ""),
    "class of no benchmark": ("{g},7,{x},{y},{w},{h},1,15,1", 7, "cat"),
    "aicity": ("6 7 {g} {x:.0f} {y:.0f} {w:.0f} {h:.0f} -1 -1", 7, ""),
    "ab3dmot": ("{f},2,{l},{t},{r},{b},9.5,1.5,1.6,4,1,1.6,20,1.5,1.6", -1, "car"),
    "world": ("{g},7,{x},{y},{w},{h},1,2.5,-3.25,0.5", 7, ""),
    "mot17": ("{g},7,{x},{y},{w},{h},1,3,0.5", 7, "car"),
}


GUESSED = (
    *("boxmot", "boxmot evaluation", "score and class", "one and class", "class and score"),
    *("boxmot from 1", "class for score", "class of no benchmark"),
)


@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts_that_look_alike(tmp_path: Path, name: str) -> None:
    layout, identity, class_name = LAYOUTS[name]
    path = tmp_path / "boxes.txt"
    path.write_text(rows_in(layout))
    assert label_format_of(path).name == "mot"
    rows = read_mot(path)
    assert rows.frame.tolist() == list(range(12))
    assert set(rows.track_id.tolist()) == {identity}
    assert set(rows.class_name) == {class_name}
    np.testing.assert_allclose(rows.xyxy_px[[0, -1]], [BOX, [144, 50, 174, 90]], atol=1e-9)
    assert not rows.is_region.any()
    assert len(rows.notes) == (name == "frames from 0" or name in GUESSED)


def test_names_of_numbers_are_the_users(tmp_path: Path) -> None:
    path = tmp_path / "boxes.txt"
    path.write_text(rows_in("{g},7,{x},{y},{w},{h},1,2,0.{g}8"))
    rows = read_mot(path, names=("car", "bus", "truck"))
    assert set(rows.class_name) == {"truck"}
    assert "from --names" in rows.notes[0]
    assert rows.score[0] == 0.18
    # MOTChallenge's list has a visible fraction in the last column
    rows = read_mot(path, names=CLASS_LISTS["mot"])
    assert (set(rows.class_name), set(rows.score)) == ({"person on vehicle"}, {1.0})
    (tmp_path / "classes.txt").write_text("van\nbus\ntruck\n")
    rows = read_mot(path)
    assert set(rows.class_name) == {"truck"}
    assert "classes.txt" in rows.notes[0]


def test_lists_of_classes_that_fit_alike_are_a_question(tmp_path: Path) -> None:
    path = tmp_path / "boxes.txt"
    path.write_text(rows_in("{g},7,{x},{y},{w},{h},0.8,4,-1,-1"))
    with pytest.raises(MotFormatError, match="--names visdrone or --names coco"):
        read_mot(path)
    assert set(read_mot(path, names=CLASS_LISTS["visdrone"]).class_name) == {"car"}
    assert set(read_mot(path, names=CLASS_LISTS["coco"]).class_name) == {"airplane"}
    path.write_text(rows_in("{g},7,{x},{y},{w},{h},0.8,4,-1,-1") + "1,8,1,1,9,9,0.8,0,-1,-1\n")
    assert "person" in read_mot(path).class_name  # VisDrone's results have no class 0


def test_columns_of_both_meanings_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "boxes.txt"
    # corners and per cent, or id, x, y, w, h
    path.write_text("0,100,200,300,400,87\n1,104,200,304,400,85\n")
    with pytest.raises(MotFormatError, match="both"):
        read_mot(path)
    # left, top, width, height and a score
    path.write_text("0,100.5,200,30,40,0.5\n1,104.5,200,34,40,0.5\n")
    with pytest.raises(MotFormatError, match="neither"):
        read_mot(path)


def test_frames_that_end_with_the_number_of_images(tmp_path: Path) -> None:
    path = tmp_path / "boxes.txt"
    path.write_text(rows_in("{g},{l},{t},{r},{b},0.4"))
    assert read_mot(path).frame.tolist() == list(range(1, 13))  # rows of corners count from 0
    assert read_mot(path, 12).frame.tolist() == list(range(12))
    assert read_mot(path, 40).frame.tolist() == list(range(1, 13))


def test_classes_of_labels_txt(tmp_path: Path) -> None:
    path = tmp_path / "gt.txt"
    path.write_text(rows_in("{g},7,{x},{y},{w},{h},1,2,1") + "1,8,1,1,9,9,0,1,1\n")
    (tmp_path / "labels.txt").write_text("truck\ncar\n")
    rows = read_mot(path)
    assert set(rows.class_name[:-1]) == {"car"}
    assert (rows.class_name[-1], rows.is_region.nonzero()[0].tolist()) == ("truck", [12])


def test_several_cameras_of_ai_city_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "boxes.txt"
    path.write_text(rows_in("6 7 {g} {x:.0f} {y:.0f} {w:.0f} {h:.0f} -1 -1\n8 7 {g} 1 1 9 9 -1 -1"))
    with pytest.raises(MotFormatError, match="one camera"):
        read_mot(path)


@pytest.mark.parametrize("names", [(), CLASS_LISTS["coco"]])
def test_rounded_scores_are_unknown_with_and_without_names(
    tmp_path: Path, names: tuple[str, ...]
) -> None:
    path = tmp_path / "boxes.txt"
    path.write_text(rows_in(LAYOUTS["boxmot"][0]))
    rows = read_mot(path, names=names)
    assert set(rows.class_name) == {"car"}
    assert not rows.is_region.any()


@pytest.mark.parametrize(
    ("rows", "found"),
    [
        ("1,1,0.4,0.3,0.1,0.2,0.9\n2,1,0.4,0.3,0.1,0.2,0.9\n", "fractions"),
        ("684,8,273,116,1,9,0,0\n406,119,265,70,0,0,0,0\n", "VisDrone's labels of one image"),
    ],
)
def test_boxes_that_are_not_in_pixels(tmp_path: Path, rows: str, found: str) -> None:
    path = tmp_path / "boxes.txt"
    path.write_text(rows)
    with pytest.raises(MotFormatError, match=found):
        read_mot(path)
