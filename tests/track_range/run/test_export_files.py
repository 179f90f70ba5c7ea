"""`track-range export` on small files: options, files that are not replaced, label files as
input."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from mcap.reader import make_reader

from tests.support.command_line import Finished
from track_range.detection.formats.label_formats import LABEL_FORMATS, read_labels
from track_range.foundation.files.folder_lock import locked_folder
from track_range.results.rows.columns import column_names

Cli = Callable[..., Finished]
VALUES = {
    "track_id": "3",
    "class": "car",
    "observed": "1",
    "x1_px": "1.5",
    "y1_px": "2",
    "x2_px": "9",
    "y2_px": "8.25",
}


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The folder of a run that was killed before its summary: three frames of one car, predicted in
    the last one."""
    names = column_names()
    rows = [
        {**VALUES, "frame": str(i), "time_s": f"{i / 10}", "fused_m": "12.5", "score": "0.9"}
        for i in range(3)
    ]
    rows[2]["observed"] = "0"
    lines = [",".join(names), *(",".join(row.get(name, "") for name in names) for row in rows)]
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "tracks.csv").write_text("\n".join(lines) + "\n")
    (folder / "settings.yaml").write_text(
        "run: {mono: /videos/drive 1.mp4}\n"
        "found: {image_size_px: [100, 50], principal_point_px: [50, 25], focal_px: 80, fps: 10.0}\n"
    )
    return folder


@pytest.fixture
def exported(run: Path, cli: Cli) -> dict[str, Path]:
    """The run in the formats that are files."""
    paths = {name: run.parent / f"labels-{name}" for name in ("kitti", "coco", "cvat", "mot")}
    for name, path in paths.items():
        assert cli("export", run, "--to", name, "--out", path)[0] == 0
    return paths


def test_killed_run(run: Path, exported: dict[str, Path], tmp_path: Path, cli: Cli) -> None:
    for name, path in exported.items():
        table = read_labels(path)
        assert table.frame.tolist() == [0, 1, 2]
        np.testing.assert_allclose(table.xyxy_px, [[1.5, 2, 9, 8.25]] * 3, atol=0.01)
        assert table.track_id.tolist() == [3, 3, 3]
        assert table.observed.tolist() == [True, True, name not in ("coco", "cvat")]
    x, y, z = read_labels(exported["kitti"]).location_m[0]
    np.testing.assert_allclose(
        [x, y, z], [12.5 * (5.25 - 50) / 80, 12.5 * (8.25 - 25) / 80, 12.5], atol=6e-4
    )
    assert cli("export", run, "--to", "yolo", "--out", tmp_path / "yolo", "--observed-only")[0] == 0
    labels = [file.read_text() for file in sorted((tmp_path / "yolo/labels").iterdir())]
    assert [len(text.splitlines()) for text in labels] == [1, 1, 0]
    assert (tmp_path / "yolo/labels/drive_1_000000.txt").exists()


def test_result_writers(run: Path, tmp_path: Path, cli: Cli) -> None:
    assert cli("export", run, "--to", "parquet", "--out", tmp_path / "rows.parquet")[0] == 0
    assert len(read_labels(tmp_path / "rows.parquet")) == 3
    assert (
        cli(
            "export", run, "--to", "parquet", "--out", tmp_path / "rows.parquet", "--observed-only"
        )[0]
        == 0
    )
    assert len(read_labels(tmp_path / "rows.parquet")) == 2
    assert {path.name for path in tmp_path.iterdir()} == {"run", "rows.parquet"}


def test_links_are_written_to(run: Path, tmp_path: Path, cli: Cli) -> None:
    """As devices are: an export to /dev/null must not replace it by a file."""
    (tmp_path / "link").symlink_to(tmp_path / "target")
    for name in ("parquet", "mcap"):
        (tmp_path / "target").write_bytes(b"")
        assert cli("export", run, "--to", name, "--out", tmp_path / "link")[0] == 0
        assert (tmp_path / "link").is_symlink()
        assert (tmp_path / "target").stat().st_size > 0


