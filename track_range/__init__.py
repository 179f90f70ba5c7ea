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
    from track_range.api.evaluation import evaluate_events as evaluate_events
    from track_range.api.evaluation import evaluate_ranges as evaluate_ranges
    from track_range.api.evaluation import evaluate_stereo as evaluate_stereo
    from track_range.api.evaluation import evaluate_tracks as evaluate_tracks
    from track_range.api.parts import Detector as Detector
    from track_range.api.parts import Tracker as Tracker
    from track_range.api.parts import load_rig as load_rig
    from track_range.detection.classes import ROAD_CLASSES as ROAD_CLASSES
    from track_range.detection.classes import road_class_id as class_id
    from track_range.detection.detections import Detections as Detections
    from track_range.detection.evaluation import evaluate_detections as evaluate_detections
    from track_range.detection.evaluation.object_sizes import evaluate_by_size as evaluate_detections_by_size
    from track_range.detection.evaluation.score_calibration import evaluate_calibration as evaluate_score_calibration
    from track_range.detection.formats.errors import LabelFileError as LabelFileError
    from track_range.detection.formats.image_labels.image_truth import ImageTruth as ImageTruth
    from track_range.detection.models.onnx_session import ModelError as ModelError
    from track_range.foundation.errors import ConfigError as ConfigError
    from track_range.foundation.errors import UsageError as UsageError
    from track_range.foundation.errors import UserError as UserError
    from track_range.foundation.files.output_files import OutputError as OutputError
    from track_range.foundation.processes import tuned_process as tuned_process
    from track_range.pipeline.frame_result import FrameResult as FrameResult
    from track_range.pipeline.frame_result import TrackedObject as TrackedObject
    from track_range.ranging.filtering.distance_filter import DistanceFilters as DistanceFilters
    from track_range.ranging.filtering.lateral_motion import LateralFilters as LateralFilters
    from track_range.ranging.fusion.fusion import Fusion as Fusion
    from track_range.ranging.method import ErrorSource as ErrorSource
    from track_range.ranging.method import MethodError as MethodError
    from track_range.ranging.method import Ranger as Ranger
    from track_range.ranging.method import RangingMethod as RangingMethod
    from track_range.ranging.methods.ground_plane import GroundRanger as GroundRanger
    from track_range.ranging.methods.patch_stereo import StereoRanger as StereoRanger
    from track_range.ranging.methods.size_regression import SizeRanger as SizeRanger
    from track_range.ranging.ranges import Ranges as Ranges
    from track_range.ranging.registry import methods as ranging_methods
    from track_range.ranging.registry import register as register_method
    from track_range.ranging.warning.collision_warning import CollisionWarning as CollisionWarning
    from track_range.ranging.warning.settings import WarningSettings as WarningSettings
    from track_range.ranging.warning.warnings import Warnings as Warnings
    from track_range.recording.frame import VideoError as VideoError
    from track_range.recording.recording import open_recording as open_recording
    from track_range.results.events.event import Event as Event
    from track_range.results.events.files import EventFileError as EventFileError
    from track_range.results.events.files import read_events as read_events
    from track_range.results.writers import WriterError as WriterError
    from track_range.results.writers import register_writer as register_writer
    from track_range.run.pipeline import FrameError as FrameError
    from track_range.run.pipeline import MonoPipeline as MonoPipeline
    from track_range.run.pipeline import Pipeline as Pipeline
    from track_range.run.pipeline import StereoPipeline as StereoPipeline
    from track_range.run.run import Run as Run
    from track_range.run.settings import RunSettings as RunSettings
    from track_range.stereo.alignment.file import load_alignment as load_alignment
    from track_range.stereo.geometry.camera import PinholeCamera as PinholeCamera
    from track_range.stereo.geometry.frames import Frame as Frame
    from track_range.stereo.geometry.rectification import Rectifier as Rectifier
    from track_range.stereo.geometry.rig import RigError as RigError
    from track_range.stereo.geometry.rig import StereoRig as StereoRig
    from track_range.stereo.matching.patch_matcher import PatchMatcher as PatchMatcher
    from track_range.tracking.registry import TrackerError as TrackerError
    from track_range.tracking.registry import register_tracker as register_tracker
    from track_range.tracking.tracks import Tracks as Tracks
    from track_range.views.overlay.annotator import Overlay as Overlay
    from track_range.views.report.page import write_report as write_report

    __version__: str

