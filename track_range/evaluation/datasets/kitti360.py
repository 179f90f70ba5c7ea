"""KITTI-360: the root folder, with data_3d_bboxes, data_poses and calibration, and, if it is there,
data_2d_raw. Frames are those that have a pose; cuboids are those of road users within 100 m.
"""

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from track_range.evaluation.datasets.drive import DatasetError, LabelledDrive
from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import MAX_TABLE_BYTES, open_regular, read_text
from track_range.foundation.files.xml_events import parse_xml
from track_range.stereo.geometry.camera import PinholeCamera

_STEP_S = 0.1037  # mean interval of its frames
_EXPECTED = "cuboids of KITTI-360"
_KINDS = ("car", "truck", "bus", "trailer", "caravan", "person", "rider", "bicycle", "motorcycle")
_FAR_M = 100.0


def read(folder: Path, camera_name: str) -> Iterator[LabelledDrive]:
    """The drive of each file of cuboids; DatasetError if a file is missing or damaged."""
    place = folder / "calibration/perspective.txt"
    text = read_text(place, DatasetError, "KITTI-360's calibration")
    lens = dict(line.split(":", 1) for line in text.splitlines() if ":" in line)
    P = _numbers(lens.get(f"P_rect_{camera_name[-2:]}", ""), 4, place)
    fx, fy, cx, cy = P[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
    width_px, height_px = _numbers(lens.get(f"S_rect_{camera_name[-2:]}", ""), 2, place)[0].tolist()
    for file in sorted((folder / "data_3d_bboxes").rglob("*.xml")):
        place = folder / "data_poses" / file.stem / "cam0_to_world.txt"
        poses = _numbers(
            read_text(place, DatasetError, "poses", max_bytes=MAX_TABLE_BYTES), 17, place
        )
        number, pose = poses[:, 0], poses[:, 1:].reshape(-1, 4, 4)
        pose[:, :3, 3] -= pose[:, :3, :3] @ np.linalg.solve(P[:, :3], P[:, 3])  # of this camera
        cuboids = [one for node in _nodes(file) for one in _cuboids(node, number, pose, file)]
        frame, track, kind, cuboid, lwh_m = map(list, zip(*cuboids, strict=True))
        images = folder / "data_2d_raw" / file.stem / camera_name / "data_rect"
        named = (images / f"{int(n):010d}.png" for n in number)
        yield LabelledDrive(
            name=file.stem,
            camera=PinholeCamera(fx, fy, cx, cy, int(width_px), int(height_px)),
            time_s=number * _STEP_S,
            pose=pose,
            images=[image for image in named if image.is_file()],
            track=np.array(track),
            kind=kind,
            frame=np.array(frame),
            cuboid_s=number[frame] * _STEP_S,
            cuboid=np.array(cuboid),
            lwh_m=np.array(lwh_m),
            n_points=np.full(len(frame), np.nan),
        )


def _numbers(text: str, n_columns: int, path: Path) -> FloatArray:
    """(N, n_columns) numbers of a text; at least one row."""
    try:
        rows = np.array(text.split(), np.float64).reshape(-1, n_columns)
        return rows[np.arange(max(len(rows), 1))]
    except (ValueError, IndexError) as error:
        raise DatasetError(
            f"{path}: expected rows of {n_columns} numbers, found others."
        ) from error


def _nodes(path: Path) -> list[ElementTree.Element]:
    """The elements of cuboids of road users in a file."""
    with open_regular(path, DatasetError, _EXPECTED) as file:
        parse_xml(file, path, None, DatasetError, _EXPECTED)
    root = ElementTree.parse(path).getroot()  # noqa: S314  # without entities, as checked above
    return [node for node in root if node.findtext("label") in _KINDS]


def _cuboids(
    node: ElementTree.Element, number: FloatArray, camera: FloatArray, path: Path
) -> Iterator[tuple[int, str, str, FloatArray, FloatArray]]:
    """Frame, identity, class, pose (4, 4) and size (3,) of a cuboid: a moving one in its frame, a
    static one in all near frames of its part of the drive; `number` (F,) are those of the frames,
    and `camera` (F, 4, 4) the poses.
    """
    transform = _numbers(node.findtext("transform/data", ""), 4, path)
    vertices = _numbers(node.findtext("vertices/data", ""), 3, path)
    scale = np.linalg.norm(transform[:3, :3], axis=0)
    pose = np.eye(4)
    pose[:3, :3] = transform[:3, :3] / scale
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    pose[:3, 3] = transform[:3, :3] @ middle + transform[:3, 3]
    keys = ("timestamp", "start_frame", "end_frame", "semanticId", "instanceId")
    time, first, last, *identity = (int(node.findtext(key, "-1")) for key in keys)
    is_shown = number == time if time >= 0 else (number >= first) & (number <= last)
    is_near = np.linalg.norm(camera[:, :3, 3] - pose[:3, 3], axis=1) < _FAR_M
    for frame in np.flatnonzero(is_shown & is_near).tolist():
        yield (
            frame,
            str(identity),
            node.findtext("label", ""),
            pose,
            np.ptp(vertices, axis=0) * scale,
        )
