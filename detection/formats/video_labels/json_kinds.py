"""Kinds of JSON files with labels that are not read, by the keys that they have."""

from typing import Any

_CONVERT = "export it as COCO or CVAT for video 1.1"
_KINDS = (  # keys of the document, or of the first item of a list; what it is; what to do
    ("vcd", "labels of VCD 4", "convert them to OpenLABEL 1.0 with the package vcd"),
    ("items categories", "a data set of Datumaro", "`datum convert -f coco` writes COCO"),
    ("results meta", "results of nuScenes", "export the boxes of one camera as COCO"),
    ("sample_token token", "a table of nuScenes", "export the boxes of one camera as COCO"),
    (
        "sample_data_token bbox_corners",
        "2-D boxes of nuScenes",
        "export those of one camera as COCO",
    ),
    ("token", "a table of nuScenes", "export the boxes of one camera as COCO"),
    ("project metadata view", "a project of VIA 3", "export it as COCO, or use VIA 2"),
    ("data_row", "labels of Labelbox", _CONVERT),
    ("Labeled Data", "labels of Labelbox", _CONVERT),
    ("DataRow ID", "labels of Labelbox", _CONVERT),
    ("label_hash", "labels of Encord", _CONVERT),
    ("data_hash", "labels of Encord", _CONVERT),
    ("item annotations", "labels of V7 Darwin", _CONVERT),
    ("samples", "a data set of FiftyOne", "`fiftyone convert` writes COCO"),
    ("metainfo data_list", "a data set of MMDetection", _CONVERT),
    ("cuboids", "cuboids of 3-D labels", "export 2-D boxes as COCO"),
    ("image_id category_id bbox", "a list of detection results", "add the boxes to a data set"),
    ("box confidence", "detections of Ultralytics for one image", "save them with save_txt"),
    ("instances metadata", "labels of SuperAnnotate", _CONVERT),
    ("task_id response", "tasks of Scale", _CONVERT),
)


def kind_of_json(document: Any) -> str:
    """What a document is that is no COCO data set, and what to do; "" if it may be one."""
    first = document[0] if isinstance(document, list) and document else document
    keys = set(first) if isinstance(first, dict) else set()
    if isinstance(document, dict) and {"images", "annotations"} <= keys:
        return ""
    for names, kind, advice in _KINDS:
        # names with a space are one key
        if names in keys or set(names.split()) <= keys:
            return f"{kind}; {advice}"
    return (
        "a list, such as detection results; add the boxes to a data set"
        if isinstance(document, list)
        else ""
    )
