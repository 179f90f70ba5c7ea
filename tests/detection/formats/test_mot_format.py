from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.detection.formats.video_labels.mot import MotFormatError, MotRows, mot_lines, read_mot


def lines_of(boxes: list[list[float]], frame: int) -> list[str]:
    n = len(boxes)
    return mot_lines(frame, np.arange(1, n + 1), np.array(boxes, np.float64).reshape(-1, 4), np.full(n, 0.875))


def test_a_line_by_hand() -> None:
    # the centre of the first pixel is 0, 0 in track-range and 1, 1 in MOTChallenge
    assert lines_of([[2.5, 0.0, 5.5, 10.0]], 0) == ["1,1,3.50,1.00,3.00,10.00,0.8750,-1,-1,-1\n"]


def test_no_tracks_no_lines() -> None:
    assert lines_of([], 3) == []


@given(box=st.tuples(*[st.floats(-100, 3000)] * 2, *[st.floats(0.1, 2000)] * 2), frame=st.integers(0, 10**6 - 1))
@settings(deadline=None)
def test_written_then_read_is_the_same_box(
    box: tuple[float, ...], frame: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    x, y, w, h = box
    path = tmp_path_factory.getbasetemp() / "mot.txt"
    path.write_text("".join(lines_of([[x, y, x + w, y + h]], frame)))
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
    assert rows.visibility.tolist() == [0.25, 1.0]


def test_mot15_world_coordinates_are_not_a_class(tmp_path: Path) -> None:
    path = tmp_path / "gt.txt"
    path.write_text("1,1,212,204,20,57,0,-3.1784,16.34,0.45739\n")
    rows = read_mot(path)
    assert rows.mot_class.tolist() == [0]
    assert np.isnan(rows.visibility).all()


def test_an_empty_file_has_no_rows(tmp_path: Path) -> None:
    path = tmp_path / "gt.txt"
    path.write_text("")
    assert len(read_mot(path)) == 0


@pytest.mark.parametrize(
    ("line", "key_word"),
    [
        ("1,1,2,3,4,5", "7 to 10"),
        ("1 1 2 3 4 5 1", "7 to 10"),
        ("1,1,x,3,4,5,1", "'x'"),
        ("1,1,nan,3,4,5,1", "finite"),
        ("0,1,2,3,4,5,1", "frame"),
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
        MotRows(ids, ids, np.zeros((2, 4)), np.zeros(1), ids, np.zeros(2))
