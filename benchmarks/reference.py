"""Results of every main command on real and simulated input: recorded once, and compared after a
change of the code.

python -m benchmarks reference --out before --data DATA      records
python -m benchmarks reference --out after --data DATA --against before

Everything but times is expected to be equal to the last byte; of tables, each column that differs
is printed.
"""

from __future__ import annotations

import csv
import json
import re
import subprocess
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from benchmarks.harness import PROGRAM, Figures, option, workload
from benchmarks.inputs.drives import REAL_DATA

_TIMES = {
    *(
        "wall_s",
        "frames_per_s",
        "stages_ms",
        "latency_ms",
        "seconds",
        "ms",
        "look_s",
        "started_s",
        "heartbeat_s",
    ),
    *("versions", "memory_mb", "settings_hash", "pid"),
}
"""Keys of JSON files that differ from run to run."""

_MACHINE = {
    *(
        "processed_s",
        "wall_s",
        "overhead_s",
        "alignment_look_s",
        "started_utc",
        "finished_utc",
        "frames_per_s",
    ),
    *("peak_memory_mb", "memory_mb", "node", "worker", "left", "right", "inputs"),
}
"""Columns of the table of clips that differ from run to run, or have the path of the results."""

_EXPORTS = {
    "coco": "0003.json", "cvat": "0003.xml", "kitti": "0003.txt", "mot": "mot.txt", "yolo": "yolo", "mcap": "run.mcap",
    "parquet": "0003.parquet", "rrd": "run.rrd",
}  # fmt: skip


@workload(
    option("--out", type=Path, required=True, help="folder of the results, new"),
    option("--data", default=REAL_DATA, help="folder of the real data"),
    option("--against", type=Path, help="folder of an earlier recording, to compare with"),
    option("--only", default="", help="only the commands whose name contains this text"),
    option("--compare-only", default=False, help="compare two recordings, run nothing"),
)
def reference(options: Namespace) -> Figures:
    if not options.compare_only:
        record(options.out, options.data.resolve(), options.only)
    if options.against is None:
        return {}
    found = dict(differences(options.against, options.out))
    for name, text in found.items():
        print(f"{name}: {text}")
    print(f"{len(found)} of {len(list(recorded(options.out)))} files differ")
    return found


