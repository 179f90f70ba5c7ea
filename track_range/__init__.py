"""track-range: distance, uncertainty and closing speed of every road user in a video, from one camera or two.

    import track_range as tr

    run = tr.Run.stereo("left.mp4", "right.mp4", rig="rig.yaml")  # or tr.Run.mono("dashcam.mp4", focal_px=1150)
    for frame in run:
        for t in frame.objects:
            print(t.id, t.class_name, t.distance_m, t.sigma_m, t.closing_mps, t.ttc_s)
    table = run.to_arrow()

`tr.errors` has the exceptions, and `tr.evaluate` the evaluations against labels. Every name below is
imported when it is first used, so that `import track_range` is fast.
"""

from typing import TYPE_CHECKING, Any

from track_range.api.lazy_names import LazyNames

if TYPE_CHECKING:
    from track_range import errors as errors, evaluate as evaluate
    from track_range.api.evaluation import check as check
    from track_range.api.parts import (
        Detector as Detector,
        Tracker as Tracker,
        load_rig as load_rig,
        open_recording as open_recording,
    )
    from track_range.detection.classes import (
        ROAD_CLASSES as ROAD_CLASSES,
        road_class_id as class_id,
    )
    from track_range.detection.detections import Detections as Detections
    from track_range.foundation.processes import tuned_process as tuned_process
    from track_range.pipeline.frame_result import (
        FrameResult as FrameResult,
        TrackedObject as TrackedObject,
    )
    from track_range.pipeline.state import PipelineState as PipelineState
    from track_range.ranging.filtering.distance_filter import DistanceFilters as DistanceFilters
    from track_range.ranging.filtering.lateral_motion import LateralFilters as LateralFilters
    from track_range.ranging.fusion.fusion import Fusion as Fusion
    from track_range.ranging.measurement.ranges import Ranges as Ranges
    from track_range.ranging.methods.ground_plane import GroundRanger as GroundRanger
    from track_range.ranging.methods.method import (
        ErrorSource as ErrorSource,
        MethodContext as MethodContext,
        Ranger as Ranger,
        RangingMethod as RangingMethod,
    )
    from track_range.ranging.methods.patch_stereo import StereoRanger as StereoRanger
    from track_range.ranging.methods.size_regression import SizeRanger as SizeRanger
    from track_range.ranging.registry import methods as ranging_methods, register as register_method
    from track_range.ranging.warning.collision_warning import CollisionWarning as CollisionWarning
    from track_range.ranging.warning.settings import WarningSettings as WarningSettings
    from track_range.ranging.warning.warnings import Warnings as Warnings
    from track_range.ranging.world.ground_file import load_ground as load_ground
    from track_range.ranging.world.road_plane import RoadPlane as RoadPlane
    from track_range.recording.video.pixel_formats import decoded_image as decoded_image
    from track_range.results.counts.counter import LineCounter as LineCounter
    from track_range.results.events.event import Event as Event
    from track_range.results.events.files import read_events as read_events
    from track_range.results.writers import register_writer as register_writer
    from track_range.run.options.settings import RunSettings as RunSettings
    from track_range.run.pipeline import Pipeline as Pipeline
    from track_range.run.run import Run as Run
    from track_range.stereo.alignment.file import load_alignment as load_alignment
    from track_range.stereo.geometry.camera import PinholeCamera as PinholeCamera
    from track_range.stereo.geometry.frames import Frame as Frame
    from track_range.stereo.geometry.mounting import Mounting as Mounting
    from track_range.stereo.geometry.rectification import Rectifier as Rectifier
    from track_range.stereo.geometry.rig import StereoRig as StereoRig
    from track_range.stereo.matching.patch_matcher import PatchMatcher as PatchMatcher
    from track_range.tracking.registry import register_tracker as register_tracker
    from track_range.tracking.tracks import Tracks as Tracks
    from track_range.views.overlay.annotator import Overlay as Overlay
    from track_range.views.report.page import write_report as write_report

    __version__: str

