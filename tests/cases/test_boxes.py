"""Boxes that people own, of trackers, annotation tools and data sets, each with what is right: the
boxes, or the sentence that names the choice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.support.command_line import Finished
from track_range.detection.classes import CLASS_LISTS, ROAD_CLASSES
from track_range.detection.formats.detection_files import read_detections
from track_range.detection.formats.label_formats import read_labels
from track_range.detection.formats.tables.box_table import BoxTable, VideoFacts
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.foundation.files.csv_tables import read_csv_table

VIDEO = VideoFacts(n_frames=15, size_px=(1280, 720))


@dataclass(frozen=True, kw_only=True)
class Case:
    """A file of the shared folder and the boxes in it, as (frame, identity, class)."""

    name: str
    file: str
    n_boxes: int
    first: tuple[int, int, str]
    last: tuple[int, int, str]
    score: float = np.nan  # of the first box
    note: str = ""
    names: tuple[str, ...] = ()
    size_px: tuple[int, int] = (1280, 720)


CASES = (
    Case(
        name="box_json_of_others",
        file="openlabel.json",
        n_boxes=1,
        first=(0, 0, "car"),
        last=(0, 0, "car"),
    ),
    Case(
        name="box_boxmot9",
        file="tracks.txt",
        n_boxes=30,
        first=(0, 1, "car"),
        last=(14, 2, "car"),
        score=0.8005,
        note="--names gives others",
    ),
    Case(
        name="box_cvat_mot",
        file="cvatmot/gt/gt.txt",
        n_boxes=30,
        first=(0, 1, "car"),
        last=(14, 2, "car"),
        note="labels.txt",
    ),
    Case(
        name="box_cvat_mot",
        file="cvatmot2/gt/gt.txt",
        n_boxes=30,
        first=(0, 1, "car"),
        last=(14, 2, "car"),
        note="labels.txt",
    ),
    Case(
        name="box_deepstream_kitti",
        file="gie",
        n_boxes=6,
        first=(0, -1, "car"),
        last=(2, -1, "person"),
        score=0.912,
    ),
    Case(
        name="box_jaad_tracks_without_id",
        file="video.xml",
        n_boxes=10,
        first=(0, 0, "pedestrian"),
        last=(4, 1, "ped"),
        size_px=(1920, 1080),
    ),
    Case(
        name="box_kitti_zero_3d",
        file="labels.txt",
        n_boxes=3,
        first=(0, 1, "car"),
        last=(2, 1, "car"),
    ),
    Case(
        name="box_mot_6_columns",
        file="mot6.txt",
        n_boxes=30,
        first=(0, 1, ""),
        last=(14, 30, ""),
    ),
    Case(
        name="box_mot_frames_from_0",
        file="mot_one.txt",
        n_boxes=30,
        first=(0, -1, ""),
        last=(14, -1, ""),
        score=0.8005,
    ),
    Case(
        name="box_mot_frames_from_0",
        file="mot_zero.txt",
        n_boxes=30,
        first=(0, -1, ""),
        last=(14, -1, ""),
        score=0.8005,
        note="start at 0",
    ),
    Case(
        name="box_mot_spaces",
        file="boxmot.txt",
        n_boxes=30,
        first=(0, 1, "car"),
        last=(14, 2, "car"),
        score=0.8005,
        note="--names gives others",
    ),
    Case(
        name="box_supervision_without_names",
        file="sink.csv",
        n_boxes=12,
        first=(0, 1, "person"),
        last=(5, 2, "bicycle"),
        score=0.9,
        note="read as COCO's",
    ),
    Case(
        name="box_supervision_without_names",
        file="sink.csv",
        n_boxes=12,
        first=(0, 1, "car"),
        last=(5, 2, "truck"),
        score=0.9,
        names=("car", "truck"),
    ),
    Case(
        name="box_yolo_save_txt",
        file="ul_conf_id",
        n_boxes=30,
        first=(0, 1, "car"),
        last=(14, 2, "car"),
        score=0.8005,
        note="start at 1",
    ),
    Case(
        name="box_yolo_track_conf_mixed",
        file="run",
        n_boxes=4,
        first=(0, -1, "car"),
        last=(3, 1, "car"),
        score=0.812345,
    ),
)


def row(table: BoxTable, index: int) -> tuple[int, int, str]:
    return int(table.frame[index]), int(table.track_id[index]), str(table.class_name[index])


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.name}-{case.file}")
def test_boxes_are_read(shared_data: Path, case: Case) -> None:
    video = VideoFacts(n_frames=VIDEO.n_frames, size_px=case.size_px, names=case.names)
    table = read_labels(shared_data / "cases" / case.name / case.file, video)
    assert (len(table), row(table, 0), row(table, -1)) == (case.n_boxes, case.first, case.last)
    assert table.score[0] == pytest.approx(case.score, nan_ok=True)
    assert np.isnan(table.distance_m).all()
    notes = " ".join(table.notes)
    assert case.note in notes
    assert case.note or "COCO" not in notes


REFUSED = {
    "box_coco_cvat_rotation/coco.json": "expected upright boxes, found the rotation 60.0",
    "box_supervisely_obb/frame_0.json": "expected upright boxes, found the rotation 1.2",
    "box_json_of_others/datumaro.json": "found a data set of Datumaro",
    "box_scalabel_two_videos/two.json": "expected the images of one video, found 2: a, b",
}


@pytest.mark.parametrize("file", REFUSED)
def test_boxes_are_refused_with_their_kind(shared_data: Path, file: str) -> None:
    with pytest.raises(LabelFileError, match=REFUSED[file]):
        read_labels(shared_data / "cases" / file, VIDEO)


@pytest.mark.parametrize("names", [(), CLASS_LISTS["coco"]])
def test_cars_of_a_tracker_stay_cars(shared_data: Path, names: tuple[str, ...]) -> None:
    path = shared_data / "cases" / "box_boxmot9" / "tracks.txt"
    recorded = read_detections(path, video=VideoFacts(n_frames=15, names=names))
    assert {ROAD_CLASSES[i] for i in recorded.detections.class_id} == {"car"}
    assert recorded.has_classes
    assert 0.6 < recorded.detections.score.min() < recorded.detections.score.max() < 0.85


def test_ignored_regions_are_no_objects(
    shared_data: Path, tmp_path: Path, cli: Callable[..., Finished]
) -> None:
    path = shared_data / "cases" / "box_visdrone_ignored_region" / "gt.txt"
    table = read_labels(path, VIDEO)
    assert table.is_region.tolist() == [True, False, False] * 2
    video = shared_data / "kitti_stereo" / "0005" / "left.mp4"
    out = tmp_path / "yolo"
    finished = cli("export", path, "--to", "yolo", "--out", out, "--video", video)
    assert finished.status == 0
    assert "Regions that are not evaluated are not written" in finished.stdout
    labels = "".join(file.read_text() for file in sorted(out.glob("labels/*.txt")))
    assert [line.split()[0] for line in labels.splitlines()] == ["2", "5"] * 2


def test_one_box_of_a_bus_does_not_make_a_car_far(
    shared_data: Path, tmp_path: Path, cli: Callable[..., Finished]
) -> None:
    """As a car it is at 20.7 m with a sigma of 2.1 m; as a bus it was at 38 +- 6 m to frame 5."""
    finished = cli(
        *("--mono", shared_data / "dashcam" / "highway_two_cars.mp4", "--focal-px", 1150),
        *("--duration", 0.6, "--no-overlay", "--out", tmp_path / "out", "--detections"),
        shared_data / "cases" / "trk_bus_then_car" / "labels.txt",
    )
    assert finished.status == 0
    rows = read_csv_table(tmp_path / "out" / "tracks.csv", LabelFileError, "rows of a run")
    mono_m, sigma_m = rows.finite("mono_m"), rows.finite("mono_sigma_m")
    assert (np.abs(mono_m[1:] - 20.7) < sigma_m[1:] + 2.1).all()
    assert (mono_m[3:] < 23.0).all()
    assert rows.texts("class")[-1] == "car"


def test_a_car_and_a_truck_on_one_vehicle_are_one_track(
    shared_data: Path, tmp_path: Path, cli: Callable[..., Finished]
) -> None:
    boxes = shared_data / "cases" / "trk_car_and_truck" / "dup_run.txt"
    finished = cli(
        *("--mono", shared_data / "dashcam" / "highway_two_cars.mp4", "--focal-px", 1150),
        *("--duration", 0.6, "--no-overlay", "--out", tmp_path / "out", "--detections", boxes),
    )
    assert finished.status == 0
    rows = read_csv_table(tmp_path / "out" / "tracks.csv", LabelFileError, "rows of a run")
    assert set(rows.texts("class")) == {"car"}
    assert len(set(rows.texts("track_id"))) == 2


def test_truth_and_results_without_a_common_frame_are_noted(
    shared_data: Path, cli: Callable[..., Finished]
) -> None:
    case = shared_data / "cases" / "met_disjoint_frames"
    arguments = ("--truth", case / "gt_10.txt", "--results", case / "gt_1000.txt")
    finished = cli("evaluate", "tracks", *arguments)
    assert finished.status == 0
    assert "no frame has both" in finished.stdout


def test_truth_of_cars_is_evaluated_as_cars(
    shared_data: Path, tmp_path: Path, cli: Callable[..., Finished]
) -> None:
    truth = shared_data / "cases" / "eval_mot_truth_of_cars" / "gt7.txt"
    boxes = shared_data / "cases" / "box_boxmot9" / "tracks.txt"
    finished = cli(
        *("--mono", shared_data / "dashcam" / "highway_two_cars.mp4", "--focal-px", 1150),
        *("--duration", 0.6, "--no-overlay", "--out", tmp_path / "run", "--detections", boxes),
    )
    assert finished.status == 0
    arguments = ("evaluate", "tracks", "--truth", truth, "--results", tmp_path / "run")
    finished = cli(*arguments, "--class", "car")
    assert finished.status == 0
    assert "Tracks of class car" in finished.stdout
    finished = cli(*arguments)
    assert "No track has the evaluated class person" in finished.stdout
