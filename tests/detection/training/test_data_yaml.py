import cv2
import numpy as np
import pytest
import yaml

from tests.detection.training.road_scenes import write_data_set
from track_range.detection.formats.image_labels.labelled_images import ImageFileError
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.training.data.data_set import CachedImages
from track_range.detection.training.data_yaml import read_data_yaml

CAR, PERSON = 2, 0


def changed(path, **changes):
    document = yaml.safe_load(path.read_text()) | changes
    path.write_text(
        yaml.safe_dump({key: value for key, value in document.items() if value is not None})
    )
    return path


def test_yolo_data_set(tmp_path):
    data = read_data_yaml(write_data_set(tmp_path, n_train=5, n_val=2))
    assert (len(data.train), len(data.val), data.notes) == (5, 2, ())
    assert data.road_class_id.tolist() == [CAR, PERSON]
    assert {int(i) for item in data.train for i in item.truth.class_id} == {CAR, PERSON}


def test_other_classes_are_left_out_with_note(tmp_path):
    path = changed(write_data_set(tmp_path), names=["zebra", "person"])
    data = read_data_yaml(path)
    assert data.road_class_id.tolist() == [PERSON]
    assert "zebra" in data.notes[0]


def test_images_without_labels_are_background(tmp_path):
    path = write_data_set(tmp_path, n_train=4, n_val=1)
    (tmp_path / "labels/train/002.txt").unlink()
    (tmp_path / "labels/train/001.txt").write_text("")
    data = read_data_yaml(path)
    assert len(data.train) == 4
    assert sum(len(item.truth.class_id) == 0 for item in data.train) == 2
    assert "1 images have no label file" in data.notes[0]


def test_list_of_images(tmp_path):
    path = changed(write_data_set(tmp_path, n_train=4), train="some.txt")
    (tmp_path / "some.txt").write_text("./images/train/003.png\nimages/train/000.png\n")
    assert [item.path.name for item in read_data_yaml(path).train] == ["000.png", "003.png"]


def test_boxes_outside_the_image_are_clipped(tmp_path):
    path = write_data_set(tmp_path, n_train=2, n_val=1)
    (tmp_path / "labels/train/000.txt").write_text(
        "0 0.5 0.5 0.2 0.2\n0 0.95 0.5 0.3 0.2\n1 1.5 0.5 0.2 0.2\n"
    )
    data = read_data_yaml(path)
    assert data.train[0].truth.xyxy_px[:, 2].max() == 1.0
    assert len(data.train[0].truth.class_id) == 2
    assert "2 labelled boxes" in data.notes[0]
    assert "000.txt, line 2" in data.notes[0]


@pytest.mark.parametrize(
    ("line", "key_word"),
    [
        ("0 nan 0.5 0.2 0.2", "'class cx cy w h'"),
        ("0 0.5 0.5 -0.2 0.2", "'class cx cy w h'"),
        ("0 0.5 0.5", "'class cx cy w h'"),
        ("car 0.5 0.5 0.2 0.2", "'class cx cy w h'"),
        ("1.5 0.5 0.5 0.2 0.2", "'class cx cy w h'"),
        ("1e30 0.5 0.5 0.2 0.2", "'class cx cy w h'"),
        ("7 0.5 0.5 0.2 0.2", "got 7"),
        ("-1 0.5 0.5 0.2 0.2", "got -1"),
    ],
)
def test_invalid_labels_name_file_and_line(tmp_path, line, key_word):
    path = write_data_set(tmp_path)
    (tmp_path / "labels/train/003.txt").write_text(line + "\n")
    with pytest.raises(LabelFileError, match=rf"003\.txt, line 1: .*{key_word}"):
        read_data_yaml(path)