_NAMES = LazyNames(
    __name__,
    {
        "track_range.errors": "errors=",
        "track_range.evaluate": "evaluate=",
        "track_range.run.run": "Run",
        "track_range.run.pipeline": "Pipeline",
        "track_range.run.options.settings": "RunSettings",
        "track_range.pipeline.frame_result": "FrameResult TrackedObject",
        "track_range.pipeline.state": "PipelineState",
        "track_range.recording.video.pixel_formats": "decoded_image",
        "track_range.api.parts": "open_recording Detector Tracker load_rig",
        "track_range.api.evaluation": "check",
        "track_range.results.events.files": "read_events",
        "track_range.foundation.processes": "tuned_process",
        "track_range.results.events.event": "Event",
        "track_range.stereo.geometry.frames": "Frame",
        "track_range.detection.detections": "Detections",
        "track_range.tracking.tracks": "Tracks",
        "track_range.ranging.measurement.ranges": "Ranges",
        "track_range.ranging.warning.warnings": "Warnings",
        "track_range.stereo.geometry.camera": "PinholeCamera",
        "track_range.stereo.geometry.mounting": "Mounting",
        "track_range.stereo.geometry.rig": "StereoRig",
        "track_range.detection.classes": "ROAD_CLASSES class_id=road_class_id",
        "track_range.ranging.methods.size_regression": "SizeRanger",
        "track_range.ranging.methods.ground_plane": "GroundRanger",
        "track_range.ranging.methods.patch_stereo": "StereoRanger",
        "track_range.stereo.matching.patch_matcher": "PatchMatcher",
        "track_range.ranging.fusion.fusion": "Fusion",
        "track_range.ranging.filtering.distance_filter": "DistanceFilters",
        "track_range.ranging.filtering.lateral_motion": "LateralFilters",
        "track_range.ranging.warning.collision_warning": "CollisionWarning",
        "track_range.ranging.warning.settings": "WarningSettings",
        "track_range.stereo.geometry.rectification": "Rectifier",
        "track_range.stereo.alignment.file": "load_alignment",
        "track_range.ranging.world.road_plane": "RoadPlane",
        "track_range.ranging.world.ground_file": "load_ground",
        "track_range.results.counts.counter": "LineCounter",
        "track_range.views.overlay.annotator": "Overlay",
        "track_range.views.report.page": "write_report",
        "track_range.ranging.methods.method": "Ranger RangingMethod MethodContext ErrorSource",
        "track_range.ranging.registry": "ranging_methods=methods register_method=register",
        "track_range.tracking.registry": "register_tracker",
        "track_range.results.writers": "register_writer",
    },
    former={
        "UserError": "track_range.errors:UserError",
        "ConfigError": "track_range.errors:ConfigError",
        "UsageError": "track_range.errors:UsageError",
        "FrameError": "track_range.errors:FrameError",
        "VideoError": "track_range.errors:VideoError",
        "RigError": "track_range.errors:RigError",
        "ModelError": "track_range.errors:ModelError",
        "DetectorError": "track_range.errors:DetectorError",
        "DownloadError": "track_range.errors:DownloadError",
        "LabelFileError": "track_range.errors:LabelFileError",
        "EventFileError": "track_range.errors:EventFileError",
        "MethodError": "track_range.errors:MethodError",
        "TrackerError": "track_range.errors:TrackerError",
        "WriterError": "track_range.errors:WriterError",
        "OutputError": "track_range.errors:OutputError",
        "evaluate_tracks": "track_range.evaluate:tracks",
        "evaluate_ranges": "track_range.evaluate:ranges",
        "evaluate_stereo": "track_range.evaluate:stereo",
        "evaluate_motion": "track_range.evaluate:motion",
        "evaluate_events": "track_range.evaluate:events",
        "evaluate_detections": "track_range.evaluate:detections",
        "evaluate_detections_by_size": "track_range.evaluate:detections_by_size",
        "evaluate_score_calibration": "track_range.evaluate:score_calibration",
        "ImageTruth": "track_range.evaluate:ImageTruth",
        "StereoPipeline": "track_range:Pipeline",
        "MonoPipeline": "track_range:Pipeline",
    },
)

__all__ = ["__version__", *_NAMES.listed]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("track-range")
    value = _NAMES.value(name)
    if name in __all__:
        globals()[name] = value  # later uses do not call __getattr__
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
