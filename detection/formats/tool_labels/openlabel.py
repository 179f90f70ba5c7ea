"""Reader of ASAM OpenLABEL 1.0: the boxes of one camera, with the distances of their cuboids.

    {"openlabel": {
      "metadata": {"schema_version": "1.0.0"},
      "coordinate_systems": {NAME: {type, parent, pose_wrt_parent}},
      "streams": {NAME: {type, uri, stream_properties}},
      "objects": {UID: {name, type, frame_intervals, object_data}},
      "frames": {NUMBER: {"frame_properties": {timestamp, transforms, streams},
                          "objects": {UID: {"object_data": {
                            "bbox": [{name, val, coordinate_system, attributes}]}}}}}}}

`val` of a `bbox` is centre x, y, width and height in pixels, where the left edge of the image is 0.
The distance is that of the attribute `distance_m`, as run.openlabel.json has it, else the one at
which the ray through the middle of the box first meets the `cuboid` of the object. In a file without
2-D boxes, the boxes are the outlines of the cuboids.
The camera of a box is its `coordinate_system`, or its `stream` as in files of Kognic and VisionAI.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path

import numpy as np

from track_range.detection.boxes import HALF_PIXEL_PX
from track_range.detection.formats.tables.box_table import BoxTable, VideoFacts
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.label_format import LabelFormat
from track_range.detection.formats.tables.table_checks import check_upright
from track_range.detection.formats.tool_labels.cuboid_view import (
    CuboidView,
    SeenCuboid,
    steps_of,
)
from track_range.detection.formats.tool_labels.reader import table_of_boxes, understood
from track_range.detection.formats.tool_labels.tool import MAX_BOXES, Object, ToolBox, whole
from track_range.foundation.files.input_files import quoted, shortened
from track_range.foundation.files.numeric_text import number, plain_number
from track_range.foundation.files.structured_text import read_json

TITLE = "ASAM OpenLABEL"
PIXELS = "track_range.pixels"  # key of `metadata` of our files: rectified or original
_MAX_BYTES = 250_000_000
_MARK = re.compile(r'\s*+\{\s*+"openlabel"\s*+:')
_SHAPES = ("bbox", "rbbox", "cuboid")  # kinds of `object_data` that are read
_KINDS = ("num", "boolean", "text")  # kinds of one value
_SCORES = ("score", "confidence", "confidence_score")
_NO_EDGES = (0.0, 0.0, 0.0, 0.0)
ONTOLOGY_TYPES: Mapping[str, str] = {
    "person": "HumanPedestrian",
    "bicycle": "VehicleCycle",
    "car": "VehicleCar",
    "motorcycle": "VehicleMotorcycle",
    "bus": "VehicleBus",
    "truck": "VehicleTruck",
}
"""Road classes in ASAM's ontology of OpenLABEL 1.0."""
_ROAD_CLASSES = {name: road_class for road_class, name in ONTOLOGY_TYPES.items()}
# of other types in it, such as VehicleVan and HumanCyclist
_KIND = re.compile(r"^(?:Vehicle|Human)(?=[A-Z])")
_MIN_FPS, _MAX_FPS = 0.5, 1000.0  # others show that timestamps are not in seconds
_MAX_OCCLUDED = 1  # KITTI's level of partly occluded objects: 3-D boxes of others are guesses


def read_openlabel(path: Path, video: VideoFacts) -> BoxTable:
    """The boxes of one camera; of several, that with the name at the end of the file's name.

    LabelFileError: the file cannot be read, has another schema version, no frames, boxes of several
    cameras, rotated boxes, boxes in fractions of the image, or invalid values.
    """
    document = read_json(path, LabelFileError, f"labels of {TITLE}", max_bytes=_MAX_BYTES)
    with understood(path, TITLE):
        root = document["openlabel"]
        frames = _frames(root)
        camera, has_boxes = _camera(root, frames, path, video)
        every_box = _boxes(root, frames, camera, has_boxes=has_boxes)
        boxes = list(islice(every_box, MAX_BOXES + 1))
        facts, images = _facts(root, frames, camera)
        table = table_of_boxes(path, boxes, images, video, facts)
        if len(table) and table.xyxy_px.max() <= 1 - HALF_PIXEL_PX:
            raise LabelFileError("expected each bbox in pixels, found only fractions of the image")
    is_missed, n_met = np.isinf(table.distance_m), np.isfinite(table.distance_m).sum()
    if (n_missed := is_missed.sum()) <= n_met:
        return replace(table, distance_m=np.where(is_missed, np.nan, table.distance_m))
    note = (
        f"{path.name}: {n_missed} of {n_missed + n_met} cuboids are not where their boxes in the "
        f"camera {camera} are, so that the labels have no distances; check the pose and the "
        "intrinsics of the camera in the file."
    )
    return replace(table, distance_m=np.full(len(table), np.nan), notes=(*table.notes, note))


