"""FoxgloveProfile: messages with Foxglove's published schemas (protobuf), and the figures of the
tracks as JSON.

Foxglove's image coordinates have their origin at the corner of the first pixel, ours at its centre:
they differ by 0.5.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

from foxglove import messages as fox
from foxglove.messages import Timestamp

from track_range.ranging.world.ego_path import EgoPose
from track_range.results.formats import scene
from track_range.results.formats.mcap import (
    ANNOTATIONS,
    NANOSECONDS,
    RANGES,
    SCENE,
    TRANSFORMS,
    Message,
    calibration_matrices,
)
from track_range.results.rows.columns import viewer_columns
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting

CALIBRATION, IMAGE, LOG = "/camera/calibration", "/camera/image", "/log"
_CORNER_PX = 0.5  # Foxglove's coordinates of the centre of the first pixel
_PREDICTED_ALPHA = 0.4  # opacity of predicted boxes

_MESSAGES: Mapping[str, Any] = {
    CALIBRATION: fox.CameraCalibration,
    IMAGE: fox.CompressedImage,
    ANNOTATIONS: fox.ImageAnnotations,
    SCENE: fox.SceneUpdate,
    TRANSFORMS: fox.FrameTransforms,
    LOG: fox.Log,
}


def _ranges_schema() -> dict[str, Any]:
    kinds = {
        "id": "integer",
        "class": "string",
        "observed": "boolean",
        **dict.fromkeys(viewer_columns(), "number"),
    }
    track = {"type": "object", "properties": {name: {"type": kind} for name, kind in kinds.items()}}
    return {
        "type": "object",
        "title": "track_range.Ranges",
        "description": "Distance, closing speed, time to collision, motion in the frame map; "
        "unknown values are absent.",
        "properties": {
            "frame_time_ns": {"type": "integer", "description": "time of the frame"},
            "tracks": {"type": "array", "items": track},
        },
    }


class FoxgloveProfile:
    """Messages for Foxglove."""

    name = ""

    def __init__(self, camera: PinholeCamera, mounting: Mounting | None = None) -> None:
        self._camera, self._mounting = camera, mounting
        self._matrices = calibration_matrices(camera)
        self._shown: set[int] = set()

    def schema(self, topic: str) -> tuple[str, str, bytes, str]:
        """Name, encoding and text of the schema of a topic, and the encoding of its messages."""
        if topic == RANGES:
            return "track_range.Ranges", "jsonschema", json.dumps(_ranges_schema()).encode(), "json"
        schema = _MESSAGES[topic].get_schema()
        return schema.name, schema.encoding, schema.data, "protobuf"

    def frame(
        self, objects: Sequence[scene.TrackObject], time_ns: int, pose: EgoPose | None = None
    ) -> Iterator[Message]:
        """Messages of a frame, without its image."""
        time = _timestamp(time_ns)
        yield (CALIBRATION, self._calibration(time))
        yield (TRANSFORMS, _transforms(time, scene.transforms(pose, self._mounting)))
        yield (ANNOTATIONS, _annotations(objects, time))
        yield (SCENE, self._scene(objects, time))
        rows = [
            {"id": o.track_id, "class": o.class_name, "observed": o.is_observed, **o.figures}
            for o in objects
        ]
        yield (RANGES, json.dumps({"frame_time_ns": time_ns, "tracks": rows}).encode())

    def image(self, jpeg: bytes, time_ns: int) -> Message:
        """Message of an image."""
        image = fox.CompressedImage(
            timestamp=_timestamp(time_ns), frame_id=scene.CAMERA_FRAME, data=jpeg, format="jpeg"
        )
        return (IMAGE, image.encode())

    def note(self, text: str, time_ns: int) -> Message:
        """Message of a note of the run."""
        note = fox.Log(
            timestamp=_timestamp(time_ns), level=fox.LogLevel.Info, message=text, name="track-range"
        )
        return (LOG, note.encode())

    def _calibration(self, time: Timestamp) -> bytes:
        k, r, p = self._matrices
        return fox.CameraCalibration(
            timestamp=time,
            frame_id=scene.CAMERA_FRAME,
            width=self._camera.width_px,
            height=self._camera.height_px,
            distortion_model="",
            D=[],
            K=k,
            R=r,
            P=p,
        ).encode()

    def _scene(self, objects: Sequence[scene.TrackObject], time: Timestamp) -> bytes:
        """The cuboids of the tracks; cuboids of other tracks that were shown before are
        deleted.
        """
        ranged = [shown for shown in objects if shown.has_cuboid]
        gone = self._shown - {shown.track_id for shown in ranged}
        self._shown = {shown.track_id for shown in ranged}
        return fox.SceneUpdate(
            deletions=[
                fox.SceneEntityDeletion(timestamp=time, id=f"track {number}")
                for number in sorted(gone)
            ],
            entities=[_entity(shown, time) for shown in ranged],
        ).encode()


def _timestamp(time_ns: int) -> Timestamp:
    return Timestamp(*divmod(time_ns, NANOSECONDS))


@cache
def _colour(rgb: tuple[int, int, int], alpha: float) -> fox.Color:
    red, green, blue = rgb
    return fox.Color(r=red / 255, g=green / 255, b=blue / 255, a=alpha)


def _transforms(time: Timestamp, parts: Sequence[scene.Transform]) -> bytes:
    transforms = [
        fox.FrameTransform(
            timestamp=time,
            parent_frame_id=parent,
            child_frame_id=child,
            translation=fox.Vector3(**dict(zip("xyz", at_m, strict=True))),
            rotation=fox.Quaternion(**dict(zip("xyzw", xyzw, strict=True))),
        )
        for parent, child, at_m, xyzw in parts
    ]
    return fox.FrameTransforms(transforms=transforms).encode()


def _annotations(objects: Sequence[scene.TrackObject], time: Timestamp) -> bytes:
    points, texts = [], []
    for shown in objects:
        x1, y1, x2, y2 = (value + _CORNER_PX for value in shown.xyxy_px)
        colour = _colour(shown.rgb, 1.0 if shown.is_observed else _PREDICTED_ALPHA)
        points.append(
            fox.PointsAnnotation(
                timestamp=time,
                type=fox.PointsAnnotationType.LineLoop,
                points=[fox.Point2(x=x, y=y) for x, y in ((x1, y1), (x2, y1), (x2, y2), (x1, y2))],
                outline_color=colour,
                thickness=2.0,
                metadata=_metadata(shown),
            )
        )
        texts.append(
            fox.TextAnnotation(
                timestamp=time,
                position=fox.Point2(x=x1, y=y1),
                text=shown.label,
                font_size=12.0,
                text_color=colour,
                background_color=_colour((0, 0, 0), 0.6),
            )
        )
    return fox.ImageAnnotations(timestamp=time, points=points, texts=texts).encode()


def _metadata(shown: scene.TrackObject) -> list[fox.KeyValuePair]:
    figures = {name: f"{value:.3f}" for name, value in shown.figures.items()}
    observed = "true" if shown.is_observed else "false"
    values = {
        "track_id": str(shown.track_id),
        "class": shown.class_name,
        "observed": observed,
        **figures,
    }
    return [fox.KeyValuePair(key=key, value=value) for key, value in values.items()]


def _entity(shown: scene.TrackObject, time: Timestamp) -> fox.SceneEntity:
    x, y, z = shown.centre_m
    length, width, height = shown.lwh_m
    turn = fox.Quaternion(**dict(zip("xyzw", shown.xyzw, strict=True)))
    return fox.SceneEntity(
        timestamp=time,
        frame_id=scene.CAMERA_FRAME,
        id=f"track {shown.track_id}",
        metadata=_metadata(shown),
        cubes=[
            fox.CubePrimitive(
                pose=fox.Pose(position=fox.Vector3(x=x, y=y, z=z), orientation=turn),
                size=fox.Vector3(x=length, y=width, z=height),
                color=_colour(shown.rgb, 0.7 if shown.is_observed else _PREDICTED_ALPHA),
            )
        ],
        texts=[
            fox.TextPrimitive(
                pose=fox.Pose(
                    position=fox.Vector3(x=x, y=y - height / 2 - 0.5, z=z), orientation=turn
                ),
                billboard=True,
                font_size=14.0,
                scale_invariant=True,
                color=_colour((255, 255, 255), 1.0),
                text=shown.label,
            )
        ],
    )
