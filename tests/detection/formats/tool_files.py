"""Files of annotation tools and data sets by their specifications, with the boxes of
reference_labels."""

from __future__ import annotations

import json
from pathlib import Path

# left, top, width and height in pixels
CAR_0, CAR_2, PERSON_2 = (10, 20, 20, 20), (20, 20, 20, 20), (50, 10, 5, 20)
OBJECTS = ((0, "car", 7, CAR_0), (2, "car", 7, CAR_2), (2, "person", 8, PERSON_2))


def by_frame(make):
    """A list for each of the frames 0 and 2 of what `make` returns for their objects."""
    return {
        f: [make(name, i, *box) for frame, name, i, box in OBJECTS if frame == f] for f in (0, 2)
    }


def scalabel(name, i, x, y, w, h):  # x2 and y2 are the last pixel
    box = {"x1": x, "y1": y, "x2": x + w - 1, "y2": y + h - 1}
    return {"id": f"{i:08d}", "category": name, "attributes": {"crowd": False}, "box2d": box}


def rectangle(name, i, x, y, w, h):
    points = [[x, y], [x + w, y + h]]
    return {"label": name, "points": points, "group_id": i, "shape_type": "rectangle", "flags": {}}


def per_cent(name, i, x, y, w, h):
    return {"x": float(x), "y": 2.0 * y, "width": float(w), "height": 2.0 * h, "rotation": 0}


def result(name, i, *box):
    value = per_cent(name, i, *box) | {"rectanglelabels": [name]}
    return {"type": "rectanglelabels", "original_width": 100, "original_height": 50, "value": value}


def region(name, i, x, y, w, h):
    shape = {"name": "rect", "x": x, "y": y, "width": w, "height": h}
    return {"shape_attributes": shape, "region_attributes": {"class": name, "track_id": str(i)}}


def figure(name, i, x, y, w, h):  # the last pixel, too
    points = {"exterior": [[x, y], [x + w - 1, y + h - 1]], "interior": []}
    return {"objectKey": f"k{i}", "geometryType": "rectangle", "geometry": {"points": points}}


def centre(name, i, x, y, w, h):
    return {"label": name, "coordinates": {"x": x + w / 2, "y": y + h / 2, "width": w, "height": h}}


def sink(frame, name, i, box):
    x, y, w, h = box
    row = {
        "x_min": x,
        "y_min": y,
        "x_max": x + w,
        "y_max": y + h,
        "class_id": {"car": 2, "person": 0}[name],
    }
    return row | {"confidence": 0.5, "tracker_id": i, "class_name": name, "frame_index": frame}


def video_result(name, frames):
    keys = [
        per_cent(name, 0, *box) | {"frame": f + 1, "enabled": enabled} for f, box, enabled in frames
    ]
    value = {"framesCount": 3, "duration": 0.3, "sequence": keys, "labels": [name]}
    return {"type": "videorectangle", "original_width": 100, "original_height": 50, "value": value}


VIDEO = [{
    "id": 1, "data": {"video": "/data/upload/1/drive.mp4"},
    "annotations": [{"result": [
        video_result("car", [(0, CAR_0, False), (2, CAR_2, True)]), video_result("person", [(2, PERSON_2, True)]),
    ]}],
}]  # fmt: skip


def table(header, row):
    lines = [",".join(map(str, row(f, name, i, *box))) for f, name, i, box in OBJECTS]
    return "\n".join([header, *lines]) + "\n"


def quoted(value):
    return '"' + json.dumps(value).replace('"', '""') + '"'


def detrac(target):
    return "".join(
        f'<frame density="1" num="{f + 1}"><target_list>{"".join(boxes)}</target_list></frame>'
        for f, boxes in by_frame(target).items()
    )


