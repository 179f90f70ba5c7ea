"""What runs say about wrong inputs: every fault of scale, image size, synchronisation and pairing
at several strengths.

Each case is a whole run, with the packaged detector by default. A fault is a change of the images
or of the calibration of a drive; it is noticed from the first frame after which a note of the run
names it, the right cause is named if that note contains it, and errors of fused distances count
from the moment of the fault on.
"""

from __future__ import annotations

import json
import re
import tempfile
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import track_range as tr
from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.drives import CACHE_OPTION, REAL_DATA, decoded
from track_range.foundation.arrays import Image
from track_range.simulation.drive import write_drive
from track_range.stereo.rig_formats.reading import load_rig

FPS = 10.0
SEEDS = (610, 611)  # no test and no choice uses them
SCENARIOS = ("city", "town", "highway", "following")
SECONDS = 12.0
FAULT_S = 4.0  # moment of a fault during a drive

Images = list[Image]


@dataclass(frozen=True, slots=True)
class Drive:
    """A pair of recordings; `known` are options of runs that make its scale known."""

    name: str
    left: Images
    right: Images
    rig: dict[str, list[float]]  # KITTI's P2 and P3 (12,)
    truth: str  # labels, one line per box, which starts with the frame
    known: dict[str, Any]
    boxes: Path | None = None  # recorded ones; None = those of the packaged detector


@dataclass(frozen=True, slots=True)
class Fault:
    """A wrong input."""

    section: str  # of the list of faults: scale, size, time or pair
    name: str
    change: Callable[[Drive, int], Drive]  # the second argument is the frame from which it holds
    said: str  # pattern of the notes that notice it
    cause: str  # pattern of the notes that name the right cause
    is_mono: bool = False
    is_known: bool = False  # whether runs have `Drive.known`


def _baseline(factor: float) -> Callable[[Drive, int], Drive]:
    def change(drive: Drive, _: int) -> Drive:
        left, right = drive.rig["P2"], list(drive.rig["P3"])
        right[3] = left[3] - factor * (left[3] - right[3])
        return replace(drive, rig={"P2": left, "P3": right})

    return change


def _focal(factor: float) -> Callable[[Drive, int], Drive]:
    def change(drive: Drive, _: int) -> Drive:
        scaled = {
            name: [factor * v if i in (0, 3, 5) else v for i, v in enumerate(p)]
            for name, p in drive.rig.items()
        }
        return replace(drive, rig=scaled)

    return change


def _each(
    left: Callable[[Image], Image] | None, right: Callable[[Image], Image] | None
) -> Callable[..., Drive]:
    def change(drive: Drive, _: int) -> Drive:
        return replace(
            drive,
            left=[left(image) for image in drive.left] if left else drive.left,
            right=[right(image) for image in drive.right] if right else drive.right,
        )

    return change


def _shifted(x_px: float, y_px: float) -> Callable[[Image], Image]:
    matrix = np.array([[1, 0, x_px], [0, 1, y_px]], np.float64)
    return lambda image: np.asarray(cv2.warpAffine(image, matrix, image.shape[1::-1]), np.uint8)


def _yaw(degrees: float) -> Callable[[Drive, int], Drive]:
    def change(drive: Drive, _: int) -> Drive:
        K = np.reshape(drive.rig["P3"], (3, 4))[:, :3]
        H = K @ cv2.Rodrigues(np.radians([0.0, degrees, 0.0]))[0] @ np.linalg.inv(K)
        warped = [
            np.asarray(cv2.warpPerspective(image, H, image.shape[1::-1]), np.uint8)
            for image in drive.right
        ]
        return replace(drive, right=warped)

    return change


def _resized(x: float, y: float) -> Callable[[Drive, int], Drive]:
    return _each(*[lambda image: np.asarray(cv2.resize(image, None, fx=x, fy=y), np.uint8)] * 2)


def _order(of_right: Callable[[int, int], list[int]]) -> Callable[[Drive, int], Drive]:
    """The right images in another order: a function of their number and the frame of the fault."""

    def change(drive: Drive, frame: int) -> Drive:
        right = [drive.right[k] for k in of_right(len(drive.right), frame)]
        n = min(len(drive.left), len(right))
        return replace(drive, left=drive.left[:n], right=right[:n])

    return change


def _skipped(k: int) -> Callable[[Drive, int], Drive]:
    """`k` right images dropped; -k: an image repeated k times."""
    return _order(lambda n, at: [*range(at), *[at] * max(-k, 0), *range(at + max(k, 0), n)])


def _flipped(code: int) -> Callable[[Image], Image]:
    return lambda image: np.asarray(cv2.flip(image, code), np.uint8)