def test_polygons_become_boxes(tmp_path):
    path = write_data_set(tmp_path, n_train=1, n_val=1)
    (tmp_path / "labels/train/000.txt").write_text("0 0.1 0.2 0.5 0.1 0.4 0.6\n")
    assert read_data_yaml(path).train[0].truth.xyxy_px[0] == pytest.approx([0.1, 0.1, 0.5, 0.6])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"train": "images/nowhere"}, r"data\.yaml: .*folder.*nowhere"),
        ({"val": None}, r"data\.yaml: .*'val'"),
        ({"names": None}, r"data\.yaml: .*'names'"),
        ({"names": ["cat", "dog"]}, r"data\.yaml: .*road class"),
        ({"pseudo_names": ["car"], "labels_pseudo": "."}, r"pseudo_names: .*probabilities"),
        ({"pseudo_scores": "yes"}, r"data\.yaml: 'pseudo_scores'"),
        (
            {"pseudo_scores": "probabilities", "pseudo_names": ["cat"], "labels_pseudo": "."},
            r"pseudo_names: .*cat",
        ),
        ({"format": "coco"}, r"data\.yaml: 'format'"),
        ({"anchors": 3}, r"data\.yaml: 'anchors'"),
        ({"foo": 1, "bar": 2}, r"data\.yaml: '(foo|bar)'"),
        ({"train": ""}, r"data\.yaml: 'train'"),
        ({"train": {"a": "b"}}, r"data\.yaml: 'train'"),
        ({"train": [None]}, r"data\.yaml: 'train'"),
        ({"names": {1: "person", 2: "car"}}, r"data\.yaml: .*1, 2"),
        ({"names": {0: "person", 2: "car"}}, r"data\.yaml: .*0, 2"),
        ({"labels": "nowhere"}, r"data\.yaml: .*folder.*nowhere"),
        ({"labels_pseudo": "nowhere"}, r"data\.yaml: .*folder.*nowhere"),
        ({"manifest": "nowhere.csv"}, r"nowhere\.csv"),
        ({"train": "images/list.txt"}, r"list\.txt: .*list"),
    ],
)
def test_invalid_data_yaml(tmp_path, changes, message):
    path = changed(write_data_set(tmp_path), **changes)
    with pytest.raises((LabelFileError, ImageFileError), match=message):
        read_data_yaml(path)


@pytest.mark.parametrize("text", ["", "[1, 2]", "train: [", "\x00"])
def test_no_data_yaml(tmp_path, text):
    path = tmp_path / "data.yaml"
    path.write_text(text)
    with pytest.raises(LabelFileError, match=r"data\.yaml"):
        read_data_yaml(path)
    with pytest.raises(LabelFileError, match=r"other\.yaml"):
        read_data_yaml(tmp_path / "other.yaml")


def test_pseudo_labels_of_incomplete_classes(tmp_path):
    path = write_data_set(tmp_path, n_train=2)
    for name, flags in (("000", "11011111"), ("001", "11111111")):
        with (tmp_path / "manifest.csv").open("a") as file:
            if name == "000":
                file.write("file,split,labels_complete\n")
            file.write(f"{name}.png,train,{flags}\n{name}.png,train,{flags}\n")
        (tmp_path / "labels/train" / f"{name}.txt").write_text("")
    (tmp_path / "teacher").mkdir()
    for name in ("000", "001"):
        # a car of high score, a car of low score, a person of high score
        (tmp_path / "teacher" / f"{name}.txt").write_text(
            "0 .2 .2 .1 .1 0.45\n0 .5 .5 .1 .1 0.3\n1 .8 .8 .1 .1 0.9\n"
        )
    document = yaml.safe_load(path.read_text()) | {
        "manifest": "manifest.csv",
        "labels_pseudo": "teacher",
    }
    document["val"] = "images/train"
    with (tmp_path / "manifest.csv").open("a") as file:
        file.write("none.png,val,11111111\n")
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(LabelFileError, match=r"data\.yaml: .*'val'"):
        read_data_yaml(path)
    (tmp_path / "images/train/none.png").write_bytes(
        (tmp_path / "images/train/000.png").read_bytes()
    )
    data = read_data_yaml(path)
    assert data.train[0].truth.is_ignored.tolist() == [
        False,
        True,
        True,
    ]  # only cars are incomplete
    assert data.train[1].truth.is_ignored.tolist() == [True, True, True]
    path.write_text(yaml.safe_dump(document | {"pseudo_scores": "probabilities"}))
    soft = read_data_yaml(path).train
    assert all(item.truth.is_complete.all() for item in soft)
    assert soft[0].truth.is_ignored.tolist() == [False, False, True]
    assert soft[0].truth.confidence.tolist() == [0.45, 0.3, 0.9]
    assert CachedImages(soft, data.road_class_id).load(0).confidence.tolist() == [0.45, 0.3, 0.9]
    first = read_data_yaml(path).fingerprint()
    pseudo = tmp_path / "teacher/000.txt"
    text = pseudo.read_text()
    pseudo.write_text(text.replace("0.45", "0.46"))
    assert read_data_yaml(path).fingerprint() != first
    pseudo.write_text(text.replace("0.45", "1.45"))
    with pytest.raises(LabelFileError, match=r"000\.txt: .*at most 1, found 1\.45"):
        read_data_yaml(path)
    pseudo.write_text(text)
    path.write_text(yaml.safe_dump(document))
    assert len(data.val) == 1
    assert not any("not in the manifest" in note for note in data.notes)
    (tmp_path / "images/train/new.png").write_bytes(
        (tmp_path / "images/train/000.png").read_bytes()
    )
    assert any("1 images for 'train'" in note for note in read_data_yaml(path).notes)


