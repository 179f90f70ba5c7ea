"""Valid inputs of every kind, most of them written by track-range, and a cheap command that reads each."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import yaml

from benchmarks.torture import mutations
from benchmarks.torture.cases import End
from benchmarks.torture.mutations import Mutation
from benchmarks.torture.processes import start
from track_range.ranging import size_models
from track_range.stereo.alignment.file import save_alignment
from track_range.stereo.alignment.model import Alignment

WIDTH_PX, HEIGHT_PX = 320, 96
"""Size of the images: small, so that a run takes a fraction of a second."""

FOCAL_PX = 186.0
"""Focal length in pixels; the angle of view is KITTI's."""

FRAMES = 5
"""Number of frames of the small drive."""

FPS = 10
"""Frame rate of all drives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """A kind of input.

    Attributes:
        name: name for tables.
        files: the files that are damaged, one in each case, from the folder of the seeds.
        mutations: what is done to their content.
        command: arguments of track-range that read the file, run in the folder of the seeds.
        has_paths: whether the files contain paths of other files, which a message may name instead.
    """

    name: str
    files: tuple[str, ...]
    mutations: tuple[Mutation, ...]
    command: tuple[str, ...]
    has_paths: bool = False


_CHEAP = ("--no-overlay", "--lanes", "off", "--out", "out")
_BOXES = ("--detections", "drive/detections.txt")
_VIDEO = ("--mono", "drive/left.mp4", "--focal-px", str(FOCAL_PX))
_MONO = (*_VIDEO, *_BOXES, *_CHEAP)
_PAIR = ("--stereo", "drive/left.mp4", "drive/right.mp4", "--no-sgbm", *_CHEAP)
_STEREO = (*_PAIR, "--rig", "drive/rig.yaml", *_BOXES, "--align", "off")
_SIZE = ("--size", f"{WIDTH_PX}x{HEIGHT_PX}")
_EVALUATION = ("evaluate", "detections", "--model", "net/net.onnx", "--images", "images/images", "--labels")
_BINARY = mutations.BYTES
_ONNX = (*_BINARY, *[mutations.change_onnx] * 12)
_NPY = (*_BINARY, *[mutations.change_npy_header] * 6)
_PNG = (*_BINARY, *[mutations.change_png_size] * 4)

KINDS = (
    Kind(
        name="rig.yaml", files=("drive/rig.yaml",), mutations=mutations.YAML, command=("rig", "show", "drive/rig.yaml")
    ),
    Kind(name="rig.yaml of a run", files=("drive/rig.yaml",), mutations=mutations.YAML, command=_STEREO),
    Kind(
        name="KITTI calib.txt",
        files=("calib.txt",),
        mutations=mutations.TEXT,
        command=("rig", "show", "calib.txt", *_SIZE),
    ),
    Kind(
        name="OpenCV yml",
        files=("opencv.yml",),
        mutations=mutations.YAML,
        command=("rig", "show", "opencv.yml", *_SIZE),
    ),
    Kind(name="Kalibr", files=("camchain.yaml",), mutations=mutations.YAML, command=("rig", "show", "camchain.yaml")),
    Kind(
        name="align.yaml",
        files=("align.yaml",),
        mutations=mutations.YAML,
        command=(*_PAIR, "--rig", "drive/rig.yaml", *_BOXES, "--align", "align.yaml"),
    ),
    Kind(
        name="model.yaml", files=("net/net.yaml",), mutations=mutations.YAML, command=("models", "info", "net/net.onnx")
    ),
    Kind(
        name="curves.json",
        files=("curves.json",),
        mutations=mutations.JSON,
        command=(*_MONO, "--curves", "curves.json"),
    ),
    Kind(
        name="settings.yaml",
        has_paths=True,
        files=("run/settings.yaml",),
        mutations=mutations.YAML,
        command=("--settings", "run/settings.yaml", "--out", "out"),
    ),
    Kind(
        name="data.yaml",
        has_paths=True,
        files=("images/data.yaml",),
        mutations=mutations.YAML,
        command=("anchors", "--data", "images/data.yaml", "--clusters", "2", "--size", "64"),
    ),
    Kind(
        name="YOLO labels",
        files=("images/labels/001000_00.txt", "images/ignored/001000_00.txt"),
        mutations=mutations.TABLE,
        command=("anchors", "--data", "images/data.yaml", "--clusters", "2", "--size", "64"),
    ),
    Kind(
        name="classes.txt",
        files=("net/classes.txt",),
        mutations=mutations.TEXT,
        command=("models", "info", "net/net.onnx", "--names", "net/classes.txt"),
    ),
    Kind(
        name="manifest",
        has_paths=True,
        files=("images/manifest.csv",),
        mutations=mutations.TABLE,
        command=(*_EVALUATION, "images/labels", "--manifest", "images/manifest.csv"),
    ),
    Kind(
        name="truth.csv",
        files=("drive/truth.csv",),
        mutations=mutations.TABLE,
        command=(*_MONO, "--truth", "drive/truth.csv"),
    ),
    Kind(
        name="KITTI truth",
        files=("drive/truth.txt",),
        mutations=mutations.TABLE,
        command=(*_MONO, "--truth", "drive/truth.txt"),
    ),
    Kind(
        name="KITTI labels",
        files=("labels/0000.txt",),
        mutations=mutations.TABLE,
        command=("evaluate", "tracks", "--truth", "labels/0000.txt", "--results", "run/mot.txt"),
    ),
    Kind(
        name="KITTI folders",
        files=("labels/0000.txt", "calib/0000.txt"),
        mutations=mutations.TABLE,
        command=("evaluate", "ranges", "--labels", "labels", "--calib", "calib"),
    ),
    Kind(
        name="ego speed",
        files=("drive/ego_speed.csv",),
        mutations=mutations.TABLE,
        command=(*_MONO, "--ego-speed", "drive/ego_speed.csv"),
    ),
    Kind(
        name="oxts",
        files=("oxts/0000000001.txt", "oxts/timestamps.txt"),
        mutations=mutations.TABLE,
        command=(*_MONO, "--ego-speed", "oxts"),
    ),
    Kind(name="KITTI detections", files=("drive/detections.txt",), mutations=mutations.TABLE, command=_MONO),
    Kind(
        name="tracks.csv as detections",
        files=("run/tracks.csv",),
        mutations=mutations.TABLE,
        command=(*_VIDEO, "--detections", "run/tracks.csv", *_CHEAP),
    ),
    Kind(name="rrc", files=("rrc.txt",), mutations=mutations.TABLE, command=("track", "rrc.txt", "--out", "out")),
    Kind(
        name="det.txt",
        files=("mot/MOT-01/det/det.txt",),
        mutations=mutations.TABLE,
        command=("track", "mot/MOT-01/det/det.txt", "--out", "out"),
    ),
    Kind(
        name="feat.npy",
        files=("mot/MOT-01/det/feat.npy",),
        mutations=_NPY,
        command=("track", "mot/MOT-01/det/det.txt", "--out", "out"),
    ),
    Kind(
        name="MOT folder",
        files=("mot/MOT-01/seqinfo.ini", "mot/MOT-01/gt/gt.txt"),
        mutations=mutations.TABLE,
        command=("evaluate", "tracks", "--truth", "mot", "--results", "tracks"),
    ),
    Kind(
        name="run folder",
        files=("run/tracks.csv", "run/summary.json", "run/settings.yaml"),
        mutations=(*mutations.TABLE, *mutations.JSON[-3:]),
        command=("report", "run"),
    ),
    Kind(
        name="Darknet",
        files=("darknet/net.cfg", "darknet/net.cfg", "darknet/net.weights"),
        mutations=mutations.TEXT,
        command=(
            "models",
            "import",
            "darknet/net.cfg",
            "darknet/net.weights",
            "--names",
            "car,bus",
            "--out",
            "out.onnx",
        ),
    ),
    Kind(
        name="ONNX",
        has_paths=True,
        files=("net/net.onnx",),
        mutations=_ONNX,
        command=("models", "info", "net/net.onnx"),
    ),
    Kind(
        name="ONNX of a run",
        has_paths=True,
        files=("net/net.onnx",),
        mutations=_ONNX,
        command=(*_VIDEO, "--detector", "net/net.onnx", *_CHEAP),
    ),
    Kind(
        name="--reid",
        has_paths=True,
        files=("net/reid.onnx",),
        mutations=_ONNX,
        command=(*_MONO, "--reid", "net/reid.onnx"),
    ),
    Kind(name="mp4", files=("drive/left.mp4", "drive/right.mp4"), mutations=_BINARY, command=_STEREO),
    *(
        Kind(
            name=suffix,
            files=(f"videos/left.{suffix}",),
            mutations=_BINARY,
            command=("--mono", f"videos/left.{suffix}", "--focal-px", str(FOCAL_PX), *_BOXES, *_CHEAP),
        )
        for suffix in ("avi", "mkv")
    ),
    *(
        Kind(
            name=f"{suffix} folder",
            files=(f"{suffix}/000000.{suffix}", f"{suffix}/000002.{suffix}"),
            mutations=_PNG,
            command=("--mono", suffix, "--focal-px", str(FOCAL_PX), *_BOXES, *_CHEAP),
        )
        for suffix in ("png", "jpg")
    ),
    Kind(
        name="timestamps.txt",
        files=("timed/timestamps.txt",),
        mutations=mutations.TABLE,
        command=("--mono", "timed", "--focal-px", str(FOCAL_PX), *_BOXES, *_CHEAP),
    ),
    Kind(
        name="box CSV",
        files=("boxes.csv",),
        mutations=mutations.TABLE,
        command=("fit", "--csv", "boxes.csv", "--focal-px", str(FOCAL_PX), "--out", "fitted.json"),
    ),
)
"""All kinds of inputs."""


def write_rig(folder: Path) -> None:
    """Write `rig.yaml`, the rig of all drives here."""
    camera = {"fx_px": FOCAL_PX, "fy_px": FOCAL_PX, "cx_px": WIDTH_PX / 2, "cy_px": 44.0}
    camera |= {"width_px": WIDTH_PX, "height_px": HEIGHT_PX}
    pose = {"rotation": np.eye(3).tolist(), "translation_m": [-0.54, 0.0, 0.0]}
    content = {"track_range_rig": 1, "left": camera, "right": dict(camera), "right_from_left": pose}
    (folder / "rig.yaml").write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def simulate(folder: Path, *, n_frames: int, scenario: str = "highway", options: Sequence[str] = ()) -> Path:
    """Simulate a small drive; returns its folder, with left.mp4, right.mp4, rig.yaml, detections.txt and truth.csv."""
    folder.mkdir(parents=True)
    write_rig(folder)
    seconds = str(n_frames / FPS)
    command = ("simulate", "--scenario", scenario, "--seconds", seconds, "--rig", "rig.yaml", "--out", ".", *options)
    succeed(command, folder)
    return folder


def succeed(command: Sequence[str], folder: Path) -> End:
    """Run a command that must succeed.

    Raises:
        RuntimeError: it fails.
    """
    end = start(command, folder, time_limit_s=300).wait()
    if end.status:
        raise RuntimeError(f"track-range {' '.join(command)} failed: {end.stderr[-1000:]}")
    return end


def write_seeds(folder: Path) -> None:
    """Write the valid files of all kinds into a new folder."""
    drive = simulate(folder / "drive", n_frames=FRAMES)
    _write_calibrations(folder)
    _write_networks(folder)
    succeed((*_MONO[:-1], "run", "--truth", "drive/truth.csv"), folder)
    succeed(("simulate", "--images", "2", "--frames", "1", "--out", "images"), folder)
    (folder / "images/manifest.csv").write_text(
        "file,split,labels_complete\n001000_00.jpg,val,11111111\n001001_00.jpg,train,11110000\n", encoding="utf-8"
    )
    images = _images(drive / "left.mp4")
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


def write_video(path: Path, images: Sequence[np.ndarray], *, codec: str = "libx264") -> None:
    """Write (H, W, 3) uint8 BGR images as a video."""
    with av.open(str(path), "w") as writer:
        stream: Any = writer.add_stream(codec, rate=FPS)
        stream.width, stream.height, stream.pix_fmt = images[0].shape[1], images[0].shape[0], "yuv420p"
        for image in images:
            writer.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        writer.mux(stream.encode())


def _images(video: Path) -> list[np.ndarray]:
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
    chain = {"cam0": _kalibr_camera(), "cam1": _kalibr_camera() | {"T_cn_cnm1": pose.tolist()}}
    (folder / "camchain.yaml").write_text(yaml.safe_dump(chain), encoding="utf-8")
    save_alignment(Alignment(offset_px=0.4, offset_sigma_px=0.1, residual_px=0.2), folder / "align.yaml")
    shutil.copy(Path(size_models.__path__[0]).parent / "curves/cuboids.json", folder / "curves.json")


def _kalibr_camera() -> dict[str, object]:
    return {
        "camera_model": "pinhole",
        "intrinsics": [FOCAL_PX, FOCAL_PX, WIDTH_PX / 2, 44.0],
        "distortion_model": "radtan",
        "distortion_coeffs": [-0.01, 0.001, 0.0, 0.0],
        "resolution": [WIDTH_PX, HEIGHT_PX],
    }


def _write_networks(folder: Path) -> None:
    """Write an ONNX detector of two classes with a sidecar, a re-identification network, and a Darknet network."""
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
        weights = [
            numpy_helper.from_array(np.zeros(1, np.float32), "zero"),
            numpy_helper.from_array(output.astype(np.float32), "rows"),
        ]
        graph = helper.make_graph(nodes, "constant", [images], [result], weights)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)])
        model.ir_version = 9
        onnx.save(model, folder / "net" / name)

    rows = np.zeros((1, 252, 7))
    rows[0, :3] = [[20, 30, 12, 10, 0.9, 0.9, 0.1], [40, 32, 10, 8, 0.8, 0.1, 0.9], [5, 5, 3, 3, 0.3, 0.5, 0.5]]
    save("net.onnx", (64, 64), rows)
    save("reid.onnx", (128, 64), np.linspace(-1, 1, 32).reshape(1, 32))
    (folder / "net/classes.txt").write_text("car\nbus\n", encoding="utf-8")
    (folder / "net/net.yaml").write_text(
        "names: {0: car, 1: bus}\nletterbox: centred-114\nfamily: test\n", encoding="utf-8"
    )
    (folder / "darknet/net.cfg").write_text(_DARKNET, encoding="utf-8")
    n_weights = 3 * 8 * 9 + 4 * 8 + 2 * (8 * 21 + 21)
    weights = np.random.default_rng(0).uniform(0.1, 1, n_weights).astype("<f4").tobytes()
    (folder / "darknet/net.weights").write_bytes(np.array([0, 2, 5, 0, 0], "<i4").tobytes() + weights)


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
"""A head of a Darknet network."""

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
