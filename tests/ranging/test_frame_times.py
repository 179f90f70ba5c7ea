import numpy as np
import pytest

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.ranging.truth.frame_times import (
    ASSUMED_STEP_S,
    KITTI_STEP_S,
    TimeSource,
    frame_times,
)
from track_range.ranging.truth.labelled_boxes import BoxSelection, box_set

FRAMES = np.arange(3)


@pytest.fixture
def labels(tmp_path):
    (tmp_path / "label_02").mkdir()
    return tmp_path / "label_02" / "a.txt"


def test_step_without_times(labels):
    assert frame_times(labels, is_kitti=True).at(FRAMES) == pytest.approx(KITTI_STEP_S * FRAMES)
    assumed = frame_times(labels, is_kitti=False)
    assert assumed.at(FRAMES) == pytest.approx(ASSUMED_STEP_S * FRAMES)
    assert "--frame-rate" in assumed.origin


def test_files_of_times(labels, tmp_path):
    """Times beside the labels, given times, and a given frame rate, each before the one before."""
    for name in ("ego", "given"):
        (tmp_path / name).mkdir()
    (tmp_path / "ego/a.csv").write_text("frame,time_s\n0,7.0\n1,7.2\n2,7.5\n")
    dates = [f"2011-09-26 13:10:5{k}.250000000" for k in (1, 2, 4)]
    (tmp_path / "given/a.txt").write_text("\n".join(dates) + "\n")
    beside = frame_times(labels, is_kitti=True)
    assert beside.at(FRAMES) == pytest.approx([0.0, 0.2, 0.5])
    assert beside.origin == str(tmp_path / "ego")
    given = TimeSource(times=tmp_path / "given")
    assert frame_times(labels, is_kitti=True, source=given).at(FRAMES) == pytest.approx([0, 1, 3])
    rate = TimeSource(times=tmp_path / "given", frame_rate_hz=4.0)
    assert frame_times(labels, is_kitti=True, source=rate).step_s == pytest.approx(0.25)
    with pytest.raises(LabelFileError, match=r"a\.csv.*frame 3.*3 times"):
        beside.at(np.array([3]))


def test_times_of_some_frames_are_refused(labels, tmp_path):
    """Times by frame: those of every second frame would give twice the speed."""
    (tmp_path / "times").mkdir()
    (tmp_path / "times/a.csv").write_text("frame,time_s\n0,7.0\n2,7.2\n4,7.4\n")
    with pytest.raises(LabelFileError, match=r"a\.csv.*every frame.*got '2'"):
        frame_times(labels, is_kitti=False)


@pytest.mark.parametrize("text", ["0.1\n", "0.1\n0.1\n", "0.1\nlater\n"])
def test_unusable_times(labels, tmp_path, text):
    (tmp_path / "times").mkdir()
    (tmp_path / "times/a.txt").write_text(text)
    with pytest.raises(LabelFileError, match=r"a\.txt"):
        frame_times(labels, is_kitti=False)
    with pytest.raises(LabelFileError, match=r"a\.csv or a\.txt"):
        frame_times(labels, is_kitti=False, source=TimeSource(times=tmp_path))


def test_boxes_have_the_times_of_their_sequence(tmp_path, row, drives):
    """Sequences with other steps: the median step is that of most frames."""
    drive = [row(frame, 1, "Car", 20.0) for frame in (0, 1, 2, 4)]
    folders = drives(tmp_path, {"a": drive, "b": drive[:2]})
    (tmp_path / "times").mkdir()
    (tmp_path / "times/a.txt").write_text("5.0\n5.05\n5.10\n5.15\n5.20\n")
    boxes = box_set(*folders)
    assert boxes.time_s == pytest.approx([0.0, 0.05, 0.10, 0.20, 0.0, ASSUMED_STEP_S])
    assert boxes.time_step_s == pytest.approx(0.05)
    assert "0.05 s" in boxes.notes[0]
    assert "0.1 s (assumed" in boxes.notes[0]
    rate = BoxSelection(times=TimeSource(frame_rate_hz=25.0))
    assert box_set(*folders, selection=rate).time_step_s == pytest.approx(0.04)