def commands(data: Path) -> Iterator[tuple[str, list[str]]]:
    """Name and arguments of each command, run in the order given in one folder; outputs carry the
    name.
    """
    n = data / "models" / "yolov5n_coco_640.onnx"
    yield "drive", "simulate --out drive --seconds 3 --seed 5".split()
    yield "demo", "demo --out demo".split()
    for drive in ("0003", "0005"):
        folder = data / "kitti_stereo" / drive
        pair = [
            "--stereo",
            f"{folder}/left.mp4",
            f"{folder}/right.mp4",
            "--rig",
            f"{folder}/calib.txt",
        ]
        truth = ["--truth", f"{folder}/label.txt", "--no-overlay"]
        yield f"{drive}-road", [*pair, *truth, "--out", f"{drive}-road"]
        yield f"{drive}-v5n", [*pair, *truth, "--detector", f"{n}", "--out", f"{drive}-v5n"]
        mono = ["--mono", f"{folder}/left.mp4", "--rig", f"{folder}/calib.txt", *truth]
        yield f"{drive}-mono", [*mono, "--out", f"{drive}-mono"]
        yield (
            f"{drive}-uncalibrated",
            [*pair[:3], "--no-overlay", "--no-sgbm", "--out", f"{drive}-uncalibrated"],
        )
    grey = data / "kitti_odometry" / "gray51"
    pair = ["--stereo", f"{grey}/left.mp4", f"{grey}/right.mp4", "--rig", f"{grey}/calib.txt"]
    yield "gray51", [*pair, "--no-overlay", "--out", "gray51"]
    mono = [
        "--mono",
        f"{grey}/left.mp4",
        "--rig",
        f"{grey}/calib.txt",
        "--camera-height-m",
        "1.65",
        "--no-overlay",
    ]
    yield "gray51-mono", [*mono, "--out", "gray51-mono"]
    yield "gray51-speed", [*mono, "--ego-speed", "30", "--out", "gray51-speed"]
    pair = "--stereo drive/left.mp4 drive/right.mp4 --rig drive/rig.yaml --no-overlay --truth drive/truth.csv".split()
    yield "simulated", [*pair, "--write", "csv,mot,parquet,kitti,recorded", "--out", "simulated"]
    for clip in ("highway_two_cars", "solid_white_right"):
        mono = [
            "--mono",
            f"{data}/dashcam/{clip}.mp4",
            "--focal-px",
            "1150",
            "--camera-height-m",
            "1.4",
        ]
        yield (
            clip,
            [*mono, "--no-overlay", "--write", "csv,mot,parquet,kitti,recorded", "--out", clip],
        )
    for folder in sorted(data.glob("mot/*/*/det/det.txt")):
        name = f"track-{folder.parents[1].name}"
        yield name, ["track", f"{folder}", "--out", name]
        yield f"{name}-online", ["track", f"{folder}", "--online", "--out", f"{name}-online"]
    for kind in ("Car", "Pedestrian"):
        yield (
            f"track-rrc-{kind}",
            ["track", f"{data}/kitti_labels/rrc/{kind}", "--out", f"track-rrc-{kind}"],
        )
        evaluated = [
            "--results",
            f"track-rrc-{kind}",
            "--class",
            kind.lower().replace("pedestrian", "person"),
        ]
        yield (
            f"evaluate-{kind}",
            ["evaluate", "tracks", "--truth", f"{data}/kitti_labels/label_02", *evaluated],
        )
    labels = ["--labels", f"{data}/kitti_labels/label_02", "--calib", f"{data}/kitti_labels/calib"]
    yield "evaluate-ranges", ["evaluate", "ranges", *labels, "--noise-px", "2"]
    yield "evaluate-stereo", ["evaluate", "stereo", "--pairs", f"{data}/kitti2015"]
    yield (
        "evaluate-events",
        ["evaluate", "events", "--events", "simulated", "--truth", "drive/contacts.csv"],
    )
    for to, name in _EXPORTS.items():
        yield f"export-{to}", ["export", "0003-road", "--to", to, "--out", f"export-{to}/{name}"]
    rows = "clip,left,right,rig\n" + "".join(
        f"{d},{data}/kitti_stereo/{d}/left.mp4,{data}/kitti_stereo/{d}/right.mp4,{data}/kitti_stereo/{d}/calib.txt\n"
        for d in ("0003", "0005")
    )
    yield "clips.csv", [f"{rows}drive,drive/left.mp4,drive/right.mp4,drive/rig.yaml\n"]
    yield "fleet", ["fleet", "run", "clips.csv", "--out", "fleet", "--no-sgbm"]


def record(out: Path, data: Path, only: str) -> None:
    """Run the commands in `out`; what each prints is in NAME.out."""
    out.mkdir(parents=True, exist_ok=True)
    for name, arguments in commands(data):
        if only not in name:
            continue
        if name.endswith(".csv"):
            (out / name).write_text(arguments[0], encoding="utf-8")
            continue
        for argument in arguments:
            if argument.startswith("export-"):
                (out / argument).parent.mkdir(exist_ok=True)
        command = [*PROGRAM, *arguments]
        done = subprocess.run(command, cwd=out, capture_output=True, text=True, check=False)
        (out / f"{name}.out").write_text(
            f"status {done.returncode}\n{done.stdout}", encoding="utf-8"
        )
        if done.returncode:
            print(f"{name}: status {done.returncode}: {done.stderr[-400:]}")


_COMPARED = {".csv", ".txt", ".json", ".parquet", ".xml", ".out", ".mcap"}


