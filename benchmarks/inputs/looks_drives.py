"""Drives with pictures, identities and occlusions: the simulated street before a shaking camera, and two of KITTI's.

The simulation's camera neither turns nor shakes. Turning about its own centre moves its picture by a homography,

    pixel' = K R K^-1 pixel        R = pitch after yaw

so the street is drawn wider than needed, by a straight camera, and each frame is cut out of it; the boxes are those of
the turned 3-D boxes. Who is occluded on purpose is not detected: the picture stays as it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from track_range.detection.classes import ROAD_CLASS_OF, ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.formats.kitti import KittiLabels, read_kitti
from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.simulation.camera.playback import HIDDEN, play_back
from track_range.simulation.render.renderer import Renderer
from track_range.simulation.world.scene import (
    AWAY_RAD,
    SIZE_HWL_M,
    SIZE_SPREAD,
    TOWARDS_RAD,
    RoadUser,
    Scene,
    make_scene,
)
from track_range.simulation.world.truth import box_corners_m, label_scene, projected_boxes_px
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.video.reader import VideoReader

FPS = 10.0
CAMERA = PinholeCamera(721.5, 721.5, 500.0, 160.0, 1000, 320)
"""KITTI's focal length, and most of its picture."""

PITCH_RMS_RAD, PITCH_HZ = np.radians(0.45), (0.8, 3.5)
"""Of bumps: six sines of these frequencies."""

YAW_RATE_RAD, YAW_PERIOD_S = np.radians((9.0, 15.0)), (4.0, 5.0)
"""Greatest rate of a drive's turns, and how long one to and fro takes."""

MIN_SHARE_INSIDE = 0.25
"""Road users of which less lies in the picture do not count."""

STROLL_MPS = 3.0
PAVEMENT_M, LANE_M, N_LANES = 7.9, 0.55, 5


@dataclass(frozen=True, slots=True)
class Hiding:
    """How long, in seconds (from, to), a road user is seen and then hidden, in turns."""

    seen_s: tuple[float, float] = (0.8, 2.5)
    hidden_s: tuple[float, float] = (0.5, 2.0)
    seen_after_s: float = 0.5


@dataclass(frozen=True, slots=True)
class LooksDrive:
    """Pictures, boxes and truth of one drive at `FPS`.

    Attributes:
        name: of the drive.
        images: (H, W, 3) BGR.
        found: what the playback detector found in each.
        truth: who is there; `occluded` >= HIDDEN does not count.
        occlusions: (N, 3) track id, first and last frame of what was hidden on purpose.
    """

    name: str
    images: Sequence[Image]
    found: Sequence[Detections]
    truth: KittiLabels
    occlusions: IntArray


def simulated(seed: int, *, seconds: float, is_shaken: bool = True) -> LooksDrive:
    """A drive of this seed: even ones at 10 m/s in traffic, odd ones at 3 m/s past people who cross each other."""
    rng = np.random.default_rng([seed, 11])
    scene = make_scene(seed, seconds=seconds)
    if seed % 2:
        scene = _with_walkers(scene, rng)
    time_s = np.arange(round(seconds * FPS)) / FPS
    turns = _turns(time_s, rng) if is_shaken else np.tile(np.eye(3), (len(time_s), 1, 1))
    wide = _wide_camera(turns)
    renderer = Renderer(scene, StereoRig.rectified(wide, 0.54))
    images = [_cut_out(renderer.render(t), wide, turn) for t, turn in zip(time_s.tolist(), turns, strict=True)]
    truth = _turned(label_scene(scene, time_s.tolist(), camera=wide), turns)
    return _played(f"{'stroll' if seed % 2 else 'traffic'} {seed}", images, truth, seed=seed, hiding=Hiding())


def real(folder: Path, seeds: Sequence[int]) -> Iterator[LooksDrive]:
    """A drive of kitti_stereo with its labels' boxes, played back with these seeds."""
    images = [read.image for read in VideoReader(folder / "left.mp4")]
    truth = read_kitti(folder / "label.txt")
    truth = truth.select((truth.track_id >= 0) & (truth.frame < len(images)))
    known = [str(kind).lower() in ROAD_CLASS_OF for kind in truth.kitti_type]
    hiding = Hiding(seen_s=(0.3, 0.7), hidden_s=(0.5, 0.8), seen_after_s=0.2)
    for seed in seeds:
        yield _played(f"{folder.name} {seed}", images, truth.select(np.array(known)), seed=seed, hiding=hiding)


def class_ids(labels: KittiLabels) -> IntArray:
    """(N,) road classes of KITTI's types."""
    return np.array([ROAD_CLASSES.index(ROAD_CLASS_OF[str(kind).lower()]) for kind in labels.kitti_type], np.int64)


def _played(name: str, images: Sequence[Image], truth: KittiLabels, *, seed: int, hiding: Hiding) -> LooksDrive:
    """Hide road users now and then, and let the playback detector look."""
    occlusions = _occlusions(truth, np.random.default_rng([seed, 12]), hiding)
    hidden = np.zeros(len(truth), np.bool_)
    for track_id, first, last in occlusions:
        hidden |= (truth.track_id == track_id) & (truth.frame >= first) & (truth.frame <= last)
    truth = replace(truth, occluded=np.where(hidden, HIDDEN, truth.occluded))
    height, width = images[0].shape[:2]
    boxes = play_back(truth, seed=seed, image_size_px=(width, height))
    class_id = class_ids(boxes)
    frames = (np.flatnonzero(boxes.frame == frame) for frame in range(len(images)))
    found = [Detections.of(boxes.xyxy_px[rows], boxes.score[rows], class_id[rows]) for rows in frames]
    return LooksDrive(name, images, found, truth, occlusions)