def _unrelated(drive: Drive, _: int) -> Drive:
    """The right images are those of another drive."""
    other = decoded(
        REAL_DATA / "kitti_stereo" / ("0005" if drive.name == "0003" else "0003") / "right.mp4"
    )
    size_px = drive.left[0].shape[1::-1]
    images = [np.asarray(cv2.resize(image, size_px), np.uint8) for image in other]
    return replace(drive, right=[images[k % len(images)] for k in range(len(drive.left))])


SCALE, SIZE = "Scale in doubt", "focal length is in doubt|principal point in the middle third"
TIME = "not synchronised|repeats its last image|do not show the same moment"
PAIR = f"{TIME}|swapped|rig does not fit|upside down|ertical offset"

FAULTS = (
    *(
        Fault(
            "scale", f"baseline {f:g}", _baseline(f), SCALE, "baseline", is_known=f in (0.83, 1.2)
        )
        for f in (0.39, 0.5, 0.67, 0.83, 1.2, 1.5, 2.54, 4.3, 9.0)
    ),
    *(
        Fault(
            "scale",
            f"focal length {f:g}, one camera",
            _focal(f),
            SCALE,
            "focal length",
            is_mono=True,
            is_known=True,
        )
        for f in (0.5, 2.0)
    ),
    *(
        Fault("size", f"images {x:g} x {y:g}", _resized(x, y), SIZE, "principal point")
        for x, y in ((0.75, 0.75), (0.5, 0.5), (1024 / 1242, 320 / 375))
    ),
    *(Fault("time", f"{k} dropped", _skipped(k), TIME, "left video lags") for k in (1, 3)),
    *(
        Fault("time", f"{k} repeated", _skipped(-k), TIME, "right video (repeats|lags)")
        for k in (1, 5)
    ),
    Fault(
        "time",
        "frozen",
        _order(lambda n, at: [*range(at), *[at] * (n - at)]),
        TIME,
        "right video repeats",
    ),
    Fault(
        "time",
        "lag 2 from the start",
        _order(lambda n, at: [0, 0, *range(n - 2)]),
        TIME,
        "right video lags",
    ),
    Fault("pair", "swapped", lambda d, _: replace(d, left=d.right, right=d.left), PAIR, "swapped"),
    *(
        Fault(
            "pair",
            f"offset {x:+d} px",
            _each(None, _shifted(-x, 0)),
            f"{PAIR}|px too",
            "disparities|camera is turned",
        )
        for x in (-60, -15, 15, 60)
    ),
    *(
        Fault("pair", f"yaw {a:+d} degrees", _yaw(a), f"{PAIR}|px too", "disparities|turned")
        for a in (-3, -1, 1, 3)
    ),
    Fault("pair", "rows 20 px", _each(None, _shifted(0, 20)), PAIR, "ertical|rows"),
    Fault("pair", "both upside down", _each(_flipped(-1), _flipped(-1)), PAIR, "upside down"),
    Fault("pair", "right upside down", _each(None, _flipped(-1)), PAIR, "upside down"),
    Fault("pair", "right mirrored", _each(None, _flipped(1)), PAIR, "mirrored"),
    Fault("pair", "same video twice", lambda d, _: replace(d, right=d.left), PAIR, "one camera"),
    Fault("pair", "unrelated videos", _unrelated, PAIR, "different scenes"),
)
CLEAN = Fault("", "none", lambda drive, _: drive, f"{SCALE}|{SIZE}|{PAIR}", "")


@workload(
    option(
        "--sections",
        default=("scale", "size", "time", "pair"),
        metavar="NAME",
        help="kinds of faults",
    ),
    option(
        "--scenarios",
        default=SCENARIOS,
        metavar="NAME",
        help="scenarios of simulated drives, or none",
    ),
    option("--seeds", default=SEEDS, metavar="N", help="random seeds of simulated drives"),
    option(
        "--real",
        default=("0003", "0005", "gray51"),
        metavar="NAME",
        help="KITTI's drives; 'none' = simulation only",
    ),
    option(
        "--simulated-boxes",
        action="store_true",
        help="boxes of a simulated detector and no alignment: three times as fast, for --sections "
        "scale time",
    ),
    CACHE_OPTION,
)
def doubt(options: Namespace) -> Figures:
    """Notes and errors of runs with wrong inputs, by fault; without a fault, notes are false
    alarms.
    """
    cases: dict[str, list[dict[str, Any]]] = {}
    for drive in _drives(options):
        frame = round(min(FAULT_S * FPS, len(drive.left) / 3))
        for fault in (CLEAN, *FAULTS):
            if fault.section not in ("", *options.sections):
                continue
            case = _case(drive, fault, frame)
            cases.setdefault(f"{fault.section} {fault.name}".strip(), []).append(case)
            print(drive.name, fault.section, fault.name, json.dumps(case), flush=True)
    return {name: _summed(rows) for name, rows in cases.items()}


