"""Label files that are refused, each in one sentence with the file, or read with a note; and
damaged files."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from tests.detection.formats.reference_labels import COCO, CVAT, SIZE, YOLO
from tests.support.damaged_text import check_damaged, check_reading, damaged
from tests.support.error_messages import error_message
from track_range.detection.formats.label_formats import read_labels
from track_range.detection.formats.tables.box_table import VideoFacts
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.video_labels import cvat
from track_range.detection.formats.video_labels.coco import MAX_COCO_BYTES

BOMB = (
    '<?xml version="1.0"?>\n<!DOCTYPE a [<!ENTITY a "aaaa"><!ENTITY b '
    '"&a;&a;&a;&a;">]>\n<annotations>&b;</annotations>'
)
EXTERNAL = (
    '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a SYSTEM '
    '"file:///etc/passwd">]><annotations>&a;</annotations>'
)


def refused(path: Path, key_word: str) -> None:
    """Check that a file is refused in one short sentence with the file and a word."""
    message = error_message(LabelFileError, read_labels, path, SIZE)
    assert re.search(key_word, message)
    assert path.name in message
    assert message.endswith(".")


def changed(path: tuple[str | int, ...], value: Any) -> str:
    """The COCO file with another value; None removes it."""
    document = json.loads(COCO)
    place = document
    for key in path[:-1]:
        place = place[key]
    if value is None:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return json.dumps(document)


@pytest.mark.parametrize(
    ("content", "key_word"),
    [
        (changed(("annotations", 0, "category_id"), 99), "category_id"),
        (changed(("categories", 1, "id"), 1), "one name for each category"),
        (changed(("annotations", 0, "image_id"), 99), "image_id"),
        (changed(("images", 1, "id"), 1), "image id"),
        (changed(("images", 1, "frame_index"), 0), "two for frame 0"),
        (changed(("images", 1, "frame_index"), -1), "frame_index"),
        (changed(("images", 1, "video_id"), 2), "one video"),
        (
            changed(("images",), [{"id": i, "video": i, "frame_index": i} for i in (1, 3)]),
            "one video",
        ),
        (
            changed(("images",), [{"id": i, "file_name": f"{i}/0{i}.png"} for i in (1, 3)]),
            "one video",
        ),
        (changed(("annotations", 0, "bbox"), [1, 2, 3]), "bbox"),
        (changed(("annotations", 0, "bbox"), [1, 2, -3, 4]), "bbox"),
        (changed(("annotations", 0, "bbox"), [1, 2, True, 4]), "bbox"),
        (changed(("annotations", 0, "bbox"), None), "found none"),
        (
            changed(
                ("annotations", 0),
                {"image_id": 1, "category_id": 3, "segmentation": [[1, 2, 3, 4, 5, 6]]},
            ),
            "polygon",
        ),
        (changed(("annotations", 0, "bbox"), ["10", "20", "20", "20"]), "bbox"),
        (changed(("annotations", 0, "attributes"), {"distance_m": "near"}), "distance_m"),
        (re.sub(r'"bbox": \[.*?\]', '"bbox": [0.1, 0.2, 0.2, 0.2]', COCO), "fractions"),
        (
            re.sub(r'"frame_index": ., "video_id": 1', '"x": 0', COCO).replace(
                "a_000002", "b_000002"
            ),
            "one video",
        ),
        (
            changed(
                ("annotations", 0),
                {"image_id": 1, "category_id": 3, "segmentation": {"counts": "a"}},
            ),
            "RLE",
        ),
        (changed(("annotations", 0, "track_id"), "x"), "track_id"),
        (changed(("annotations", 0, "score"), 1e9), "score"),
        (changed(("annotations", 2, "track_id"), 7), "once per frame"),
        (changed(("annotations", 0, "attributes"), {"distance_m": -1}), "distance_m"),
        (changed(("annotations",), None), "annotations"),
        ('[{"image_id": 1, "category_id": 3, "bbox": [1, 2, 3, 4], "score": 0.5}]', "list"),
        ('{"annotations": ' + "[" * 100_000, "JSON"),
        (
            '{"images": [' + "[" * 60 + "]" * 60 + '], "annotations": [], "categories": []}',
            "nested",
        ),
        ("{}", "categories"),
        (changed(("annotations", 0, "attributes"), {"rotation": 60.0}), "upright boxes"),
        ('{"openlabel": {"frames": {}}}', "ASAM OpenLABEL"),
        ('{"categories": {"label": {}}, "items": []}', "Datumaro"),
        ('{"meta": {}, "results": {"a": []}}', "results of nuScenes"),
        ('[{"token": "a", "sample_token": "b", "translation": [1, 2, 3]}]', "table of nuScenes"),
        ('{"project": {}, "config": {}, "metadata": {}, "view": {}}', "VIA 3"),
        ('[{"ID": "a", "DataRow ID": "b", "Labeled Data": "c"}]', "Labelbox"),
        ('{"version": "2.0", "item": {}, "annotations": []}', "V7 Darwin"),
        ('{"samples": []}', "FiftyOne"),
        ('[{"name": "car", "class": 2, "confidence": 0.5, "box": {"x1": 1}}]', "Ultralytics"),
    ],
)
def test_bad_coco(tmp_path: Path, content: str, key_word: str) -> None:
    path = tmp_path / "labels.json"
    path.write_text(content)
    refused(path, key_word)


def test_images_of_several_sizes(tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    path.write_text(changed(("images", 0, "width"), 99))
    assert read_labels(path).video.size_px is None


def test_large_coco_is_refused_by_its_size(tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    path.write_text("{" + " " * 70_000)
    os.truncate(path, MAX_COCO_BYTES + 2_000_000)  # a sparse file
    refused(path, "252 MB")


@pytest.mark.parametrize(
    ("content", "key_word"),
    [
        (BOMB, "document type"),
        (EXTERNAL, "document type"),
        ("<annotations>" + "<a>" * 5000, "nested"),
        ("<annotations>&undefined;</annotations>", "undefined entity"),
        ("<annotations><track", "XML"),
        ("<html></html>", "element"),
        ('<annotations><image id="0" name="a.png"></image></annotations>', "CVAT for video"),
        (CVAT.replace("<box ", "<polygon ").replace("</box>", "</polygon>"), "polygon"),
        (CVAT.replace("<box ", "<points ").replace("</box>", "</points>"), "shape points"),
        (CVAT.replace('z_order="0"', 'rotation="12.5"'), "rotation"),
        (CVAT.replace('frame="2"', 'frame="x"'), "frame"),
        (CVAT.replace('frame="2"', 'frame="3"'), "the last frame of the task"),
        (CVAT.replace('frame="1"', 'frame="2"'), "two in frame 2"),
        (CVAT.replace('xbr="30.00"', 'xbr="3.00"'), "xtl"),
        (CVAT.replace('outside="0"', 'outside="maybe"'), "outside"),
        (CVAT.replace('id="8"', 'id="7"'), "track id"),
        (CVAT.replace('label="person"', ""), "label"),
        (CVAT.replace(">12.5<", ">near<"), "distance_m"),
        (
            CVAT.replace('id="7"', 'id="7" task_id="1"').replace('id="8"', 'id="8" task_id="2"'),
            "one task",
        ),
        (CVAT.replace("<width>100<", "<width>640<"), "640x50"),
        (
            CVAT.replace("<stop_frame>2", "<stop_frame>9999999").replace(
                'frame="2"', 'frame="999999"'
            ),
            "boxes",
        ),
    ],
)
def test_bad_cvat(tmp_path: Path, content: str, key_word: str) -> None:
    path = tmp_path / "labels.xml"
    if key_word == "boxes":  # 100 bytes may describe a million interpolated boxes
        box = '<box frame="{}" outside="0" keyframe="1" xtl="1" ytl="1" xbr="9" ybr="9"/>'
        track = f'<track id="{{}}" label="car">{box.format(0)}{box.format(999_999)}</track>'
        content = f"<annotations>{''.join(track.format(i) for i in range(3))}</annotations>"
    path.write_text(content)
    refused(path, key_word)


@pytest.mark.parametrize(
    ("file", "row", "key_word"),
    [
        ("labels/a_000000.txt", "5 0.5 0.5 0.1 0.1", "class number"),
        ("labels/a_000000.txt", "1 0.5 0.5 0.1", "fractions"),
        ("labels/a_000000.txt", "1 320 240 10 10", "fractions"),
        ("labels/a_000000.txt", "1 0.5 0.5 -0.1 0.1", "fractions"),
        ("labels/a_000000.txt", "1 0.1 0.1 0.2 0.1 0.2 0.25", "polygon"),
        ("labels/a_000000.txt", "1 " + "0.5 " * 20, "polygon"),
        ("labels/a_000000.txt", "1 nan 0.5 0.1 0.1", "fractions"),
        ("labels/b_000002.txt", "1 0.5 0.5 0.1 0.1", "one file for each frame"),
        ("labels/b_000003.txt", "1 0.5 0.5 0.1 0.1", "one video"),
        ("labels/notes.txt", "1 0.5 0.5 0.1 0.1", "frame number"),
        ("labels/a_99999999999999999.txt", "1 0.5 0.5 0.1 0.1", "frame number"),
        ("data.yaml", "names: {0: a, 1: b}\nvideo: {width: wide}", "video"),
    ],
)
def test_bad_yolo(tmp_path: Path, file: str, row: str, key_word: str) -> None:
    folder = tmp_path / "labelled"
    for name, text in {**YOLO, file: row}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(f"{text}\n")
    with pytest.raises(LabelFileError, match=key_word) as caught:
        read_labels(folder, SIZE)
    assert "labelled" in str(caught.value)


def test_many_boxes_of_cvat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cvat, "MAX_BOXES", 2)
    path = tmp_path / "labels.xml"
    path.write_text(CVAT)
    refused(path, "line 10.*at most 2")


def test_yolo_without_image_size(tmp_path: Path) -> None:
    (tmp_path / "a_0.txt").write_text("1 0.5 0.5 0.1 0.1\n")
    with pytest.raises(LabelFileError, match="the image size"):
        read_labels(tmp_path)


def test_other_image_size_than_the_video(tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    path.write_text(COCO)
    with pytest.raises(LabelFileError, match="100x50"):
        read_labels(path, VideoFacts(size_px=(640, 480)))


def test_first_frame_1_is_noted(tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    path.write_text(changed(("images", 0, "frame_index"), 1))
    assert any("start at 1" in note for note in read_labels(path).notes)


def test_empty_boxes_of_coco_are_noted(tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    path.write_text(changed(("annotations", 0, "bbox"), [1, 2, 0, 4]))
    table = read_labels(path)
    assert len(table) == 2
    assert any("ignored 1 box" in note for note in table.notes)


@pytest.mark.parametrize("content", [COCO, CVAT], ids=["coco", "cvat"])
@settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_damaged_labels(tmp_path: Path, content: str, data: st.DataObject) -> None:
    check_damaged(read_labels, tmp_path / "labels.dat", data.draw(damaged(content.encode())))


@settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_damaged_yolo(tmp_path: Path, data: st.DataObject) -> None:
    for name, text in YOLO.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    name = data.draw(st.sampled_from(["data.yaml", "labels/a_000002.txt"]))
    (tmp_path / name).write_bytes(data.draw(damaged(YOLO[name].encode())))
    check_reading(lambda folder: read_labels(folder, SIZE), tmp_path)