def _occlusions(truth: KittiLabels, rng: np.random.Generator, hiding: Hiding) -> IntArray:
    """(N, 3) track id, first and last frame; only while somebody could be seen, before, after and all the time."""
    chosen: list[tuple[int, int, int]] = []
    after = round(hiding.seen_after_s * FPS)
    for track_id in np.unique(truth.track_id):
        frames = np.sort(truth.frame[(truth.track_id == track_id) & (truth.occluded < HIDDEN)])
        ends = [0, *(np.flatnonzero(np.diff(frames) > 1) + 1), len(frames)]
        for begin, end in pairwise(ends):
            first = begin + round(rng.uniform(*hiding.seen_s) * FPS)
            last = first + round(rng.uniform(*hiding.hidden_s) * FPS) - 1
            while last + after < end:
                chosen.append((int(track_id), int(frames[first]), int(frames[last])))
                first = last + 1 + round(rng.uniform(*hiding.seen_s) * FPS)
                last = first + round(rng.uniform(*hiding.hidden_s) * FPS) - 1
    return np.array(chosen, np.int64).reshape(-1, 3)


def _with_walkers(scene: Scene, rng: np.random.Generator) -> Scene:
    """Slower, and with people on both pavements who go to and fro in lanes instead of those of the street."""
    users = [user for user in scene.road_users if not _walks_on_pavement(user)]
    for lane in range(2 * N_LANES):
        side, heading_rad = (-1 if lane % 2 else 1), (AWAY_RAD if (lane // 2) % 2 else TOWARDS_RAD)
        speed_mps = float(rng.uniform(0.9, 1.6))
        for z_m in (10.0, 28.0, 46.0):
            height, width, length = np.array(SIZE_HWL_M["Pedestrian"]) * (1 + SIZE_SPREAD * rng.uniform(-1, 1, 3))
            walker = RoadUser(
                track_id=1 + max(user.track_id for user in users),
                kitti_type="Pedestrian",
                size_hwl_m=(float(height), float(width), float(length)),
                start_xz_m=(side * (PAVEMENT_M + LANE_M * (lane // 2)), z_m + float(rng.uniform(-4, 4))),
                rotation_y_rad=heading_rad,
                speed_mps=speed_mps,
            )
            users.append(walker)
    return replace(scene, road_users=tuple(users), ego_speed_mps=STROLL_MPS)


def _walks_on_pavement(user: RoadUser) -> bool:
    return user.kitti_type == "Pedestrian" and abs(user.start_xz_m[0]) > PAVEMENT_M - 1


def _turns(time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(F, 3, 3) from the straight camera's axes to the shaking one's."""
    hz, phase = rng.uniform(*PITCH_HZ, (6, 1)), rng.uniform(0, 2 * np.pi, (6, 1))
    pitch = np.sin(2 * np.pi * hz * time_s + phase).sum(axis=0) * PITCH_RMS_RAD / np.sqrt(3)
    turn_hz = 2 * np.pi / rng.uniform(*YAW_PERIOD_S)
    yaw = rng.uniform(*YAW_RATE_RAD) / turn_hz * np.sin(turn_hz * time_s)
    return np.stack([_about("x", a) @ _about("y", b) for a, b in zip(pitch.tolist(), yaw.tolist(), strict=True)])


def _about(axis: str, angle_rad: float) -> FloatArray:
    vector = np.array([[angle_rad if axis == "x" else 0.0], [angle_rad if axis == "y" else 0.0], [0.0]])
    return np.asarray(cv2.Rodrigues(vector)[0], np.float64)


def _wide_camera(turns: FloatArray) -> PinholeCamera:
    """A straight camera that sees whatever the turned ones see."""
    right, bottom = CAMERA.width_px, CAMERA.height_px
    corners = CAMERA.rays(np.array([[-1, -1], [right, -1], [-1, bottom], [right, bottom]], np.float64))
    rays = (corners @ turns).reshape(-1, 3)  # row vectors: ray R is R^T ray
    xy_px = np.array([CAMERA.fx_px, CAMERA.fy_px]) * rays[:, :2] / rays[:, 2:]
    low, high = np.floor(xy_px.min(axis=0)) - 1, np.ceil(xy_px.max(axis=0)) + 1
    width, height = (int(side) for side in high - low + 1)
    return PinholeCamera(CAMERA.fx_px, CAMERA.fy_px, float(-low[0]), float(-low[1]), width, height)


def _cut_out(image: Image, wide: PinholeCamera, turn: FloatArray) -> Image:
    homography = CAMERA.matrix @ turn @ np.linalg.inv(wide.matrix)
    return np.asarray(cv2.warpPerspective(image, homography, (CAMERA.width_px, CAMERA.height_px)), np.uint8)


def _turned(labels: KittiLabels, turns: FloatArray) -> KittiLabels:
    """The labels as the turned cameras see them; who is outside is left out, who is largely outside does not count."""
    labels = labels.select(labels.has_3d_box)
    corners_m = box_corners_m(labels.location_m, size_hwl_m=labels.size_hwl_m, rotation_y_rad=labels.rotation_y_rad)
    boxes = projected_boxes_px(corners_m @ turns[labels.frame].swapaxes(1, 2), CAMERA)
    inside = np.clip(boxes, 0, np.array([CAMERA.width_px - 1, CAMERA.height_px - 1] * 2))
    share = np.prod(inside[:, 2:] - inside[:, :2], axis=1) / np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    occluded = np.where(share < MIN_SHARE_INSIDE, HIDDEN, labels.occluded)
    return replace(labels, xyxy_px=inside, occluded=occluded).select(share > 0)  # false for NaN
