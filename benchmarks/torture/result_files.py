"""Checks of the result files of a run that may have ended early."""

from __future__ import annotations

from pathlib import Path

import av

MAX_LAG_FRAMES = 5
"""Largest number of frames by which the overlay may lag behind the rows after a kill."""

FRAMES_BEFORE_PLAYABLE = 10
"""Number of frames, a second of video, after which the overlay must be playable."""

_MOT_COLUMNS = 10


def result_problems(
    folder: Path, *, first_frame: int = 0, has_overlay: bool = False, max_lag: int = 0
) -> tuple[str, ...]:
    """What is wrong with the result files in a folder.

    Args:
        folder: folder of the run.
        first_frame: number of the first frame.
        has_overlay: whether overlay.mp4 is checked.
        max_lag: largest number of frames that overlay.mp4 may lack.
    """
    faults: list[str] = []
    frames = _frames(folder / "tracks.csv", faults, offset=0)
    mot_frames = _frames(folder / "mot.txt", faults, offset=1)
    if frames is not None and mot_frames is not None:
        last = min(max(frames, default=0), max(mot_frames, default=0))
        if abs(max(frames, default=0) - max(mot_frames, default=0)) > 1 or {f for f in frames ^ mot_frames if f < last}:
            faults.append(
                f"frames of tracks.csv to {max(frames, default=0)}, of mot.txt to {max(mot_frames, default=0)}"
            )
    if has_overlay and frames:
        n_shown, error = decodable_frames(folder / "overlay.mp4")
        n_rows = max(frames) - first_frame + 1
        if error and n_rows > FRAMES_BEFORE_PLAYABLE:
            faults.append(f"overlay.mp4 is not playable: {error}")
        elif n_rows - n_shown > (FRAMES_BEFORE_PLAYABLE if error else max_lag):
            faults.append(f"overlay.mp4 has {n_shown} frames, tracks.csv {n_rows}")
    return tuple(faults)


def decodable_frames(video: Path) -> tuple[int, str]:
    """Number of frames of a video that can be decoded, and the error that ends it, if any."""
    n_frames = 0
    try:
        with av.open(str(video)) as reader:
            for _ in reader.decode(video=0):
                n_frames += 1
    except (av.FFmpegError, OSError, IndexError) as error:
        return n_frames, f"{type(error).__name__} after {n_frames} frames"
    return n_frames, ""


def _frames(path: Path, faults: list[str], *, offset: int) -> set[int] | None:
    """Numbers of the frames in a file of rows; None if there is no such file or it is damaged, which is recorded."""
    if not path.exists():
        return None
    text = path.read_text(encoding="utf-8")
    if text and not text.endswith("\n"):
        faults.append(f"{path.name} ends inside a row: {text.splitlines()[-1][:80]!r}")
        return None
    rows = [line.split(",") for line in text.splitlines()]
    n_columns = _MOT_COLUMNS if offset else len(rows[0]) if rows else 0
    if cut := [row for row in rows if len(row) != n_columns]:
        faults.append(f"{path.name} has a cut row: {','.join(cut[0])[:80]!r}")
        return None
    return {int(row[0]) - offset for row in rows if row[0].isdigit()}
