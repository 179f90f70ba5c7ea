"""The files that README's commands name, as small as they may be: drives, boards, boxes, labels, networks.

A name that README uses for the first time wants a line here; a folder's content is its owner's own layout.
"""

from __future__ import annotations

import contextlib
import fnmatch
import shutil
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
import yaml
from rich.console import Console

from tests.detection.darknet_networks import write_weights, yolov4_tiny
from tests.detection.lane_roads import HW, road_x_px
from tests.detection.onnx_models import write_model
from tests.detection.training.road_scenes import write_data_set
from tests.stereo.board_scenes import drawn, rig, varied_poses
from tests.stereo.kitti_folder import write_set
from tests.track_range.labelled_drives import F_PX, drive
from track_range.cli.run import run_and_print
from track_range.detection.classes import COCO_CLASSES
from track_range.detection.darknet.importer import import_darknet
from track_range.detection.darknet.network import read_network
from track_range.detection.formats.kitti import read_kitti
from track_range.run.settings import RunSettings
from track_range.simulation.drive import write_drive
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.stereo.calibration.boards import ChessBoard
from track_range.stereo.rig_formats.reading import load_rig
from track_range.video.reader import VideoReader

SECONDS = 1.0
N_BOARDS = 7
INSIDE = {"DIR": ("left.mp4", "right.mp4", "rig.yaml", "det.txt")}
"""What a folder's files name in their turn."""

SIZE_PX = (620, 188)
SEQUENCES = ("0000", "0001")


def write_inputs(folder: Path) -> Path:
    """Everything, in one folder."""
    for write in (_drive, _boxes, _folders_of_images, _boards, _networks, _labelled_drives, _training, _runs):
        write(folder)
    write_set(folder / "kitti2015", [f"{n:06d}_10" for n in range(5)])
    return folder


def lay(store: Path, words: Iterable[str], table: Path) -> None:
    """Copy what the words name from the store to the table, but not what comes after --out: that is yet to be made."""
    words = list(words)
    wanted = [word.partition("/")[0] for before, word in zip(["", *words], words, strict=False) if before != "--out"]
    wanted += [name for word in wanted for name in INSIDE.get(word, ())]
    for source in store.iterdir():
        if any(fnmatch.fnmatch(source.name, word) for word in wanted):
            copy = shutil.copytree if source.is_dir() else shutil.copy
            copy(source, table / source.name)
    for settings in table.glob("*/settings.yaml"):  # as though the run had been made here
        settings.write_text(settings.read_text().replace(str(store.resolve()), str(table.resolve())))


def _drive(folder: Path) -> None:
    """A short drive, under the names of the user's own videos too."""
    small = kitti_like_rig(width_px=SIZE_PX[0], height_px=SIZE_PX[1])
    made = write_drive(folder / "drive", seed=3, seconds=SECONDS, rig=small)
    for source, name in (
        (made.left, "left.mp4"),
        (made.left, "dashcam.mp4"),
        (made.right, "right.mp4"),
        (made.rig, "rig.yaml"),
        (made.truth, "labels.txt"),
        (made.ego_speed, "gps.csv"),
    ):
        shutil.copy(source, folder / name)
    left, right = small.left, small.right
    rows = [
        [c.fx_px, 0, c.cx_px, t, 0, c.fy_px, c.cy_px, 0, 0, 0, 1, 0] for c, t in ((left, 0), (right, _shift(small)))
    ]
    kitti = [f"{name}: {' '.join(map(str, row))}\n" for name, row in zip(("P2", "P3"), rows, strict=True)]
    (folder / "calib.txt").write_text("".join(kitti))
    (folder / "camchain.yaml").write_text(yaml.safe_dump(_camchain(folder / "rig.yaml")))


def _shift(pair) -> float:
    return -pair.right.fx_px * pair.baseline_m


def _camchain(rig_file: Path) -> dict:
    """Kalibr's way to say what rig.yaml says."""
    pair, _ = load_rig(rig_file, size_px=SIZE_PX)
    blocks = [
        {
            "camera_model": "pinhole",
            "intrinsics": [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px],
            "distortion_model": "radtan",
            "distortion_coeffs": [0.0, 0.0, 0.0, 0.0],
            "resolution": list(SIZE_PX),
        }
        for camera in (pair.left, pair.right)
    ]
    return {"cam0": blocks[0], "cam1": blocks[1] | {"T_cn_cnm1": pair.right_from_left.tolist()}}


