"""run.rrd, loaded without a viewer, and `track-range view`."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr

import track_range as tr
from tests.support.file_size_limit import file_size_limit
from tests.track_range.results.moving_frames import START_S, frame, info
from track_range.cli.commands.view import recording_of, viewer_command
from track_range.foundation.errors import UserError
from track_range.foundation.files.folder_lock import locked_folder
from track_range.foundation.files.output_files import OutputError
from track_range.foundation.library_telemetry import VIEWER_VARIABLES
from track_range.foundation.schemas.schema_version import SCHEMA_VERSION
from track_range.results.formats.scene import track_objects
from track_range.results.rows.columns import viewer_columns
from track_range.results.writers import OpenWriters, create_writers

Rows = dict[str, list[dict[str, Any]]]


def write(folder: Path, n_frames: int = 4, **values: Any) -> Path:
    writers = OpenWriters(("rrd",), info(notes=("a note",), **values), folder)
    for index in range(n_frames):
        writers.write(frame(index))
    writers.close({"notes": ["a note", "another note"]})
    return folder / "run.rrd"


def rows_of(path: Path) -> Rows:
    """Rows of each entity in the order of the frames, static ones first, with the columns that are
    not null."""
    rows = defaultdict(list)
    for chunk in rr.chunk.RrdReader(path).stream().to_chunks():
        for row in chunk.to_record_batch().to_pylist():
            rows[chunk.entity_path].append(
                {name: value for name, value in row.items() if value is not None}
            )
    return {
        entity: sorted(given, key=lambda row: row.get("frame", -1))
        for entity, given in rows.items()
    }


def values(rows: Rows, entity: str, component: str) -> list[Any]:
    return [row[name] for row in rows[entity] for name in row if name.endswith(component)]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Rows:
    return rows_of(write(tmp_path_factory.mktemp("rerun")))


def test_entities(recording: Rows) -> None:
    expected = {
        "/camera/image/boxes",
        "/world/tracks",
        "/birds_eye/tracks",
        "/distance/track_3",
        "/log",
    }
    assert expected <= set(recording)
    assert values(recording, "/log", ":text") == [["a note"], ["another note"]]
    assert values(recording, "/distance/track_3", ":scalars") == [[12.0], [12.0], [12.0]]
    assert values(recording, "/closing_speed/track_3", ":scalars") == [[2.0], [2.0], [2.0]]
    assert [row["frame"] for row in recording["/distance/track_3"] if "frame" in row] == [0, 1, 3]
    assert "/distance/track_7" not in recording or not values(
        recording, "/distance/track_7", ":scalars"
    )


def test_scene(recording: Rows) -> None:
    (car, _) = track_objects(frame(0), viewer_columns())
    centres = values(recording, "/world/tracks", ":centers")
    assert [len(boxes) for boxes in centres] == [1, 1, 0, 1]
    np.testing.assert_allclose(centres[0][0], car.centre_m, rtol=1e-6)
    np.testing.assert_allclose(
        2 * np.array(values(recording, "/world/tracks", ":half_sizes")[0][0]), car.lwh_m, rtol=1e-6
    )
    turn = values(recording, "/world/tracks", ":quaternions")[0][0]
    np.testing.assert_allclose(turn, car.xyzw, rtol=1e-6)
    footprint = values(recording, "/birds_eye/tracks", ":strips")[0][0]
    np.testing.assert_allclose(
        footprint, [[0.1, -16], [1.9, -16], [1.9, -12], [0.1, -12], [0.1, -16]], rtol=1e-6
    )
    boxes = values(recording, "/camera/image/boxes", ":centers")
    np.testing.assert_allclose(boxes[0], [[2.5, 3.75], [20.5, 30.5]])
    assert values(recording, "/camera/image/boxes", ":labels")[0] == [
        "car 3  12.0 ± 0.5 m",
        "traffic light 7",
    ]


def test_map(recording: Rows) -> None:
    assert values(recording, "/map/vehicle", "Transform3D:translation")[0] == [[8.0, -1.0, 0.0]]
    points = values(recording, "/map/tracks", ":positions")
    assert [len(positions) for positions in points] == [1, 1, 0, 1]
    assert points[0] == [[20.25, -3.5, 0.0]]
    (path,) = values(recording, "/map/paths/vehicle", ":strips")
    assert path == [[[8.0, -1.0, 0.0]] * 4]
    (paths,) = values(recording, "/map/paths/tracks", ":strips")
    assert paths == [[[20.25, -3.5, 0.0]] * 3]


def test_stores_and_provenance(tmp_path: Path) -> None:
    path = write(tmp_path, start_utc_s=START_S)
    reader = rr.chunk.RrdReader(path)
    assert [store.application_id for store in reader.recordings()] == ["track-range"]
    assert len(reader.blueprints()) == 1
    rows = rows_of(path)
    (entity,) = (name for name in rows if name.endswith("provenance"))
    assert [str(SCHEMA_VERSION)] in [
        value for row in rows[entity] for name, value in row.items() if "schema_version" in name
    ]
    assert rows["/distance/track_3"][-1]["time"].timestamp() == pytest.approx(
        START_S + 0.3, abs=1e-3
    )


def test_last_frame_is_discarded(tmp_path: Path) -> None:
    writers = OpenWriters(("rrd",), info(), tmp_path)
    for index in (0, 1):
        writers.write(frame(index))
    writers.discard_last()
    writers.write(frame(3))
    writers.close(None)
    rows = rows_of(tmp_path / "run.rrd")["/distance/track_3"]
    assert [row["frame"] for row in rows if "frame" in row] == [0, 3]


def test_no_file_before_the_end(tmp_path: Path) -> None:
    """A killed run leaves no empty file, which the viewer would refuse."""
    writers = OpenWriters(("rrd",), info(), tmp_path)
    writers.write(frame(0))
    assert list(tmp_path.iterdir()) == []
    writers.close(None)
    assert [path.name for path in tmp_path.iterdir()] == ["run.rrd"]


def test_full_disk(tmp_path: Path) -> None:
    writers = OpenWriters(("rrd",), info(), tmp_path)
    writers.write(frame(0))
    with file_size_limit(2000), pytest.raises(OutputError, match=r"run\.rrd"):
        writers.close(None)


def test_missing_package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(UserError, match=r"pip install 'track-range\[rerun\]'"):
        create_writers(("rrd",))


@pytest.mark.slow
def test_view(tmp_path: Path, run_on_noise: Callable[..., tr.Run]) -> None:
    """A run with video, and one of which only the rows are left."""
    for name in ("whole", "killed"):
        folder = tmp_path / name
        list(run_on_noise(folder, write="csv,mot,parquet,rrd" if name == "whole" else "csv"))
        if name == "killed":
            (folder / "summary.json").unlink()
        path = recording_of(folder)
        rows = rows_of(path)
        references = [row for row in rows["/camera/image/video"] if "frame" in row]
        assert [row["frame"] for row in references] == list(range(20))
        assert len(values(rows, "/distance/track_1", ":scalars")) > 10
        assert str(path) in viewer_command(path, is_web=True)
    (tmp_path / "killed" / "run.rrd").unlink()
    with locked_folder(tmp_path / "killed"), pytest.raises(UserError, match="in progress"):
        recording_of(tmp_path / "killed")
    with pytest.raises(UserError, match="nowhere"):
        recording_of(tmp_path / "nowhere")
    assert json.loads((tmp_path / "whole" / "summary.json").read_text())["frames"] == 20


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
def test_viewer_makes_no_connection(tmp_path: Path) -> None:
    """The viewer without a window, whether it can draw on this machine or not."""
    command = viewer_command(write(tmp_path), is_web=False)
    log = tmp_path / "calls.txt"
    calls = ("strace", "-f", "-e", "trace=connect,bind,sendto,sendmmsg", "-o", str(log))
    environment = {**os.environ, **VIEWER_VARIABLES, "HOME": str(tmp_path)}
    with suppress(subprocess.TimeoutExpired):
        subprocess.run(
            [*calls, *command, "--headless"],
            env=environment,
            timeout=20,
            capture_output=True,
            check=False,
        )
    addresses = re.findall(r"sin6?_addr.*?[\"]([0-9a-f.:]+)[\"]", log.read_text())
    assert addresses
    assert set(addresses) <= {"127.0.0.1", "::1"}
    assert not list(tmp_path.rglob("analytics*"))
