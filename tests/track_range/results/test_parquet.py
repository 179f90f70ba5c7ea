"""tracks.parquet: full precision, units, provenance; kills, full disks, damaged and newer files."""

from __future__ import annotations

import ast
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

import track_range as tr
from tests.documentation.documented_commands import PAGES, python_blocks
from tests.support.file_size_limit import file_size_limit
from tests.support.results.frame_results import result, writing
from track_range.detection.formats.detection_files import read_detections
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.evaluation.sequences.evaluation import evaluate_tracks
from track_range.evaluation.sequences.settings import TrackEvaluationSettings
from track_range.foundation.files.output_files import OutputError
from track_range.foundation.files.structured_text import read_yaml
from track_range.foundation.schemas.schema_version import SCHEMA_VERSION
from track_range.results.folder import read_run_folder, read_run_rows
from track_range.results.formats.csv_file import read_tracks_csv
from track_range.results.formats.parquet_file import read_tracks_arrows, read_tracks_parquet
from track_range.results.formats.provenance import settings_hash
from track_range.results.replay import frames_of_rows
from track_range.results.rows.columns import column_names, result_columns
from track_range.results.rows.rows import Rows
from track_range.run.export.export import ExportSettings, export
from track_range.views.report.run_folders import report

PARQUET, ARROWS = "tracks.parquet", "tracks.arrows"


@pytest.fixture
def run_file(tmp_path: Path) -> Path:
    """tracks.parquet of five frames with two tracks each, and tracks.csv."""
    with writing(tmp_path, ("csv", "parquet")) as rows:
        for index in range(5):
            rows.write(result(index))
    return tmp_path / PARQUET


def test_values_and_schema(run_file: Path) -> None:
    table = parquet.read_table(run_file)
    assert table.column_names == column_names()
    frame = result(3)
    for column in result_columns():
        values = table.column(column.name)
        assert len(values) == 10
        field = table.schema.field(column.name)
        assert (field.metadata or {}).get(b"unit", b"").decode() == column.unit
        if column.kind == "name":
            assert pa.types.is_dictionary(field.type)
            assert values.to_pylist()[6:8] == (
                ["car", "traffic light"] if column.name == "class" else [None, "parked"]
            )
        else:
            expected = np.asarray(column.read(frame), np.float64)
            np.testing.assert_array_equal(np.asarray(values.to_numpy(), np.float64)[6:8], expected)
    assert table.column("mono_m").null_count == 5
    file = parquet.ParquetFile(run_file).metadata
    assert file.row_group(0).column(0).compression == "ZSTD"
    assert table.schema.metadata[b"track_range.schema_version"] == str(SCHEMA_VERSION).encode()
    assert table.schema.metadata[b"track_range.version"].decode() == tr.__version__
    assert not run_file.with_name(ARROWS).exists()


def test_rounded_rows_equal_the_csv(run_file: Path) -> None:
    columns = read_tracks_parquet(run_file)
    assert columns["mono_m"][0] == 12.3456
    table = read_tracks_csv(run_file.with_name("tracks.csv"))
    for name, values in Rows(columns).rounded().columns.items():
        np.testing.assert_array_equal(values, table[name])


def test_replayed_rows_are_the_same(run_file: Path, tmp_path: Path) -> None:
    rows = read_run_rows(run_file, [])
    (tmp_path / "again").mkdir()
    with writing(tmp_path / "again", ("parquet",)) as again:
        for frame in frames_of_rows(rows, range(5), ("mono", "fused", "fused_kf"), 10.0):
            again.write(frame)
    assert parquet.read_table(tmp_path / "again" / PARQUET).equals(parquet.read_table(run_file))


def test_last_frame_is_discarded(tmp_path: Path) -> None:
    with writing(tmp_path, ("parquet",)) as rows:
        for index in range(3):
            rows.write(result(index))
        rows.discard_last()
        rows.write(result(3))
        rows.discard_last()
        rows.discard_last()
        rows.write(result(4))
    assert read_tracks_parquet(tmp_path / PARQUET)["frame"].tolist() == [0, 0, 1, 1, 4, 4]


def stream_sizes(folder: Path, n_frames: int) -> list[int]:
    """Bytes of tracks.arrows after each frame."""
    sizes = []
    with writing(folder, ("parquet",)) as rows:
        for index in range(n_frames):
            rows.write(result(index))
            sizes.append((folder / ARROWS).stat().st_size)
    return sizes