FILES = {
    "bdd100k": [
        {"name": f"b1-6f-{f + 1:07d}.jpg", "videoName": "b1-6f", "frameIndex": f, "labels": labels}
        for f, labels in by_frame(scalabel).items()
    ],
    "bdd100k det_20": [
        {"name": f"b1-6f-{f:07d}.jpg", "attributes": {"weather": "clear"}, "timestamp": 10000, "labels": labels}
        for f, labels in by_frame(scalabel).items()
    ],
    "labelstudio": [
        {"id": f, "data": {"image": f"/data/upload/1/1a2b3c{f}d-a_{f:04d}.jpg"}, "annotations": [{"result": results}]}
        for f, results in by_frame(result).items()
    ],
    "labelstudio min": [
        {"image": f"/data/upload/1/1a2b3c{f}d-a_{f:04d}.jpg", "label": [r["value"] | r for r in results]}
        for f, results in by_frame(result).items()
    ],
    "labelstudio video": VIDEO,
    "via": {
        f"a_{f:04d}.jpg12": {"filename": f"a_{f:04d}.jpg", "size": 12, "regions": regions, "file_attributes": {}}
        for f, regions in by_frame(region).items()
    },
    "via project": {"_via_settings": {}, "_via_img_metadata": {
        f"a_{f}.jpg": {"filename": f"a_{f:04d}.jpg", "regions": dict(enumerate(map(str, ()), 0)) | {
            str(n): r for n, r in enumerate(regions)
        }}
        for f, regions in by_frame(region).items()
    }},
    "supervisely": {
        "size": {"width": 100, "height": 50}, "framesCount": 3,
        "objects": [{"key": "k7", "classTitle": "car"}, {"key": "k8", "classTitle": "person"}],
        "frames": [{"index": f, "figures": figures} for f, figures in by_frame(figure).items()],
    },
    "createml": [
        {"image": f"a_{f:04d}_jpg.rf.3f2a9c81d4e5.jpg", "annotations": boxes} for f, boxes in by_frame(centre).items()
    ],
    "supervision": [sink(*entry) for entry in OBJECTS],
    "supervision csv": table(
        "x_min,y_min,x_max,y_max,class_id,confidence,tracker_id,frame_number",
        lambda f, name, i, x, y, w, h: (x, y, x + w, y + h, {"car": 2, "person": 0}[name], 0.5, i, f),
    ),
    "csv_filename": table(
        "filename,width,height,class,xmin,ymin,xmax,ymax",
        lambda f, name, i, x, y, w, h: (f"a_{f:04d}_jpg.rf.3f2a9c81d4e5.jpg", 100, 50, name, x, y, x + w, y + h),
    ),
    "via_csv": table(
        "filename,file_size,file_attributes,region_count,region_id,region_shape_attributes,region_attributes",
        lambda f, name, i, *box: (
            f"a_{f:04d}.jpg", 9, quoted({}), 1, 0, *map(quoted, region(name, i, *box).values()),
        ),
    ),
    "detrac": '<?xml version="1.0" encoding="utf-8"?>\n<sequence name="MVI_1"><sequence_attribute camera="a"/>'
    + detrac(lambda name, i, x, y, w, h: f'<target id="{i}"><box left="{x}" top="{y}" width="{w}" height="{h}"/>'
             f'<attribute vehicle_type="{name}" truncation_ratio="0"/></target>')
    + "</sequence>",
    "coco waymo": {
        "categories": [{"id": 1, "name": "TYPE_VEHICLE"}, {"id": 2, "name": "TYPE_PEDESTRIAN"}],
        "images": [
            {"id": f, "file_name": f"1020_7625_000_{f:03d}_FRONT.jpg", "width": 100, "height": 50, "camera_id": 1}
            for f in (0, 2)
        ],
        "annotations": [
            {"id": n, "image_id": f, "category_id": 1 + (name == "person"), "bbox": box, "track_id": f"uv-{i}"}
            for n, (f, name, i, box) in enumerate(OBJECTS)
        ],
    },
    "coco mono3d": {
        "categories": [{"id": 0, "name": "car"}, {"id": 7, "name": "pedestrian"}],
        "images": [
            {"id": f"token{f}", "file_name": f"samples/CAM_FRONT/n015-2018__CAM_FRONT__15324029276124{f}0.jpg",
             "width": 100, "height": 50}
            for f in (0, 2)
        ],
        "annotations": [
            {"id": n, "image_id": f"token{f}", "category_id": 7 * (name == "person"), "bbox": box, "iscrowd": 0,
             "bbox_cam3d": [1, 1, 20, 4, 1.5, 1.6, 0.1]}
            for n, (f, name, _, box) in enumerate(OBJECTS)
        ],
    },
}  # fmt: skip