def test_kitti_labels(tmp_path):
    for folder in ("images", "labels"):
        (tmp_path / folder).mkdir()
    cv2.imwrite(str(tmp_path / "images/000000.png"), np.zeros((100, 300, 3), np.uint8))
    row = "{} 0 0 0 {} 1 1 1 0 0 0 0"
    (tmp_path / "labels/000000.txt").write_text(
        "\n".join(
            row.format(kind, box)
            for kind, box in (("Car", "10 20 60 50"), ("Person_sitting", "80 20 90 50"))
        )
    )
    (tmp_path / "data.yaml").write_text("train: images\nval: images\nformat: kitti\n")
    cv2.imwrite(str(tmp_path / "images/000001.png"), np.zeros((100, 300, 3), np.uint8))
    data = read_data_yaml(tmp_path / "data.yaml")
    assert ["1 images without a label file" in note for note in data.notes] == [True]
    assert data.road_class_id.tolist() == [0, 1, 2, 5]
    item = CachedImages(data.train, data.road_class_id, max_side_px=150).load(0)
    assert item.image.shape == (50, 150, 3)
    assert item.class_index.tolist() == [2, 0]
    assert item.is_ignored.tolist() == [False, False]  # sitting persons are persons in training
    assert item.xyxy[0] == pytest.approx([5.25, 10.25, 30.25, 25.25])


def test_damaged_images_are_left_out(tmp_path):
    path = write_data_set(tmp_path, n_train=4)
    (tmp_path / "images/train/001.png").write_bytes(b"not an image")
    (tmp_path / "images/train/002.png").write_bytes(b"")
    data = read_data_yaml(path)
    images = CachedImages(data.train, data.road_class_id)
    assert len(images) == 2
    assert ["001.png" in images.unreadable[0], "002.png" in images.unreadable[1]] == [True, True]
    for name in ("000", "003"):
        (tmp_path / f"images/train/{name}.png").write_bytes(b"")
    with pytest.raises(ImageFileError, match=r"none of the 4 images .*000\.png"):
        CachedImages(data.train, data.road_class_id)


def test_image_cache_limit(tmp_path):
    data = read_data_yaml(write_data_set(tmp_path, n_train=4))
    one_image = 160 * 120 * 3
    images = CachedImages(data.train, data.road_class_id, max_bytes=2 * one_image)
    all_images = CachedImages(data.train, data.road_class_id)
    assert (images.n_cached, all_images.n_cached, len(images)) == (2, 4, 4)
    assert all(np.array_equal(images.load(i).image, all_images.load(i).image) for i in range(4))


def test_nested_data_set(tmp_path):
    for name in ("first", "drawn"):
        (tmp_path / name).mkdir()
    other = write_data_set(tmp_path / "drawn", n_train=3)
    path = changed(
        write_data_set(tmp_path / "first", n_train=2), train=["images/train", "../drawn/data.yaml"]
    )
    assert len(read_data_yaml(path).train) == 5
    both = changed(path, val="../drawn/data.yaml")
    changed(other, val="images/train", names=["car", "zebra"])
    (tmp_path / "drawn/images/val").mkdir(exist_ok=True)
    data = read_data_yaml(both)
    assert {item.path.parent.parent.parent.name for item in data.val} == {"drawn"}
    nested = [item for item in data.train if "drawn" in str(item.path)]
    # data.yaml does not name this class
    assert not any(item.truth.is_complete[PERSON] for item in nested)
    assert all(item.truth.is_complete[CAR] for item in nested)
    changed(other, train="../first/data.yaml")
    with pytest.raises(LabelFileError, match=r"data\.yaml: refers to itself"):
        read_data_yaml(path)


def test_loop_of_links(tmp_path):
    (tmp_path / "data.yaml").symlink_to(tmp_path / "data.yaml")
    with pytest.raises(LabelFileError, match=r"data\.yaml: .*loop"):
        read_data_yaml(tmp_path / "data.yaml")


def test_missing_images_of_a_list(tmp_path):
    path = changed(write_data_set(tmp_path, n_train=2), train="some.txt")
    (tmp_path / "some.txt").write_text("images/train/000.png\nimages/train/missing.png\n")
    with pytest.raises(LabelFileError, match=r"some\.txt: .*images/train/missing\.png"):
        read_data_yaml(path)


def test_kitti_boxes_of_negative_size(tmp_path):
    for folder in ("images", "labels"):
        (tmp_path / folder).mkdir()
    cv2.imwrite(str(tmp_path / "images/000000.png"), np.zeros((100, 300, 3), np.uint8))
    (tmp_path / "labels/000000.txt").write_text("Car 0 0 0 60 60 10 10 1 1 1 0 0 0 0\n")
    (tmp_path / "data.yaml").write_text("train: images\nval: images\nformat: kitti\n")
    with pytest.raises(LabelFileError, match=r"000000\.png: .*boxes"):
        read_data_yaml(tmp_path / "data.yaml")