def _frames(root: Object) -> Mapping[int, Object]:
    """The frames in the order of their numbers."""
    version = str(root["metadata"]["schema_version"])
    if not version.startswith("1."):
        raise LabelFileError(
            f"expected schema_version 1.0.0, found {quoted(version)}; convert the file, for example "
            "with the package vcd"
        )
    frames = {int(key): frame for key, frame in _part(root, "frames").items()}
    if not frames:
        raise LabelFileError("expected frames, found none: a video has labels by frame")
    return {frame: frames[frame] for frame in sorted(frames)}


def _camera(
    root: Object, frames: Mapping[int, Object], path: Path, video: VideoFacts
) -> tuple[str, bool]:
    """The camera whose boxes are read, "" = boxes name none, and whether there are 2-D boxes."""
    in_frames = (_part(frame, "objects").values() for frame in frames.values())
    items = chain(_part(root, "objects").values(), *in_frames)
    cameras = {_system_of(box) for item in items for box in _listed(item, "bbox", "rbbox")}
    names = sorted(cameras - {""})
    names = names or [name for name in _part(root, "streams") if _view(root, name)]
    named = [name for name in names if path.stem.endswith(name) or name == video.name]
    if len(names) > 1 and not named:
        raise LabelFileError(
            f"expected the boxes of one camera, found {len(names)}: "
            f"{shortened(', '.join(names), 200)}; choose one by the name of a copy or link of the "
            f"file, such as {path.stem}-{names[0]}{path.suffix}"
        )
    return max(named or names, key=len, default=""), bool(cameras)


def _facts(root: Object, frames: Mapping[int, Object], camera: str) -> tuple[VideoFacts, list[int]]:
    """What the file states about the camera's video, and the number of each frame in it."""
    stream = _part(root, "streams", camera)
    properties = _part(stream, "stream_properties")
    if _part(properties, "sync").get("frame_shift"):
        raise LabelFileError(
            f"expected frame numbers of the camera {camera}, found a frame_shift, whose sign is not "
            "defined; write frame_stream in each frame"
        )
    images = [_image(frame, content, camera) for frame, content in frames.items()]
    stamps = (_part(frame, "frame_properties").get("timestamp") for frame in frames.values())
    steps_s = np.diff([number(str(stamp)) for stamp in stamps]) / np.diff(list(frames))
    step_s = float(np.median(steps_s)) if len(steps_s) else 0.0
    lenses = [properties[key] for key in properties if key.startswith("intrinsics")]
    sizes = [(lens["width_px"], lens["height_px"]) for lens in lenses if "width_px" in lens]
    facts = VideoFacts(
        name=Path(str(stream.get("uri", ""))).stem,
        n_frames=max(images) + 1,
        first_frame=min(images),
        size_px=(whole(sizes[0][0]), whole(sizes[0][1])) if sizes else None,
        fps=1 / step_s if 1 / _MAX_FPS <= step_s <= 1 / _MIN_FPS else None,
        is_rectified=root["metadata"].get(PIXELS) == "rectified",
    )
    return facts, images


def _image(frame: int, content: Object, camera: str) -> int:
    streams = _part(content, "frame_properties", "streams")
    return whole(_part(streams, camera, "stream_properties", "sync").get("frame_stream", frame))


def _boxes(
    root: Object, frames: Mapping[int, Object], camera: str, *, has_boxes: bool
) -> Iterator[ToolBox]:
    """The boxes of the camera in all frames."""
    # files of this program state what was measured; its cuboids are filtered
    view = None if PIXELS in root["metadata"] else _view(root, camera)
    for frame, uid, items in _objects(root, frames):
        cuboids = _cuboids_of(items)
        transforms = _part(frames[frame], "frame_properties", "transforms")
        seen = view.seen(cuboids, steps_of(transforms)) if view and cuboids else None
        kind = re.split("[#/]", str(items[0]["type"]))[-1]
        label = _ROAD_CLASSES.get(kind) or _KIND.sub("", kind)
        image = _image(frame, frames[frame], camera)
        common = ToolBox(image, label, _NO_EDGES, uid)
        if has_boxes or not cuboids:
            yield from _boxes_of(items, camera, common, seen)
        else:
            outline = common._replace(
                edges=_NO_EDGES if seen is None else seen.outline(),
                shape="cuboid that no camera shows",
            )
            yield _box(outline, _values(*items), seen)