def _boxes(folder: Path) -> None:
    """The drive's true boxes as a detector's, as a tracker's, and as the truth of a sequence."""
    truth = read_kitti(folder / "labels.txt")
    boxes = [
        (frame + 1, number, x1 + 1, y1 + 1, x2 - x1, y2 - y1)
        for frame, number, (x1, y1, x2, y2) in zip(truth.frame, truth.track_id, truth.xyxy_px, strict=True)
        if number >= 0
    ]
    found = "".join(f"{f},-1,{x:.2f},{y:.2f},{w:.2f},{h:.2f},0.9,-1,-1,-1\n" for f, _, x, y, w, h in boxes)
    tracked = "".join(f"{f},{i},{x:.2f},{y:.2f},{w:.2f},{h:.2f},0.9,-1,-1,-1\n" for f, i, x, y, w, h in boxes)
    files = {"det.txt": found}
    for name in SEQUENCES:
        files[f"sequences/{name}/det/det.txt"] = found
        files[f"tracks/mot/{name}.txt"] = tracked
        files[f"labels/{name}.txt"] = (folder / "labels.txt").read_text()
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def _folders_of_images(folder: Path) -> None:
    """The drive's frames one by one, and as those of sequences."""
    for eye in ("left", "right"):
        (folder / eye).mkdir()
        for number, frame in enumerate(VideoReader(folder / f"{eye}.mp4")):
            cv2.imwrite(str(folder / eye / f"{number:06}.png"), frame.image)
    for place in (folder / "frames", *(folder / "frames" / name for name in SEQUENCES)):
        shutil.copytree(folder / "left", place, dirs_exist_ok=True)


def _boards(folder: Path) -> None:
    true, board = rig(), ChessBoard(9, 6, 0.02)
    for number, pose in enumerate(varied_poses(N_BOARDS, seed=3, board=board)):
        for eye, camera, motion in (("left", true.left, np.eye(4)), ("right", true.right, true.right_from_left)):
            image = drawn(camera, motion @ pose, board=board, seed=number)
            cv2.imwrite(str(folder / f"{eye}{number}.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 97])


def _networks(folder: Path) -> None:
    """One car in whatever YOLOv5 sees, the two lines of a lane, and YOLOv4-tiny with a sixteenth of its filters."""
    rows = np.zeros((1, 252, 6))
    rows[0, 0] = [32, 34, 9, 6, 0.9, 0.9]
    for name in ("yolov5n", "a", "b"):
        write_model(folder / f"{name}.onnx", rows, metadata={"names": "['car']"})
    write_model(folder / "twinlitenet.onnx", np.zeros((1, 2, *HW)), _lane_mask(), input_shape=(1, 3, *HW))
    cfg, weights = folder / "yolov4-tiny.cfg", folder / "yolov4-tiny.weights"
    cfg.write_text(yolov4_tiny(size_px=(96, 96), width=16))
    write_weights(weights, read_network(cfg), seed=0)
    (folder / "coco.names").write_text("\n".join(COCO_CLASSES) + "\n")
    import_darknet(cfg, weights, folder / "mine.onnx", names=COCO_CLASSES)


def _lane_mask() -> np.ndarray:
    """(1, 2, h, w) scores: lines 3.5 m apart, 7 px wide."""
    scores = np.zeros((1, 2, *HW))
    y = np.arange(190, 358)
    for x_m in (-1.75, 1.75):
        for offset in range(-3, 4):
            scores[0, 1, y, np.clip(np.rint(road_x_px(x_m, y)).astype(int) + offset, 0, HW[1] - 1)] = 1.0
    return scores


def _labelled_drives(folder: Path) -> None:
    for place in ("label_02", "calib"):
        (folder / place).mkdir()
    for seed in range(3):
        (folder / "label_02" / f"{seed:04}.txt").write_text("\n".join(drive(seed)) + "\n")
        (folder / "calib" / f"{seed:04}.txt").write_text(f"P2: {F_PX} 0 600 0 0 {F_PX} 180 0 0 0 1 0\n")


def _training(folder: Path) -> None:
    """Six drawn scenes to train on, and the same to be judged by."""
    made = write_data_set(folder / "scenes", n_train=6)
    told = yaml.safe_load(made.read_text())
    (folder / "data.yaml").write_text(yaml.safe_dump(told | {"path": str(folder / "scenes")}))
    shutil.copytree(folder / "scenes/images/train", folder / "val")
    shutil.copytree(folder / "scenes/labels/train", folder / "val-labels")
    (folder / "val-labels/classes.txt").write_text("\n".join(told["names"]) + "\n")


def _runs(folder: Path) -> None:
    """Folders of runs: one, thrice."""
    videos = Path("left.mp4"), Path("right.mp4")
    settings = RunSettings(stereo=videos, detections=Path("det.txt"), sgbm=False, out=Path("DIR"))
    with contextlib.chdir(folder):
        run_and_print(settings, Console(quiet=True))
    for name in ("A", "B"):
        shutil.copytree(folder / "DIR", folder / name)
