"""Random tracks through every pair of label formats and back, and recognition of formats by
content."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from track_range.detection.classes import COCO_CLASSES, ROAD_CLASSES
from track_range.detection.formats.label_formats import LABEL_FORMATS, label_format_of, read_labels
from track_range.detection.formats.tables.box_table import BoxTable, VideoFacts
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.titles import (
    GENERAL_TITLES,
    READ_TITLES,
    TRUTH_NAMES,
    TRUTH_TITLES,
)

VIDEO = VideoFacts("drive", n_frames=40, size_px=(1242, 375), fps=10.0)
WRITTEN = [
    name for name, label_format in LABEL_FORMATS.usable.items() if label_format.write is not None
]
YOLO_PX = 2e-5
"""Largest error of an edge in YOLO labels of 8 decimals, for an image of 1242 px."""


@st.composite
def tables(draw: st.DrawFn) -> BoxTable:
    """Tracks with gaps, of one class each, with boxes inside the image and distances for some of
    them."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    keys = draw(
        st.lists(
            st.tuples(st.integers(0, 39), st.integers(1, 12)), min_size=1, max_size=60, unique=True
        ).map(sorted)
    )
    frame, track_id = (np.array(column) for column in zip(*keys, strict=True))
    n = len(keys)
    first = rng.uniform([0, 0], [1100, 300], (n, 2))
    size = rng.uniform(2, 70, (n, 2))
    distance_m = np.where(rng.random(n) < 0.8, rng.uniform(2, 150, n), np.nan)
    return BoxTable.of(
        frame,
        track_id,
        [ROAD_CLASSES[number % len(ROAD_CLASSES)] for number in track_id],
        np.concatenate([first, first + size], axis=1) - 0.5,
        score=rng.random(n),
        observed=rng.random(n) < 0.7,
        distance_m=distance_m,
        sigma_m=distance_m / 20,
        video=VIDEO,
    )


def written(table: BoxTable, name: str, folder: Path) -> BoxTable:
    """A table that was written in a format and read again."""
    label_format = LABEL_FORMATS.usable[name]
    path = folder / f"{name}{len(list(folder.iterdir()))}"
    assert label_format.write is not None
    label_format.write(table, path)
    assert label_format_of(path) is label_format
    return read_labels(path, VIDEO)


def by_box(table: BoxTable) -> BoxTable:
    """A table in an order that does not depend on identities: by frame, then by box."""
    return table.select(np.lexsort((table.xyxy_px[:, 1], table.xyxy_px[:, 0], table.frame)))