def test_run_is_not_replaced(run: Path, tmp_path: Path, cli: Cli) -> None:
    """Neither the rows that are read, nor files in the folder of a run in progress."""
    assert cli("export", run, "--to", "parquet", "--out", tmp_path / "tracks.parquet")[0] == 0
    (tmp_path / "tracks.parquet").rename(run / "tracks.parquet")
    status, _, error = cli(
        "export", run, "--to", "parquet", "--observed-only", "--out", run / "tracks.parquet"
    )
    assert status == 1
    assert "input" in error
    assert len(read_labels(run / "tracks.parquet")) == 3
    with locked_folder(run):
        status, _, error = cli("export", run, "--to", "mcap", "--out", run / "run.mcap")
        assert cli("export", run, "--to", "mcap", "--out", tmp_path / "run.mcap")[0] == 0
    assert status == 1
    assert "a run is writing" in error


def test_scenarios_of_an_earlier_export_stay_if_one_cannot_be_replaced(
    run: Path, tmp_path: Path, cli: Cli
) -> None:
    out = tmp_path / "scenarios"
    out.mkdir()
    contents = {f"0{i}-cut_in-3.xosc": "<?xml" for i in range(1, 9)} | {"09-cut_in-3.xosc": "mine"}
    for name, text in contents.items():
        (out / name).write_text(text)
    options = ("--to", "openscenario", "--per-event", "--out", out)
    status, _, error = cli("export", run, *options)
    assert (status, "09-cut_in-3.xosc" in error) == (1, True)
    assert {file.name: file.read_text() for file in out.iterdir()} == contents


@pytest.mark.parametrize(
    "name", ["parquet", "mcap", "rrd", "kitti", "openscenario", "mf4", "osi", "osi-gt", "osi-mcap"]
)
@pytest.mark.parametrize(
    ("column", "value"), [("class", "c" * 150), ("fused_m", "inf"), ("time_s", "9e9")]
)
def test_unusual_rows(
    run: Path, tmp_path: Path, cli: Cli, name: str, column: str, value: str
) -> None:
    """A class of another program, and numbers that no run writes, in one row of three."""
    header, *rows = (run / "tracks.csv").read_text().splitlines()
    place = header.split(",").index(column)
    cells = rows[1].split(",")
    rows[1] = ",".join([*cells[:place], value, *cells[place + 1 :]])
    (run / "tracks.csv").write_text("\n".join([header, *rows]) + "\n")
    status, printed, error = cli("export", run, "--to", name, "--out", tmp_path / "out")
    assert (status, error) == (0, "")
    n_rows = 3 if column == "fused_m" or (column, name) == ("class", "kitti") else 2
    assert f"{n_rows} boxes" in printed
    assert ("The scenario is empty" in printed) == (name == "openscenario")
    assert ("The trace is empty" in printed) == (name == "osi-gt")
    assert b"inf" not in (tmp_path / "out").read_bytes() or name != "kitti"


def test_live_run_starts_at_its_first_frame(run: Path, tmp_path: Path, cli: Cli) -> None:
    rows = (
        (run / "tracks.csv")
        .read_text()
        .replace("\n1,", "\n8,")
        .replace("\n2,", "\n9,")
        .replace("\n0,", "\n7,")
    )
    (run / "tracks.csv").write_text(rows)
    for video, n_images in (("/videos/drive.mp4", 10), ("rtsp://camera/1", 3)):
        settings = (run / "settings.yaml").read_text().splitlines()[1]
        (run / "settings.yaml").write_text(f"run: {{mono: '{video}'}}\n{settings}\n")
        assert cli("export", run, "--to", "coco", "--out", tmp_path / "out")[0] == 0
        assert len(json.loads((tmp_path / "out").read_text())["images"]) == n_images


def each_third_frame(run: Path) -> None:
    """Make the run one of each third frame of a 10 Hz video, without rows in frame 6."""
    rows = (
        (run / "tracks.csv").read_text().replace("\n1,0.1", "\n3,0.3").replace("\n2,0.2", "\n9,0.9")
    )
    (run / "tracks.csv").write_text(rows)
    settings = (
        (run / "settings.yaml")
        .read_text()
        .replace("run: {", "run: {every: 3, ")
        .replace("10.0", f"{10 / 3}")
    )
    (run / "settings.yaml").write_text(settings)
    (run / "summary.json").write_text('{"frames": 5}')  # 0 to 12