_MODULE_OF = {
    # a run
    "Run": "run.run",
    "Pipeline": "run.pipeline",
    "StereoPipeline": "run.pipeline",
    "MonoPipeline": "run.pipeline",
    "RunSettings": "run.settings",
    "FrameResult": "pipeline.frame_result",
    "TrackedObject": "pipeline.frame_result",
    "open_recording": "api.parts",
    "read_events": "results.events.files",
    "tuned_process": "foundation.processes",
    # types
    "Event": "results.events.event",
    "Frame": "stereo.geometry.frames",
    "Detections": "detection.detections",
    "ImageTruth": "detection.formats.image_labels.image_truth",
    "Tracks": "tracking.tracks",
    "Ranges": "ranging.ranges",
    "Warnings": "ranging.warning.warnings",
    "PinholeCamera": "stereo.geometry.camera",
    "StereoRig": "stereo.geometry.rig",
    "ROAD_CLASSES": "detection.classes",
    "class_id": "detection.classes:road_class_id",
    # parts
    "Detector": "api.parts",
    "Tracker": "api.parts",
    "SizeRanger": "ranging.methods.size_regression",
    "GroundRanger": "ranging.methods.ground_plane",
    "StereoRanger": "ranging.methods.patch_stereo",
    "PatchMatcher": "stereo.matching.patch_matcher",
    "Fusion": "ranging.fusion.fusion",
    "DistanceFilters": "ranging.filtering.distance_filter",
    "LateralFilters": "ranging.filtering.lateral_motion",
    "CollisionWarning": "ranging.warning.collision_warning",
    "WarningSettings": "ranging.warning.settings",
    "Rectifier": "stereo.geometry.rectification",
    "load_rig": "api.parts",
    "load_alignment": "stereo.alignment.file",
    "Overlay": "views.overlay.annotator",
    # evaluation
    "evaluate_events": "api.evaluation",
    "evaluate_ranges": "api.evaluation",
    "evaluate_stereo": "api.evaluation",
    "evaluate_tracks": "api.evaluation",
    "evaluate_detections": "detection.evaluation",
    "evaluate_detections_by_size": "detection.evaluation.object_sizes:evaluate_by_size",
    "evaluate_score_calibration": "detection.evaluation.score_calibration:evaluate_calibration",
    "write_report": "views.report.page",
    # extension
    "Ranger": "ranging.method",
    "RangingMethod": "ranging.method",
    "ErrorSource": "ranging.method",
    "ranging_methods": "ranging.registry:methods",
    "register_method": "ranging.registry:register",
    "register_tracker": "tracking.registry",
    "register_writer": "results.writers",
    # errors
    "UserError": "foundation.errors",
    "ConfigError": "foundation.errors",
    "UsageError": "foundation.errors",
    "FrameError": "run.pipeline",
    "VideoError": "recording.frame",
    "RigError": "stereo.geometry.rig",
    "ModelError": "detection.models.onnx_session",
    "LabelFileError": "detection.formats.errors",
    "EventFileError": "results.events.files",
    "MethodError": "ranging.method",
    "TrackerError": "tracking.registry",
    "WriterError": "results.writers",
    "OutputError": "foundation.files.output_files",
}
"""Module of each public name, relative to track_range; "module:NAME" where the name differs there."""

__all__ = ["__version__", *_MODULE_OF]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("track-range")
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'track_range' has no attribute {name!r}")
    module, _, attribute = _MODULE_OF[name].partition(":")
    value = getattr(import_module(f"track_range.{module}"), attribute or name)
    globals()[name] = value  # later uses do not call __getattr__
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
