"""A raw pair (distorted, rotated cameras) with its rig gives the distances of the rectified
videos."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from track_range.ranging.methods.patch_stereo import StereoRanger
from track_range.recording.recording import open_recording
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scene import make_scene
from track_range.simulation.world.truth import label_scene
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.patch_matcher import PatchMatcher, PatchMatcherSettings
from track_range.stereo.rig_formats.rig_yaml import save_rig
from track_range.tracking.tracks import Tracks

IDEAL = kitti_like_rig()
LEFT = PinholeCamera(770.0, 772.0, 505.0, 172.0, 1000, 340, (-0.25, 0.08, 0.001, -0.0005, 0.0))
RIGHT = PinholeCamera(765.0, 766.0, 492.0, 166.0, 1000, 340, (-0.22, 0.06, -0.0008, 0.0007, 0.0))
ROTATIONS_RAD = {"left": (0.004, 0.012, -0.01), "right": (-0.006, -0.008, 0.012)}
N_FRAMES = 4


def rotation(side):
    """(3, 3) rotation from the ideal camera's frame to that of the raw camera, `side` "left" or
    "right"."""
    return cv2.Rodrigues(np.array(ROTATIONS_RAD[side]))[0]


def raw_rig():
    right_from_left = np.eye(4)
    right_from_left[:3, :3] = rotation("right") @ rotation("left").T
    right_from_left[:3, 3] = rotation("right") @ (-IDEAL.baseline_m, 0.0, 0.0)
    return StereoRig(LEFT, RIGHT, right_from_left)


def raw_image(image, camera, side):
    """The raw camera's image, from that of the ideal camera."""
    y, x = np.mgrid[: camera.height_px, : camera.width_px].astype(np.float64)
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)[:, None]
    ideal_px = cv2.undistortPoints(
        pixels, camera.matrix, np.array(camera.distortion), R=rotation(side).T, P=IDEAL.left.matrix
    ).astype(np.float32)
    maps = ideal_px.reshape(camera.height_px, camera.width_px, 2)
    return cv2.remap(image, maps, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """The same drive rectified and raw: two folders with left/, right/ and rig.yaml."""
    top = tmp_path_factory.mktemp("raw_pair")
    renderer = Renderer(make_scene(3, seconds=1.0), IDEAL)
    for kind, rig in (("ideal", IDEAL), ("raw", raw_rig())):
        for side, camera in (("left", LEFT), ("right", RIGHT)):
            (top / kind / side).mkdir(parents=True)
            for number in range(N_FRAMES):
                image = renderer.render(number / 10, side=side)
                image = raw_image(image, camera, side) if kind == "raw" else image
                cv2.imwrite(str(top / kind / side / f"{number:06d}.png"), image)
        save_rig(rig, top / kind / "rig.yaml")
    return top, label_scene(
        renderer.scene, [number / 10 for number in range(N_FRAMES)], camera=IDEAL.left
    )


def opened(folder):
    return open_recording(folder / "left", folder / "right", rig=folder / "rig.yaml", align="off")


def measured_m(folder: Path, boxes_of_frame):
    """Distances of the boxes, measured as in a run, and the recording."""
    recording = opened(folder)
    ranger = StereoRanger(recording.rig, PatchMatcher(PatchMatcherSettings.for_rig(recording.rig)))
    distances_m = []
    for frame in recording.frames:
        boxes = boxes_of_frame[frame.index]
        n = len(boxes)
        tracks = Tracks(np.arange(n), boxes, np.full(n, 2), np.ones(n), np.ones(n, bool))
        distances_m.append(ranger.measure(tracks, frame).distance_m)
    return np.concatenate(distances_m), recording


@pytest.mark.slow
def test_raw_pair_gives_the_same_distances(folders):
    top, labels = folders
    clear = (labels.occluded == 0) & (labels.truncated == 0) & (labels.location_m[:, 2] < 50)
    boxes = [labels.xyxy_px[clear & (labels.frame == number)] for number in range(N_FRAMES)]
    assert sum(map(len, boxes)) >= 12
    ideal_m, _ = measured_m(top / "ideal", boxes)
    rig = raw_rig()
    rectification = cv2.stereoRectify(
        *(
            LEFT.matrix,
            np.array(LEFT.distortion),
            RIGHT.matrix,
            np.array(RIGHT.distortion),
            (1000, 340),
        ),
        *(rig.right_from_left[:3, :3].copy(), rig.right_from_left[:3, 3:].copy()),
        alpha=0,
    )[0]
    rectified_from_ideal = rectification @ rotation("left")
    probe = opened(top / "raw")
    to_rectified = probe.camera.matrix @ rectified_from_ideal @ np.linalg.inv(IDEAL.left.matrix)
    probe.frames.close()
    moved = [
        cv2.perspectiveTransform(b.reshape(-1, 1, 2), to_rectified).reshape(-1, 4) for b in boxes
    ]
    raw_m, recording = measured_m(top / "raw", moved)
    assert recording.rig.is_rectified
    centres = np.concatenate(boxes).reshape(-1, 2, 2).mean(axis=1)
    expected_m = (IDEAL.left.rays(centres) * ideal_m[:, None]) @ rectified_from_ideal[2]
    both = np.isfinite(raw_m) & np.isfinite(expected_m)
    assert both.sum() >= 0.8 * len(both)
    error = raw_m[both] / expected_m[both] - 1
    assert np.median(np.abs(error)) < 0.003
    difference_px = error * IDEAL.left.fx_px * IDEAL.baseline_m / expected_m[both]
    assert np.median(np.abs(difference_px)) < 0.04
    assert abs(np.median(error)) < 0.001