def test_each_third_frame_as_labels(run: Path, tmp_path: Path, cli: Cli) -> None:
    each_third_frame(run)
    assert cli("export", run, "--to", "coco", "--out", tmp_path / "coco")[0] == 0
    coco = json.loads((tmp_path / "coco").read_text())
    assert [image["frame_index"] for image in coco["images"]] == [0, 3, 6, 9, 12]
    assert coco["videos"][0]["fps"] == pytest.approx(10)
    assert cli("export", run, "--to", "yolo", "--out", tmp_path / "yolo")[0] == 0
    assert [int(file.stem[-6:]) for file in sorted((tmp_path / "yolo/labels").iterdir())] == [
        0,
        3,
        6,
        9,
        12,
    ]
    video = yaml.safe_load((tmp_path / "yolo/data.yaml").read_text())["video"]
    assert (video["frames"], video["fps"]) == (13, pytest.approx(10))
    assert cli("export", run, "--to", "cvat", "--out", tmp_path / "cvat")[0] == 0
    # 6 was processed without the road user
    assert read_labels(tmp_path / "cvat").frame.tolist() == [0, 1, 2, 3, 9]


def test_irregular_frames_are_all_listed(run: Path, tmp_path: Path, cli: Cli) -> None:
    """After frames that could not be read, those of the run are no longer multiples of N."""
    each_third_frame(run)
    (run / "tracks.csv").write_text((run / "tracks.csv").read_text().replace("\n9,0.9", "\n10,1.0"))
    assert cli("export", run, "--to", "coco", "--out", tmp_path / "coco")[0] == 0
    assert len(json.loads((tmp_path / "coco").read_text())["images"]) == 13


def test_each_third_frame_in_mcap(run: Path, tmp_path: Path, cli: Cli) -> None:
    each_third_frame(run)
    assert cli("export", run, "--to", "mcap", "--out", tmp_path / "mcap")[0] == 0
    with (tmp_path / "mcap").open("rb") as file:
        times_s = {message.log_time / 1e9 for _, channel, message in make_reader(file).iter_messages()
                   if channel.topic == "/tracks/ranges"}  # fmt: skip
    assert np.diff(sorted(times_s)) == pytest.approx([0.3] * 4)


@pytest.mark.parametrize(
    ("summary", "listed"),
    [
        ({"frames": 5, "frames_dropped": 5, "processed_frames": [[0, 3], [9, 9]]}, [0, 1, 2, 3, 9]),
        # contradicts itself
        ({"frames": 9, "frames_dropped": 5, "processed_frames": [[0, 3], [9, 9]]}, [0, 3, 9]),
        ({"frames": 5, "frames_dropped": 5}, [0, 3, 9]),  # of an earlier version
        (None, [0, 3, 9]),  # killed
    ],
)
def test_dropped_frames_are_not_listed(
    run: Path, tmp_path: Path, cli: Cli, summary: dict[str, Any] | None, listed: list[int]
) -> None:
    each_third_frame(run)
    (run / "settings.yaml").write_text(
        (run / "settings.yaml").read_text().replace("every: 3", "realtime: true")
    )
    (run / "summary.json").unlink()
    if summary is not None:
        (run / "summary.json").write_text(json.dumps(summary))
    assert cli("export", run, "--to", "coco", "--out", tmp_path / "coco")[0] == 0
    assert [
        image["frame_index"] for image in json.loads((tmp_path / "coco").read_text())["images"]
    ] == listed
    assert cli("export", run, "--to", "cvat", "--out", tmp_path / "cvat")[0] == 0
    # frames 1 and 2 either end the track, since they were processed without the road user, or are
    # interpolated
    assert read_labels(tmp_path / "cvat").frame.tolist() == [
        0,
        *({1, 2} - set(listed)),
        *range(3, 10),
    ]


@pytest.mark.parametrize(
    ("summary", "is_refused"),
    [({"frames_dropped": 2}, True), ({"frames_dropped": 0}, False), (None, True)],
)
def test_images_of_runs_with_dropped_frames(
    run: Path, tmp_path: Path, cli: Cli, summary: dict[str, int] | None, is_refused: bool
) -> None:
    """A killed run has no number of dropped frames."""
    (run / "settings.yaml").write_text(
        (run / "settings.yaml").read_text().replace("run: {", "run: {realtime: true, ")
    )
    if summary is not None:
        (run / "summary.json").write_text(json.dumps(summary))
    status, _, error = cli("export", run, "--to", "yolo", "--images", "--out", tmp_path / "out")
    assert (status != 0, "dropped frames" in error) == (True, is_refused)  # the video is missing
    assert not (tmp_path / "out").exists()


