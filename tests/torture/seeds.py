"""Valid inputs of every kind, most of them written by track-range, and a cheap command that reads
each."""

from __future__ import annotations

import copy
import json
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import yaml

from tests.detection.formats import tool_files
from tests.torture.mutations import BYTES, JSON, NPY, ONNX, PNG, TABLE, TEXT, YAML, Mutation
from tests.torture.processes import succeed
from track_range.ranging import size_models
from track_range.stereo.alignment.file import save_alignment
from track_range.stereo.geometry.alignment import Alignment

WIDTH_PX, HEIGHT_PX = 320, 96  # small, so that a run takes a fraction of a second
FOCAL_PX = 186.0  # the angle of view is KITTI's
FRAMES, FPS = 5, 10


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of input: files of the seeds' folder, of which one is damaged in each case, and a
    command that reads them.

    `has_paths`: the files contain paths of other files, which a message may name instead.
    """

    name: str
    files: tuple[str, ...]
    mutations: tuple[Mutation, ...]
    command: tuple[str, ...]
    has_paths: bool = False


CHEAP = "--no-overlay --lanes off --out out"
BOXES = "--detections drive/detections.txt"
VIDEO = f"--mono drive/left.mp4 --focal-px {FOCAL_PX}"
MONO = f"{VIDEO} {BOXES} {CHEAP}"
PAIR = f"--stereo drive/left.mp4 drive/right.mp4 --no-sgbm {CHEAP} {BOXES}"
STEREO = f"{PAIR} --rig drive/rig.yaml --align off"
SIZE = f"--size {WIDTH_PX}x{HEIGHT_PX}"
ANCHORS = "anchors --data images/data.yaml --clusters 2 --size 64"
EVALUATION = (
    "evaluate detections --model net/net.onnx --images images/images --labels images/labels"
)
TRACK = "track mot/MOT-01/det/det.txt --out out"
IMPORT = "models import darknet/net.cfg darknet/net.weights --names car,bus --out out.onnx"
MOT = "evaluate tracks --truth mot --results tracks"

NAMES_PATHS = ("settings.yaml", "data.yaml", "manifest", "ONNX", "ONNX of a run", "--reid")
KINDS = tuple(
    Kind(
        name, tuple(files.split()), mutations, tuple(command.split()), has_paths=name in NAMES_PATHS
    )
    for name, files, mutations, command in (
        ("rig.yaml", "drive/rig.yaml", YAML, "rig show drive/rig.yaml"),
        ("rig.yaml of a run", "drive/rig.yaml", YAML, STEREO),
        ("KITTI calib.txt", "calib.txt", TEXT, f"rig show calib.txt {SIZE}"),
        ("OpenCV yml", "opencv.yml", YAML, f"rig show opencv.yml {SIZE}"),
        ("Kalibr", "camchain.yaml", YAML, "rig show camchain.yaml"),
        ("align.yaml", "align.yaml", YAML, f"{PAIR} --rig drive/rig.yaml --align align.yaml"),
        ("model.yaml", "net/net.yaml", YAML, "models info net/net.onnx"),
        ("curves.json", "curves.json", JSON, f"{MONO} --curves curves.json"),
        ("settings.yaml", "run/settings.yaml", YAML, "--settings run/settings.yaml --out out"),
        ("data.yaml", "images/data.yaml", YAML, ANCHORS),
        ("YOLO labels", "images/labels/001000_00.txt images/ignored/001000_00.txt", TABLE, ANCHORS),
        (
            "classes.txt",
            "net/classes.txt",
            TEXT,
            "models info net/net.onnx --names net/classes.txt",
        ),
        ("manifest", "images/manifest.csv", TABLE, f"{EVALUATION} --manifest images/manifest.csv"),
        ("truth.csv", "drive/truth.csv", TABLE, f"{MONO} --truth drive/truth.csv"),
        ("KITTI truth", "drive/truth.txt", TABLE, f"{MONO} --truth drive/truth.txt"),
        (
            "KITTI labels",
            "labels/0000.txt",
            TABLE,
            "evaluate tracks --truth labels/0000.txt --results run/mot.txt",
        ),
        (
            "KITTI folders",
            "labels/0000.txt calib/0000.txt",
            TABLE,
            "evaluate ranges --labels labels --calib calib",
        ),
        ("ego speed", "drive/ego_speed.csv", TABLE, f"{MONO} --ego-speed drive/ego_speed.csv"),
        ("oxts", "oxts/0000000001.txt oxts/timestamps.txt", TABLE, f"{MONO} --ego-speed oxts"),
        ("KITTI detections", "drive/detections.txt", TABLE, MONO),
        (
            "tracks.csv as detections",
            "run/tracks.csv",
            TABLE,
            f"{VIDEO} --detections run/tracks.csv {CHEAP}",
        ),
        ("rrc", "rrc.txt", TABLE, "track rrc.txt --out out"),
        ("det.txt", "mot/MOT-01/det/det.txt", TABLE, TRACK),
        *(
            (
                name,
                f"tools/{name.replace(' ', '_')}",
                JSON if isinstance(content, list | dict) else TEXT,
                f"track tools/{name.replace(' ', '_')} --out out",
            )
            for name, content in tool_files.FILES.items()
        ),
        ("feat.npy", "mot/MOT-01/det/feat.npy", NPY, TRACK),
        ("MOT folder", "mot/MOT-01/seqinfo.ini mot/MOT-01/gt/gt.txt", TABLE, MOT),
        (
            "run folder",
            "run/tracks.csv run/summary.json run/settings.yaml",
            (*TABLE, *JSON[-3:]),
            "report run",
        ),
        ("Darknet", "darknet/net.cfg darknet/net.cfg darknet/net.weights", TEXT, IMPORT),
        ("ONNX", "net/net.onnx", ONNX, "models info net/net.onnx"),
        ("ONNX of a run", "net/net.onnx", ONNX, f"{VIDEO} --detector net/net.onnx {CHEAP}"),
        ("--reid", "net/reid.onnx", ONNX, f"{MONO} --reid net/reid.onnx"),
        ("mp4", "drive/left.mp4 drive/right.mp4", BYTES, STEREO),
        (
            "avi",
            "videos/left.avi",
            BYTES,
            f"--mono videos/left.avi --focal-px {FOCAL_PX} {BOXES} {CHEAP}",
        ),
        (
            "mkv",
            "videos/left.mkv",
            BYTES,
            f"--mono videos/left.mkv --focal-px {FOCAL_PX} {BOXES} {CHEAP}",
        ),
        (
            "png folder",
            "png/000000.png png/000002.png",
            PNG,
            f"--mono png --focal-px {FOCAL_PX} {BOXES} {CHEAP}",
        ),
        (
            "jpg folder",
            "jpg/000000.jpg jpg/000002.jpg",
            PNG,
            f"--mono jpg --focal-px {FOCAL_PX} {BOXES} {CHEAP}",
        ),
        (
            "timestamps.txt",
            "timed/timestamps.txt",
            TABLE,
            f"--mono timed --focal-px {FOCAL_PX} {BOXES} {CHEAP}",
        ),
        (
            "box CSV",
            "boxes.csv",
            TABLE,
            f"fit --csv boxes.csv --focal-px {FOCAL_PX} --out fitted.json",
        ),
    )
)
"""All kinds of inputs."""


def _write_rig(folder: Path) -> None:
    camera = {"fx_px": FOCAL_PX, "fy_px": FOCAL_PX, "cx_px": WIDTH_PX / 2, "cy_px": 44.0}
    camera |= {"width_px": WIDTH_PX, "height_px": HEIGHT_PX}
    pose = {"rotation": np.eye(3).tolist(), "translation_m": [-0.54, 0.0, 0.0]}
    content = {"track_range_rig": 1, "left": camera, "right": dict(camera), "right_from_left": pose}
    (folder / "rig.yaml").write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def simulate(
    folder: Path, *, n_frames: int, scenario: str = "highway", options: Sequence[str] = ()
) -> Path:
    """Simulate a small drive; returns its folder, with left.mp4, right.mp4, rig.yaml,
    detections.txt and truth.csv."""
    folder.mkdir(parents=True)
    _write_rig(folder)
    seconds = str(n_frames / FPS)
    command = (
        "simulate",
        "--scenario",
        scenario,
        "--seconds",
        seconds,
        "--rig",
        "rig.yaml",
        "--out",
        ".",
        *options,
    )
    succeed(command, folder)
    return folder


def write_seeds(folder: Path) -> None:
    """Write the valid files of all kinds into a new folder."""
    drive = simulate(folder / "drive", n_frames=FRAMES)
    _write_calibrations(folder)
    _write_networks(folder)
    succeed([*MONO.split()[:-1], "run", "--truth", "drive/truth.csv"], folder)
    succeed(("simulate", "--images", "2", "--frames", "1", "--out", "images"), folder)
    (folder / "images/manifest.csv").write_text(
        "file,split,labels_complete\n001000_00.jpg,val,11111111\n001001_00.jpg,train,11110000\n",
        encoding="utf-8",
    )
    images = read_images(drive / "left.mp4")
    for name, suffix in (("png", "png"), ("jpg", "jpg"), ("timed", "png")):
        (folder / name).mkdir()
        for number, image in enumerate(images):
            cv2.imwrite(str(folder / name / f"{number:06d}.{suffix}"), image)
    times = [f"2011-09-26 13:10:{number / FPS:012.9f}\n" for number in range(len(images))]
    (folder / "timed/timestamps.txt").write_text("".join(times), encoding="utf-8")
    (folder / "videos").mkdir()
    for suffix in ("avi", "mkv"):
        write_video(folder / f"videos/left.{suffix}", images, codec="mpeg4")
    _write_tables(folder, times)
    (folder / "tools").mkdir()
    for name, content in tool_files.FILES.items():
        text = content if isinstance(content, str) else json.dumps(content)
        (folder / "tools" / name.replace(" ", "_")).write_text(text, encoding="utf-8")


def write_video(path: Path, images: Iterable[np.ndarray], *, codec: str = "libx264") -> None:
    """Write (H, W, 3) uint8 BGR images as a video."""
    with av.open(str(path), "w") as writer:
        stream: Any = writer.add_stream(codec, rate=FPS)
        stream.width, stream.height, stream.pix_fmt = WIDTH_PX, HEIGHT_PX, "yuv420p"
        for image in images:
            writer.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        writer.mux(stream.encode())


def read_images(video: Path) -> list[np.ndarray]:
    with av.open(str(video)) as reader:
        return [frame.to_ndarray(format="bgr24") for frame in reader.decode(video=0)]


def _write_calibrations(folder: Path) -> None:
    """Write the rig in the formats of KITTI, OpenCV and Kalibr, and an alignment."""
    succeed(("rig", "convert", "drive/rig.yaml", "opencv.yml", "--to", "opencv"), folder)
    left = f"{FOCAL_PX} 0 {WIDTH_PX / 2} 0 0 {FOCAL_PX} 44 0 0 0 1 0"
    right = f"{FOCAL_PX} 0 {WIDTH_PX / 2} {-0.54 * FOCAL_PX} 0 {FOCAL_PX} 44 0 0 0 1 0"
    rows = [f"P{i}: {right if i in (1, 3) else left}" for i in range(4)]
    rows += ["R0_rect: 1 0 0 0 1 0 0 0 1", "Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0"]
    (folder / "calib").mkdir()
    for name in ("calib.txt", "calib/0000.txt"):
        (folder / name).write_text("\n".join(rows) + "\n", encoding="utf-8")
    pose = np.eye(4)
    pose[0, 3] = -0.54
    camera = {
        "camera_model": "pinhole",
        "intrinsics": [FOCAL_PX, FOCAL_PX, WIDTH_PX / 2, 44.0],
        "distortion_model": "radtan",
        "distortion_coeffs": [-0.01, 0.001, 0.0, 0.0],
        "resolution": [WIDTH_PX, HEIGHT_PX],
    }
    chain = {"cam0": camera, "cam1": copy.deepcopy(camera) | {"T_cn_cnm1": pose.tolist()}}
    (folder / "camchain.yaml").write_text(yaml.safe_dump(chain), encoding="utf-8")
    save_alignment(
        Alignment(offset_px=0.4, offset_sigma_px=0.1, residual_px=0.2), folder / "align.yaml"
    )
    shutil.copy(Path(size_models.__path__[0]) / "curves/cuboids.json", folder / "curves.json")


def _write_networks(folder: Path) -> None:
    """Write an ONNX detector of two classes with a sidecar, a re-identification network, and a
    Darknet network."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    (folder / "net").mkdir()
    (folder / "darknet").mkdir()

    def save(name: str, side_px: tuple[int, int], output: np.ndarray) -> None:
        """A network with a constant output."""
        images = helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, 3, *side_px))
        result = helper.make_tensor_value_info("output0", TensorProto.FLOAT, output.shape)
        nodes = [
            helper.make_node("ReduceMean", ["images"], ["mean"], keepdims=0),
            helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
            helper.make_node("Add", ["rows", "nothing"], ["output0"]),
        ]
        constants = {"zero": np.zeros(1, np.float32), "rows": output.astype(np.float32)}
        weights = [numpy_helper.from_array(values, name) for name, values in constants.items()]
        graph = helper.make_graph(nodes, "constant", [images], [result], weights)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)])
        model.ir_version = 9
        onnx.save(model, folder / "net" / name)

    rows = np.zeros((1, 252, 7))
    rows[0, :3] = [
        [20, 30, 12, 10, 0.9, 0.9, 0.1],
        [40, 32, 10, 8, 0.8, 0.1, 0.9],
        [5, 5, 3, 3, 0.3, 0.5, 0.5],
    ]
    save("net.onnx", (64, 64), rows)
    save("reid.onnx", (128, 64), np.linspace(-1, 1, 32).reshape(1, 32))
    (folder / "net/classes.txt").write_text("car\nbus\n", encoding="utf-8")
    (folder / "net/net.yaml").write_text(
        "names: {0: car, 1: bus}\nletterbox: centred-114\nfamily: test\n", encoding="utf-8"
    )
    (folder / "darknet/net.cfg").write_text(_DARKNET, encoding="utf-8")
    n_weights = 3 * 8 * 9 + 4 * 8 + 2 * (8 * 21 + 21)
    weights = np.random.default_rng(0).uniform(0.1, 1, n_weights).astype("<f4").tobytes()
    (folder / "darknet/net.weights").write_bytes(
        np.array([0, 2, 5, 0, 0], "<i4").tobytes() + weights
    )


