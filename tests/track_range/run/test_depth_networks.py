"""Runs with depth networks that are right, short, constant, flickering, or that saturate: what
`depth` and `fused` are worth. The images of a simulated drive have the true distances of its road
users in their blue channel; the networks decode and distort them.
"""

import csv
import math
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import track_range as tr
from track_range.detection.boxes import iou
from track_range.ranging import registry
from track_range.ranging.measurement.dense_map import DenseMap
from track_range.ranging.methods.network_depth import DEPTH, NetworkDepthRanger
from track_range.simulation.settings import DriveOptions

pytestmark = pytest.mark.slow

NEAREST_M, RATIO = 1.5, 200.0  # of the least and the largest blue


class Decoded:
    """A network that decodes the blue channel; `distorted` gets the depth and the generator."""

    path, notes, is_metric, described = Path("made.onnx"), (), True, {}

    def __init__(self, distorted):
        self._distorted, self._rng = distorted, np.random.default_rng(1)
        self._factors = np.exp(self._rng.normal(0, 0.08, (8, 24)))  # by part of the image

    def measure(self, image, fx_px):
        depth = NEAREST_M * RATIO ** (image[:, :, 0] / 255)
        factors = cv2.resize(self._factors, image.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        seen = self._distorted(depth * factors, self._rng)
        return DenseMap(seen.astype(np.float32), "depth", image.shape[:2])


NETWORKS = {
    "right": lambda depth, rng: depth,
    "short": lambda depth, rng: 0.6 * depth,
    "constant": lambda depth, rng: np.full_like(depth, 20.0),
    "flickering": lambda depth, rng: depth * 2 ** rng.uniform(-0.5, 0.5),
    "saturating": lambda depth, rng: np.minimum(depth, 40.0),
}


@pytest.fixture(scope="module")
def drive(render_drive):
    """A drive of 6 s, and its true boxes with their distances (N, 5) by frame."""
    files = render_drive(seed=45, seconds=6.0, options=DriveOptions(lossless=True))
    painted, true = defaultdict(list), defaultdict(list)
    for row in csv.DictReader(files.table.read_text().splitlines()):
        names, frame = ("x1", "y1", "x2", "y2", "distance_m"), int(row["frame"])
        values = [float(row[name]) for name in names]
        if math.isnan(values[-1]):  # hidden wholly
            continue
        painted[frame].append(values)
        if float(row["visible_share"]) > 0.6:
            true[frame].append(values)
    for path in sorted(files.left.glob("*.png")):
        image = cv2.imread(str(path))
        image[:, :, 0] = 180
        for x1, y1, x2, y2, distance_m in sorted(painted[int(path.stem)], key=lambda row: -row[4]):
            rows = slice(max(round(y1), 0), round(y2) + 1)
            code = 255 * math.log(distance_m / NEAREST_M) / math.log(RATIO)
            image[rows, max(round(x1), 0) : round(x2) + 1, 0] = round(code)
        cv2.imwrite(str(path), image)
    return files, {frame: np.array(rows) for frame, rows in true.items()}


@pytest.fixture(scope="module")
def measured(drive):
    """Relative errors, sigmas and notes of a run of one camera or a pair with a network; None =
    without."""
    files, true = drive
    known = {}

    def run(kind, network):
        if (kind, network) in known:
            return known[kind, network]
        with registry.METHODS.restored():
            if network is not None:
                made = Decoded(NETWORKS[network])
                registry.METHODS.registered["depth"] = replace(
                    DEPTH, create=lambda c: NetworkDepthRanger("depth", made, c.camera)
                )
            known[kind, network] = errors_of(opened(files, kind), true)
        return known[kind, network]

    return run


def opened(files, kind):
    options = {"detections": files.detections, "lanes": "off"}
    if kind == "stereo":
        return tr.Run.stereo(files.left, files.right, rig=files.rig, align="off", **options)
    return tr.Run.mono(files.left, focal_px=360.75, **options)


def errors_of(run, true):
    found = defaultdict(list)
    with run:
        for result in run:
            boxes, tracks = true.get(result.frame.index, np.zeros((0, 5))), result.tracks
            if not len(boxes) or not len(tracks):
                continue
            overlap = iou(tracks.xyxy_px, boxes[:, :4])
            best = overlap.argmax(axis=1)
            rows = np.flatnonzero((overlap.max(axis=1) > 0.6) & tracks.observed)
            true_m = boxes[best[rows], 4]
            for name, ranges in result.ranges.items():
                distance_m, sigma_m = ranges.distance_m[rows], ranges.sigma_m[rows]
                found[name].append([distance_m / true_m - 1, sigma_m / true_m])
        summary, notes = run.summary, [str(note) for note in run.notes]
    values = {name: np.concatenate(parts, axis=1) for name, parts in found.items()}
    return values, notes, summary


def percentile(values, percent):
    error = np.abs(values[0])
    return float(np.percentile(error[np.isfinite(error)], percent))


def within(values, n_sigmas):
    error, sigma = values[:, np.isfinite(values[0])]
    return float((np.abs(error) < n_sigmas * sigma).mean())


@pytest.mark.parametrize("kind", ["mono", "stereo"])
@pytest.mark.parametrize("network", NETWORKS)
def test_fused_is_not_worse_with_any_network(measured, kind, network):
    without, values = measured(kind, None)[0]["fused"], measured(kind, network)[0]["fused"]
    assert percentile(values, 50) < 1.15 * percentile(without, 50) + 0.002
    assert percentile(values, 95) < 1.15 * percentile(without, 95) + 0.005
    assert within(values, 2) > within(without, 2) - 0.03
    assert np.isfinite(values[0]).sum() >= np.isfinite(without[0]).sum()


@pytest.mark.parametrize("kind", ["mono", "stereo"])
@pytest.mark.parametrize("network", ["right", "short", "flickering", "saturating"])
def test_sigma_of_a_network_is_that_of_its_errors(measured, kind, network):
    values = measured(kind, network)[0]["depth"]
    assert within(values, 2) > 0.88
    if network in ("right", "short"):
        assert percentile(values, 50) < 0.1
        known = np.isfinite(values[1])
        assert np.median(values[1][known]) < 0.25


@pytest.mark.parametrize("kind", ["mono", "stereo"])
def test_what_is_said_of_each_network(measured, kind):
    def note(network):
        (text,) = (text for text in measured(kind, network)[1] if "depth network" in text)
        return text

    assert "corrected" in note("short")
    assert "says little" in note("constant")
    values = measured(kind, "constant")[0]["depth"]
    # empty, or with sigmas that cover; that `fused` is not worse is tested above
    assert not np.isfinite(values[0]).any() or within(values, 2) >= 0.9
    assert not any("depth network" in text for text in measured(kind, None)[1])