def _case(drive: Drive, fault: Fault, frame: int) -> dict[str, Any]:
    """Figures of a run with a fault."""
    changed = fault.change(drive, frame)
    from_frame = frame if fault.section == "time" and "start" not in fault.name else 0
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        (root / "calib.txt").write_text(
            "".join(f"{k}: {' '.join(map(str, v))}\n" for k, v in changed.rig.items())
        )
        lines = [
            line for line in drive.truth.splitlines() if int(line.split(" ", 1)[0]) >= from_frame
        ]
        (root / "truth.txt").write_text("\n".join(lines) + "\n")
        for side, images in (("left", changed.left), ("right", changed.right)):
            (root / side).mkdir()
            for number, image in enumerate(images):
                cv2.imwrite(
                    str(root / side / f"{number:06d}.png"), image, [cv2.IMWRITE_PNG_COMPRESSION, 1]
                )
        options: dict[str, Any] = {
            "rig": root / "calib.txt",
            "sgbm": False,
            "duration": len(changed.left) / FPS,
        }
        is_same_size = changed.left[0].shape == drive.left[0].shape
        options |= {"truth": root / "truth.txt"} if lines and is_same_size else {}
        options |= drive.known if fault.is_known else {}
        options |= {"detections": drive.boxes, "align": "off"} if drive.boxes is not None else {}
        make = tr.Run.mono if fault.is_mono else tr.Run.stereo
        sides = [str(root / "left"), *([] if fault.is_mono else [str(root / "right")])]
        noticed_s, notes, methods = float("nan"), "", {}
        try:
            with make(*sides, **options) as run:
                for result in run:
                    if np.isnan(noticed_s) and re.search(fault.said, " ".join(run.notes)):
                        noticed_s = max(result.time_s - from_frame / FPS, 0.0)
                notes, methods = " ".join(run.notes), run.summary["methods"]
        except tr.errors.RigError as error:
            notes, noticed_s = (
                str(error),
                0.0 if re.search(fault.said, str(error)) else float("nan"),
            )
        if np.isnan(noticed_s) and re.search(fault.said, notes):
            noticed_s = len(changed.left) / FPS
        fused, stereo = methods.get("fused", {}), methods.get("stereo", {})
        found = " ".join(
            sentence for sentence in re.split(r"(?<=\.) ", notes) if re.search(fault.said, sentence)
        )
        return {
            "noticed_s": noticed_s,
            "named": bool(fault.cause and re.search(fault.cause, found)),
            "fused_median_pct": fused.get("median_relative_error_pct"),
            "fused_within_2_sigma": fused.get("within_2_sigma"),
            "stereo_median_pct": stereo.get("median_relative_error_pct"),
            "stereo_within_2_sigma": stereo.get("within_2_sigma"),
            "said": found[:300],
        }


def _summed(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    noticed_s = np.array([row["noticed_s"] for row in rows])

    def median(name: str) -> float:
        values = [row[name] for row in rows if row[name] is not None]
        return round(float(np.median(values)), 2) if values else float("nan")

    return {
        "drives": len(rows),
        "noticed": round(float(np.isfinite(noticed_s).mean()), 2),
        "within_2_s": round(float((noticed_s <= 2.0).mean()), 2),
        "within_10_s": round(float((noticed_s <= 10.0).mean()), 2),
        "named": round(float(np.mean([row["named"] for row in rows])), 2),
        **{
            f"{method}_{name}": median(f"{method}_{name}")
            for method in ("fused", "stereo")
            for name in ("median_pct", "within_2_sigma")
        },
    }


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
    for scenario in options.scenarios if "none" not in options.scenarios else ():
        for seed in options.seeds:
            folder = options.cache / f"doubt_{scenario}_{seed}"
            if not (folder / "rig.yaml").exists():
                write_drive(folder, scenario=scenario, seed=seed, seconds=SECONDS, fps=FPS)
            drive = _simulated(f"{scenario} {seed}", folder)
            yield (
                replace(drive, boxes=folder / "detections.txt")
                if options.simulated_boxes
                else drive
            )


def _simulated(name: str, folder: Path) -> Drive:
    left, right = decoded(folder / "left.mp4"), decoded(folder / "right.mp4")
    rig, _ = load_rig(folder / "rig.yaml", size_px=(left[0].shape[1], left[0].shape[0]))
    camera = rig.left
    P2 = [
        camera.fx_px,
        0.0,
        camera.cx_px,
        0.0,
        0.0,
        camera.fy_px,
        camera.cy_px,
        0.0,
        0.0,
        0.0,
        1.0,
        0.0,
    ]
    P3 = [*P2[:3], -camera.fx_px * rig.baseline_m, *P2[4:]]
    return Drive(
        name,
        left,
        right,
        {"P2": P2, "P3": P3},
        (folder / "truth.txt").read_text(),
        {"ego_speed": folder / "ego_speed.csv"},
    )
