"""run.openlabel.json: ASAM OpenLABEL 1.0 with the boxes, cuboids, distances and events of a run.

    frame -> line of the file (frame_properties, objects), while the run is in progress
    end   -> objects with pointers to their data, events as actions with relations to their objects

The lines of the frames come before the objects, which are known at the end: the file of a killed run
is no JSON. Boxes and intrinsics are those of the left camera, rectified; cuboids are in its axes.
What is not known is left out.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from track_range.detection.boxes import HALF_PIXEL_PX
from track_range.detection.formats.tool_labels.openlabel import ONTOLOGY_TYPES, PIXELS
from track_range.pipeline.frame_result import FrameResult
from track_range.results.formats.row_file import RowWriter
from track_range.results.formats.run_info import RunInfo
from track_range.results.formats.scene import (
    CAMERA_FRAME,
    MAP_FRAME,
    Transform,
    track_objects,
    transforms,
)
from track_range.results.rows.column import ResultColumn
from track_range.results.rows.columns import viewer_columns

OPENLABEL_FILE = "run.openlabel.json"
_VEHICLE = "vehicle-iso8855"  # name in the standard's examples
_ONTOLOGY = "https://openlabel.asam.net/V1-0-0/ontologies/openlabel_ontology_scenario_tags.ttl"
_DECIMALS, _DECIMALS_OF_TURNS = 4, 9  # of pixels, metres and others; of quaternions
_POINTERS = "object_data_pointers"
_MARGIN_S = 0.001  # times of events are rounded

_Track = tuple[str, str, dict[str, Any]]  # uid, class, `object_data`
_Span = dict[str, int]


class OpenLabelWriter(RowWriter):
    """Writer of run.openlabel.json, frame by frame; in memory are the intervals of each object."""

    files = (OPENLABEL_FILE,)

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create the file with what is known before the first frame."""
        self._columns = viewer_columns()
        self._times_s: dict[int, float] = {}  # of the frames
        self._objects: dict[str, dict[str, Any]] = {}
        self._held: tuple[int, float, list[_Track]] | None = None  # the last frame
        super().open(info, folder)

    def header(self) -> str:
        """The file up to its frames."""
        return _text({"openlabel": _header(self.info)}).removesuffix("}}") + ',"frames":{'

    def rows(self, result: FrameResult) -> str:
        """A frame on a line."""
        self._count_held()
        tracks = list(_tracks(result, self._columns))
        properties: dict[str, Any] = {
            "timestamp": round(result.time_s + (self.info.start_utc_s or 0.0), 6),
            **_known(ego_mps=result.ego_mps, ego_sigma_mps=result.ego_sigma_mps),
        }
        if math.isfinite(result.ego_pose.x_m):
            vehicle, _ = transforms(result.ego_pose, self.info.mounting)
            step = {"src": _VEHICLE, "dst": MAP_FRAME, "transform_src_to_dst": _pose(vehicle)}
            properties["transforms"] = {f"{_VEHICLE}_to_{MAP_FRAME}": step}
        self._held = result.index, result.time_s, tracks
        objects = {uid: {"object_data": data} for uid, _, data in tracks}
        frame = _text({"frame_properties": properties, "objects": objects})
        return f'{"," if self._times_s else ""}\n"{result.index}":{frame}'

    def discard_last(self) -> None:
        """Remove the last frame."""
        super().discard_last()
        self._held = None

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Write the objects and the events."""
        self._count_held()
        spans: list[_Span] = []
        for frame in self._times_s:
            _extend(spans, frame, frame - 1)
        end = {"objects": self._objects, **self._events(), "frame_intervals": spans}
        try:
            self._file.write("\n}," + _text(end).removeprefix("{") + "}\n")
        finally:
            super().close(summary)

    def _count_held(self) -> None:
        """Add the last frame, which can no longer be discarded, to the intervals of its objects."""
        if self._held is None:
            return
        (frame, time_s, tracks), self._held = self._held, None
        before = next(reversed(self._times_s), -1)
        for uid, class_name, data in tracks:
            item = self._objects.setdefault(uid, {"frame_intervals": [], _POINTERS: {}})
            item |= {"name": f"{class_name} {uid}", "type": class_name}
            if class_name in ONTOLOGY_TYPES:
                item |= {"type": ONTOLOGY_TYPES[class_name], "ontology_uid": "0"}
            _extend(item["frame_intervals"], frame, before)
            for kind, entry in ((key, entry) for key, listed in data.items() for entry in listed):
                new = {"type": kind, "frame_intervals": [], "attribute_pointers": {}}
                pointer = item[_POINTERS].setdefault(entry["name"], new)
                _extend(pointer["frame_intervals"], frame, before)
                pointer["attribute_pointers"] |= _kinds(entry.get("attributes", {}))
        self._times_s[frame] = time_s

    def _events(self) -> dict[str, Any]:
        """Events as actions with their columns, and the relation of each to its object."""
        actions, relations = {}, {}
        frames, times_s = list(self._times_s), list(self._times_s.values())
        for number, event in enumerate(self.info.events() if frames else ()):
            limits_s = event["start_s"] - _MARGIN_S, event["end_s"] + _MARGIN_S
            rows = np.clip(np.searchsorted(times_s, limits_s) - [0, 1], 0, len(frames) - 1)
            first, last = frames[rows[0]], frames[rows.max()]
            name, track = f"{event['kind']} {event['track_id']}", str(event["track_id"])
            spans = [{"frame_start": first, "frame_end": last}]
            numbers = {key: value for key, value in event.items() if isinstance(value, int | float)}
            actions[str(number)] = {
                "name": name,
                "type": event["kind"],
                "frame_intervals": spans,
                "action_data": {
                    "num": _named(_known(**numbers)),
                    "text": _named({"reason": event["reason"]}),
                },
            }
            if track in self._objects:
                relations[str(number)] = {
                    "name": name,
                    "type": "isSubjectOfAction",
                    "rdf_subjects": [{"type": "object", "uid": track}],
                    "rdf_objects": [{"type": "action", "uid": str(number)}],
                    "frame_intervals": spans,
                }
        return {"actions": actions, "relations": relations}


def _header(info: RunInfo) -> dict[str, Any]:
    """What is known before the first frame."""
    _, camera = transforms(None, info.mounting)
    video: Any = info.settings.get("stereo") or info.settings.get("mono") or ""
    while isinstance(video, list | tuple):
        video = next(iter(video), "")
    # no folders, and nothing of the user of a network camera
    name = re.split(r"[/\\@]", str(video).partition("?")[0])[-1]
    K = info.camera
    matrix = [K.fx_px, 0.0, K.cx_px, 0.0, 0.0, K.fy_px, K.cy_px, 0.0, 0.0, 0.0, 1.0, 0.0]
    pinhole = {
        **dict.fromkeys(("camera_matrix", "camera_matrix_3x4"), matrix),  # schema, package vcd
        **dict.fromkeys(("distortion_coeffs", "distortion_coeffs_1xN"), [0.0] * 5),
        "width_px": K.width_px,
        "height_px": K.height_px,
    }
    return {
        "metadata": {
            "schema_version": "1.0.0",
            "annotator": f"track-range {info.provenance.version}",
            "comment": "Measured by a program. NAME_sigma is the standard deviation of NAME.",
            "tagged_file": name,
            PIXELS: "rectified",
            **info.provenance.metadata(),
        },
        "ontologies": {"0": _ONTOLOGY},
        "coordinate_systems": {
            MAP_FRAME: {"type": "scene_cs", "parent": "", "children": [_VEHICLE]},
            _VEHICLE: {"type": "local_cs", "parent": MAP_FRAME, "children": [CAMERA_FRAME]},
            CAMERA_FRAME: {
                "type": "sensor_cs",
                "parent": _VEHICLE,
                "children": [],
                "pose_wrt_parent": _pose(camera),
            },
        },
        "streams": {
            CAMERA_FRAME: {
                "type": "camera",
                "uri": name,
                "description": "left or only camera, rectified",
                "stream_properties": {"intrinsics_pinhole": pinhole},
            }
        },
    }


def _tracks(result: FrameResult, columns: Mapping[str, ResultColumn]) -> Iterator[_Track]:
    """Uid, class and `object_data` of the tracks of a frame."""
    sigmas_m = result.cuboids.lwh_sigma_m
    for track, sigma_m in zip(track_objects(result, columns), sigmas_m, strict=True):
        x1, y1, x2, y2 = track.xyxy_px
        middle = (x1 + x2) / 2 + HALF_PIXEL_PX, (y1 + y2) / 2 + HALF_PIXEL_PX
        attributes = {
            "num": _named({"score": track.score}),
            "boolean": _named({"predicted": not track.is_observed}),
        }
        data = {
            "bbox": [_shape("box", _rounded([*middle, x2 - x1, y2 - y1]), attributes)],
            "num": _named(_known(**track.figures)),
        }
        turn = _rounded(track.xyzw, _DECIMALS_OF_TURNS)
        cuboid = [*_rounded(track.centre_m), *turn, *_rounded(track.lwh_m)]
        if np.isfinite(cuboid).all():
            attributes = {
                "vec": _named(
                    {
                        "size_sigma_m": _rounded(sigma_m),
                        "centre_covariance_m2": _rounded(track.covariance_m2),
                    }
                ),
                "num": _named(_known(yaw_sigma_rad=track.yaw_sigma_rad)),
                "boolean": _named({"front_known": track.front_known}),
            }
            data["cuboid"] = [_shape("cuboid", cuboid, attributes)]
        yield str(track.track_id), track.class_name, data


def _shape(name: str, val: list[float], attributes: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "name": name,
        "coordinate_system": CAMERA_FRAME,
        "val": val,
        "attributes": attributes,
    }


def _pose(step: Transform) -> dict[str, Any]:
    return {
        "quaternion": _rounded(step.xyzw, _DECIMALS_OF_TURNS),
        "translation": _rounded(step.at_m),
    }


def _rounded(values: npt.ArrayLike, decimals: int = _DECIMALS) -> list[float]:
    """Values in one list, row by row."""
    rounded: list[float] = np.round(np.ravel(values), decimals).tolist()
    return rounded


def _known(**values: float) -> dict[str, float]:
    return {name: round(v, _DECIMALS) for name, v in values.items() if math.isfinite(v)}


def _named(values: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [{"name": name, "val": value} for name, value in values.items()]


def _kinds(attributes: Mapping[str, Any]) -> dict[str, str]:
    return {entry["name"]: kind for kind, entries in attributes.items() for entry in entries}


def _extend(spans: list[_Span], frame: int, previous: int) -> None:
    """Add a frame to intervals, the last of which goes on if it has the frame before."""
    if spans and spans[-1]["frame_end"] == previous:
        spans[-1]["frame_end"] = frame
    else:
        spans.append({"frame_start": frame, "frame_end": frame})


def _text(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)
