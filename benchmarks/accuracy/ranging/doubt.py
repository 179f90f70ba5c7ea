"""What runs say about wrong inputs: every fault of scale, image size, synchronisation, pairing,
cameras, clocks and speeds at several strengths.

Each case is a whole run, with the packaged detector by default. A fault is a change of the images
or of the inputs of a drive (`inputs/faulty_drives.py`); it is noticed from the first frame after
which a note of the run names it. The right cause is named if that note contains it, and named
first if no other one is before it; notes from before the fault, or of runs without one, do not
count. Rows count from 2 s after the fault on, in the sections size, time and pair from its moment
on; rows without a value are counted apart.
"""

from __future__ import annotations

import contextlib
import json
import re
import tempfile
from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import track_range as tr
from benchmarks.accuracy.ranging.row_scores import RowScores, median, pooled
from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.drives import CACHE_OPTION, REAL_DATA, decoded
from benchmarks.inputs.faulty_drives import FAULTS, FPS, Drive, Fault, clean
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.truth.truth import Truth, read_truth
from track_range.simulation.drive import write_drive
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.rig_formats.reading import load_rig

SEEDS = tuple(range(730, 740))  # no test and no choice uses them
SCENARIOS = ("city", "town", "highway", "following", "winding")
SECONDS = 12.0
FAULT_S = 4.0  # moment of a fault during a drive
SECTIONS = ("scale", "size", "time", "pair", "values", "rig", "clock", "speed", "image")


@workload(
    option("--sections", default=SECTIONS, metavar="NAME", help="kinds of faults"),
    option(
        "--faults", default=(), nargs="*", type=str, metavar="NAME", help="parts of their names"
    ),
    option("--without-clean", default=False, help="no runs without a fault"),
    option(
        "--scenarios",
        default=SCENARIOS,
        metavar="NAME",
        help="scenarios of simulated drives, or none; the shorter of --scenarios and --seeds "
        "repeats",
    ),
    option("--seeds", default=SEEDS, metavar="N", help="random seeds of simulated drives"),
    option("--seconds", default=SECONDS, metavar="S", help="length of simulated drives"),
    option(
        "--real",
        default=("0003", "0005", "gray51"),
        metavar="NAME",
        help="KITTI's drives; 'none' = simulation only",
    ),
    option(
        "--simulated-boxes",
        action="store_true",
        help="boxes of a simulated detector, and no alignment in --sections scale time: three "
        "times as fast",
    ),
    CACHE_OPTION,
)
def doubt(options: Namespace) -> Figures:
    """Notes and errors of runs with wrong inputs, by fault; without a fault, notes are false
    alarms.
    """
    faults = [
        fault
        for fault in FAULTS
        if fault.section in options.sections
        and (not options.faults or any(name in fault.name for name in options.faults))
    ]
    cases: dict[str, list[dict[str, Any]]] = {}
    for drive in _drives(options):
        run = _Runs(drive, round(min(FAULT_S * FPS, len(drive.left) / 3)))
        for fault in faults:
            if not fault.applies_to(drive):
                continue
            chosen = [fault] if options.without_clean else [clean(fault), fault]
            for each in chosen:
                case = run.case(each)
                if case is not None:
                    cases.setdefault(f"{each.section} {each.name}".strip(), []).append(case)
    return {name: _summed(rows) for name, rows in cases.items()}


class _Runs:
    """The runs of one drive with all faults; `said` are the notes of those without a fault."""

    def __init__(self, drive: Drive, frame: int) -> None:
        self._drive, self._frame = drive, frame
        self._said: dict[tuple[bool, bool], set[str]] = {}

    def case(self, fault: Fault) -> dict[str, Any] | None:
        """Figures of a run with a fault; None for a run without one that has been made already."""
        options = (fault.is_mono, fault.is_known)
        if not fault.section and options in self._said:
            return None
        case, sentences = _case(self._drive, fault, self._frame, self._said.get(options, set()))
        if not fault.section:
            self._said[options] = {_worded(sentence) for sentence in sentences}
        print(self._drive.name, fault.section, fault.name, json.dumps(case), flush=True)
        return case


