"""The annotation tools and data sets whose labels are read: a row of `TOOLS` for each.

Boxes have the corner convention, where the left edge of the image is 0, except in Scalabel (BDD100K)
and Supervisely, whose edges are the first and last pixel.
"""

import re
from collections.abc import Iterator
from typing import Any

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tool_labels.label_studio import boxes_of_tasks
from track_range.detection.formats.tool_labels.tool import (
    MAX_BOXES,
    Object,
    Tool,
    around,
    centred,
    corners,
    one_of,
    sized,
    value_at,
)
from track_range.foundation.files.structured_text import parse_json


def _mark(pattern: str) -> re.Pattern[str]:
    return re.compile(pattern, re.DOTALL)


def _createml(content: Any) -> Iterator[Object]:
    return ({"image": image, "box": box} for image in content for box in image["annotations"])


# as Roboflow exports it; https://developer.apple.com/documentation/createml
CREATEML = Tool(
    name="createml",
    title="CreateML",
    mark=_mark(r'^\s*\[.*"coordinates"\s*:'),
    objects=_createml,
    image="image.image image.imagefilename",
    label="box.label",
    edges=centred("box.coordinates"),
)


def _scalabel(content: Any) -> Iterator[Object]:
    """Boxes of images (det_20) and of the frames of a video (box_track_20), where they have
    identities.
    """
    images = content.get("frames", [content]) if isinstance(content, dict) else content
    for position, image in enumerate(images):
        frame = value_at(image, "frameIndex frame_index index")
        name = position if frame is None and "name" not in image else frame
        for box in image.get("labels") or image.get("objects") or ():
            if corner := box.get("box2d"):
                yield {
                    "frame": name,
                    "image": image,
                    "box": box,
                    "points": [[corner["x1"], corner["y1"]], [corner["x2"], corner["y2"]]],
                    "identity": None if frame is None else box.get("id"),
                }


# Scalabel's format; https://doc.bdd100k.com/format.html
BDD100K = Tool(
    name="bdd100k",
    title="BDD100K",
    mark=_mark(r'^\s*[\[{].*"(box2d|frameIndex|videoName)"\s*:'),
    objects=_scalabel,
    frame="frame",
    image="image.name",
    label="box.category",
    edges=around("points", border_px=1),
    identity="identity",
    score="box.score",
    is_region="box.attributes.crowd box.attributes.Crowd",
    video="image.videoName image.video_name image.video",
)


def _shapes(content: Any) -> Iterator[Object]:
    for shape in content["shapes"]:
        kind = shape.get("shape_type", "polygon")
        is_box = kind in ("rectangle", "polygon", "rotation")
        yield {"file": content, "shape": shape} | ({} if is_box else {"no_box": kind})


# one file for each image; https://github.com/wkentaro/labelme
LABELME = Tool(
    name="labelme",
    title="LabelMe",
    mark=_mark(r'^\s*\{.*"(shape_type|shapes)"\s*:'),
    objects=_shapes,
    image="file.imagePath",
    label="shape.label",
    edges=around("shape.points"),
    identity="shape.group_id",
    score="shape.score",
    size_px=("file.imageWidth", "file.imageHeight"),
    rotation="shape.direction",  # of X-AnyLabeling
    is_folder=True,
)

LABEL_STUDIO = Tool(
    name="labelstudio",
    title="Label Studio",
    mark=_mark(r'^\s*[\[{].*"(rectanglelabels|videorectangle|original_width)"'),
    objects=boxes_of_tasks,
    frame="frame",
    first_frame=1,
    image="image",
    label="label",
    edges=sized("value"),
    is_per_cent=True,
    identity="number",
    score="result.score",
    size_px=(
        "result.original_width value.original_width data.original_width",
        "result.original_height value.original_height data.original_height",
    ),
    rotation="value.rotation",
    video="video",
)


def _via_regions(content: Any) -> Iterator[Object]:
    for image in content.get("_via_img_metadata", content).values():
        regions = image["regions"]
        for region in regions.values() if isinstance(regions, dict) else regions:
            yield from _via_region(
                image["filename"], region["shape_attributes"], region["region_attributes"]
            )


def _via_rows(content: Any) -> Iterator[Object]:
    for row in content:
        shape, attributes = (
            parse_json(row[f"region_{kind}attributes"] or "{}", kind, LabelFileError, "attributes")
            for kind in ("shape_", "")
        )
        yield from _via_region(row.get("filename") or row["#filename"], shape, attributes)


def _via_region(image: str, shape: Any, attributes: Any) -> Iterator[Object]:
    """A region whose attributes the user has named: unless one has a usual name, the first is the
    label.
    """
    first = next(iter(attributes.values()), "")
    region = {"image": image, "attributes": attributes, "first": first}
    if shape.get("name") == "rect":
        yield region | {"rectangle": shape}
    elif "all_points_x" in shape:
        points = list(zip(shape["all_points_x"], shape["all_points_y"], strict=True))
        yield region | {"points": points}
    elif shape:
        yield region | {"no_box": shape.get("name")}


_VIA_NAMES: dict[str, Any] = {
    "image": "image",
    "label": "attributes.class attributes.label attributes.type attributes.name "
    "attributes.category attributes.object attributes.class_name first",
    "edges": one_of(rectangle=sized("rectangle"), points=around("points")),
    "identity": "attributes.track_id attributes.track attributes.instance_id attributes.id",
}
# version 1 and 2; https://www.robots.ox.ac.uk/~vgg/software/via
VIA = Tool(
    name="via",
    title="VIA",
    mark=_mark(r'^\s*\{.*"(shape_attributes|_via_img_metadata)"\s*:'),
    objects=_via_regions,
    **_VIA_NAMES,
)
VIA_CSV = Tool(
    name="via_csv",
    title="CSV of VIA",
    mark=_mark(r"^#?filename,[^\n]{0,300}region_shape_attributes"),
    objects=_via_rows,
    **_VIA_NAMES,
)


