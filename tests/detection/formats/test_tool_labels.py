"""Files of annotation tools and data sets are read with the boxes of reference_labels."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from tests.detection.formats.reference_labels import CAR, CAR_LATER, PERSON, SIZE
from tests.detection.formats.tool_files import (
    FILES,
    FOLDERS,
    VIDEO,
    write,
)
from tests.support.damaged_text import check_damaged, check_reading, damaged
from track_range.detection.formats.label_formats import LABEL_FORMATS, label_format_of, read_labels
from track_range.detection.formats.tables.box_table import VideoFacts
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tool_labels import reader
from track_range.detection.formats.tool_labels.annotation_tools import TOOLS
from track_range.detection.formats.tool_labels.content import content_of
from track_range.detection.formats.tool_labels.tool import Tool, centred

WITHOUT_IDENTITIES = (
    "bdd100k det_20",
    "labelstudio",
    "labelstudio min",
    "createml",
    "csv_filename",
    "coco mono3d",
    "voc",
)


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
    tools = {tool.name for tool in TOOLS}
    assert tools <= names
    assert tools <= set(LABEL_FORMATS.usable)


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
        (
            "bdd100k",
            '"videoName": "b1-6f",\n    "frameIndex": 2',
            '"videoName": "c7",\n    "frameIndex": 2',
            "found 2: b1-6f, c7",
        ),
        ("labelstudio", '"rotation": 0', '"rotation": 30', "upright boxes"),
        ("labelstudio video", '"rotation": 0', '"rotation": 30', "upright boxes"),
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


def test_shapes_that_are_no_boxes_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "a_0000.json"
    box = {"label": "car", "points": [[10, 20], [30, 40]], "shape_type": "rectangle"}
    point = {"label": "car", "points": [[1, 2]], "shape_type": "point"}
    path.write_text(json.dumps({"imagePath": "a_0000.jpg", "shapes": [box, point, point]}))
    table = read_labels(path)
    assert len(table) == 1
    (note,) = [note for note in table.notes if "shapes" in note]
    assert "point (2)" in note
    rotated = box | {"shape_type": "rotation", "direction": 0.5}  # of X-AnyLabeling
    path.write_text(json.dumps({"imagePath": "a_0000.jpg", "shapes": [rotated]}))
    with pytest.raises(LabelFileError, match="upright boxes"):
        read_labels(path)


def test_oriented_boxes_of_supervisely_are_refused_unless_they_are_upright(tmp_path: Path) -> None:
    shape = {
        "geometryType": "oriented_bbox",
        "classTitle": "car",
        "points": {"exterior": [[10, 20], [29, 39]], "interior": []},
    }
    path = tmp_path / "frame_0.json"
    for angle in (0, 1.2):
        size = {"width": 100, "height": 50}
        content = {"size": size, "objects": [shape | {"angle": angle}]}
        path.write_text(json.dumps(content))
        if angle:
            with pytest.raises(LabelFileError, match=r"upright boxes, found the rotation 1\.2"):
                read_labels(path)
        else:
            np.testing.assert_allclose(read_labels(path).xyxy_px, [[9.5, 19.5, 29.5, 39.5]])


def test_boxes_of_rolabelimg_with_an_angle_are_refused(tmp_path: Path) -> None:
    box = "<robndbox><cx>20</cx><cy>30</cy><w>20</w><h>20</h><angle>{}</angle></robndbox>"
    path = tmp_path / "a_0000.xml"
    text = f"<annotation><filename>a_0000</filename><object><name>car</name>{box}</object></annotation>"
    path.write_text(text.format(0.0))
    np.testing.assert_allclose(read_labels(path).xyxy_px, [[9.5, 19.5, 29.5, 39.5]])
    path.write_text(text.format(0.7))
    with pytest.raises(LabelFileError, match="upright boxes"):
        read_labels(path)


def test_numbers_in_place_of_names(tmp_path: Path) -> None:
    """They are the user's list, then that of a file beside the labels, then COCO's with a note."""
    path = tmp_path / "labels.csv"
    path.write_text(str(FILES["csv_filename"]).replace(",car", ",2").replace(",person", ",0"))
    table = read_labels(path)
    assert set(table.class_name) == {"car", "person"}
    assert "COCO's" in " ".join(table.notes)
    assert set(read_labels(path, VideoFacts(names=("van", "", "bus"))).class_name) == {"van", "bus"}
    (tmp_path / "classes.txt").write_text("truck\nbus\nvan\n")
    table = read_labels(path)
    assert set(table.class_name) == {"van", "truck"}
    assert "COCO's" not in " ".join(table.notes)


def test_a_tool_is_described_by_the_names_of_its_values(tmp_path: Path) -> None:
    toy = Tool(
        name="toy",
        title="Toy",
        mark=re.compile("toy"),
        objects=lambda content: (
            {"at": place, "thing": t} for place in content for t in place["t"]
        ),
        frame="at.n at.number",
        first_frame=1,
        label="thing.what",
        edges=centred("thing.where", "cx cy w h"),
        is_per_cent=True,
        identity="thing.who",
        size_px=("at.size.w", "at.size.h"),
    )
    where = {"cx": 20, "cy": 60, "w": 20, "h": 40}
    things = [{"what": "car", "where": where, "who": "a"}, {"what": "bus", "where": where}]
    path = tmp_path / "labels.dat"
    path.write_text(json.dumps([{"number": 3, "size": {"w": 100, "h": 50}, "t": things}]))
    table = reader.read_tool(path, toy, VideoFacts())
    assert table.frame.tolist() == [2, 2]
    assert table.class_name.tolist() == ["bus", "car"]
    assert table.track_id.tolist() == [-1, 0]
    np.testing.assert_allclose(table.xyxy_px, [[9.5, 19.5, 29.5, 39.5]] * 2)
    assert table.video.size_px == (100, 50)
    things[0].pop("what")
    path.write_text(json.dumps([{"number": 3, "size": {"w": 100, "h": 50}, "t": things}]))
    with pytest.raises(LabelFileError, match=r"labels\.dat.*Toy.*thing\.what"):
        reader.read_tool(path, toy, VideoFacts())


def test_elements_as_plain_values(tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    path.write_text('<a><b>1</b><b>2</b><c d="3"/><c><e> f </e></c></a>')
    assert content_of(path, "Toy") == {"a": [{"b": "1", "c": [{"d": "3"}, {"e": "f"}]}]}


def test_entities_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a_0.xml"
    path.write_text(
        '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]><annotation><filename>&b;</filename></annotation>'
    )
    with pytest.raises(LabelFileError, match="document type"):
        read_labels(path)


def test_many_boxes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader, "MAX_BOXES", 2)
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
    check_reading(lambda folder: read_labels(folder, SIZE), path)