def _case(
    drive: Drive, fault: Fault, frame: int, usual: set[str]
) -> tuple[dict[str, Any], list[str]]:
    """Figures of a run with a fault, and the sentences of its notes; `usual` are those of runs
    without a fault.
    """
    changed = fault.change(drive, frame)
    from_s, earlier = (frame if fault.is_sudden else 0) / changed.fps, set[str]()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        truth = _truth(root, drive, changed)
        options = _written(root, changed, fault)
        make = tr.Run.mono if fault.is_mono else tr.Run.stereo
        sides = [str(root / "left"), *([] if fault.is_mono else [str(root / "right")])]
        noticed_s, sentences, rows = (
            float("nan"),
            [],
            RowScores(truth, changed.true_mps, lambda index: changed.source(index)[1]),
        )
        try:
            with make(*sides, **options) as run:
                for result in run:
                    rows.add(result)
                    if result.time_s < from_s - 1e-6:
                        earlier = {_worded(sentence) for sentence in _sentences(run.notes)}
                    elif np.isnan(noticed_s) and _found(run.notes, fault, usual | earlier):
                        noticed_s = result.time_s - from_s
                sentences = _sentences(run.notes)
        except (tr.errors.RigError, tr.errors.UserError) as error:
            sentences = [str(error)]
            noticed_s = 0.0 if re.search(fault.said, str(error)) else float("nan")
        found = _found(sentences, fault, usual | earlier)
        if np.isnan(noticed_s) and found:
            noticed_s = changed.n_frames / changed.fps
        scored_s = (from_s + fault.after_s, from_s + fault.after_s + fault.for_s)
        return {
            "noticed_s": noticed_s,
            "named": bool(fault.cause and re.search(fault.cause, found)),
            "named_first": bool(fault.cause) and _is_first(found, fault.cause),
            **rows.scores(*scored_s),
            "said": found[:300],
        }, sentences


def _is_first(found: str, cause: str) -> bool:
    """Whether a sentence names a cause before others."""
    return any(re.search(cause, one.split("; or")[0]) for one in _sentences([found]))


def _sentences(notes: Sequence[str]) -> list[str]:
    return re.split(r"(?<=\.) ", " ".join(notes))


def _worded(sentence: str) -> str:
    """A sentence without its numbers."""
    return re.sub(r"[\d.,]+", "#", sentence)


def _found(notes: Sequence[str], fault: Fault, usual: set[str]) -> str:
    """The sentences that notice a fault."""
    return " ".join(
        sentence
        for sentence in _sentences(notes)
        if re.search(fault.said, sentence) and _worded(sentence) not in usual
    )


def _written(root: Path, drive: Drive, fault: Fault) -> dict[str, Any]:
    """Options of a run on the files of a changed drive, which are written."""
    (root / "calib.txt").write_text(
        "".join(f"{k}: {' '.join(map(str, v))}\n" for k, v in drive.rig.items())
    )
    for side, images in (("left", drive.left), ("right", drive.right)):
        (root / side).mkdir()
        for number, image in enumerate(images):
            cv2.imwrite(str(root / side / f"{number:06d}.bmp"), image)  # faster than PNG
    options: dict[str, Any] = {
        "rig": root / "calib.txt",
        "sgbm": False,
        "folder_fps": drive.fps,
        "duration": drive.n_frames / drive.fps,
    }
    if fault.is_known:
        options |= drive.known
        if drive.speed is not None:
            options["ego_speed"] = root / "speed.csv"
            lines = [f"{time_s:.3f},{mps:.4f}\n" for time_s, mps in drive.speed.tolist()]
            options["ego_speed"].write_text("time_s,speed_mps\n" + "".join(lines))
    if drive.boxes is not None:
        options["detections"] = root / "boxes.txt"
        options["detections"].write_text(_boxes_text(drive))
        if fault.section in ("scale", "time"):
            options["align"] = "off"
    return options


def _boxes_text(drive: Drive) -> str:
    """Recorded boxes of the images, which have other frames and places than those of the drive."""
    by_frame: dict[int, list[list[str]]] = {}
    for line in (drive.boxes or "").splitlines():
        words = line.split(" ")
        by_frame.setdefault(int(words[0]), []).append(words)
    lines = []
    for number in range(drive.n_frames):
        for words in by_frame.get(drive.source(number)[0], []):
            box = _mapped(np.array(words[6:10], np.float64)[None], drive, number)[0]
            middle, half = (box[:2] + box[2:]) / 2, drive.box_scale * (box[2:] - box[:2]) / 2
            edges = [f"{edge:.3f}" for edge in (*(middle - half), *(middle + half))]
            lines.append(" ".join([str(number), *words[1:6], *edges, *words[10:]]))
    return "\n".join(lines) + "\n"


def _mapped(xyxy_px: FloatArray, drive: Drive, frame: int) -> FloatArray:
    """(N, 4) boxes of the drive in the pixels of an image."""
    if drive.left_map is None:
        return xyxy_px
    A, moved = drive.left_map[frame][:, :2], drive.left_map[frame][:, 2]
    return np.concatenate([xyxy_px[:, :2] @ A.T + moved, xyxy_px[:, 2:] @ A.T + moved], axis=1)


def _truth(root: Path, drive: Drive, changed: Drive) -> Truth | None:
    """The labels of the images of a changed drive, with the distances of their times; None without
    labels, or for images of another size.
    """
    if not drive.truth or changed.left[0].shape != drive.left[0].shape:
        return None
    P = drive.rig["P2"]
    height_px, width_px = drive.left[0].shape[:2]
    camera = PinholeCamera(P[0], P[5], P[2], P[6], width_px, height_px)
    path = root / ("truth.csv" if drive.truth.startswith("frame,") else "truth.txt")
    path.write_text(drive.truth)
    with contextlib.suppress(tr.errors.UserError):
        truth = read_truth(path, camera, np.zeros(3))
        return _truth_of_images(truth, changed)
    return None