def test_provenance(run: Path, tmp_path: Path, cli: Cli) -> None:
    """That of the run, also with values that only YAML has; an earlier version has the calibration
    in summary.json."""
    settings = (run / "settings.yaml").read_text()
    kinds = (
        "detections: boxes.txt",
        "calibration: rig",
        "rig: drives/rig.yaml",
        "versions: {track-range: 0.9.9}",
    )
    found = settings.replace("fps: 10.0", f"fps: 10.0, {', '.join(kinds)}").replace(
        "run: {", "run: {1: 2026-01-31, "
    )
    for text, kind, version in ((found, "rig", b"0.9.9"), (settings, "focal length", None)):
        (run / "settings.yaml").write_text(text)
        (run / "summary.json").write_text('{"frames": 3, "calibration": "focal length"}')
        assert cli("export", run, "--to", "parquet", "--out", tmp_path / "rows")[0] == 0
        metadata = pq.read_schema(tmp_path / "rows").metadata
        rig = json.loads(metadata[b"track_range.rig"])
        assert (rig["calibration"], rig["focal_px"]) == (kind, 80)
        assert version in (None, metadata[b"track_range.version"])
        assert metadata[b"track_range.settings_hash"].startswith(b"sha256:")
        if version is not None:
            assert rig["file"] == "rig.yaml"
            assert json.loads(metadata[b"track_range.model"]) == {"detections": "boxes.txt"}


@pytest.mark.parametrize(
    ("first", "second"), [("coco", "cvat"), ("cvat", "mot"), ("kitti", "coco"), ("cvat", "yolo")]
)
def test_label_files_as_input(
    exported: dict[str, Path], tmp_path: Path, cli: Cli, first: str, second: str
) -> None:
    out = tmp_path / "out"
    assert cli("export", exported[first], "--to", second, "--out", out)[0] == 0
    table = read_labels(out)
    assert table.frame.tolist() == [0, 1, 2]
    assert LABEL_FORMATS.usable[second].has_classes == (table.class_id == 2).all()


def test_yolo_needs_an_image_size(exported: dict[str, Path], tmp_path: Path, cli: Cli) -> None:
    status, _, error = cli("export", exported["kitti"], "--to", "yolo", "--out", tmp_path / "out")
    assert status == 1
    assert "--video" in error
    assert not (tmp_path / "out").exists()


def test_yolo_folders_are_replaced_only_if_exported(run: Path, tmp_path: Path, cli: Cli) -> None:
    folder = tmp_path / "data"
    for _ in range(2):
        assert cli("export", run, "--to", "yolo", "--out", folder)[0] == 0
    assert {path.name for path in folder.iterdir()} == {"labels", "data.yaml"}
    (folder / "notes.txt").write_text("a note")
    status, _, error = cli("export", run, "--to", "yolo", "--out", folder)
    assert status == 1
    assert "data" in error
    assert (folder / "notes.txt").exists()


def test_first_frame_of_labels(exported: dict[str, Path], tmp_path: Path, cli: Cli) -> None:
    status, _, error = cli(
        "export", exported["coco"], "--to", "kitti", "--first-frame", 1, "--out", tmp_path / "out"
    )
    assert status == 1
    assert "first-frame" in error


def test_labels_beyond_the_video(exported: dict[str, Path], tmp_path: Path, cli: Cli) -> None:
    video = tmp_path / "video"
    video.mkdir()
    for frame in range(2):
        cv2.imwrite(str(video / f"{frame}.png"), np.zeros((50, 100, 3), np.uint8))
    options = ("--to", "yolo", "--video", video, "--out", tmp_path / "out")
    status, printed, _ = cli("export", exported["kitti"], *options)
    assert status == 0
    assert "frame 2" in printed
    assert len(list((tmp_path / "out/labels").iterdir())) == 3
    status, _, error = cli("export", exported["kitti"], *options, "--images")
    assert status == 1
    assert "frame 2" in error


