"""OpenedDetectors: detectors that stay open for the next run, for processes that run many recordings."""

from __future__ import annotations

from pathlib import Path

from track_range.detection.yolo.detector import YoloDetector
from track_range.run.options.detector_options import DetectorOptions, open_detector


class OpenedDetectors:
    """The last opened detector, which a run with the same file and options uses again.

    The results are those of a newly opened detector. One run at a time may use it.
    """

    def __init__(self) -> None:
        self._key: tuple[object, ...] | None = None
        self._detector: YoloDetector | None = None

    def __call__(self, path: Path, options: DetectorOptions) -> YoloDetector:
        """The detector of a file and options.

        Raises:
            ModelError, ClassNameError, ConfigError: see `open_detector`.
        """
        key = (path, options, _state(path), None if options.names is None else _state(Path(options.names)))
        if self._detector is None or key != self._key:
            self._detector = self._key = None  # two networks at a time would need twice the memory
            self._detector = open_detector(path, options)
            self._key = key
        self._detector.n_invalid = 0
        return self._detector


def _state(path: Path) -> tuple[int, int] | None:
    """Size and time of change of a file; None without one."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_size, status.st_mtime_ns