def test_full_disk(tmp_path: Path) -> None:
    """The frames before the failure are in tracks.parquet; without space for it, in
    tracks.arrows."""
    sizes = stream_sizes(tmp_path, 4)
    for size in (sizes[1], sizes[3]):
        with writing(tmp_path, ("csv", "parquet")) as rows, file_size_limit(size + 500):
            with pytest.raises(OutputError, match=ARROWS):  # noqa: PT012
                for index in range(50):
                    rows.write(result(index))
                    n_frames = index + 1
            assert n_frames > 1
        for columns in (
            read_tracks_csv(tmp_path / "tracks.csv"),
            read_tracks_parquet(tmp_path / PARQUET),
        ):
            assert columns["frame"].tolist() == [
                index for index in range(n_frames) for _ in range(2)
            ]
    (tmp_path / PARQUET).unlink()
    with writing(tmp_path, ("parquet",)) as rows:
        rows.write(result(0))
        with file_size_limit(500), pytest.raises(OutputError, match=PARQUET):
            rows.close(None)
    assert {path.name for path in tmp_path.iterdir()} == {"tracks.csv", ARROWS}
    assert read_tracks_arrows(tmp_path / ARROWS)[0]["frame"].tolist() == [0, 0]


@pytest.mark.slow
def test_killed_process(tmp_path: Path) -> None:
    program = (
        "import os, sys, signal, pathlib\n"
        "from tests.support.results.frame_results import result, writing\n"
        "with writing(pathlib.Path(sys.argv[1]), ('parquet',)) as rows:\n"
        "    for index in range(7):\n"
        "        rows.write(result(index))\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path)], cwd=Path(__file__).parents[3], check=False
    )
    assert ended.returncode == -9
    assert read_tracks_arrows(tmp_path / ARROWS)[0]["frame"].tolist() == [
        index for index in range(7) for _ in range(2)
    ]
    report([tmp_path], None)
    assert (tmp_path / "report.html").exists()


