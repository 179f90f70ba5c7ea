"""Each format reads its file of reference_labels with the same boxes, and writes them back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.detection.formats.reference_labels import (
    CAR,
    CAR_LATER,
    COCO,
    FILES,
    PERSON,
    SIZE,
    make,
)
from track_range.detection.formats.label_formats import LABEL_FORMATS, label_format_of, read_labels
from track_range.detection.formats.tables.box_table import BoxTable, VideoFacts


@pytest.mark.parametrize("name", [*FILES, "yolo"])
def test_reference_file(tmp_path: Path, name: str) -> None:
    path = make(tmp_path, name)
    assert label_format_of(path).name == name
    table = read_labels(path, SIZE)
    assert table.frame.tolist() == [0, 2, 2]
    order = [0, *(1 + np.argsort(table.xyxy_px[1:, 0]))]
    np.testing.assert_allclose(table.xyxy_px[order], [CAR, CAR_LATER, PERSON], atol=1e-9)
    assert table.class_id[order].tolist() == [2, 2, 0]
    assert table.track_id[order].tolist() == ([-1, -1, -1] if name == "yolo" else [7, 7, 8])
    assert table.observed.all()
    assert table.notes == ()


@pytest.mark.parametrize("name", ["coco", "cvat", "kitti", "mot", "yolo"])
def test_written_reference(tmp_path: Path, name: str) -> None:
    table = read_labels(make(tmp_path, "coco"))
    label_format = LABEL_FORMATS.usable[name]
    assert label_format.write is not None
    label_format.write(table, tmp_path / "out")
    if name == "mot":
        assert (
            (tmp_path / "out")
            .read_text()
            .startswith("1,7,10.50,20.50,20.00,20.00,1.0000,-1,-1,-1\n3,7,20.50")
        )
    elif name == "kitti":
        assert (
            (tmp_path / "out")
            .read_text()
            .startswith("0 7 Car -1 -1 -10 9.50 19.50 29.50 39.50 -1 -1 -1 -1000 -1000")
        )
    elif name == "yolo":
        file = tmp_path / "out/labels/a_000002.txt"
        assert file.read_text().splitlines()[0] == "2 0.30000000 0.60000000 0.20000000 0.40000000"
        assert (tmp_path / "out/labels/a_000001.txt").read_text() == ""
    else:
        text = (tmp_path / "out").read_text()
        assert {
            "coco": '"bbox": [20.0, 20.0, 20.0, 20.0]',
            "cvat": 'xtl="20.000" ytl="20.000" xbr="40.000"',
        }[name] in text


def test_distance_of_cvat(tmp_path: Path) -> None:
    table = read_labels(make(tmp_path, "cvat"))
    np.testing.assert_array_equal(table.distance_m, [12.5, np.nan, np.nan])
    assert (table.video.n_frames, table.video.size_px, table.video.name) == (3, (100, 50), "a")


# -- what a person changes in CVAT
# ------------------------------------------------------------------------------------


def cvat_of(tmp_path: Path, tracks: str, *, stop: int = 9, meta: str = "") -> BoxTable:
    path = tmp_path / "corrected.xml"
    path.write_text(
        f"<annotations><version>1.1</version><meta><task><size>{stop + 1}</size><start_frame>"
        f"0</start_frame><stop_frame>{stop}</stop_frame></task>{meta}</meta>{tracks}</annotations>"
    )
    return read_labels(path)


def box(frame: int, x: float, *, outside: int = 0, keyframe: int = 1, distance_m: str = "") -> str:
    attribute = f'<attribute name="distance_m">{distance_m}</attribute>'
    return (
        f'<box frame="{frame}" outside="{outside}" occluded="0" keyframe="{keyframe}" xtl="{x}" '
        f'ytl="5" xbr="{x + 10}" ybr="25" z_order="0">{attribute}</box>'
    )


def test_only_keyframes_are_interpolated(tmp_path: Path) -> None:
    tracks = (
        '<track id="0" '
        f'label="car">{box(2, 10, distance_m="20")}{box(6, 18, distance_m="10")}</track>'
    )
    table = cvat_of(tmp_path, tracks, stop=6)
    assert table.frame.tolist() == [2, 3, 4, 5, 6]
    np.testing.assert_allclose(table.xyxy_px[:, 0], [9.5, 11.5, 13.5, 15.5, 17.5])
    np.testing.assert_allclose(table.distance_m, [20, 17.5, 15, 12.5, 10])
    assert table.notes == ()


def test_outside_ends_a_track_and_it_returns(tmp_path: Path) -> None:
    boxes = box(0, 0) + box(3, 6, outside=1) + box(7, 40) + box(8, 40, outside=1)
    table = cvat_of(tmp_path, f'<track id="0" label="car">{boxes}</track>')
    assert table.frame.tolist() == [0, 1, 2, 7]
    np.testing.assert_allclose(table.xyxy_px[:, 0], [-0.5, 1.5, 3.5, 39.5])


def test_repeated_distances_are_interpolated(tmp_path: Path) -> None:
    listed = [
        box(0, 0, distance_m="20"),
        *(box(i, i, keyframe=0, distance_m="20") for i in (1, 2, 3)),
    ]
    track = f'<track id="0" label="car">{"".join(listed)}{box(4, 4, distance_m="12")}</track>'
    np.testing.assert_allclose(cvat_of(tmp_path, track, stop=4).distance_m, [20, 18, 16, 14, 12])
    own = cvat_of(
        tmp_path, track, stop=4, meta="<track_range><pixels>rectified</pixels></track_range>"
    )
    np.testing.assert_allclose(own.distance_m, [20, 20, 20, 20, 12])
    assert own.video.is_rectified


def test_renamed_label_open_end_and_empty_track(tmp_path: Path) -> None:
    tracks = f'<track id="0" label="Tractor">{box(0, 0)}</track><track id="4" label="car"></track>'
    table = cvat_of(tmp_path, tracks)
    assert table.class_name.tolist() == ["tractor"]
    assert table.class_id.tolist() == [-1]
    assert [word in " ".join(table.notes) for word in ("without boxes", "outside")] == [True, True]


def test_one_job_of_a_task(tmp_path: Path) -> None:
    path = tmp_path / "job.xml"
    path.write_text(
        "<annotations><meta><job><size>10</size><start_frame>20</start_frame><stop_frame>29</stop_frame></job></meta>"
        f'<track id="0" label="car">{box(20, 0)}{box(29, 5)}</track></annotations>'
    )
    table = read_labels(path)
    assert len(table) == 10
    assert "frames 20 to 29" in table.notes[0]
    assert (table.video.first_frame, table.video.n_frames) == (20, 30)


def test_keyframes_of_an_export_suffice(tmp_path: Path) -> None:
    frame = np.arange(60)
    left = 10 + 0.9 * frame + 8 * np.sin(frame / 9)
    boxes = np.stack([left, 0 * left + 5, left + 20, 0 * left + 30], axis=1)
    table = BoxTable.of(frame, 0 * frame, ["car"] * 60, boxes, distance_m=80.0 - frame, video=SIZE)
    path = tmp_path / "run.xml"
    assert LABEL_FORMATS.usable["cvat"].write is not None
    LABEL_FORMATS.usable["cvat"].write(table, path)
    text = path.read_text()
    blocks = text.split("    <box ")
    kept = [block for block in blocks if 'keyframe="0"' not in block]
    assert len(kept) < 25
    end = "" if kept[-1].rstrip().endswith("</annotations>") else "  </track>\n</annotations>\n"
    path.write_text("    <box ".join(kept) + end)
    back = read_labels(path)
    np.testing.assert_allclose(back.xyxy_px, table.xyxy_px, atol=1.01)
    np.testing.assert_allclose(back.distance_m, table.distance_m, rtol=0.021)


# -- other variants
# ---------------------------------------------------------------------------------------------------


def test_yolo_with_score_and_identity(tmp_path: Path) -> None:
    """Rows as Ultralytics' save_txt writes them: frames from 1, then the score, then the
    identity."""
    for frame, row in {1: "2 0.5 0.5 0.2 0.2 0.9 3", 2: "2 0.5 0.5 0.2 0.2 1"}.items():
        (tmp_path / f"drive_{frame}.txt").write_text(f"{row}\n")
    (tmp_path / "drive_2.txt").write_text("2 0.5 0.5 0.2 0.2 0.8 3\n0 0.1 0.1 0.1 0.1\n")
    table = read_labels(tmp_path, SIZE)
    assert table.frame.tolist() == [0, 1, 1]  # NAME_1 is the first frame
    assert table.track_id.tolist() == [3, -1, 3]
    np.testing.assert_array_equal(table.score, [0.9, np.nan, 0.8])
    assert [word in " ".join(table.notes) for word in ("class names", "start at 1")] == [True, True]


def test_yolo_size_from_an_image(tmp_path: Path) -> None:
    path = make(tmp_path, "yolo")
    (path / "images").mkdir()
    (path / "images/a_000000.pgm").write_bytes(b"P5 200 100 255\n" + bytes(20_000))
    np.testing.assert_allclose(read_labels(path).xyxy_px[0], [19.5, 39.5, 59.5, 79.5])


def test_coco_of_cvat(tmp_path: Path) -> None:
    """COCO as CVAT writes it: no frame_index, and the identity among the attributes."""
    path = tmp_path / "coco"
    path.write_text(
        '{"images": [{"id": 1, "file_name": "frame_000005.PNG", "width": 100, "height": 50}], '
        '"categories": [{"id": 3, "name": "Car"}], "annotations": [{"id": 1, "image_id": 1, '
        '"category_id": 3, "iscrowd": 0, "bbox": [10.0, 20.0, 20.0, 20.0], "attributes": '
        '{"occluded": false, "track_id": 7}}]}'
    )
    table = read_labels(path)
    assert (table.frame.tolist(), table.track_id.tolist(), table.class_id.tolist()) == (
        [5],
        [7],
        [2],
    )
    assert "names of the images" in table.notes[0]


def test_coco_of_datumaro(tmp_path: Path) -> None:
    """COCO as Datumaro converts it from CVAT: boxes outside, and the size 0 for images that it does
    not have."""
    document = json.loads(COCO)
    document["annotations"][0]["attributes"] = {"outside": True, "keyframe": True}
    for image in document["images"]:
        image |= {"width": 0, "height": 0}
    path = tmp_path / "coco"
    path.write_text(json.dumps(document))
    table = read_labels(path, SIZE)
    assert table.frame.tolist() == [2, 2]
    assert table.video.size_px == (100, 50)


@pytest.mark.parametrize("attributes", [(12.5, "", True, 0.75), ("12.500", None, "true", "0.75")])
def test_text_attributes_of_coco(tmp_path: Path, attributes: tuple[object, ...]) -> None:
    """CVAT writes attributes of the input type text as texts, and empty ones as empty texts."""
    document = json.loads(COCO)
    names = ("distance_m", "sigma_m", "predicted", "score")
    document["annotations"][0]["attributes"] = dict(zip(names, attributes, strict=True))
    path = tmp_path / "coco"
    path.write_text(json.dumps(document))
    table = read_labels(path)
    assert (table.distance_m[0], table.score[0], table.observed.tolist()) == (
        12.5,
        0.75,
        [False, True, True],
    )
    assert np.isnan(table.sigma_m).all()


@pytest.mark.parametrize(
    ("numbers", "n_frames", "frames"),
    [
        (("1", "2", "11"), None, [0, 1, 10]),  # of Ultralytics
        (("3", "12"), None, [2, 11]),
        (("0", "1", "11"), None, [0, 1, 11]),
        (("01", "02", "11"), None, [1, 2, 11]),
        (("01", "02", "11"), 11, [0, 1, 10]),
        (("01", "02", "11"), 12, [1, 2, 11]),
        (("101", "102"), None, [101, 102]),
    ],
)
def test_frame_numbers_in_names(
    tmp_path: Path, numbers: tuple[str, ...], n_frames: int | None, frames: list[int]
) -> None:
    for number in numbers:
        (tmp_path / f"drive_{number}.txt").write_text("2 0.5 0.5 0.2 0.2\n")
    table = read_labels(tmp_path, VideoFacts(size_px=(100, 50), n_frames=n_frames))
    assert table.frame.tolist() == frames
    as_in_names = [int(number) for number in numbers]
    assert (
        read_labels(tmp_path, VideoFacts(size_px=(100, 50), first_frame=1)).frame.tolist()
        == as_in_names
    )


def test_yolo_of_roboflow(tmp_path: Path) -> None:
    """Names with a hash after .rf., and the names of the classes two folders up."""
    (tmp_path / "data.yaml").write_text("names: ['Person', 'Car']\n")
    folder = tmp_path / "train"
    (folder / "labels").mkdir(parents=True)
    for name in ("a_0000_jpg.rf.3f2a9c81d4e9", "a_0012_jpg.rf.0b1c2d3e4f57"):
        (folder / f"labels/{name}.txt").write_text("1 0.2 0.6 0.2 0.4\n")
    table = read_labels(folder, SIZE)
    assert table.frame.tolist() == [0, 12]
    assert table.class_id.tolist() == [2, 2]
    np.testing.assert_allclose(table.xyxy_px, [CAR, CAR], atol=1e-9)
