"""Times of the frames of labelled sequences, whose labels have frame numbers only.

The times are, in this order: a given frame rate; a file of times, given or beside the labels
(times/NAME.csv, timestamps/NAME.txt, ego/NAME.csv and similar); KITTI's mean interval, if the
focal length is one of KITTI's cameras; else 10 Hz is assumed, which a note says.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.files.csv_tables import read_csv_table
from track_range.foundation.files.input_files import MAX_TABLE_BYTES, quoted, read_text

KITTI_STEP_S = 0.1036  # mean frame interval of KITTI's tracking drives
ASSUMED_STEP_S = 0.1  # of other sequences without times: most labelled drives have 10 Hz
_FOLDERS = ("times", "timestamps", "ego")  # beside the folder of labels
_SUFFIXES = (".csv", ".txt")
_COLUMN = "time_s"


@dataclass(frozen=True, slots=True)
class TimeSource:
    """What a user gave about times; both None = found beside the labels, or assumed."""

    # folder of files of times, NAME.csv with a column time_s, or NAME.txt with a time in each line
    times: Path | None = None
    frame_rate_hz: float | None = None


@dataclass(frozen=True, slots=True)
class FrameTimes:
    """Times of the frames of one sequence: of a file, or a constant step."""

    step_s: float  # median interval
    origin: str  # for notes; the folder of a file of times
    by_frame_s: FloatArray | None = None  # (F,) time of each frame; None = constant step
    file_name: str = ""  # of the times by frame

    def at(self, frame: IntArray) -> FloatArray:
        """(N,) seconds from the first frame; LabelFileError for a frame without a time."""
        if self.by_frame_s is None:
            return np.asarray(frame * self.step_s, np.float64)
        if len(frame) and frame.max() >= len(self.by_frame_s):
            raise LabelFileError(
                f"{Path(self.origin, self.file_name)}: expected a time for each frame, up to "
                f"frame {frame.max()}, found {len(self.by_frame_s)} times."
            )
        return self.by_frame_s[frame]


def frame_times(labels: Path, *, is_kitti: bool, source: TimeSource | None = None) -> FrameTimes:
    """Times of the frames of the label file `labels`; LabelFileError if times cannot be read."""
    source = source or TimeSource()
    if source.frame_rate_hz is not None:
        return FrameTimes(1 / source.frame_rate_hz, "the given frame rate")
    folders = [source.times] if source.times else [labels.parent.parent / name for name in _FOLDERS]
    paths = [folder / f"{labels.stem}{suffix}" for folder in folders for suffix in _SUFFIXES]
    path = next((path for path in paths if path.is_file()), None)
    if path is not None:
        time_s = _read_times(path)
        step_s = float(np.median(np.diff(time_s)))
        return FrameTimes(step_s, str(path.parent), time_s - time_s[0], path.name)
    if source.times:
        raise LabelFileError(
            f"{source.times}: expected times of the frames in {paths[0].name} or {paths[1].name}, "
            "found neither."
        )
    if is_kitti:
        return FrameTimes(KITTI_STEP_S, "the mean interval of KITTI's drives")
    return FrameTimes(ASSUMED_STEP_S, "assumed; give --frame-rate or --times")


def _read_times(path: Path) -> FloatArray:
    """(F,) times of the frames 0, 1, ... in s, of at least two frames."""
    if path.suffix == ".csv":
        table = read_csv_table(path, LabelFileError, f"a column {_COLUMN}")
        table.require((_COLUMN,))
        time_s = table.finite(_COLUMN)
        if "frame" in table:
            frame = table.finite("frame")
            table.check("frame", frame == np.arange(len(frame)), "every frame from 0 on")
    else:
        text = read_text(path, LabelFileError, "times of frames", max_bytes=MAX_TABLE_BYTES)
        time_s = np.array([_seconds(line, path) for line in text.splitlines() if line.strip()])
    if len(time_s) < 2 or (np.diff(time_s) <= 0).any():
        raise LabelFileError(
            f"{path}: expected the times of at least two frames, each later than the one before."
        )
    return time_s


def _seconds(line: str, path: Path) -> float:
    """Seconds of a line: a number, or a date and time as KITTI writes it."""
    text = line.strip()
    try:
        return float(text.split()[0])
    except ValueError:
        pass
    try:
        return float(np.datetime64(text, "ns").astype(np.int64)) / 1e9
    except ValueError as error:
        raise LabelFileError(
            f"{path}: expected a time in seconds, or a date and time, in each line, found "
            f"{quoted(text)}."
        ) from error
