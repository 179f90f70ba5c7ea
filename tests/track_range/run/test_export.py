"""`track-range export`, and the way back: exported files as truth, detections, tracks, for fit and
for training."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.command_line import Finished
from track_range.detection.formats.label_formats import label_format_of, read_labels
from track_range.detection.training.data_yaml import read_data_yaml
from track_range.simulation.drive import Drive

pytestmark = pytest.mark.slow  # the run takes seconds

Cli = Callable[..., Finished]
FORMATS = ("kitti", "coco", "cvat", "mot")


@pytest.fixture(scope="module")
def run(small_drive: Drive, tmp_path_factory: pytest.TempPathFactory, cli: Cli) -> Path:
    """A run on a simulated drive with its exact boxes as detections, and kitti.txt."""
    out = tmp_path_factory.mktemp("run") / "out"
    labels = out.parent / "boxes.txt"
    lines = small_drive.truth.read_text().splitlines()
    labels.write_text("".join(f"{line} 0.9\n" for line in lines if " DontCare " not in line))
    status, printed, error = cli(
        *(
            "--mono",
            small_drive.left,
            "--rig",
            small_drive.rig,
            "--detections",
            labels,
            "--lanes",
            "off",
        ),
        *("--no-overlay", "--write", "csv,mot,kitti", "--out", out),
    )
    assert status == 0, printed + error
    return out


@pytest.fixture(scope="module")
def exported(run: Path, cli: Cli) -> dict[str, Path]:
    """The run in each label format."""
    paths = {name: run.parent / f"labels-{name}" for name in FORMATS}
    for name, path in paths.items():
        status, printed, error = cli("export", run, "--to", name, "--out", path)
        assert status == 0, printed + error
    return paths


def figures_of(cli: Cli, folder: Path, *options: object) -> dict[str, object]:
    status, printed, error = cli("evaluate", "tracks", *options, "--json", folder / "figures.json")
    assert status == 0, printed + error
    figures: dict[str, object] = json.loads((folder / "figures.json").read_text())
    return figures


def test_kitti_of_a_run_against_its_cvat_export(
    run: Path, exported: dict[str, Path], tmp_path: Path, cli: Cli
) -> None:
    classes = set(read_labels(run / "tracks.csv").class_name.tolist())
    assert len(classes) > 1
    for truth in ("cvat", "coco"):
        for name in classes:
            options = ("--truth", exported[truth], "--results", run / "kitti.txt", "--class", name)
            figures = figures_of(cli, tmp_path, *options)
            assert figures["combined"]["hota"] == pytest.approx(100)  # type: ignore[index]
            assert figures["format"] == truth
            assert figures["notes"] == []


def test_class_filters_both_sides(exported: dict[str, Path], tmp_path: Path, cli: Cli) -> None:
    table = read_labels(exported["coco"])
    for name in ("car", "person"):
        figures = figures_of(
            cli,
            tmp_path,
            "--truth",
            exported["coco"],
            "--results",
            exported["cvat"],
            "--class",
            name,
        )
        assert figures["combined"]["n"] == np.count_nonzero(table.class_name == name)  # type: ignore[index]
        assert figures["combined"]["fp"] == 0  # type: ignore[index]


def test_frames_shifted_by_one_are_noted(
    exported: dict[str, Path], tmp_path: Path, cli: Cli
) -> None:
    text = exported["coco"].read_text()
    later = re.sub(
        r'"frame_index": (\d+)', lambda match: f'"frame_index": {int(match[1]) + 1}', text
    )
    (tmp_path / "later.json").write_text(later)
    figures = figures_of(
        cli, tmp_path, "--truth", tmp_path / "later.json", "--results", exported["cvat"]
    )
    assert [word in " ".join(figures["notes"]) for word in ("start at 1", "increased by 1")] == [
        True,
        True,
    ]  # type: ignore[arg-type]
    back = tmp_path / "back.json"
    assert (
        cli("export", tmp_path / "later.json", "--to", "coco", "--first-frame", 1, "--out", back)[0]
        == 0
    )
    assert read_labels(back).frame.tolist() == read_labels(exported["coco"]).frame.tolist()


@pytest.mark.parametrize("name", ["coco", "cvat"])
def test_exported_boxes_as_truth_and_detections(
    run: Path, exported: dict[str, Path], small_drive: Drive, name: str, tmp_path: Path, cli: Cli
) -> None:
    options = (
        "--mono",
        small_drive.left,
        "--rig",
        small_drive.rig,
        "--lanes",
        "off",
        "--no-overlay",
    )
    files = ("--detections", exported[name], "--truth", exported[name])
    status, printed, error = cli(*options, *files, "--out", tmp_path / "out")
    assert status == 0, printed + error
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    assert summary["tracks"]["mota"] > 90
    assert summary["methods"]["fused"]["n"] > 0
    assert any("distances are read from the labels" in note for note in summary["notes"])


def test_truth_without_distances(
    exported: dict[str, Path], small_drive: Drive, tmp_path: Path, cli: Cli
) -> None:
    truth = tmp_path / "truth.xml"
    truth.write_text(
        re.sub(r'<attribute name="distance_m">.*?</attribute>', "", exported["cvat"].read_text())
    )
    options = (
        "--mono",
        small_drive.left,
        "--rig",
        small_drive.rig,
        "--lanes",
        "off",
        "--no-overlay",
    )
    status, printed, error = cli(
        *options, "--detections", exported["cvat"], "--truth", truth, "--out", tmp_path / "out"
    )
    assert status == 0, printed + error
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    assert summary["tracks"]["idf1"] > 90
    assert summary["methods"]["fused"]["mean_relative_error_pct"] is None
    assert any("no distances" in note for note in summary["notes"])


def test_frame_numbers_of_truth_are_noted(
    exported: dict[str, Path], small_drive: Drive, tmp_path: Path, cli: Cli
) -> None:
    text = exported["coco"].read_text()
    later = re.sub(
        r'"frame_index": (\d+)', lambda match: f'"frame_index": {int(match[1]) + 1}', text
    )
    (tmp_path / "truth.json").write_text(later)
    options = (
        "--mono",
        small_drive.left,
        "--rig",
        small_drive.rig,
        "--lanes",
        "off",
        "--no-overlay",
    )
    files = (
        "--detections",
        exported["coco"],
        "--truth",
        tmp_path / "truth.json",
        "--out",
        tmp_path / "out",
    )
    assert cli(*options, *files)[0] == 0
    notes = " ".join(json.loads((tmp_path / "out/summary.json").read_text())["notes"])
    assert [word in notes for word in ("start at 1", "frame 12, but", "increased by 1")] == [
        True
    ] * 3


def test_labels_and_images_for_training(
    run: Path, exported: dict[str, Path], small_drive: Drive, cli: Cli
) -> None:
    folder, corrected = run.parent / "data", run.parent / "corrected"
    assert cli("export", run, "--to", "yolo", "--images", "--out", folder)[0] == 0
    video = ("--video", small_drive.left)
    assert (
        cli("export", exported["cvat"], "--to", "yolo", "--images", *video, "--out", corrected)[0]
        == 0
    )
    for path in (folder, corrected):
        data = read_data_yaml(path / "data.yaml")
        assert len(data.train) == 12
        assert sum(len(item.truth.class_id) for item in data.train) == len(
            read_labels(run / "tracks.csv")
        )
    images = sorted((folder / "images").iterdir())
    assert cv2.imread(str(images[0])).shape == (188, 620, 3)
    assert label_format_of(folder).name == "yolo"


def test_rows_of_a_run(run: Path, exported: dict[str, Path]) -> None:
    rows = read_labels(run / "tracks.csv")
    for name in ("coco", "cvat"):
        table = read_labels(exported[name])
        np.testing.assert_allclose(table.xyxy_px, rows.xyxy_px, atol=6e-4)
        np.testing.assert_allclose(table.distance_m, rows.distance_m, atol=6e-4)
        assert table.track_id.tolist() == rows.track_id.tolist()
        assert table.observed.tolist() == rows.observed.tolist()
        assert (table.video.n_frames, table.video.size_px) == (12, (620, 188))
        assert table.video.is_rectified
    assert read_labels(exported["kitti"]).frame.tolist() == rows.frame.tolist()


def test_kitti_file_of_a_run(run: Path) -> None:
    cells = (run / "kitti.txt").read_text().splitlines()[0].split()
    assert len(cells) == 18
    assert (cells[3:6], cells[10:13], cells[16]) == (["-1", "-1", "-10"], ["-1", "-1", "-1"], "-10")
    table, rows = read_labels(run / "kitti.txt"), read_labels(run / "tracks.csv")
    np.testing.assert_allclose(table.location_m[:, 2], rows.distance_m, atol=6e-4)
    assert table.class_id.tolist() == rows.class_id.tolist()


def test_observed_only(run: Path, tmp_path: Path, cli: Cli) -> None:
    rows = read_labels(run / "tracks.csv")
    assert not rows.observed.all()
    for options, n_rows in (
        ((), len(rows)),
        (("--observed-only",), np.count_nonzero(rows.observed)),
    ):
        assert cli("export", run, "--to", "coco", "--out", tmp_path / "out", *options)[0] == 0
        table = read_labels(tmp_path / "out")
        assert len(table) == n_rows
        assert table.observed.all() == bool(options)


def test_fit_to_corrected_labels(tmp_path: Path, cli: Cli) -> None:
    rng = np.random.default_rng(1)
    distance_m = rng.uniform(8, 60, 150)
    height_px = 700 * 1.5 / distance_m
    rows = [
        {
            "id": i + 1,
            "image_id": i + 1,
            "category_id": 1,
            "bbox": [500, 200, 1.2 * h, h],
            "attributes": {"distance_m": d},
        }
        for i, (h, d) in enumerate(zip(height_px.tolist(), distance_m.tolist(), strict=True))
    ]
    images = [
        {"id": i + 1, "width": 1242, "height": 375, "file_name": f"{i:06}.jpg", "frame_index": i}
        for i in range(150)
    ]
    document = {"images": images, "annotations": rows, "categories": [{"id": 1, "name": "car"}]}
    (tmp_path / "labels.json").write_text(json.dumps(document))
    options = ("--labels", tmp_path / "labels.json", "--out", tmp_path / "curves.json")
    status, printed, error = cli("fit", *options, "--focal-px", 700)
    assert status == 0, printed + error
    assert (tmp_path / "curves.json").exists()
    assert cli("fit", *options)[0] == 1
