"""Labelled images: hand-worked labels of every format, manifests, and errors."""

import json

import cv2
import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.image_labels.image_truth import ANY_CLASS
from track_range.detection.formats.image_labels.labelled_images import (
    ImageFileError,
    images_in,
    of_split,
    read_image,
    read_labelled,
    read_manifest,
    read_sequence,
)
from track_range.detection.formats.tables.errors import LabelFileError

CAR = ROAD_CLASSES.index("car")


@pytest.fixture
def folder(tmp_path):
    """Two images of 40 x 20, a.png and b.png, and an empty folder for labels."""
    (tmp_path / "images").mkdir()
    (tmp_path / "labels").mkdir()
    for name in ("a", "b"):
        cv2.imwrite(str(tmp_path / "images" / f"{name}.png"), np.zeros((20, 40, 3), np.uint8))
    return tmp_path


def yolo(folder, text, **options):
    (folder / "labels/a.txt").write_text(text)
    return read_labelled(folder / "images", folder / "labels", "yolo", **options)


def test_yolo_boxes_are_fractions_of_the_image(folder):
    (item,) = yolo(folder, "2 0.5 0.5 0.25 0.5 0.9\n\n7 0.1 0.1 0.1 0.1\n")
    truth = item.truth_in(read_image(item.path))
    # corners 15 5 25 15, less half a pixel
    np.testing.assert_allclose(truth.xyxy_px[0], [14.5, 4.5, 24.5, 14.5])
    assert [ROAD_CLASSES[i] for i in truth.class_id] == ["car", "traffic sign"]
    assert truth.is_complete.all()


def test_sources_of_yolo_names(folder):
    text = "0 0.5 0.5 0.2 0.2\n1 0.5 0.5 0.2 0.2\n"
    (item,) = yolo(folder, text, names=["dog", "car"])
    assert item.truth.class_id.tolist() == [CAR]  # a dog is not a road user
    (folder / "data.yaml").write_text("names: {0: car, 1: bus}")
    assert yolo(folder, text)[0].truth.class_id.tolist() == [CAR, ROAD_CLASSES.index("bus")]
    (folder / "labels/classes.txt").write_text("truck\ncar\n")
    assert yolo(folder, text)[0].truth.class_id.tolist() == [ROAD_CLASSES.index("truck"), CAR]
    (folder / "labels/classes.txt").unlink()
    (folder / "data.yaml").write_text("path: .")
    with pytest.raises(LabelFileError, match=r"data\.yaml: .*class names"):
        yolo(folder, text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("2 0.5 0.5 0.2", "line 1: .*'class cx cy w h'"),
        ("2 0.5 0.5 0.2 0.2\ncar 0.5 0.5 0.2 0.2", "line 2"),
        ("2 0.5 nan 0.2 0.2", "line 1"),
        ("2 0.5 0.5 -0.2 0.2", "line 1"),
        ("8 0.5 0.5 0.2 0.2", "line 1: .*--label-names"),
    ],
)
def test_invalid_yolo_labels(folder, text, message):
    with pytest.raises(LabelFileError, match=rf"a\.txt, {message}"):
        yolo(folder, text)


def test_labels_that_are_not_text(folder):
    (folder / "labels/a.txt").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(LabelFileError, match=r"a\.txt: .*text"):
        read_labelled(folder / "images", folder / "labels", "yolo")


def test_labels_of_other_images(folder):
    (folder / "labels/z.txt").write_text("")
    with pytest.raises(LabelFileError, match="labels: no labels"):
        read_labelled(folder / "images", folder / "labels", "yolo")


KITTI_ROW = "{} 0 0 0 10 20 30 40 1.5 1.6 3.7 1 2 3 0"


def test_kitti_objects_are_labelled_for_four_classes(folder):
    rows = [KITTI_ROW.format(name) for name in ("Car", "Van", "Cyclist", "Tram", "DontCare")]
    (folder / "labels/b.txt").write_text("\n".join(rows))
    (item,) = read_labelled(folder / "images", folder / "labels", "kitti")
    truth = item.truth_in(read_image(item.path))
    assert item.path.name == "b.png"
    assert truth.class_id.tolist() == [
        CAR,
        CAR,
        ROAD_CLASSES.index("bicycle"),
        ANY_CLASS,
        ANY_CLASS,
    ]
    assert truth.is_ignored.tolist() == [False, True, False, True, True]
    assert truth.is_region.tolist() == [False, False, False, False, True]
    assert truth.xyxy_px[0].tolist() == [10, 20, 30, 40]
    assert [ROAD_CLASSES[i] for i in np.flatnonzero(truth.is_complete)] == [
        "person",
        "bicycle",
        "car",
        "truck",
    ]


def test_kitti_sequence_by_frame_number(folder):
    sequence = folder / "label.txt"
    sequence.write_text(
        f"3 0 {KITTI_ROW.format('Car')}\n3 1 {KITTI_ROW.format('Car')}\n5 0 "
        f"{KITTI_ROW.format('Car')}\n"
    )
    assert [len(read_sequence(sequence)(frame).class_id) for frame in (3, 4, 5)] == [2, 0, 1]
    cv2.imwrite(str(folder / "images/frame_0005.png"), np.zeros((20, 40, 3), np.uint8))
    (item,) = read_labelled(folder / "images", sequence, "kitti")
    assert (item.path.name, len(item.truth.class_id)) == ("frame_0005.png", 1)