def recorded(folder: Path) -> Iterator[Path]:
    for path in sorted(folder.rglob("*")):
        if (
            path.is_file()
            and path.suffix in _COMPARED
            and ".track-range" not in path.parts
            and path.parent != folder / "drive"
        ):
            yield path.relative_to(folder)


def differences(before: Path, after: Path) -> Iterator[tuple[str, str]]:
    names = dict.fromkeys([*recorded(before), *recorded(after)])
    for name in names:
        old, new = before / name, after / name
        if not old.exists() or not new.exists():
            yield f"{name}", f"only in {before if old.exists() else after}"
        elif old.read_bytes() != new.read_bytes() and (text := _difference(old, new)):
            yield f"{name}", text


def _difference(old: Path, new: Path) -> str:
    if old.suffix == ".parquet":
        return _of_tables(_parquet_columns(old), _parquet_columns(new))
    if old.suffix == ".mcap":
        return f"{old.stat().st_size} -> {new.stat().st_size} bytes, other content"
    if old.suffix == ".csv":
        return _of_tables(_csv_columns(old), _csv_columns(new))
    texts = [path.read_text(encoding="utf-8", errors="replace") for path in (old, new)]
    if old.suffix == ".json":
        a, b = (dict(_leaves(json.loads(text))) for text in texts)
        keys = [key for key in dict.fromkeys([*a, *b]) if a.get(key) != b.get(key)]
        return "; ".join(f"{key} {a.get(key)} -> {b.get(key)}" for key in keys[:12])
    if old.suffix == ".out" and not old.name.startswith("evaluate"):
        texts = [text.splitlines()[0] for text in texts]  # tables of runs have times
    elif old.name == "evaluate-stereo.out":
        # the last column is a time
        texts = [re.sub(r" +[0-9.]+ *$", "", text, flags=re.MULTILINE) for text in texts]
    pairs = zip(*(text.splitlines() for text in texts), strict=False)
    lines = [f"{a[:100]!r} -> {b[:100]!r}" for a, b in pairs if a != b]
    return f"{len(lines)} lines: " + "; ".join(lines[:4]) if lines else ""


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, item in value.items():
            if key not in _TIMES:
                yield from _leaves(item, f"{path}.{key}")
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from _leaves(item, f"{path}.{index}")
    elif not (isinstance(value, str) and re.search(r"\d (s|ms)\b|per second", value)):
        yield path, value


def _csv_columns(path: Path) -> dict[str, list[Any]]:
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    names = rows[0] if rows else []
    return {
        name: [row[i] if i < len(row) else "" for row in rows[1:]] for i, name in enumerate(names)
    }


def _parquet_columns(path: Path) -> dict[str, list[Any]]:
    table = pq.read_table(path)
    return {name: [str(value) for value in table[name].to_pylist()] for name in table.column_names}


def _of_tables(a: dict[str, list[Any]], b: dict[str, list[Any]]) -> str:
    """Columns that differ, with the largest difference of numbers."""
    parts = [f"column {name} only in one" for name in sorted(a.keys() ^ b.keys())]
    for name in (name for name in a if name in b and _is_compared(name) and a[name] != b[name]):
        if len(a[name]) != len(b[name]):
            return "; ".join([*parts, f"{len(a[name])} -> {len(b[name])} rows"])
        unequal = [(x, y) for x, y in zip(a[name], b[name], strict=True) if x != y]
        numbers = np.array([(_number(x), _number(y)) for x, y in unequal])
        largest = np.nanmax(np.abs(numbers[:, 1] - numbers[:, 0]), initial=0.0)
        parts.append(f"{name}: {len(unequal)} of {len(a[name])} rows, at most {largest:.4g}")
    return "; ".join(parts)


def _is_compared(name: str) -> bool:
    """Whether a column has results, not times of the machine."""
    return name not in _MACHINE and not name.endswith("_ms")


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan
