"""run.rrd: the tracks of a run for Rerun, with a blueprint: video, bird's eye, 3-D scene and plots.

    camera/image/video           overlay.mp4, logged at the end; H.264
    camera/image/boxes           boxes in the image
    world/camera, world/tracks   camera and cuboids (x right, y down, z forward)
    birds_eye/tracks             their footprints: x right, y = -z
    map/vehicle, map/tracks      poses and positions in the world (x forward, y left, z up); paths in map/paths
    distance/track_ID, closing_speed/track_ID, log

Timelines: `frame`, and `time` (UTC where the recording knows it, else seconds from the first
frame).

The file is written at the end of the run, since rerun-sdk hangs when it writes to a full disk, and
since its stream in memory cannot be written in parts (each has an index that is valid for this part
only). Until then the content is in memory, about 1.5 kB per frame with 10 tracks. A killed run
leaves no file; `track-range view` makes it from the rows.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from track_range.foundation.files import atomic_files
from track_range.pipeline.colours import track_colour
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.world.ego_path import EgoPose
from track_range.results.formats.run_info import RunInfo
from track_range.results.formats.scene import (
    TrackObject,
    check_extra,
    track_objects,
    transforms,
)
from track_range.results.rows.columns import viewer_columns

RERUN_FILE = "run.rrd"
APPLICATION = "track-range"  # application id: the viewer stores changes of the blueprint by it
_VIDEO, _BOXES, _TRACKS, _TOP_VIEW = (
    "camera/image/video",
    "camera/image/boxes",
    "world/tracks",
    "birds_eye/tracks",
)
_MAP, _VEHICLE, _MAP_TRACKS, _PATHS = "map", "map/vehicle", "map/tracks", "map/paths"
_DISTANCE, _CLOSING, _LOG = "distance", "closing_speed", "log"
_MAX_VIDEO_BYTES = 1_000_000_000  # largest video that is embedded; the viewer holds it in memory
_PREDICTED_ALPHA, _OBSERVED_ALPHA = 110, 255


class RerunWriter:
    """Writer of run.rrd. The last frame is held back, so that it can be discarded."""

    files = (RERUN_FILE,)

    def check_requirements(self) -> None:
        """Raise ExtraError unless rerun-sdk is installed."""
        check_extra("rrd", "rerun", "rerun")

    def open(self, info: RunInfo, folder: Path) -> None:
        """Log the camera, the provenance and the blueprint."""
        self.check_requirements()
        import rerun as rr

        self._info = info
        self._recording = rr.RecordingStream(APPLICATION)
        self._stream = rr.binary_stream(self._recording)
        self._recording.send_blueprint(_blueprint(has_video=info.overlay is not None))
        metadata = {
            key.rpartition(".")[2]: value for key, value in info.provenance.metadata().items()
        }
        self._recording.send_property(
            "provenance", rr.AnyValues(drop_untyped_nones=True, **metadata)
        )
        pinhole = rr.Pinhole(
            resolution=[info.camera.width_px, info.camera.height_px],
            focal_length=[info.camera.fx_px, info.camera.fy_px],
            principal_point=[info.camera.cx_px, info.camera.cy_px],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=3.0,
        )
        self._recording.log("world", rr.ViewCoordinates.RDF, static=True)
        self._recording.log(_MAP, rr.ViewCoordinates.FLU, static=True)
        self._path: list[tuple[float, float, float]] = []
        self._paths: dict[int, list[tuple[float, float, float]]] = {}  # by track
        self._recording.log("world/camera", pinhole, static=True)
        self._recording.log(
            "birds_eye/camera", rr.Points2D([[0.0, 0.0]], labels=["camera"], radii=0.5), static=True
        )
        self._held: FrameResult | None = None
        self._frames: list[int] = []
        self._times_s: list[float] = []
        self._last_s, self._named = 0.0, set[int]()
        self._first_notes = info.notes
        self._columns = viewer_columns()
        self._file = folder / RERUN_FILE

    def write(self, result: FrameResult) -> None:
        """Log the previous frame, and hold this frame."""
        self._release()
        self._held = result

    def discard_last(self) -> None:
        """Discard the frame that is held."""
        self._held = None

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Log the last frame, the notes of the run and the video, and write the file."""
        try:
            self._release()
            notes = (summary or {}).get("notes") or ()
            self._log_notes(
                (*self._first_notes, *(note for note in notes if note not in self._info.notes))
            )
            self._log_video()
            self._log_paths()
            atomic_files.write_bytes(self._file, self._stream.read() or b"")
        finally:
            self._recording.disconnect()

    def _release(self) -> None:
        if self._held is None:
            return
        result, self._held = self._held, None
        time_s = result.time_s
        if self._info.start_utc_s is not None:
            time_s = (
                result.utc_s if math.isfinite(result.utc_s) else self._info.start_utc_s + time_s
            )
        self._last_s = max(self._last_s, time_s)
        self._frames.append(result.index)
        self._times_s.append(self._last_s)
        self._recording.set_time("frame", sequence=result.index)
        if self._info.start_utc_s is None:
            self._recording.set_time("time", duration=self._last_s)
        else:
            self._recording.set_time("time", timestamp=self._last_s)
        self._log_notes(self._first_notes)
        self._first_notes = ()
        objects = list(track_objects(result, self._columns))
        self._log_objects(objects)
        self._log_map(objects, result.ego_pose)

    def _log_map(self, objects: Sequence[TrackObject], pose: EgoPose) -> None:
        import rerun as rr

        if not math.isfinite(pose.x_m):
            return
        vehicle, _ = transforms(pose, self._info.mounting)
        at_m, xyzw = vehicle.at_m, vehicle.xyzw
        self._path.append(at_m)
        self._recording.log(
            _VEHICLE, rr.Transform3D(translation=at_m, quaternion=rr.Quaternion(xyzw=xyzw))
        )
        self._recording.log(
            _VEHICLE, rr.Arrows3D(vectors=[[4.0, 0.0, 0.0]], radii=0.3, labels=["camera"])
        )
        placed = [shown for shown in objects if "world_x_m" in shown.figures]
        points = [(shown.figure("world_x_m"), shown.figure("world_y_m"), 0.0) for shown in placed]
        colours = [_rgba(shown) for shown in placed]
        labels = [shown.label for shown in placed]
        self._recording.log(
            _MAP_TRACKS, rr.Points3D(points, radii=0.6, colors=colours, labels=labels)
        )
        for shown, point in zip(placed, points, strict=True):
            self._paths.setdefault(shown.track_id, []).append(point)

    def _log_paths(self) -> None:
        """The paths of the whole run in the frame `map`."""
        import rerun as rr

        if not self._path:
            return
        self._recording.log(
            f"{_PATHS}/vehicle", rr.LineStrips3D([self._path], radii=0.2), static=True
        )
        colours = [track_colour(track_id)[::-1] for track_id in self._paths]
        strips = rr.LineStrips3D(list(self._paths.values()), radii=0.05, colors=colours)
        self._recording.log(f"{_PATHS}/tracks", strips, static=True)

    def _log_objects(self, objects: Sequence[TrackObject]) -> None:
        import rerun as rr

        boxes = rr.Boxes2D(
            array=np.array([shown.xyxy_px for shown in objects]).reshape(-1, 4)
            + 0.5,  # Rerun's centre of the first pixel
            array_format=rr.Box2DFormat.XYXY,
            colors=[_rgba(shown) for shown in objects],
            labels=[shown.label for shown in objects],
        )
        self._recording.log(_BOXES, boxes)
        ranged = [shown for shown in objects if shown.has_cuboid]
        centres = np.array([shown.centre_m for shown in ranged]).reshape(-1, 3)
        sizes = np.array([shown.lwh_m for shown in ranged]).reshape(-1, 3)
        turns = np.array([shown.xyzw for shown in ranged]).reshape(-1, 4)
        style: dict[str, Any] = {
            "colors": [_rgba(shown) for shown in ranged],
            "labels": [shown.label for shown in ranged],
        }
        cuboids = rr.Boxes3D(centers=centres, sizes=sizes, quaternions=turns, **style)
        self._recording.log(_TRACKS, cuboids)
        above = [shown.corners_m[[0, 1, 2, 3, 0], ::2] * [1.0, -1.0] for shown in ranged]
        self._recording.log(_TOP_VIEW, rr.LineStrips2D(above, radii=0.1, **style))
        for shown in objects:
            values = {_DISTANCE: shown.distance_m, _CLOSING: shown.figure("closing_mps")}
            paths = {f"{plot}/track_{shown.track_id}": value for plot, value in values.items()}
            if shown.track_id not in self._named:
                self._named.add(shown.track_id)
                line = rr.SeriesLines(
                    colors=[shown.rgb], names=[f"{shown.class_name} {shown.track_id}"]
                )
                for path in paths:
                    self._recording.log(path, line, static=True)
            for path, value in paths.items():
                if math.isfinite(value):
                    self._recording.log(path, rr.Scalars(value))

    def _log_notes(self, notes: Iterable[str]) -> None:
        import rerun as rr

        for note in notes:
            self._recording.log(_LOG, rr.TextLog(note, level=rr.TextLogLevel.INFO))

    def _log_video(self) -> None:
        """The annotated video, with a reference to its frame for each frame of the run."""
        import rerun as rr

        path = self._info.overlay
        if path is None or not path.is_file() or not self._frames:
            return
        if path.stat().st_size > _MAX_VIDEO_BYTES:
            self._log_notes(
                [
                    f"{path.name} is not embedded, since it has more than "
                    f"{_MAX_VIDEO_BYTES / 1e9:.0f} GB."
                ]
            )
            return
        video = rr.AssetVideo(path=path)
        try:
            shown_ns = video.read_frame_timestamps_nanos()
        except (RuntimeError, ValueError):  # the video of a killed run without a frame
            return
        n = min(len(shown_ns), len(self._frames))
        times_s = np.array(self._times_s[:n])
        is_utc = self._info.start_utc_s is not None
        by_time = (
            rr.TimeColumn("time", timestamp=times_s)
            if is_utc
            else rr.TimeColumn("time", duration=times_s)
        )
        self._recording.log(_VIDEO, video, static=True)
        self._recording.send_columns(
            _VIDEO,
            indexes=[rr.TimeColumn("frame", sequence=self._frames[:n]), by_time],
            columns=rr.VideoFrameReference.columns_nanos(shown_ns[:n]),
        )


def _rgba(shown: TrackObject) -> tuple[int, int, int, int]:
    return (*shown.rgb, _OBSERVED_ALPHA if shown.is_observed else _PREDICTED_ALPHA)


def _blueprint(*, has_video: bool) -> Any:
    """Arrangement of the views; the boxes are hidden where the video already shows them."""
    import rerun.blueprint as rrb

    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial2DView(
                    origin="camera/image",
                    name="Video",
                    overrides={_BOXES: rrb.EntityBehavior(visible=False)} if has_video else None,
                ),
                rrb.Tabs(
                    rrb.Spatial2DView(origin="birds_eye", name="Bird's eye (m)"),
                    rrb.Spatial3DView(origin="world", name="3-D scene"),
                    rrb.Spatial3DView(origin=_MAP, name="Map"),
                ),
            ),
            rrb.Vertical(
                rrb.TimeSeriesView(origin=_DISTANCE, name="Distance (m)"),
                rrb.TimeSeriesView(origin=_CLOSING, name="Closing speed (m/s)"),
                rrb.TextLogView(origin=_LOG, name="Notes"),
                row_shares=[3, 2, 1],
            ),
            column_shares=[3, 2],
        ),
        collapse_panels=True,
    )
