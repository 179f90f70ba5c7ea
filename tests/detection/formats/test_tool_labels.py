"""Small files of annotation tools and data sets by their specifications, with the boxes of
test_reference_labels."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from tests.detection.formats.test_reference_labels import CAR, CAR_LATER, PERSON, SIZE
from tests.support.damaged_text import MAX_MESSAGE, check_damaged, damaged
from track_range.detection.formats.box_table import VideoFacts
from track_range.detection.formats.errors import LabelFileError
from track_range.detection.formats.label_formats import LABEL_FORMATS, label_format_of, read_labels
from track_range.detection.formats.video_labels import tool_labels
from track_range.foundation.errors import UserError

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
WITHOUT_IDENTITIES = (
    "bdd100k det_20",
    "labelstudio",
    "labelstudio min",
    "createml",
    "csv_filename",
    "coco mono3d",
    "voc",
)


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


NAMES = [*FILES, *(f"{name} folder" for name in FOLDERS)]


@pytest.mark.parametrize("name", NAMES)
def test_reference_file(tmp_path: Path, name: str) -> None:
    path = write(tmp_path, name)
    assert label_format_of(path).name == {"supervision csv": "supervision"}.get(
        name, name.partition(" ")[0]
    )
    table = read_labels(path, SIZE)
    later = 1 if name == "coco mono3d" else 2  # the order of two times
    assert table.frame.tolist() == [0, later, later]
    order = [0, *(1 + np.argsort(table.xyxy_px[1:, 0]))]
    np.testing.assert_allclose(table.xyxy_px[order], [CAR, CAR_LATER, PERSON], atol=1e-9)
    assert table.class_id[order].tolist() == [2, 2, 0]
    identities = table.track_id[order].tolist()
    if name in WITHOUT_IDENTITIES or name in ("voc folder", "supervisely folder"):
        assert identities == [-1, -1, -1]
    else:
        assert identities[0] == identities[1] != identities[2]
    if name.startswith("supervision"):
        assert table.score.tolist() == [0.5, 0.5, 0.5]


def test_all_layouts_have_a_reference() -> None:
    names = {name.partition(" ")[0] for name in NAMES}
    assert set(tool_labels.LAYOUTS) <= names
    assert set(tool_labels.LAYOUTS) <= set(LABEL_FORMATS)


def test_interpolation_of_label_studio(tmp_path: Path) -> None:
    document = json.loads(json.dumps(VIDEO))
    document[0]["annotations"][0]["result"][0]["value"]["sequence"][0]["enabled"] = True
    path = tmp_path / "labels.json"
    path.write_text(json.dumps(document))
    table = read_labels(path)
    assert table.frame.tolist() == [0, 1, 2, 2]
    np.testing.assert_allclose(table.xyxy_px[1], [14.5, 19.5, 34.5, 39.5])
    assert table.video.size_px == (100, 50)


def test_ignored_regions_of_detrac(tmp_path: Path) -> None:
    path = tmp_path / "MVI.xml"
    region = '<ignored_region><box left="1" top="2" width="30" height="40"/></ignored_region>'
    path.write_text(str(FILES["detrac"]).replace("<frame", f"{region}<frame", 1))
    table = read_labels(path)
    assert (table.is_region.sum(), len(table)) == (2, 5)
    np.testing.assert_allclose(table.xyxy_px[table.is_region], [[0.5, 1.5, 30.5, 41.5]] * 2)


def test_frames_that_end_with_the_number_of_images(tmp_path: Path) -> None:
    path = tmp_path / "labels.csv"
    path.write_text(str(FILES["csv_filename"]).replace("a_0000", "a_0001"))
    assert read_labels(path).frame.tolist() == [1, 2, 2]
    table = read_labels(path, VideoFacts(n_frames=2))
    assert table.frame.tolist() == [0, 1, 1]
    assert "start at 1" in table.notes[0]


@pytest.mark.parametrize(
    ("name", "old", "new", "key_word"),
    [
        ("supervision", "frame_index", "when", "custom_data"),
        ("bdd100k det_20", "b1-6f-0000002.jpg", "c7-0000002.jpg", "one video"),
        ("bdd100k det_20", "b1-6f-0000002.jpg", "b1-6f-0000000.jpg", ""),
        ("createml", '"width": 20', '"width": "wide"', "CreateML"),
        ("labelstudio video", '"framesCount": 3', '"framesCount": 90000000', "frames"),
        ("labelstudio video", '"original_width": 100', '"other": 100', "original_width"),
        ("supervisely", '"index": 2', '"index": 0.5', "Supervisely"),
        ("supervisely", '"index": 2', '"index": -2', "from 0"),
        ("detrac", 'width="20"', 'width="1e9"', "pixels"),
        ("csv_filename", "a_0002", "front", "number"),
        ("coco waymo", '"uv-8"', "8", "track_id"),
    ],
)
def test_bad_files(tmp_path: Path, name: str, old: str, new: str, key_word: str) -> None:
    path = write(tmp_path, name)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    if key_word:
        with pytest.raises(LabelFileError, match=key_word) as caught:
            read_labels(path)
        assert path.name in str(caught.value)
    else:
        assert set(read_labels(path).frame.tolist()) == {0}


def test_entities_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a_0.xml"
    path.write_text(
        '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]><annotation><filename>&b;</filename></annotation>'
    )
    with pytest.raises(LabelFileError, match="document type"):
        read_labels(path)


def test_many_boxes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tool_labels, "_MAX_BOXES", 2)
    with pytest.raises(LabelFileError, match="at most 2"):
        read_labels(write(tmp_path, "bdd100k"))


@pytest.mark.parametrize("name", NAMES)
@settings(
    deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_damaged_files(tmp_path: Path, name: str, data: st.DataObject) -> None:
    path = write(tmp_path, name)
    if path.is_file():
        check_damaged(read_labels, path, data.draw(damaged(path.read_bytes())))
        return
    file = tmp_path / next(iter(FOLDERS[name.removesuffix(" folder")]))
    file.write_bytes(data.draw(damaged(file.read_bytes())))
    try:
        read_labels(path, SIZE)
    except UserError as error:
        message = str(error)
        assert tmp_path.name in message
        assert len(message.replace(str(tmp_path), "")) <= MAX_MESSAGE
        assert message.isprintable()