def test_other_files_are_not_replaced(
    exported: dict[str, Path], run: Path, tmp_path: Path, cli: Cli
) -> None:
    other = tmp_path / "notes.txt"
    other.write_text("a note, not labels")
    for out in (other, run / "tracks.csv", exported["cvat"], tmp_path):
        before = out.read_bytes() if out.is_file() else b""
        status, _, error = cli("export", run, "--to", "coco", "--out", out)
        assert status == 1
        assert out.name in error
        assert not before or out.read_bytes() == before
    for name in ("osi", "osi-gt", "osi-mcap", "mf4"):
        assert cli("export", run, "--to", name, "--out", other)[0] == 1
    for _ in range(2):
        assert cli("export", run, "--to", "osi", "--out", tmp_path / "drive_sd.osi")[0] == 0
    (tmp_path / "again").write_bytes(exported["coco"].read_bytes())
    assert cli("export", run, "--to", "coco", "--out", tmp_path / "again")[0] == 0


@pytest.mark.parametrize(
    ("options", "key_word"),
    [
        (("--to", "coco", "--images"), "yolo"),
        (("--to", "coco", "--first-frame", "1"), "first-frame"),
        (("--to", "coco", "--video", "a.mp4"), "video"),
        (("--to", "excel"), "excel"),
    ],
)
def test_contradictory_options(
    run: Path, tmp_path: Path, cli: Cli, options: tuple[str, ...], key_word: str
) -> None:
    status, _, error = cli("export", run, *options, "--out", tmp_path / "out")
    assert status == 2
    assert key_word in error
    assert not (tmp_path / "out").exists()


def test_labels_have_no_rows(exported: dict[str, Path], tmp_path: Path, cli: Cli) -> None:
    status, _, error = cli("export", exported["coco"], "--to", "parquet", "--out", tmp_path / "out")
    assert status == 2
    assert "run" in error


def test_mot_rows_become_persons(exported: dict[str, Path], tmp_path: Path, cli: Cli) -> None:
    status, printed, _ = cli("export", exported["mot"], "--to", "coco", "--out", tmp_path / "out")
    assert status == 0
    assert "person" in printed
    assert set(read_labels(tmp_path / "out").class_name.tolist()) == {"person"}


def test_scenario_with_its_road(run: Path, tmp_path: Path, cli: Cli) -> None:
    """The road is a file beside the scenario, or a file of its own; files of others remain."""
    out, road = tmp_path / "drive.xosc", tmp_path / "drive.xodr"
    status, _, error = cli("export", run, "--to", "opendrive", "--out", road)
    assert (status, "no position of the camera is known" in error, road.exists()) == (
        1,
        True,
        False,
    )
    poses = "frame,time_s,x_m,y_m,heading_deg,x_sigma_m,y_sigma_m,heading_sigma_deg\n"
    poses += "".join(f"{i},{i / 10},{i}.0,0.0,0.0,{i / 100},0.0,0.1\n" for i in range(40))
    (run / "poses.csv").write_text(poses)
    status, text, _ = cli("export", run, "--to", "opendrive", "--out", road)
    assert (status, "boxes" in text, road.name in text) == (0, False, True)
    alone = road.read_text()
    assert cli("export", run, "--to", "openscenario", "--out", out)[0] == 0
    assert 'filepath="drive.xodr"' in out.read_text()
    assert road.read_text() == alone
    road.write_text("mine")
    status, _, error = cli("export", run, "--to", "openscenario", "--out", out)
    assert (status, "drive.xodr" in error, road.read_text()) == (1, True, "mine")
    scenarios = tmp_path / "scenarios"
    options = ("--to", "openscenario", "--per-event", "--out", scenarios)
    assert cli("export", run, *options)[0] == 0
    assert (scenarios / "run.xodr").read_text() == alone


def test_scenario_of_an_earlier_run(run: Path, tmp_path: Path, cli: Cli) -> None:
    """Rows without cuboids have no road users in a scenario, which a note says."""
    poses = "frame,time_s,x_m,y_m,heading_deg,x_sigma_m,y_sigma_m,heading_sigma_deg\n"
    (run / "poses.csv").write_text(poses + "0,0.0,0.0,0.0,0.0,0.0,0.0,0.1\n")
    header, *rows = (run / "tracks.csv").read_text().splitlines()
    kept = [i for i, name in enumerate(header.split(",")) if not name.startswith("centre_")]
    lines = [",".join(line.split(",")[i] for i in kept) for line in (header, *rows)]
    (run / "tracks.csv").write_text("\n".join(lines) + "\n")
    status, printed, _ = cli("export", run, "--to", "openscenario", "--out", tmp_path / "a.xosc")
    assert (status, "no cuboids" in printed) == (0, True)
    assert 'name="ego"' in (tmp_path / "a.xosc").read_text()
