"""The files that the documented commands of `test_documented_runs` name, as small as possible."""

from __future__ import annotations

import fnmatch
import shutil
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

import track_range as tr
from tests.support.images.board_scenes import drawn, rig, varied_poses
from tests.support.networks.onnx_models import write_model
from track_range.detection.formats.video_labels.kitti import read_kitti
from track_range.recording.sources.open_video import open_video
from track_range.simulation.drive import Drive
from track_range.stereo.calibration.boards import ChessBoard

N_BOARDS = 7


def write_inputs(folder: Path, drive: Drive) -> Path:
    """Everything that the commands name, in one folder."""
    names = {
        "left.mp4": drive.left,
        "dashcam.mp4": drive.left,
        "right.mp4": drive.right,
        "rig.yaml": drive.rig,
        "labels.txt": drive.truth,
    }
    for name, source in names.items():
        shutil.copy(source, folder / name)
    for write in (_kitti_calibration, _boxes, _image_folders, _boards, _network):
        write(folder)
    return folder


def copy_inputs(store: Path, words: Iterable[str], folder: Path) -> None:
    """Copy the files that the words of a command name from the store, except the value of --out."""
    words = list(words)
    names = [
        word.rstrip("/")
        for before, word in zip(["", *words], words, strict=False)
        if before != "--out"
    ]
    for source in store.iterdir():
        if any(fnmatch.fnmatch(source.name, name) for name in names):
            copy = shutil.copytree if source.is_dir() else shutil.copy
            copy(source, folder / source.name)


def _kitti_calibration(folder: Path) -> None:
    """KITTI's calib.txt of the same cameras as rig.yaml."""
    pair = tr.load_rig(folder / "rig.yaml")
    shift_px_m = -pair.right.fx_px * pair.baseline_m
    lines = []
    for name, camera, shift in (("P2", pair.left, 0.0), ("P3", pair.right, shift_px_m)):
        row = [camera.fx_px, 0, camera.cx_px, shift, 0, camera.fy_px, camera.cy_px, 0, 0, 0, 1, 0]
        lines.append(f"{name}: {' '.join(map(str, row))}\n")
    (folder / "calib.txt").write_text("".join(lines))


def _boxes(folder: Path) -> None:
    """The true boxes of the drive as detections, as tracks, and as the truth of a sequence."""
    truth = read_kitti(folder / "labels.txt")
    detections, tracks = [], []
    for frame, number, (x1, y1, x2, y2) in zip(
        truth.frame, truth.track_id, truth.xyxy_px, strict=True
    ):
        if number >= 0:
            box = f"{x1 + 1:.2f},{y1 + 1:.2f},{x2 - x1:.2f},{y2 - y1:.2f},0.9,-1,-1,-1\n"
            detections.append(f"{frame + 1},-1,{box}")
            tracks.append(f"{frame + 1},{number},{box}")
    for name in ("tracks/mot", "labels"):
        (folder / name).mkdir(parents=True)
    (folder / "det.txt").write_text("".join(detections))
    (folder / "tracks/mot/0000.txt").write_text("".join(tracks))
    shutil.copy(folder / "labels.txt", folder / "labels/0000.txt")


def _image_folders(folder: Path) -> None:
    """The frames of the drive as numbered images."""
    for side in ("left", "right"):
        (folder / side).mkdir()
        for number, frame in enumerate(open_video(folder / f"{side}.mp4")):
            cv2.imwrite(str(folder / side / f"{number:06}.png"), frame.image)


def _boards(folder: Path) -> None:
    """Images of a chessboard by two cameras."""
    pair, board = rig(), ChessBoard(9, 6, 0.02)
    for number, pose in enumerate(varied_poses(N_BOARDS, seed=3, board=board)):
        for side, camera, motion in (
            ("left", pair.left, np.eye(4)),
            ("right", pair.right, pair.right_from_left),
        ):
            image = drawn(camera, motion @ pose, board=board, seed=number)
            cv2.imwrite(str(folder / f"{side}{number}.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 97])


def _network(folder: Path) -> None:
    """A network with YOLOv5's outputs that finds one car in every image."""
    rows = np.zeros((1, 252, 6))
    rows[0, 0] = [32, 34, 9, 6, 0.9, 0.9]
    write_model(folder / "yolov5n.onnx", rows, metadata={"names": "['car']"})
