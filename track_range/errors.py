"""Exceptions that an input can cause; all derive from `UserError`. Names are imported when they are
first used.
"""

from typing import TYPE_CHECKING, Any

from track_range.api.lazy_names import LazyNames

if TYPE_CHECKING:
    from track_range.detection.catalogue.download import DownloadError as DownloadError
    from track_range.detection.detector import DetectorError as DetectorError
    from track_range.detection.formats.tables.errors import LabelFileError as LabelFileError
    from track_range.detection.models.onnx_session import ModelError as ModelError
    from track_range.foundation.errors import (
        ConfigError as ConfigError,
        UsageError as UsageError,
        UserError as UserError,
    )
    from track_range.foundation.files.output_files import OutputError as OutputError
    from track_range.pipeline.state import StateError as StateError
    from track_range.ranging.methods.method import MethodError as MethodError
    from track_range.ranging.world.road_plane_fit import GroundError as GroundError
    from track_range.recording.video.frame import FrameError as FrameError, VideoError as VideoError
    from track_range.results.events.files import EventFileError as EventFileError
    from track_range.results.writers import WriterError as WriterError
    from track_range.stereo.geometry.rig import RigError as RigError
    from track_range.tracking.registry import TrackerError as TrackerError

_NAMES = LazyNames(
    __name__,
    {
        "track_range.foundation.errors": "UserError ConfigError UsageError",
        "track_range.recording.video.frame": "FrameError VideoError",
        "track_range.pipeline.state": "StateError",
        "track_range.stereo.geometry.rig": "RigError",
        "track_range.detection.models.onnx_session": "ModelError",
        "track_range.detection.detector": "DetectorError",
        "track_range.detection.catalogue.download": "DownloadError",
        "track_range.detection.formats.tables.errors": "LabelFileError",
        "track_range.results.events.files": "EventFileError",
        "track_range.ranging.methods.method": "MethodError",
        "track_range.ranging.world.road_plane_fit": "GroundError",
        "track_range.tracking.registry": "TrackerError",
        "track_range.results.writers": "WriterError",
        "track_range.foundation.files.output_files": "OutputError",
    },
)

__all__ = [*_NAMES.listed]


def __getattr__(name: str) -> Any:
    return _NAMES.value(name)


def __dir__() -> list[str]:
    return sorted(__all__)
