"""track-range: distance, uncertainty and closing speed of every road user in a video, from one camera or two.

    import track_range as tr

    run = tr.Run.stereo("left.mp4", "right.mp4", rig="rig.yaml")  # or tr.Run.mono("dashcam.mp4", focal_px=1150)
    for frame in run:
        for t in frame.objects:
            print(t.id, t.class_name, t.distance_m, t.sigma_m, t.closing_mps, t.ttc_s)
    table = run.to_arrow()

Every name below is imported when it is first used, so that `import track_range` is fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from track_range.api.evaluation import (
        evaluate_events as evaluate_events,
        evaluate_motion as evaluate_motion,
        evaluate_ranges as evaluate_ranges,
        evaluate_stereo as evaluate_stereo,
        evaluate_tracks as evaluate_tracks,
    )
    from track_range.api.parts import Detector as Detector, Tracker as Tracker, load_rig as load_rig
    from track_range.detection.catalogue.download import DownloadError as DownloadError
    from track_range.detection.classes import (
        ROAD_CLASSES as ROAD_CLASSES,
        road_class_id as class_id,
    )
    from track_range.detection.detections import Detections as Detections
    from track_range.detection.detector import DetectorError as DetectorError
    from track_range.detection.evaluation import evaluate_detections as evaluate_detections
    from track_range.detection.evaluation.object_sizes import (
        evaluate_by_size as evaluate_detections_by_size,
    )
    from track_range.detection.evaluation.score_calibration import (
        evaluate_calibration as evaluate_score_calibration,
    )
    from track_range.detection.formats.image_labels.image_truth import ImageTruth as ImageTruth
    from track_range.detection.formats.tables.errors import LabelFileError as LabelFileError
    from track_range.detection.models.onnx_session import ModelError as ModelError
    from track_range.foundation.errors import (
        ConfigError as ConfigError,
        UsageError as UsageError,
        UserError as UserError,
    )
    from track_range.foundation.files.output_files import OutputError as OutputError
    from track_range.foundation.processes import tuned_process as tuned_process
    from track_range.pipeline.frame_result import (
        FrameResult as FrameResult,
        TrackedObject as TrackedObject,
    )
    from track_range.ranging.filtering.distance_filter import DistanceFilters as DistanceFilters
    from track_range.ranging.filtering.lateral_motion import LateralFilters as LateralFilters
    from track_range.ranging.fusion.fusion import Fusion as Fusion
    from track_range.ranging.measurement.ranges import Ranges as Ranges
    from track_range.ranging.methods.ground_plane import GroundRanger as GroundRanger
    from track_range.ranging.methods.method import (
        ErrorSource as ErrorSource,
        MethodContext as MethodContext,
        MethodError as MethodError,
        Ranger as Ranger,
        RangingMethod as RangingMethod,
    )
    from track_range.ranging.methods.patch_stereo import StereoRanger as StereoRanger
    from track_range.ranging.methods.size_regression import SizeRanger as SizeRanger
    from track_range.ranging.registry import methods as ranging_methods, register as register_method
    from track_range.ranging.warning.collision_warning import CollisionWarning as CollisionWarning
    from track_range.ranging.warning.settings import WarningSettings as WarningSettings
    from track_range.ranging.warning.warnings import Warnings as Warnings
    from track_range.recording.recording import open_recording as open_recording
    from track_range.recording.video.frame import VideoError as VideoError
    from track_range.results.events.event import Event as Event
    from track_range.results.events.files import (
        EventFileError as EventFileError,
        read_events as read_events,
    )
    from track_range.results.writers import (
        WriterError as WriterError,
        register_writer as register_writer,
    )
    from track_range.run.options.settings import RunSettings as RunSettings
    from track_range.run.pipeline import (
        FrameError as FrameError,
        Pipeline as MonoPipeline,
        Pipeline as Pipeline,
        Pipeline as StereoPipeline,
    )
    from track_range.run.run import Run as Run
    from track_range.stereo.alignment.file import load_alignment as load_alignment
    from track_range.stereo.geometry.camera import PinholeCamera as PinholeCamera
    from track_range.stereo.geometry.frames import Frame as Frame
    from track_range.stereo.geometry.rectification import Rectifier as Rectifier
    from track_range.stereo.geometry.rig import RigError as RigError, StereoRig as StereoRig
    from track_range.stereo.matching.patch_matcher import PatchMatcher as PatchMatcher
    from track_range.tracking.registry import (
        TrackerError as TrackerError,
        register_tracker as register_tracker,
    )
    from track_range.tracking.tracks import Tracks as Tracks
    from track_range.views.overlay.annotator import Overlay as Overlay
    from track_range.views.report.page import write_report as write_report

    __version__: str

_NAMES = {
    "run.run": "Run",
    "run.pipeline": "Pipeline FrameError",
    "run.options.settings": "RunSettings",
    "pipeline.frame_result": "FrameResult TrackedObject",
    "api.parts": "open_recording Detector Tracker load_rig",
    "results.events.files": "read_events EventFileError",
    "foundation.processes": "tuned_process",
    "results.events.event": "Event",
    "stereo.geometry.frames": "Frame",
    "detection.detections": "Detections",
    "detection.formats.image_labels.image_truth": "ImageTruth",
    "tracking.tracks": "Tracks",
    "ranging.measurement.ranges": "Ranges",
    "ranging.warning.warnings": "Warnings",
    "stereo.geometry.camera": "PinholeCamera",
    "stereo.geometry.rig": "StereoRig RigError",
    "detection.classes": "ROAD_CLASSES class_id=road_class_id",
    "ranging.methods.size_regression": "SizeRanger",
    "ranging.methods.ground_plane": "GroundRanger",
    "ranging.methods.patch_stereo": "StereoRanger",
    "stereo.matching.patch_matcher": "PatchMatcher",
    "ranging.fusion.fusion": "Fusion",
    "ranging.filtering.distance_filter": "DistanceFilters",
    "ranging.filtering.lateral_motion": "LateralFilters",
    "ranging.warning.collision_warning": "CollisionWarning",
    "ranging.warning.settings": "WarningSettings",
    "stereo.geometry.rectification": "Rectifier",
    "stereo.alignment.file": "load_alignment",
    "views.overlay.annotator": "Overlay",
    "api.evaluation": "evaluate_events evaluate_motion evaluate_ranges evaluate_stereo "
    "evaluate_tracks",
    "detection.evaluation": "evaluate_detections",
    "detection.evaluation.object_sizes": "evaluate_detections_by_size=evaluate_by_size",
    "detection.evaluation.score_calibration": "evaluate_score_calibration=evaluate_calibration",
    "views.report.page": "write_report",
    "ranging.methods.method": "Ranger RangingMethod MethodContext ErrorSource MethodError",
    "ranging.registry": "ranging_methods=methods register_method=register",
    "tracking.registry": "register_tracker TrackerError",
    "results.writers": "register_writer WriterError",
    "foundation.errors": "UserError ConfigError UsageError",
    "recording.video.frame": "VideoError",
    "detection.detector": "DetectorError",
    "detection.catalogue.download": "DownloadError",
    "detection.models.onnx_session": "ModelError",
    "detection.formats.tables.errors": "LabelFileError",
    "foundation.files.output_files": "OutputError",
}
"""Public names by module, relative to track_range; "name=NAME" where the name differs there."""

_SOURCES = {
    name.partition("=")[0]: (module, name.rpartition("=")[2])
    for module, names in _NAMES.items()
    for name in names.split()
}

# names of earlier versions, which are not listed
_FORMER_NAMES = {"StereoPipeline": "Pipeline", "MonoPipeline": "Pipeline"}

__all__ = ["__version__", *_SOURCES]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("track-range")
    source = _SOURCES.get(_FORMER_NAMES.get(name, name))
    if source is None:
        raise AttributeError(f"module 'track_range' has no attribute {name!r}")
    module, attribute = source
    value = getattr(import_module(f"track_range.{module}"), attribute)
    globals()[name] = value  # later uses do not call __getattr__
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
