"""Full disks, two runs into one folder, and runs that end before their first frame."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import track_range as tr
from tests.support.file_size_limit import file_size_limit
from tests.support.images.films import N_NOISE_FRAMES, noise
from tests.support.results.frame_results import result, writing
from tests.toys.registrations import registered_writer
from track_range.detection.formats.video_labels.mot import read_mot
from track_range.foundation.errors import UserError
from track_range.foundation.files.folder_lock import FolderLockError, locked_folder
from track_range.foundation.files.output_files import OutputError
from track_range.pipeline.clock import StageClock
from track_range.recording.sources.open_video import open_video
from track_range.recording.video.frame import VideoError
from track_range.results.formats.csv_file import read_tracks_csv
from track_range.results.formats.parquet_file import read_tracks_parquet
from track_range.results.formats.row_file import RowFile
from track_range.results.progress_note import ProgressNote, read_progress
from track_range.results.table import RunTable
from track_range.results.writers import OpenWriters
from track_range.views.report.run_folders import report
from track_range.views.videos.result_video import ResultVideo
from track_range.views.videos.video_writer import FragmentFile, VideoWriter


class FailingWriter:
    """Fails in the third frame."""

    files = ("failing.txt",)

    def open(self, info: Any, folder: Path) -> None:
        self.n = 0

    def write(self, result: Any) -> None:
        self.n += 1
        if self.n == 3:
            raise OSError(28, "No space left on device")

    def close(self, summary: Any) -> None:
        pass


# -- rows
# -----------------------------------------------------------------------------------------------------------


def test_row_file_is_cut_back(tmp_path: Path) -> None:
    path = tmp_path / "rows.txt"
    rows = RowFile(path, "header\n")
    rows.write("first\n")
    with file_size_limit(20), pytest.raises(OSError, match="large"):
        rows.write("second\nthird\n")
    assert path.read_text() == "header\nfirst\n"
    rows.write("third\n")
    rows.discard_last()
    rows.discard_last()
    rows.write("")
    rows.write("fourth\n")
    rows.close()
    assert path.read_text() == "header\nfirst\nfourth\n"


def write_until_full(rows: OpenWriters) -> int:
    """Write frames until tracks.csv fails; returns the number of frames written before."""
    for index in range(50):
        try:
            rows.write(result(index))
        except OutputError as error:
            assert "tracks.csv" in str(error)  # noqa: PT017
            return index
    raise AssertionError("no write failed")


@pytest.mark.parametrize("names", [("csv", "mot"), ("mot", "csv")])
def test_rows_end_with_the_same_frame(tmp_path: Path, names: tuple[str, ...]) -> None:
    for limit in range(600, 2600, 487):
        with writing(tmp_path, names) as rows, file_size_limit(limit):
            n_written = write_until_full(rows)
        expected = [index for index in range(n_written) for _ in range(2)]
        assert read_tracks_csv(tmp_path / "tracks.csv")["frame"].tolist() == expected
        assert (tmp_path / "tracks.csv").read_bytes().endswith(b"\n")
        assert read_mot(tmp_path / "mot.txt").frame.tolist() == expected


def test_failing_writer_of_another_package(tmp_path: Path) -> None:
    with (
        registered_writer("failing", FailingWriter),
        writing(tmp_path, ("csv", "mot", "failing")) as rows,
    ):
        rows.write(result(0))
        rows.write(result(1))
        with pytest.raises(OutputError, match=r"failing\.txt"):
            rows.write(result(2))
    assert read_tracks_csv(tmp_path / "tracks.csv")["frame"].tolist() == [0, 0, 1, 1]
    assert read_mot(tmp_path / "mot.txt").frame.tolist() == [0, 0, 1, 1]


def test_table_without_space(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with RunTable(rows_per_batch=4) as table:
        for index in range(5):
            table.append(result(index))
        size = next(tmp_path.rglob("rows.arrows")).stat().st_size
        with file_size_limit(size + 200), pytest.raises(OutputError, match="rows of the run"):
            table.append(result(5))
        assert table.to_rows()["frame"].tolist() == [index for index in range(5) for _ in range(2)]


# -- videos
# ---------------------------------------------------------------------------------------------------------


def test_video_is_playable_after_a_failure(tmp_path: Path) -> None:
    path, images = tmp_path / "out.mp4", noise(8)
    counts = []
    for limit in (1500, 9000, 12_000, 20_000, 26_001):
        writer = VideoWriter(path, width_px=64, height_px=48, fps=10.0)
        with file_size_limit(limit):
            with pytest.raises(VideoError, match=r"out\.mp4"):  # noqa: PT012
                for number, image in enumerate(images * 5):
                    writer.write(image, number / 10)
            with pytest.raises(VideoError, match=r"out\.mp4"):
                writer.write(images[0], 100.0)
        with pytest.raises(VideoError, match=r"out\.mp4"):
            writer.close()  # with free space again
        if limit > 5000:
            frames = [frame.time_s for frame in open_video(path)]
            assert frames == pytest.approx([number / 10 for number in range(len(frames))])
            counts.append(len(frames))
        assert path.stat().st_size <= limit
    assert counts == sorted(counts)
    assert 1 <= counts[0] < counts[-1]


def test_trailer_without_space(tmp_path: Path) -> None:
    path = tmp_path / "out.mp4"
    writer = VideoWriter(path, width_px=64, height_px=48, fps=10.0)
    for number, image in enumerate(noise(5)):
        writer.write(image, number / 10)
    with file_size_limit(path.stat().st_size + 1), pytest.raises(VideoError, match=r"out\.mp4"):
        writer.close()
    assert len(list(open_video(path))) == 4  # the muxer holds the last one


@pytest.mark.parametrize("n_bytes", [1, 3, 7, 16, 1000])
def test_fragments_in_parts(tmp_path: Path, n_bytes: int) -> None:
    boxes = [(b"ftyp", 4), (b"moov", 30), (b"moof", 12), (b"mdat", 50), (b"moof", 12), (b"mdat", 0)]
    content = b"".join((size + 8).to_bytes(4, "big") + kind + b"x" * size for kind, size in boxes)
    content += b"\0\0\0\1mdat" + (26).to_bytes(8, "big") + b"x" * 10
    complete = len(content)
    content += b"\0\0\0\x20moof"
    file = FragmentFile(tmp_path / "a.mp4")
    for start in range(0, len(content), n_bytes):
        file.write(content[start : start + n_bytes])
    with file_size_limit(len(content) + 2):
        file.write(b"more")
        file.write(b"")
    assert file.failure is not None
    file.write(b"nothing")
    file.close()
    assert (tmp_path / "a.mp4").read_bytes() == content[:complete]


@pytest.mark.parametrize(
    ("fps", "max_lag"), [(0.5, 1), (1.0, 1), (2.0, 2), (4.0, 4), (10.0, 5), (60.0, 5)]
)
def test_lag_of_a_video(tmp_path: Path, fps: float, max_lag: int) -> None:
    """After the rows of a frame, the file lacks at most so many frames."""
    path, image = tmp_path / "out.mp4", np.zeros((48, 64, 3), np.uint8)
    with ResultVideo(path, lambda _: image, size_px=(64, 48), fps=fps, clock=StageClock()) as video:
        for index in range(12):
            frame = result(index)
            object.__setattr__(frame.frame, "time_s", index / fps)
            video.wait()
            if video.precedes_rows:
                video.write(frame)
            n_rows = index + 1
            n_frames = len(list(open_video(path))) if n_rows > max_lag else 0
            assert n_rows - n_frames <= max_lag
            if not video.precedes_rows:
                video.write(frame)


# -- runs
# -----------------------------------------------------------------------------------------------------------


def check_folder(out: Path, n_frames: int) -> None:
    """The rows and the summary, if there is one, have the same frames, and the overlay is
    playable."""
    rows = read_tracks_csv(out / "tracks.csv")["frame"]
    assert (out / "tracks.csv").read_bytes().endswith(b"\n")
    assert sorted(rows.tolist()) == sorted(read_mot(out / "mot.txt").frame.tolist())
    assert rows.max() == n_frames - 1
    if (out / "tracks.parquet").exists():
        assert sorted(read_tracks_parquet(out / "tracks.parquet")["frame"].tolist()) == sorted(
            rows.tolist()
        )
    if (out / "summary.json").exists():
        assert json.loads((out / "summary.json").read_text())["frames"] == n_frames
    assert not (out / "progress.json").exists()
    assert not (out / ".running").exists()


@pytest.mark.parametrize(
    "limit",
    [24_000, *(pytest.param(n, marks=pytest.mark.slow) for n in (25_500, 27_000, 32_000, 37_000))],
)
def test_run_on_a_full_disk(
    tmp_path: Path, run_on_noise: Callable[..., tr.Run], limit: int
) -> None:
    run = run_on_noise(tmp_path)
    frames = iter(run)
    n_frames = 0
    with file_size_limit(limit), pytest.raises(UserError, match=r"tracks\.arrows|overlay\.mp4"):  # noqa: PT012
        for _ in frames:
            n_frames += 1
    assert n_frames == run.summary["frames"]
    check_folder(tmp_path, n_frames)
    assert n_frames - 6 <= len(list(open_video(tmp_path / "overlay.mp4"))) <= n_frames


@pytest.mark.slow
def test_first_error_is_reported(tmp_path: Path, run_on_noise: Callable[..., tr.Run]) -> None:
    """Without space for anything; then with space for all but the report."""
    run = run_on_noise(tmp_path, overlay=False)
    with file_size_limit(0), pytest.raises(UserError, match=r"settings|progress|tracks"):
        next(iter(run))
    run = run_on_noise(tmp_path, overlay=False, write="csv,mot")
    for _ in run:
        size = (tmp_path / "tracks.csv").stat().st_size
    other = tmp_path / "other"
    run = run_on_noise(other, overlay=False, sgbm=False, write="csv,mot")
    with file_size_limit(size), pytest.raises(OutputError, match=r"report\.html"):
        list(run)
    check_folder(other, N_NOISE_FRAMES)
    assert (other / "summary.json").exists()


def test_failing_overlay(
    tmp_path: Path, run_on_noise: Callable[..., tr.Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    draw = ResultVideo._draw
    failure = RuntimeError("drawing failed")

    def failing(self: ResultVideo, frame: Any) -> None:
        if frame.index == 6:
            raise failure
        if frame.index > 6:
            raise RuntimeError("drawing failed again")
        draw(self, frame)

    monkeypatch.setattr(ResultVideo, "_draw", failing)
    run = run_on_noise(tmp_path)
    with pytest.raises(RuntimeError) as caught:
        list(run)
    assert caught.value is failure
    check_folder(tmp_path, run.summary["frames"])
    assert 6 <= run.summary["frames"] <= 12


@pytest.mark.slow
def test_second_run_is_refused(tmp_path: Path, run_on_noise: Callable[..., tr.Run]) -> None:
    first = run_on_noise(tmp_path / "out", overlay=False)
    frames = iter(first)
    next(frames)
    before = {path: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    second = run_on_noise(tmp_path / "out", overlay=False)
    with pytest.raises(FolderLockError, match=f"process {os.getpid()}"):
        second.open()
    finished = run_on_noise(None, overlay=False)
    list(finished)
    with pytest.raises(FolderLockError, match="another run"):
        finished.write(tmp_path / "out")
    assert {path: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before
    list(frames)
    check_folder(tmp_path / "out", N_NOISE_FRAMES)
    second.open().close()
    finished.write(tmp_path / "out")
    check_folder(tmp_path / "out", N_NOISE_FRAMES)


@pytest.mark.slow
def test_unusable_input_leaves_the_folder_as_it_was(
    tmp_path: Path, run_on_noise: Callable[..., tr.Run]
) -> None:
    out = tmp_path / "a" / "b" / "out"
    for name, options in (
        ("missing.mp4", {}),
        ("missing.txt", {"detections": tmp_path / "missing.txt"}),
    ):
        run = (
            tr.Run.mono(tmp_path / name, out=out, focal_px=60)
            if not options
            else run_on_noise(out, **options)
        )
        with pytest.raises(UserError, match="missing"):
            run.open()
        assert list(tmp_path.iterdir()) == []
    out.mkdir(parents=True)
    for name in ("settings.yaml", "tracks.csv", "notes.txt"):
        (out / name).write_text("precious")
    with pytest.raises(UserError, match="missing"):
        tr.Run.mono(tmp_path / "missing.mp4", out=out, focal_px=60).open()
    assert {path.name: path.read_text() for path in out.iterdir()} == dict.fromkeys(
        ("settings.yaml", "tracks.csv", "notes.txt"), "precious"
    )


@pytest.mark.slow
def test_run_that_is_opened_only(tmp_path: Path, run_on_noise: Callable[..., tr.Run]) -> None:
    run = run_on_noise(tmp_path / "out").open()
    note = read_progress(tmp_path / "out")
    assert (note.state, note.pid, note.frames) == ("loading the networks", os.getpid(), 0)
    assert "found" not in (tmp_path / "out" / "settings.yaml").read_text()
    with pytest.raises(OutputError, match="is loading"):
        report([tmp_path / "out"], None)
    run.close()
    assert list(tmp_path.iterdir()) == []
    run_on_noise(tmp_path / "out").open()  # dropped
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_folder_of_a_run_killed_while_opening(
    tmp_path: Path, run_on_noise: Callable[..., tr.Run]
) -> None:
    ProgressNote("estimating the alignment", 4711, "2026-01-01 12:00:00+00:00").write(tmp_path)
    (tmp_path / "settings.yaml").write_text("of the killed run")
    (tmp_path / ".4711.progress.json").write_text("{}")
    (tmp_path / ".4711.notes.txt").write_text("precious")
    with pytest.raises(OutputError, match=r"4711.*alignment"):
        report([tmp_path], None)
    run = run_on_noise(tmp_path, overlay=False).open()
    assert "film.mp4" in (tmp_path / "settings.yaml").read_text()
    list(run)
    check_folder(tmp_path, N_NOISE_FRAMES)
    assert not (tmp_path / ".4711.progress.json").exists()
    assert (tmp_path / ".4711.notes.txt").exists()


@pytest.mark.parametrize("command", ["simulate", "demo", "track"])
def test_other_commands_lock_their_folder(
    tmp_path: Path, cli: Callable[..., Any], command: str
) -> None:
    out = tmp_path / "drive" if command == "demo" else tmp_path
    out.mkdir(exist_ok=True)
    options: tuple[Any, ...] = ("--out", tmp_path)
    if command == "track":
        boxes = tmp_path / "det.txt"
        boxes.write_text("1,-1,10,20,30,40,0.9,-1,-1,-1\n")
        options = (*options, boxes)
    before = set(out.iterdir())
    with locked_folder(out):
        status, _, complaint = cli(command, *options)
    assert (status, f"process {os.getpid()}" in complaint, complaint.count("\n")) == (1, True, 1), (
        complaint
    )
    assert set(out.iterdir()) == before


def test_temporary_files_of_a_killed_run(
    tmp_path: Path, run_on_noise: Callable[..., tr.Run]
) -> None:
    """Those of all atomically written files are removed by the next run, other hidden files are
    not."""
    for name in (".123.settings.yaml", ".123.tracks.parquet", ".123.run.rrd", ".123.notes", ".git"):
        (tmp_path / name).write_text("")
    list(run_on_noise(tmp_path, overlay=False))
    assert {path.name for path in tmp_path.iterdir() if path.name.startswith(".")} == {
        ".123.notes",
        ".git",
    }


def test_rows_that_cannot_be_stored(
    tmp_path: Path, run_on_noise: Callable[..., tr.Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The temporary folder is full while the output folder is not: the files end with the last
    stored frame."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    run = run_on_noise(tmp_path / "out", overlay=False)
    run.session.rows.table = RunTable(rows_per_batch=10)
    with pytest.raises(OutputError, match="rows of the run cannot be stored"):
        list(run)
    assert run.summary["frames"] == 4
    assert len(run.session.rows) == 4
    check_folder(tmp_path / "out", 4)