@pytest.mark.parametrize(("first", "second"), list(itertools.product(WRITTEN, repeat=2)))
@given(table=tables())
@settings(max_examples=4, deadline=None, suppress_health_check=list(HealthCheck))
def test_pairs_of_formats_and_back(
    table: BoxTable, first: str, second: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("formats")
    back = written(written(table, first, folder), second, folder)
    used = {first, second}
    table, back = by_box(table), by_box(back)
    np.testing.assert_array_equal(back.frame, table.frame)
    error_px = sum(LABEL_FORMATS.usable[name].precision_px or YOLO_PX for name in (first, second))
    np.testing.assert_allclose(back.xyxy_px, table.xyxy_px, rtol=0, atol=error_px + 1e-9)
    if "mot" not in used:
        np.testing.assert_array_equal(back.class_id, table.class_id)
    if "yolo" not in used:
        np.testing.assert_array_equal(back.track_id, table.track_id)
        np.testing.assert_allclose(back.score, table.score, rtol=0, atol=1.1e-4)
    if used <= {"coco", "cvat", "kitti"}:
        np.testing.assert_allclose(back.distance_m, table.distance_m, rtol=0, atol=1.1e-3)
    if used <= {"coco", "cvat"}:
        np.testing.assert_allclose(back.sigma_m, table.sigma_m, rtol=0, atol=1.1e-3)
        np.testing.assert_array_equal(back.observed, table.observed)


@given(table=tables())
@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
def test_second_write_is_the_same_file(
    table: BoxTable, tmp_path_factory: pytest.TempPathFactory
) -> None:
    for name in ("mot", "kitti", "coco", "cvat"):
        folder = tmp_path_factory.mktemp(name)
        label_format = LABEL_FORMATS.usable[name]
        assert label_format.write is not None
        label_format.write(table, folder / "first")
        label_format.write(label_format.read(folder / "first", VIDEO), folder / "second")
        assert (folder / "first").read_bytes() == (folder / "second").read_bytes()


@pytest.mark.parametrize("name", WRITTEN)
def test_no_boxes(tmp_path: Path, name: str) -> None:
    empty = BoxTable.of([], [], [], [], video=VIDEO)
    label_format = LABEL_FORMATS.usable[name]
    assert label_format.write is not None
    assert label_format.write(empty, tmp_path / "empty") == (0, ())
    if name in ("mot", "kitti"):
        with pytest.raises(LabelFileError, match="empty"):
            read_labels(tmp_path / "empty")
    else:
        table = read_labels(tmp_path / "empty")
        assert len(table) == 0
        assert (table.video.n_frames, table.video.size_px) == (40, (1242, 375))


def test_pycocotools_reads_an_export(tmp_path: Path) -> None:
    coco = pytest.importorskip("pycocotools.coco")
    boxes = [[9.5, 19.5, 29.5, 39.5], [0.5, 1.5, 3.5, 9.5]]
    table = BoxTable.of([0, 3], [1, 2], ["car", "bus"], boxes, score=[0.5, 0.25], video=VIDEO)
    assert LABEL_FORMATS.usable["coco"].write is not None
    LABEL_FORMATS.usable["coco"].write(table, tmp_path / "labels.json")
    data = coco.COCO(str(tmp_path / "labels.json"))
    assert len(data.getImgIds()) == 40
    (image_id,) = data.getImgIds(catIds=data.getCatIds(catNms=["bus"]))
    assert data.loadImgs(image_id)[0]["file_name"] == "drive_000003.jpg"
    assert [annotation["bbox"] for annotation in data.loadAnns(data.getAnnIds())] == [
        [10, 20, 20, 20],
        [1, 2, 3, 8],
    ]


@pytest.mark.parametrize(
    ("first_line", "name"),
    [
        ("frame,time_s,id,class,x1,y1,x2,y2,visible_share,distance_m", "csv"),
        ("frame,time_s,track_id,class,score,observed,x1_px", "tracks"),
        ("1,-1,11,21,5,6,0.5", "mot"),
        ("0 7 Car 0 1 -1.5 10 20 30 40 1.5 1.6 4.0 1.0 1.7 12.0 0.1", "kitti"),
        (' \n {"images": []', "coco"),
        ("\ufeff<annotations>", "cvat"),
        ("PAR1", "parquet"),
    ],
)
def test_format_is_recognised_from_the_content(tmp_path: Path, first_line: str, name: str) -> None:
    (tmp_path / "file.dat").write_text(f"{first_line}\n", encoding="utf-8")
    assert label_format_of(tmp_path / "file.dat").name == name


def test_kitti_folders_are_not_yolo(tmp_path: Path) -> None:
    (tmp_path / "0000.txt").write_text(
        "0 7 Car 0 1 -1.5 10 20 30 40 1.5 1.6 4.0 1.0 1.7 12.0 0.1\n"
    )
    assert label_format_of(tmp_path).name == "kitti"
    (tmp_path / "0000.txt").write_text("0 0.5 0.5 0.1 0.1\n")
    assert label_format_of(tmp_path).name == "yolo"


@pytest.mark.parametrize("name", ["coco", "cvat", "kitti", "mot", "yolo"])
def test_regions(tmp_path: Path, name: str) -> None:
    """Regions stay regions, or are left out with a note; they never become objects."""
    boxes = np.tile([10.0, 10.0, 20.0, 20.0], (2, 1))
    table = BoxTable.of(
        [0, 0], [5, -1], ["car", "person"], boxes, is_region=[False, True], video=VIDEO
    )
    label_format = LABEL_FORMATS.usable[name]
    assert label_format.write is not None
    n_written, notes = label_format.write(table, tmp_path / "out")
    back = read_labels(tmp_path / "out", VIDEO)
    assert len(back) == n_written == (1 if name in ("mot", "yolo") else 2)
    assert back.is_region.sum() == n_written - 1
    assert any("Regions" in note for note in notes) == (n_written == 1)


@pytest.mark.parametrize("name", ["../../out", "/etc/a", "a/b", "a\0b", ".", "", "\u00e4" * 190])
def test_video_names_stay_in_the_folder(tmp_path: Path, name: str) -> None:
    """The name of the video comes from the file, and becomes part of the names of written files."""
    table = BoxTable.of(
        [0], [1], ["car"], [[10, 10, 20, 20]], video=VideoFacts(name, n_frames=1, size_px=(100, 50))
    )
    folder = tmp_path / "a/b/c"
    folder.mkdir(parents=True)
    assert LABEL_FORMATS.usable["yolo"].write is not None
    LABEL_FORMATS.usable["yolo"].write(table, folder / "yolo")
    files = [file for file in tmp_path.rglob("*") if file.is_file()]
    assert {file.parent for file in files} == {folder / "yolo", folder / "yolo/labels"}
    assert len(read_labels(folder / "yolo")) == 1


@pytest.mark.parametrize("name", ["a b", "a\nb", "a\u2003b\u2028", "a,b", "<b>&'\"", "#", "x" * 90])
def test_odd_class_names(tmp_path: Path, name: str) -> None:
    for label_format in (LABEL_FORMATS.usable[key] for key in ("kitti", "coco", "cvat", "yolo")):
        table = BoxTable.of(
            [0, 0], [1, 2], [name, "car"], [[10, 10, 20, 20], [5, 5, 9, 9]], video=VIDEO
        )
        assert label_format.write is not None
        label_format.write(table, tmp_path / label_format.name)
        back = label_format.read(tmp_path / label_format.name, VIDEO)
        assert sorted(back.class_id.tolist()) == [-1, 2]
        assert label_format_of(tmp_path / label_format.name) is label_format


def test_tracks_of_several_classes_in_cvat(tmp_path: Path) -> None:
    boxes = np.tile([10.0, 10.0, 20.0, 20.0], (3, 1))
    table = BoxTable.of([0, 1, 2], [5, 5, 5], ["car", "truck", "car"], boxes, video=VIDEO)
    assert LABEL_FORMATS.usable["cvat"].write is not None
    notes = LABEL_FORMATS.usable["cvat"].write(table, tmp_path / "a.xml").notes
    back = read_labels(tmp_path / "a.xml")
    assert back.class_name.tolist() == ["car", "truck", "car"]
    assert back.track_id.tolist() == [5, 6, 5]
    assert "several classes" in notes[0]


def test_columns_have_one_value_for_each_box() -> None:
    with pytest.raises(ValueError, match="reshape"):
        BoxTable.of([0, 1], [0, 1], ["car", "bus"], np.ones((2, 4)), score=[0.5])
    assert BoxTable.of(
        [0, 1], [0, 1], ["car", "bus"], np.ones((2, 4)), score=0.5
    ).score.tolist() == [0.5, 0.5]


def test_titles_of_help_pages():
    formats = LABEL_FORMATS.usable.values()
    assert ", ".join(form.title for form in formats) == READ_TITLES
    assert ", ".join(form.title for form in formats if form.is_general) == GENERAL_TITLES
    true = [form for form in formats if not form.is_of_run]
    assert ", ".join(form.title for form in true) == TRUTH_TITLES
    assert ", ".join(form.name for form in true) == TRUTH_NAMES


@pytest.mark.parametrize(
    "label", ["DontCare", "dont_care", "ignored region", "Ignored Regions", "ignore"]
)
def test_labels_of_regions_are_regions_in_every_format(tmp_path: Path, label: str) -> None:
    table = BoxTable.of([0, 0], [3, 4], [label, "car"], [[1, 2, 3, 4]] * 2)
    assert table.is_region.tolist() == [True, False]
    assert table.track_id.tolist() == [-1, 4]
    path = tmp_path / "labels.json"
    write = LABEL_FORMATS.usable["coco"].write
    assert write is not None
    write(table, path)
    assert read_labels(path).is_region.tolist() == [True, False]


def test_rows_of_a_tracker_that_starts_without_identities(tmp_path: Path) -> None:
    """Ultralytics writes a score, and the identity after it where there is one."""
    (tmp_path / "data.yaml").write_text("names: [person, bicycle, car]")
    for frame, line in enumerate(("2 .4 .5 .1 .2 .8", "2 .4 .5 .1 .2 .7 5"), start=1):
        (tmp_path / f"drive_{frame}.txt").write_text(line)
    table = read_labels(tmp_path, VideoFacts(size_px=(100, 50)))
    assert table.track_id.tolist() == [-1, 5]
    assert table.score.tolist() == [0.8, 0.7]


def test_tracks_without_ids_are_numbered(tmp_path: Path) -> None:
    box = '<box frame="0" outside="0" xtl="1" ytl="2" xbr="3" ybr="4"/>'
    track = f'<track label="car">{box}</track>'
    path = tmp_path / "labels.xml"
    path.write_text(f"<annotations><version>1.1</version>{track}{track}</annotations>")
    assert read_labels(path).track_id.tolist() == [0, 1]


@pytest.mark.parametrize("mark", [{"ignore": 1}, {"attributes": {"ignore": True}}])
def test_ignored_boxes_of_coco_are_regions(tmp_path: Path, mark: dict[str, Any]) -> None:
    box = {"image_id": 1, "category_id": 1, "bbox": [1, 2, 3, 4]}
    document = {
        "images": [{"id": 1, "file_name": "000000.png"}],
        "categories": [{"id": 1, "name": "car"}],
        "annotations": [{"id": 1, **box}, {"id": 2, **box, **mark}],
    }
    path = tmp_path / "labels.json"
    path.write_text(json.dumps(document))
    assert sorted(read_labels(path).is_region.tolist()) == [False, True]


def test_numbers_of_a_yolo_folder_without_names_are_a_question(tmp_path: Path) -> None:
    """5 is a bus in COCO's list, and a truck in that of the road classes."""
    video = VideoFacts(size_px=(100, 50))
    (tmp_path / "drive_000000.txt").write_text("2 .4 .5 .1 .2")
    table = read_labels(tmp_path, video)
    assert (table.class_name.tolist(), "2 car" in table.notes[0]) == (["car"], True)
    (tmp_path / "drive_000000.txt").write_text("5 .4 .5 .1 .2")
    with pytest.raises(LabelFileError, match="--names coco"):
        read_labels(tmp_path, video)
    assert read_labels(tmp_path, replace(video, names=COCO_CLASSES)).class_name == ["bus"]
