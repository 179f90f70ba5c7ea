"""What survives a round trip through each label format, with its precision, size and time.

Boxes in 2,000 frames, of 10 tracks, with distances for 80 % of them, are written and read again:

    edges, distance, score   largest difference; "-" = not in the format
    ids, classes, predicted  fraction of the boxes for which the value is the same; "-" = not in the format
"""

from __future__ import annotations

import tempfile
import time
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Figures, option, workload
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.label_formats import LABEL_FORMATS
from track_range.detection.formats.tables.box_table import BoxTable, VideoFacts
from track_range.detection.formats.tables.label_format import LabelFormat

_N_TRACKS = 10
_SIZE_PX = (1242, 375)


@workload(option("--frames", default=2000, help="number of frames"))
def formats(options: Namespace) -> Figures:
    table = _tracks(options.frames)
    with tempfile.TemporaryDirectory() as folder:
        return {
            name: _figures(table, label_format, Path(folder) / name)
            for name, label_format in LABEL_FORMATS.usable.items()
            if label_format.write is not None
        }


def _tracks(n_frames: int) -> BoxTable:
    rng = np.random.default_rng(1)
    frame = np.repeat(np.arange(n_frames), _N_TRACKS)
    track_id = np.tile(np.arange(1, _N_TRACKS + 1), n_frames)
    first = rng.uniform([0, 0], [1100, 300], (len(frame), 2))
    distance_m = np.where(rng.random(len(frame)) < 0.8, rng.uniform(2, 150, len(frame)), np.nan)
    return BoxTable.of(
        frame,
        track_id,
        [ROAD_CLASSES[number % len(ROAD_CLASSES)] for number in track_id.tolist()],
        np.concatenate([first, first + rng.uniform(5, 70, (len(frame), 2))], axis=1) - 0.5,
        score=rng.random(len(frame)),
        observed=rng.random(len(frame)) < 0.9,
        distance_m=distance_m,
        sigma_m=distance_m / 20,
        video=VideoFacts("drive", n_frames, 0, _SIZE_PX, 10.0),
    )


def _figures(table: BoxTable, label_format: LabelFormat, path: Path) -> dict[str, float | None]:
    if label_format.write is None:
        raise ValueError(f"{label_format.name}: expected a format that is written")
    start_s = time.perf_counter()
    label_format.write(table, path)
    written_s = time.perf_counter()
    back = label_format.read(path, VideoFacts(size_px=_SIZE_PX))
    read_s = time.perf_counter()
    if (back.track_id < 0).all():
        table, back = _by_box(table), _by_box(back)
    files = [file for file in (path.rglob("*") if path.is_dir() else [path]) if file.is_file()]
    return {
        "edges_px": float(np.abs(back.xyxy_px - table.xyxy_px).max()),
        "distance_m": _error(back.distance_m, table.distance_m),
        "score": _error(back.score, table.score),
        "ids_pct": _fraction(
            back.track_id == table.track_id, is_there=bool((back.track_id >= 0).any())
        ),
        "classes_pct": _fraction(
            back.class_id == table.class_id, is_there=bool((back.class_id >= 0).any())
        ),
        "predicted_pct": _fraction(
            back.observed == table.observed, is_there=not back.observed.all()
        ),
        "size_mb": sum(file.stat().st_size for file in files) / 1e6,
        "write_s": written_s - start_s,
        "read_s": read_s - written_s,
    }


def _by_box(table: BoxTable) -> BoxTable:
    """A table sorted by frame and position, which do not depend on identities."""
    return table.select(np.lexsort((table.xyxy_px[:, 0], table.frame)))


def _error(values: np.ndarray[Any, Any], expected: np.ndarray[Any, Any]) -> float | None:
    """Largest difference of values that are known in both; None if there are none."""
    both = np.isfinite(values) & np.isfinite(expected)
    return float(np.abs(values - expected)[both].max()) if both.any() else None


def _fraction(is_same: np.ndarray[Any, Any], *, is_there: bool) -> float | None:
    return 100 * float(is_same.mean()) if is_there else None