def test_truncated_stream(tmp_path: Path) -> None:
    with writing(tmp_path, ("parquet",)) as rows:
        for index in range(6):
            rows.write(result(index))
        shutil.copy(tmp_path / ARROWS, tmp_path / "whole.arrows")
    content = (tmp_path / "whole.arrows").read_bytes()
    path = tmp_path / ARROWS
    n_before = -1
    for n_bytes in range(len(content) - 12_000, len(content) + 1, 487):
        path.write_bytes(content[:n_bytes])
        missing: list[str] = []
        frames = read_run_rows(path, missing)["frame"]
        assert frames.tolist() == [index for index in range(len(frames) // 2) for _ in range(2)]
        assert len(frames) >= n_before
        n_before = len(frames)
    path.write_bytes(content[:-100])
    read_run_rows(path, missing)
    assert any(ARROWS in note for note in missing)
    path.write_bytes(content)
    missing.clear()
    assert len(read_run_rows(path, missing)["frame"]) == 12
    assert missing == []
    for start in (b"", b"ARROW", content[:300]):
        path.write_bytes(start)
        with pytest.raises(OutputError, match=ARROWS):
            read_run_rows(path, missing)


def test_newer_schema_version(run_file: Path) -> None:
    table = parquet.read_table(run_file)
    newer = {**table.schema.metadata, b"track_range.schema_version": b"7"}
    parquet.write_table(table.replace_schema_metadata(newer), run_file)
    with pytest.raises(OutputError, match=r"tracks\.parquet: .*schema_version.*7.*update"):
        read_tracks_parquet(run_file)
    newer[b"track_range.schema_version"] = b"1" + b"0" * 30
    parquet.write_table(table.replace_schema_metadata(newer), run_file)
    with pytest.raises(OutputError, match="schema_version"):
        read_tracks_parquet(run_file)
    newer[b"track_range.schema_version"] = b"many"
    parquet.write_table(table.replace_schema_metadata(newer), run_file)
    assert len(read_tracks_parquet(run_file)["frame"]) == 10


def test_rows_as_labels(run_file: Path) -> None:
    """Parquet is binary, also where readers look at the first line of text: as detections and as
    tracks."""
    frames = read_detections(run_file).frame
    assert frames.tolist() == list(range(5))  # predicted boxes are no detections
    truth = run_file.with_name("truth.csv")
    rows = "".join(f"{frame},3,car,1,2,3,4.5,12\n" for frame in range(5))
    truth.write_text(f"frame,id,class,x1,y1,x2,y2,distance_m\n{rows}")
    settings = TrackEvaluationSettings(truth=truth, results=run_file, road_class="car")
    assert evaluate_tracks(settings)["combined"]["hota"] == pytest.approx(100)
    table = parquet.read_table(run_file)
    newer = {**table.schema.metadata, b"track_range.schema_version": b"3"}
    parquet.write_table(table.replace_schema_metadata(newer), run_file)
    with pytest.raises(LabelFileError, match=r"tracks\.parquet: .*schema_version"):
        read_detections(run_file)


def test_damaged_parquet(run_file: Path) -> None:
    content = run_file.read_bytes()
    rng = np.random.default_rng(1)
    for damaged in (b"", content[:-1], content[len(content) // 2 :], b"PAR1" * 20):
        run_file.write_bytes(damaged)
        with pytest.raises(OutputError, match=r"tracks\.parquet"):
            read_run_rows(run_file, [])
    for _ in range(40):
        damaged = bytearray(content)
        for place in rng.integers(0, len(content), 8):
            damaged[place] ^= 1 << int(rng.integers(8))
        run_file.write_bytes(damaged)
        try:
            read_run_rows(run_file, [])
        except OutputError as error:
            assert len(str(error).removeprefix(str(run_file))) < 300  # noqa: PT017
    long_names = pa.table({"class": pa.array(["x" * 1000]).dictionary_encode(), "frame": [1]})
    for table in (long_names, pa.table({"frame": [1.5]})):
        parquet.write_table(table, run_file)
        with pytest.raises(OutputError, match=r"tracks\.parquet"):
            read_run_rows(run_file, [])


@pytest.mark.slow
def test_run_with_parquet_only(tmp_path: Path, run_on_noise: Callable[..., tr.Run]) -> None:
    both, alone = tmp_path / "both", tmp_path / "alone"
    list(run_on_noise(both, overlay=False))
    list(run_on_noise(alone, overlay=False, write="parquet"))
    assert (alone / PARQUET).exists()
    assert not (alone / "tracks.csv").exists()
    report([alone], None)
    first, second = read_run_folder(both).rows, read_run_folder(alone).rows
    for name in first.columns:
        np.testing.assert_array_equal(first[name], second[name])
    exact = read_run_folder(both, is_rounded=False).rows
    assert np.any(exact["mono_m"] != first["mono_m"])
    metadata = parquet.read_schema(alone / PARQUET).metadata
    run = read_yaml(alone / "settings.yaml", OutputError, "settings")["run"]
    summary = json.loads((alone / "summary.json").read_text())
    hashes: dict[str, list[str]] = {}
    for entry in summary["provenance"]["files"]:  # small files, which are hashed whole
        hashes.setdefault(entry["role"], []).append(entry["sha256"])
    assert hashes.keys() == {"mono", "detections"}
    assert (
        metadata[b"track_range.settings_hash"].decode()
        == summary["settings_hash"]
        == settings_hash(run, file_hashes=hashes)
    )
    export(ExportSettings(source=alone, to="parquet", out=tmp_path / "exported"))
    assert parquet.read_schema(tmp_path / "exported").metadata == metadata
    assert summary["schema_version"] == SCHEMA_VERSION
    assert json.loads(metadata[b"track_range.rig"])["focal_px"] == 60
    assert json.loads(metadata[b"track_range.model"]) == {"detections": "boxes.txt"}


def test_settings_hash() -> None:
    """It depends on the inputs and options, not on the order of the keys and on the output
    files."""
    run = {"mono": "/a.mp4", "focal_px": 900.0, "sgbm_options": {"a": 1, "b": [1, 2]}}
    written = {
        "sgbm_options": {"b": [1, 2], "a": 1},
        "out": "/b",
        "write": ["csv"],
        "overlay": False,
        "mcap_images": True,
    }
    assert settings_hash(run) == settings_hash({**written, "focal_px": 900.0, "mono": "/a.mp4"})
    for other in ({"mono": "/b.mp4"}, {"focal_px": 901.0}, {"sgbm_options": {"a": 2, "b": [1, 2]}}):
        assert settings_hash(run) != settings_hash({**run, **other})
    first = settings_hash(run, file_hashes={"rig": ["1"]})
    assert first == settings_hash(
        written | {"focal_px": 900.0, "mono": "/a.mp4"}, {}, {"rig": ["1"]}
    )
    assert first not in (settings_hash(run), settings_hash(run, file_hashes={"rig": ["2"]}))


@pytest.mark.slow
def test_rows_written_after_the_iteration(
    tmp_path: Path, run_on_noise: Callable[..., tr.Run]
) -> None:
    list(run_on_noise(tmp_path / "while", overlay=False))
    run = run_on_noise(None, overlay=False)
    list(run)
    run.write(tmp_path / "after")
    tables = [parquet.read_table(tmp_path / name / PARQUET) for name in ("while", "after")]
    assert tables[0].equals(tables[1])


@pytest.mark.parametrize("page", ["README.md", "docs/reference/results.md"])
def test_documented_queries(run_file: Path, page: str) -> None:
    """The DuckDB and pandas lines of the documentation give the closest approach of each track."""
    blocks = [
        code for code in python_blocks(PAGES[page]) if "closest_m" in code or "groupby" in code
    ]
    text = (
        "\n".join(blocks)
        .replace("DIR/", f"{run_file.parent}/")
        .replace("results/", f"{run_file.parent}/")
    )
    text = text.replace("left-track-range/", f"{run_file.parent}/").replace("print(", "(")
    names: dict[str, object] = {}
    results = []
    for step in ast.parse(text).body:
        if isinstance(step, ast.Expr):
            results.append(eval(compile(ast.Expression(step.value), page, "eval"), names))  # noqa: S307 - our own text
        else:
            exec(compile(ast.Module([step], []), page, "exec"), names)  # noqa: S102
    sql = results[0]
    assert dict(zip(sql.fetchdf()["track_id"], sql.fetchdf()["closest_m"], strict=True))[3] == 12.5
    assert [series[3] for series in results[1:]] == [12.5] * (len(results) - 1)