def coco_document(**changed):
    document = {
        "images": [{"id": 7, "file_name": "train/a.png"}, {"id": 8, "file_name": "other.png"}],
        "categories": [{"id": 3, "name": "car"}, {"id": 17, "name": "cat"}],
        "annotations": [
            {"image_id": 7, "category_id": 3, "bbox": [10, 5, 8, 4]},
            {"image_id": 7, "category_id": 17, "bbox": [0, 0, 4, 4]},
            {"image_id": 7, "category_id": 3, "bbox": [0, 0, 40, 20], "iscrowd": 1},
        ],
    }
    return document | changed


def test_coco(folder):
    file = folder / "instances.json"
    file.write_text(json.dumps(coco_document()))
    (item,) = read_labelled(folder / "images", file, "coco")
    assert item.path.name == "a.png"
    assert item.truth.xyxy_px.tolist() == [[9.5, 4.5, 17.5, 8.5], [-0.5, -0.5, 39.5, 19.5]]
    assert item.truth.class_id.tolist() == [CAR, CAR]
    assert item.truth.is_region.tolist() == [False, True]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "COCO"),
        ("{}", "categories"),
        ("[]", "COCO"),
        (json.dumps(coco_document(images=[])), "image_id"),
        (json.dumps(coco_document(images=[{"id": 7, "file_name": "a.png"}] * 2)), "image id"),
        (
            json.dumps(
                coco_document(images=[{"id": i, "file_name": f"{i}/a.png"} for i in (7, 8)])
            ),
            "file name",
        ),
        (json.dumps(coco_document(categories=[{"id": 17, "name": "cat"}])), "category_id"),
        (
            json.dumps(
                coco_document(categories=[{"id": 3, "name": name} for name in ("car", "cat")])
            ),
            "category id",
        ),
        (
            json.dumps(
                coco_document(
                    annotations=[{"image_id": 7, "category_id": 3, "bbox": [9, 9, -4, 4]}]
                )
            ),
            "bbox",
        ),
        (
            json.dumps(
                coco_document(annotations=[{"image_id": 7, "category_id": 3, "bbox": ["9"] * 4}])
            ),
            "bbox",
        ),
    ],
)
def test_invalid_coco_file(folder, text, message):
    file = folder / "instances.json"
    file.write_text(text)
    with pytest.raises(LabelFileError, match=rf"instances\.json.*{message}"):
        read_labelled(folder / "images", file, "coco")
    with pytest.raises(LabelFileError, match=r"none\.json"):
        read_labelled(folder / "images", folder / "none.json", "coco")


def test_empty_boxes_of_coco(folder):
    file = folder / "instances.json"
    file.write_text(
        json.dumps(
            coco_document(annotations=[{"image_id": 7, "category_id": 3, "bbox": [10, 5, 0, 4]}])
        )
    )
    (item,) = read_labelled(folder / "images", file, "coco")
    assert len(item.truth.class_id) == 0
    assert "1 box" in item.notes[0]


def test_manifest_split_and_completeness(folder):
    for name in ("a", "b"):
        (folder / f"labels/{name}.txt").write_text("")
    labelled = read_labelled(folder / "images", folder / "labels", "yolo")
    file = folder / "manifest.csv"
    file.write_text(
        "file,split,other,labels_complete\na.png,train,x,11111111\nb.png,val,x,10100000\n"
    )
    (item,) = of_split(labelled, read_manifest(file), "val")
    assert item.path.name == "b.png"
    assert [ROAD_CLASSES[i] for i in np.flatnonzero(item.truth.is_complete)] == ["person", "car"]
    assert of_split(labelled, read_manifest(file), "test") == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "labels_complete"),
        ("file,split\na,val\n", "labels_complete"),
        ("file,split,labels_complete\na.png,val,101\n", "line 2: .*flags.*'101'"),
        ("file,split,labels_complete\na.png,val\n", "line 2: .*flags"),
    ],
)
def test_invalid_manifests(tmp_path, text, message):
    file = tmp_path / "manifest.csv"
    file.write_text(text)
    with pytest.raises(LabelFileError, match=rf"manifest\.csv.*{message}"):
        read_manifest(file)
    with pytest.raises(LabelFileError, match=r"none\.csv: no such file"):
        read_manifest(tmp_path / "none.csv")


def test_image_depths_and_channels(tmp_path):
    grey, deep = tmp_path / "grey.png", tmp_path / "deep.png"
    cv2.imwrite(str(grey), np.full((4, 6), 77, np.uint8))
    cv2.imwrite(str(deep), np.full((4, 6, 3), 0x1234, np.uint16))
    assert read_image(grey).shape == (4, 6, 3)
    assert np.unique(read_image(grey)).tolist() == [77]
    assert read_image(deep).dtype == np.uint8
    assert np.unique(read_image(deep)).tolist() == [0x12]


def test_unreadable_images(tmp_path):
    with pytest.raises(ImageFileError, match=r"none\.png: no such file"):
        read_image(tmp_path / "none.png")
    for content in (b"", b"text"):
        (tmp_path / "invalid.png").write_bytes(content)
        with pytest.raises(ImageFileError, match=r"invalid\.png: .*damaged"):
            read_image(tmp_path / "invalid.png")
    with pytest.raises(ImageFileError, match=r"none: .*folder"):
        images_in(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ImageFileError, match=r"empty: .*images"):
        images_in(tmp_path / "empty")