def _truth_of_images(truth: Truth, drive: Drive) -> Truth:
    parts: list[IntArray] = []
    values: list[tuple[IntArray, FloatArray, FloatArray, FloatArray]] = []
    for number in range(drive.n_frames):
        shown, moment = drive.source(number)
        rows = np.flatnonzero(truth.frame == shown)
        then = {
            int(identity): row
            for row, identity in zip(
                np.flatnonzero(truth.frame == moment).tolist(),
                truth.track_id[truth.frame == moment].tolist(),
                strict=True,
            )
        }
        at = np.array([then.get(int(identity), -1) for identity in truth.track_id[rows]], np.int64)
        parts.append(rows)
        values.append(
            (
                np.full(len(rows), number),
                _mapped(truth.xyxy_px[rows], drive, number),
                np.where(at >= 0, truth.distance_m[at], np.nan),
                np.where(at >= 0, truth.closing_mps[at], np.nan),
            )
        )
    frame, boxes_px, distance_m, closing_mps = (
        np.concatenate(column) for column in zip(*values, strict=True)
    )
    return replace(
        truth.select(np.concatenate(parts)),
        frame=frame,
        xyxy_px=boxes_px,
        distance_m=distance_m,
        closing_mps=closing_mps,
    )


def _summed(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    noticed_s = np.array([row["noticed_s"] for row in rows])
    figures: dict[str, Any] = {
        "drives": len(rows),
        "noticed": round(float(np.isfinite(noticed_s).mean()), 2),
        "within_2_s": round(float((noticed_s <= 2.0).mean()), 2),
        "within_10_s": round(float((noticed_s <= 10.0).mean()), 2),
        "named": round(float(np.mean([row["named"] for row in rows])), 2),
        "named_first": round(float(np.mean([row["named_first"] for row in rows])), 2),
        "noticed_median_s": median(noticed_s),
    }
    for name in ("fused", "closing", "ego"):
        within = [
            row[f"{name}_2_sigma"] / row[f"{name}_known"] for row in rows if row[f"{name}_known"]
        ]
        figures[f"{name}_of_drives"] = median(within)
        figures[f"{name}_worst"] = round(min(within, default=float("nan")), 2)
    figures |= pooled(rows)
    return figures


def _drives(options: Namespace) -> Iterator[Drive]:
    for name in options.real:
        folder = REAL_DATA / ("kitti_odometry" if name == "gray51" else "kitti_stereo") / name
        if name == "none" or not folder.exists():
            continue
        lines = dict(
            line.split(":", 1)
            for line in (folder / "calib.txt").read_text().splitlines()
            if ":" in line
        )
        names = ("P0", "P1") if name == "gray51" else ("P2", "P3")
        rig = {
            target: [float(v) for v in lines[own].split()]
            for target, own in zip(("P2", "P3"), names, strict=True)
        }
        labels = folder / "label.txt"
        yield Drive(
            name,
            decoded(folder / "left.mp4"),
            decoded(folder / "right.mp4"),
            rig,
            labels.read_text() if labels.exists() else "",
            {"camera_height_m": 1.65},
        )
    if "none" in options.scenarios:
        return
    n_drives = max(len(options.scenarios), len(options.seeds))
    for scenario, seed, _ in zip(
        cycle(options.scenarios), cycle(options.seeds), range(n_drives), strict=False
    ):
        length = "" if options.seconds == SECONDS else f"_{options.seconds:g}s"
        folder = options.cache / f"doubt_{scenario}_{seed}{length}"
        if not (folder / "detections.txt").exists():  # written last
            write_drive(folder, scenario=scenario, seed=seed, seconds=options.seconds, fps=FPS)
        drive = _simulated(f"{scenario} {seed}", folder)
        boxes = (folder / "detections.txt").read_text()
        yield replace(drive, boxes=boxes) if options.simulated_boxes else drive


def _simulated(name: str, folder: Path) -> Drive:
    left, right = decoded(folder / "left.mp4"), decoded(folder / "right.mp4")
    rig, _ = load_rig(folder / "rig.yaml", size_px=(left[0].shape[1], left[0].shape[0]))
    c = rig.left
    P2 = [c.fx_px, 0.0, c.cx_px, 0.0, 0.0, c.fy_px, c.cy_px, 0.0, 0.0, 0.0, 1.0, 0.0]
    P3 = [*P2[:3], -c.fx_px * rig.baseline_m, *P2[4:]]
    speed = np.loadtxt(folder / "ego_speed.csv", delimiter=",", skiprows=1)
    return Drive(
        name,
        left,
        right,
        {"P2": P2, "P3": P3},
        (folder / "truth.csv").read_text(),
        {},
        speed=speed,
        true_mps=speed[:, 1],
    )
