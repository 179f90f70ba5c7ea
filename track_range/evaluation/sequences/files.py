"""Writing tracks as files in MOTChallenge's and in KITTI's format.

MOTChallenge files count frames and pixels from 1, KITTI files from 0, independent of the format of the detections.
KITTI's format has fewer classes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.video_labels.kitti import KITTI_TYPE_OF, kitti_line
from track_range.detection.formats.video_labels.mot import mot_lines
from track_range.evaluation.sequences.find import KITTI_FOLDER, MOT_FOLDER
from track_range.foundation.files.output_files import write_text
from track_range.tracking.tracks import Tracks

_NO_LOCATION_M = (math.nan, math.nan, math.nan)


def write_mot(frames: Sequence[Tracks], out: Path, name: str) -> None:
    """Write mot/NAME.txt in `out`; the first of `frames` is frame 1.

    Raises:
        OutputError: the file cannot be written.
    """
    lines = (mot_lines(tracks, index) for index, tracks in enumerate(frames))
    write_text(out / MOT_FOLDER / f"{name}.txt", "".join(line for frame_lines in lines for line in frame_lines))


def write_kitti(frames: Sequence[Tracks], out: Path, name: str) -> tuple[str, ...]:
    """Write kitti/NAME.txt in `out`, frames from 0; returns a note about boxes omitted because of their class.

    Raises:
        OutputError: the file cannot be written.
    """
    file = Path(KITTI_FOLDER) / f"{name}.txt"
    write_text(out / file, "".join(row for frame, tracks in enumerate(frames) for row in _kitti_rows(tracks, frame)))
    class_id = np.concatenate([np.zeros(0, np.int64), *(tracks.class_id for tracks in frames)])
    omitted = [i for i in np.unique(class_id) if ROAD_CLASSES[i] not in KITTI_TYPE_OF]
    if not omitted:
        return ()
    n, names = int(np.isin(class_id, omitted).sum()), ", ".join(ROAD_CLASSES[i] for i in omitted)
    return (f"{n} of {len(class_id)} boxes omitted from {file.as_posix()}: KITTI has no class for {names}.",)


def _kitti_rows(tracks: Tracks, frame: int) -> list[str]:
    kinds = [KITTI_TYPE_OF.get(ROAD_CLASSES[i]) for i in tracks.class_id]
    boxes, scores = tracks.xyxy_px.tolist(), tracks.score.tolist()
    return [
        kitti_line(frame, track_id, kind, box, _NO_LOCATION_M, score)
        for kind, track_id, box, score in zip(kinds, tracks.track_id.tolist(), boxes, scores, strict=True)
        if kind is not None
    ]