def _supervisely_boxes(content: Any) -> Iterator[Object]:
    """The figures of the frames of a video, each of an object; else the objects of an image."""
    if "frames" not in content:
        for item in content["objects"]:
            kind = item.get("geometryType", "rectangle")
            is_box = item.get("points") and kind in ("rectangle", "polygon", "oriented_bbox")
            shape = {"points": item["points"]} if is_box else {"no_box": kind}
            yield {"file": content, "object": item} | shape
        return
    objects = {
        item.get("key", item.get("id")): item | {"number": number}
        for number, item in enumerate(content["objects"])
    }
    for frame in content["frames"]:
        for figure in frame["figures"]:
            item = objects[figure.get("objectKey", figure.get("objectId"))]
            shape = figure["geometry"]
            if not shape.get("points"):
                shape = {"no_box": figure.get("geometryType")}
            yield {"file": content, "frame": frame, "object": item} | shape


# annotations of images and videos; https://docs.supervisely.com
SUPERVISELY = Tool(
    name="supervisely",
    title="Supervisely",
    mark=_mark(r'^\s*\{.*"(classTitle|objectKey|objectId)"\s*:'),
    objects=_supervisely_boxes,
    frame="frame.index",
    label="object.classTitle",
    edges=around("points.exterior", border_px=1),
    identity="object.number",
    size_px=("file.size.width", "file.size.height"),
    rotation="angle object.angle",  # of an oriented_bbox
    is_folder=True,
)

_SINK_FRAME = "frame frame_index frame_number frame_id frame_idx frame_no frame_num"


def _sink_rows(content: Any) -> Iterator[Object]:
    """Rows with the name of the class, or its number."""
    for row in content:
        if value_at(row, _SINK_FRAME) is None:
            raise LabelFileError(
                "expected the frame number among the custom data of supervision's sink, found "
                "none; write it with sink.append(detections, custom_data={'frame_index': index})"
            )
        yield row | {"label": row.get("class_name") or row["class_id"]}


# JSONSink and CSVSink; https://supervision.roboflow.com
SUPERVISION = Tool(
    name="supervision",
    title="supervision",
    mark=_mark(r'^\s*\[\s*\{[^}]{0,2000}"x_min"\s*:|^"?x_min"?,"?y_min'),
    objects=_sink_rows,
    frame=_SINK_FRAME,
    label="label",
    edges=corners("", "x_min y_min x_max y_max"),
    identity="tracker_id",
    score="confidence",
)

ROBOFLOW_CSV = Tool(
    name="csv_filename",
    title="CSV of Roboflow",
    mark=_mark(r"^[^\n]{0,300}\bfilename\b[^\n]{0,300}\bxmin\b"),
    objects=iter,
    image="filename",
    label="class",
    edges=corners(""),
    size_px=("width", "height"),
)


def _voc_objects(content: Any) -> Iterator[Object]:
    (image,) = content["annotation"]
    return ({"image": image, "object": item, **item} for item in image.get("object", ()))


# Everingham et al., IJCV 2010, as CVAT, LabelImg and Roboflow write it
PASCAL_VOC = Tool(
    name="voc",
    title="Pascal VOC",
    mark=_mark(r"^\s*<(\?xml[^>]*>\s*<)?annotation[\s>]"),
    objects=_voc_objects,
    image="image.filename",
    label="object.name",
    edges=one_of(bndbox=corners("object.bndbox"), robndbox=centred("object.robndbox", "cx cy w h")),
    identity="object.track_id",
    size_px=("image.size.width", "image.size.height"),
    rotation="object.robndbox.angle",  # of roLabelImg
    is_folder=True,
)


def _targets(content: Any) -> Iterator[Object]:
    """The targets of each frame, and the ignored regions, which are those of all frames."""
    (sequence,) = content["sequence"]
    frames = sequence.get("frame", ())
    for frame in frames:
        for target in value_at(frame, "target_list.target") or ():
            if "attribute" in target:
                yield {"frame": frame, "target": target, "id": target["id"], "kind": "vehicle"}
    regions = value_at(sequence, "ignored_region.box") or ()
    if len(regions) * len(frames) > MAX_BOXES:
        raise ValueError("regions")
    for frame in frames:
        for box in regions:
            yield {"frame": frame, "target": {"box": box}, "kind": "dontcare", "is_region": True}


# Wen et al., CVIU 2020
UA_DETRAC = Tool(
    name="detrac",
    title="UA-DETRAC",
    mark=_mark(r"^\s*<(\?xml[^>]*>\s*<)?sequence[\s>]"),
    objects=_targets,
    frame="frame.num",
    first_frame=1,
    label="target.attribute.vehicle_type kind",
    edges=sized("target.box", "left top width height"),
    identity="id",
    is_region="is_region",
)

TOOLS = (
    CREATEML,
    BDD100K,
    LABELME,
    LABEL_STUDIO,
    VIA,
    SUPERVISELY,
    SUPERVISION,
    ROBOFLOW_CSV,
    VIA_CSV,
    PASCAL_VOC,
    UA_DETRAC,
)
"""All tools; their order has no meaning, since at most one mark fits a file."""