_HEAD = """
[convolutional]
filters=21
size=1
stride=1
pad=1
activation=linear
[yolo]
mask={mask}
anchors=10,14, 23,27, 37,58, 81,82, 135,169, 344,319
classes=2
num=6
"""
_DARKNET = f"""\
[net]
width=64
height=64
channels=3
[convolutional]
batch_normalize=1
filters=8
size=3
stride=16
pad=1
activation=leaky
[maxpool]
size=2
stride=2
{_HEAD.format(mask="3,4,5")}
[route]
layers=-4
{_HEAD.format(mask="0,1,2")}"""
"""A Darknet network with two heads."""


def _write_tables(folder: Path, times: Sequence[str]) -> None:
    """Write boxes of the drive in the formats of KITTI, MOTChallenge and RRC, and KITTI's oxts."""
    (folder / "labels").mkdir()
    shutil.copy(folder / "drive/truth.txt", folder / "labels/0000.txt")
    shutil.copytree(folder / "run", folder / "tracks")
    shutil.copy(folder / "run/mot.txt", folder / "tracks/MOT-01.txt")
    sequence = folder / "mot/MOT-01"
    for name in ("det", "gt"):
        (sequence / name).mkdir(parents=True)
    rows = np.loadtxt(folder / "run/mot.txt", delimiter=",", ndmin=2)
    rows[:, 6] = 0.9
    truth = rows[:, :9].copy()
    truth[:, 6:] = 1
    np.savetxt(sequence / "gt/gt.txt", truth, fmt="%g", delimiter=",")
    rows[:, 1] = -1
    np.savetxt(sequence / "det/det.txt", rows, fmt="%.2f", delimiter=",")
    embeddings = np.random.default_rng(0).normal(size=(len(rows), 16))
    stored = np.loadtxt(sequence / "det/det.txt", delimiter=",", ndmin=2)
    np.save(sequence / "det/feat.npy", np.hstack([stored, embeddings]))
    (sequence / "seqinfo.ini").write_text(
        f"[Sequence]\nname=MOT-01\nframeRate={FPS}\nseqLength={FRAMES}\nimWidth={WIDTH_PX}\nimHeight={HEIGHT_PX}\n",
        encoding="utf-8",
    )
    left_top, size = rows[:, 2:4], rows[:, 4:6]
    plain = np.column_stack([rows[:, 0] - 1, left_top, left_top + size, rows[:, 6]])
    np.savetxt(folder / "rrc.txt", plain, fmt="%.2f", delimiter=",")
    truth_rows = [line.split(",") for line in (folder / "drive/truth.csv").read_text().splitlines()]
    header, *boxes = truth_rows
    columns = [header.index(name) for name in ("class", "x1", "y1", "x2", "y2", "distance_m")]
    lines = [",".join(row[column] for column in columns) for row in (header, *boxes * 12)]
    (folder / "boxes.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "oxts").mkdir()
    for number in range(len(times)):
        values = ["49.0", "8.4", "112", "0", "0", "0", "0", "0", "12.5", *["0.1"] * 21]
        (folder / f"oxts/{number:010d}.txt").write_text(" ".join(values) + "\n", encoding="utf-8")
    (folder / "oxts/timestamps.txt").write_text("".join(times), encoding="utf-8")