def openlabel(name, i, x, y, w, h):
    box = {"name": "box2d", "coordinate_system": "CAM", "val": [x + w / 2, y + h / 2, w, h]}
    return f"{i:08d}-0000-4000-8000-000000000000", {"object_data": {"bbox": [box]}}


# openlabel_json_schema-v1.0.0 and section 7.12.1 of the standard
FILES["openlabel"] = {
    "openlabel": {
        "metadata": {"schema_version": "1.0.0"},
        "streams": {
            "CAM": {
                "type": "camera",
                "uri": "a.mp4",
                "stream_properties": {
                    "intrinsics_pinhole": {
                        "camera_matrix": [100, 0, 50, 0, 0, 100, 25, 0, 0, 0, 1, 0],
                        "distortion_coeffs": [0, 0, 0, 0, 0],
                        "width_px": 100,
                        "height_px": 50,
                    }
                },
            }
        },
        "objects": {
            openlabel("", i, *CAR_0)[0]: {"name": f"{name}{i}", "type": name}
            for name, i in (("Car", 7), ("Pedestrian", 8))
        },
        "frames": {
            str(f): {"frame_properties": {"timestamp": 100 + f / 10}, "objects": dict(items)}
            for f, items in by_frame(openlabel).items()
        },
    }
}

VOC = (
    "<annotation><folder>a</folder><filename>wrong.jpg</filename><size><width>100</width><height>50</height></size>{}"
    "</annotation>"
)

FOLDERS = {
    "labelme": {
        f"a_{f:04d}.json": json.dumps(
            {
                "version": "5.0",
                "shapes": shapes,
                "imagePath": f"a_{f:04d}.jpg",
                "imageHeight": 50,
                "imageWidth": 100,
            }
        )
        for f, shapes in by_frame(rectangle).items()
    },
    "voc": {
        f"Annotations/a_{f:04d}.xml": VOC.format("".join(objects))
        for f, objects in by_frame(
            lambda name, i, x, y, w, h: (
                f"<object><name>{name}</name><bndbox><xmin>{x}</xmin><ymin>{y}</ymin><xmax>{x + w}</xmax>"
                f"<ymax>{y + h}</ymax></bndbox></object>"
            )
        ).items()
    },
    "supervisely": {
        f"ann/a_{f:04d}.jpg.json": json.dumps(
            {"size": {"height": 50, "width": 100}, "objects": objects}
        )
        for f, objects in by_frame(
            lambda name, i, *box: (
                {"classTitle": name, "geometryType": "rectangle"}
                | figure(name, i, *box)["geometry"]
            )
        ).items()
    },
}


def write(folder: Path, name: str) -> Path:
    """The reference file of a layout, or its folder for those of `FOLDERS` with "folder" behind the
    name."""
    path = folder / "labels.dat"
    if name.endswith(" folder"):
        for file, text in FOLDERS[name.removesuffix(" folder")].items():
            (folder / file).parent.mkdir(exist_ok=True)
            (folder / file).write_text(text)
        return folder
    content = FILES[name]
    path.write_text(
        content if isinstance(content, str) else json.dumps(content, indent=1 + len(name) % 2)
    )
    return path