def _objects(
    root: Object, frames: Mapping[int, Object]
) -> Iterator[tuple[int, str, tuple[Object, Object]]]:
    """The number of each frame with the objects in it, each as it is in all frames, and in this
    one; those without intervals of frames are in all frames.
    """
    objects = _part(root, "objects")
    static = {uid: item for uid, item in objects.items() if any(_listed(item, *_SHAPES))}
    for frame, content in frames.items():
        dynamic = _part(content, "objects")
        shown = (uid for uid, item in static.items() if _is_in(item, frame))
        for uid in dict.fromkeys(chain(dynamic, shown)):
            yield frame, uid, (objects[uid], dynamic.get(uid, {}))


def _cuboids_of(items: Sequence[Object]) -> list[tuple[str, object]]:
    """The cuboids of an object in one frame, each with its coordinate system and its `val`."""
    given = str(items[0].get("coordinate_system") or "")
    listed = (cuboid for item in items for cuboid in _listed(item, "cuboid"))
    return [(_system_of(cuboid) or given, cuboid["val"]) for cuboid in listed]


def _boxes_of(
    items: Sequence[Object], camera: str, common: ToolBox, seen: SeenCuboid | None
) -> Iterator[ToolBox]:
    """The 2-D boxes of an object in one frame."""
    values = _values(*items)
    for box in (box for item in items for box in _listed(item, "bbox", "rbbox")):
        if _system_of(box) in ("", camera):
            yield _box(
                common._replace(edges=_edges(box)),
                {**values, **_values(box, inside="attributes")},
                seen,
            )


def _box(box: ToolBox, values: Object, seen: SeenCuboid | None) -> ToolBox:
    distance_m = plain_number(values.get("distance_m"))
    if math.isnan(distance_m) and seen is not None:
        distance_m = seen.surface_m(box.edges)
    is_cut = values.get("truncated") is True or plain_number(values.get("truncated")) > 0
    is_hidden = plain_number(values.get("occluded")) > _MAX_OCCLUDED
    return box._replace(
        score=next((values[name] for name in _SCORES if name in values), None),
        distance_m=math.nan if is_cut or is_hidden else distance_m,
        sigma_m=values.get("sigma_m"),
        is_predicted=values.get("predicted") is True,
    )


def _edges(box: Object) -> list[float]:
    x, y, width, height, *angle = map(float, box["val"])
    check_upright(next(iter(angle), None), f"box {quoted(box.get('name'))}")
    return [x - width / 2, y - height / 2, x + width / 2, y + height / 2]


def _is_in(item: Object, frame: int) -> bool:
    spans = item.get("frame_intervals")
    return not spans or any(span["frame_start"] <= frame <= span["frame_end"] for span in spans)


def _part(item: Object, *names: str) -> Object:
    """The object at a path; an empty one if there is none."""
    for name in names:
        item = item.get(name) or {}
    return item


def _listed(item: Object, *kinds: str, inside: str = "object_data") -> list[Object]:
    data = _part(item, inside)
    return [entry for kind in kinds for entry in data.get(kind) or ()]


def _values(*items: Object, inside: str = "object_data") -> dict[str, object]:
    """Numbers, flags and texts by name in lower case."""
    listed = (entry for item in items for entry in _listed(item, *_KINDS, inside=inside))
    return {str(entry.get("name")).lower(): entry["val"] for entry in listed}


def _system_of(shape: Object) -> str:
    """The coordinate system of a shape, which has the name of its sensor; "" = none is given."""
    stream = shape.get("stream") or _values(shape, inside="attributes").get("stream")
    return str(shape.get("coordinate_system") or stream or "")


def _view(root: Object, camera: str) -> CuboidView | None:
    lens = _part(root, "streams", camera, "stream_properties", "intrinsics_pinhole")
    return CuboidView.of(camera, lens, _part(root, "coordinate_systems"))


OPENLABEL = LabelFormat(
    name="openlabel",
    title=TITLE,
    recognises=lambda start: not start.is_folder and _MARK.match(start.text) is not None,
    read=read_openlabel,
    priority=1,  # names in its objects may be the marks of other formats
)
