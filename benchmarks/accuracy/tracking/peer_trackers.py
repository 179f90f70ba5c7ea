"""Run trackers of other packages on boxes: `python peer_trackers.py IN.npz OUT_FOLDER NAME...` -> OUT_FOLDER/NAME.npz.

The script runs with the interpreter of a peer's environment and imports only the standard library, numpy and the peer.
Trackers have their published defaults, a new instance per sequence, and the frame rate if they have such a parameter.

    IN   n; for sequence i: i/begin (frames + 1) first row of each frame, i/xyxy_px (N, 4), i/score (N,),
         i/descriptor (N, D) embeddings, i/fps, i/size_px (2), i/min_score confidence threshold for trackers with one
         threshold, i/max_s processor time in s after which the sequence is stopped
    OUT  for sequence i: i/frame, i/track_id (M,), i/xyxy_px (M, 4), i/us (frames): processor time of the tracker's
         update with the conversion of its input, without that of its output; version

abewley/sort is not a package; it is represented by the SORT tracker of `trackers`.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import logging
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Update = Callable[[Array, Array, Array], Any]
"""Function from boxes (N, 4), confidences (N,) and embeddings (N, D) to the output of the
tracker."""

Read = Callable[[Any], tuple[Array, Array]]
"""Function from the output of the tracker to identities (M,) and boxes (M, 4)."""

LOW_SCORE = 0.1  # confidence threshold of boxes for trackers with two thresholds


@dataclass(frozen=True)
class Stream:
    """Properties of a sequence that trackers are created with."""

    fps: float  # frame rate
    size_px: tuple[int, int]  # (width, height) of the images
    has_embeddings: bool  # whether boxes have embeddings


@dataclass(frozen=True)
class Peer:
    """One row of the table."""

    package: str  # name of the package
    environment: str  # environment with the package
    make: Callable[[str, Stream], tuple[Update, Read]]  # creates the tracker `name` for a stream
    name: str = ""  # class or option of the tracker; "" = the package has a single tracker
    has_two_thresholds: bool = False  # whether it also uses low-confidence boxes
    # whether it gets the stored embeddings; it then runs only on sequences with embeddings
    has_embeddings: bool = False


def _trackers(name: str, stream: Stream) -> tuple[Update, Read]:
    supervision = importlib.import_module("supervision")
    tracker = getattr(importlib.import_module("trackers"), name)(frame_rate=stream.fps)

    def update(xyxy: Array, score: Array, _: Array) -> Any:
        class_id = np.zeros(len(xyxy), int)
        return tracker.update(
            supervision.Detections(
                xyxy.astype(np.float32), None, score.astype(np.float32), class_id
            )
        )

    def read(output: Any) -> tuple[Array, Array]:
        if output.tracker_id is None:
            return _arrays([], [])
        is_confirmed = output.tracker_id >= 0
        return output.tracker_id[is_confirmed], output.xyxy[is_confirmed]

    return update, read


def _boxmot(name: str, stream: Stream) -> tuple[Update, Read]:
    """A tracker of boxmot without camera motion compensation, since there are no images, and
    without its networks.
    """
    boxmot = importlib.import_module("boxmot")
    options_of: dict[str, dict[str, Any]] = {
        "ByteTrack": {"frame_rate": round(stream.fps)},
        "BotSort": {"frame_rate": round(stream.fps), "use_cmc": False},
        "OccluBoost": {"use_cmc": False},
        "BoostTrack": {"use_cmc": False},
        "DeepOcSort": {"cmc_off": True},
        "HybridSort": {"cmc_method": None},
        "SFSORT": dict(zip(("frame_width", "frame_height"), stream.size_px, strict=True)),
    }
    options = options_of.get(name, {})
    if name in _OPTIONAL_EMBEDDINGS:
        options["use_embeddings"] = stream.has_embeddings
    tracker = getattr(boxmot, name)(**options)
    if name == "StrongSort":  # it has no option for camera motion
        tracker.cmc, tracker._requires_frame = None, False
    needs_embeddings, random_embeddings = tracker.use_embeddings, _RandomEmbeddings()
    structures, torch = (
        importlib.import_module("boxmot.structures"),
        importlib.import_module("torch"),
    )

    def update(xyxy: Array, score: Array, embeddings: Array) -> Any:
        if not needs_embeddings:
            rows = np.concatenate([xyxy, score[:, None], np.zeros((len(xyxy), 1))], axis=1)
            return tracker.update(rows.astype(np.float32))
        embeddings = embeddings if embeddings.shape[1] else random_embeddings(len(xyxy))
        boxes = structures.Boxes(torch.from_numpy(xyxy.astype(np.float32)))
        scores, class_id = (
            torch.from_numpy(score.astype(np.float32)),
            torch.zeros(len(xyxy), dtype=torch.int64),
        )
        tensor = torch.from_numpy(embeddings.astype(np.float32))
        return tracker.update(
            structures.Detections(boxes, scores, class_id, "frame", embeddings=tensor)
        )

    def read(output: Any) -> tuple[Array, Array]:
        if needs_embeddings:
            return output.track_ids.numpy(), output.geometry.values.numpy()
        return output[:, 4].astype(int), output[:, :4]

    return update, read


_OPTIONAL_EMBEDDINGS = ("BotSort", "OccluBoost", "BoostTrack", "DeepOcSort", "HybridSort")
"""Trackers of boxmot that use embeddings optionally."""


def _norfair(name: str, stream: Stream) -> tuple[Update, Read]:
    """A tracker of norfair, which has no default distance, with the better two of 13 distances and
    thresholds.

    Only objects detected in the current frame are reported; predictions of lost objects cost 11
    HOTA on KITTI's cars. IoU with any overlap and the detected boxes is best on KITTI; corners
    within 50 px and the filtered boxes on MOT15.
    """
    norfair = importlib.import_module("norfair")
    threshold = {"iou": 1.0, "mean_euclidean": 50.0}[name]
    tracker = norfair.Tracker(distance_function=name, distance_threshold=threshold)
    frame = [0]

    def update(xyxy: Array, score: Array, _: Array) -> Any:
        frame[0] += 1
        pairs = zip(xyxy.reshape(-1, 2, 2), score, strict=True)
        return tracker.update(
            [norfair.Detection(box, scores=np.array([s, s]), data=frame[0]) for box, s in pairs]
        )

    def read(output: Any) -> tuple[Array, Array]:
        current = [track for track in output if track.last_detection.data == frame[0]]
        boxes = [
            track.last_detection.points if name == "iou" else track.estimate for track in current
        ]
        return _arrays([track.id for track in current], [box.reshape(4) for box in boxes])

    return update, read


def _deep_sort_realtime(_: str, stream: Stream) -> tuple[Update, Read]:
    tracker = importlib.import_module("deep_sort_realtime.deepsort_tracker").DeepSort(embedder=None)
    random_embeddings = _RandomEmbeddings()

    def update(xyxy: Array, score: Array, embeddings: Array) -> Any:
        ltwh = np.concatenate([xyxy[:, :2], xyxy[:, 2:] - xyxy[:, :2]], axis=1)
        boxes = [(box, s, "object") for box, s in zip(ltwh.tolist(), score.tolist(), strict=True)]
        embeds = list(embeddings if embeddings.shape[1] else random_embeddings(len(xyxy)))
        return tracker.update_tracks(boxes, embeds=embeds)

    def read(output: Any) -> tuple[Array, Array]:
        current = [
            track for track in output if track.is_confirmed() and track.time_since_update == 0
        ]
        return _arrays(
            [int(track.track_id) for track in current],
            [track.to_ltrb(orig=True) for track in current],
        )

    return update, read


def _motpy(_: str, stream: Stream) -> tuple[Update, Read]:
    motpy = importlib.import_module("motpy")
    tracker = motpy.MultiObjectTracker(dt=1 / stream.fps)
    number: dict[str, int] = {}

    def update(xyxy: Array, score: Array, _: Array) -> Any:
        return tracker.step(
            [motpy.Detection(box=box, score=s) for box, s in zip(xyxy, score.tolist(), strict=True)]
        )

    def read(output: Any) -> tuple[Array, Array]:
        ids = [number.setdefault(track.id, len(number) + 1) for track in output]
        return _arrays(ids, [track.box for track in output])

    return update, read


def _arrays(track_id: list[int], boxes: list[Array]) -> tuple[Array, Array]:
    return np.array(track_id, int), np.array(boxes, float).reshape(-1, 4)


class _RandomEmbeddings:
    """Random embeddings, all dissimilar, for trackers that require embeddings.

    Compared with constant embeddings, HOTA of deep-sort-realtime and StrongSort is lower by 1 on
    KITTI, and higher by 3 to 8 on MOT.
    """

    def __init__(self) -> None:
        self._random = np.random.default_rng(0)

    def __call__(self, n: int) -> Array:
        """(n, 128) float32 of length 1."""
        vectors = self._random.normal(size=(n, 128))
        return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), np.float32)


def _rows() -> dict[str, Peer]:
    rows = {
        "trackers-sort": Peer("trackers", "trackers", _trackers, "SORTTracker"),
        "trackers-bytetrack": Peer("trackers", "trackers", _trackers, "ByteTrackTracker", True),
        "trackers-ocsort": Peer("trackers", "trackers", _trackers, "OCSORTTracker"),
        "trackers-botsort": Peer("trackers", "trackers", _trackers, "BoTSORTTracker", True),
        "trackers-cbiou": Peer("trackers", "trackers", _trackers, "CBIoUTracker", True),
        "deep-sort-realtime": Peer("deep-sort-realtime", "trackers", _deep_sort_realtime),
        "deep-sort-realtime+embeddings": Peer(
            "deep-sort-realtime", "trackers", _deep_sort_realtime, has_embeddings=True
        ),
        "motpy": Peer("motpy", "trackers", _motpy),
        "norfair-iou": Peer("norfair", "norfair", _norfair, "iou"),
        "norfair-euclidean": Peer("norfair", "norfair", _norfair, "mean_euclidean"),
    }
    two_thresholds = ("ByteTrack", "BotSort", "SFSORT", "OccluBoost", "BoostTrack", "HybridSort")
    with_embeddings = (*_OPTIONAL_EMBEDDINGS, "StrongSort")
    for name in ("ByteTrack", "SFSORT", "OcSort", *with_embeddings):
        rows[f"boxmot-{name.lower()}"] = Peer(
            "boxmot", "boxmot", _boxmot, name, name in two_thresholds
        )
        if name in with_embeddings:
            row = Peer("boxmot", "boxmot", _boxmot, name, name in two_thresholds, True)
            rows[f"boxmot-{name.lower()}+embeddings"] = row
    return rows


PEERS: Mapping[str, Peer] = _rows()  # peers by name, in the order of the table


def tracked(peer: Peer, inputs: Mapping[str, Array], i: int) -> dict[str, Array]:
    """Output arrays of sequence `i`, as described in the docstring of the module."""
    begin, max_s = inputs[f"{i}/begin"], float(inputs[f"{i}/max_s"])
    embeddings = (
        inputs[f"{i}/descriptor"][:, :]
        if peer.has_embeddings
        else np.zeros((begin[-1], 0), np.float32)
    )
    xyxy_px, score = inputs[f"{i}/xyxy_px"], inputs[f"{i}/score"]
    is_used = score >= (LOW_SCORE if peer.has_two_thresholds else float(inputs[f"{i}/min_score"]))
    size_px = (int(inputs[f"{i}/size_px"][0]), int(inputs[f"{i}/size_px"][1]))
    update, read = peer.make(
        peer.name, Stream(float(inputs[f"{i}/fps"]), size_px, peer.has_embeddings)
    )
    frames, us = [], []
    sequence_start_s = time.process_time()
    for rows in map(slice, begin[:-1], begin[1:]):
        used = is_used[rows]
        boxes = xyxy_px[rows][used], score[rows][used], embeddings[rows][used]
        start_s = time.process_time()
        output = update(*boxes)
        us.append(1e6 * (time.process_time() - start_s))
        frames.append(read(output))
        if time.process_time() - sequence_start_s > max_s:
            break
    return {
        f"{i}/frame": np.repeat(np.arange(len(frames)), [len(track_id) for track_id, _ in frames]),
        f"{i}/track_id": np.concatenate([track_id for track_id, _ in frames]),
        f"{i}/xyxy_px": np.concatenate(
            [np.asarray(xyxy, float).reshape(-1, 4) for _, xyxy in frames]
        ),
        f"{i}/us": np.array(us),
    }


def main() -> None:
    """Run the named peers one after another; the error of one that fails is printed, and it writes
    no file.
    """
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    with np.load(sys.argv[1], allow_pickle=False) as file:
        inputs = dict(file)
    for name in sys.argv[3:]:
        peer = PEERS[name]
        result: dict[str, Array] = {"version": np.array(importlib.metadata.version(peer.package))}
        try:
            for i in range(int(inputs["n"])):
                if not peer.has_embeddings or inputs[f"{i}/descriptor"].shape[1]:
                    result |= tracked(peer, inputs, i)
        except Exception as error:  # a peer may raise anything; the next one runs regardless
            print(f"{name}: failed and is skipped ({type(error).__name__}: {error})", flush=True)
            continue
        np.savez(Path(sys.argv[2]) / f"{name}.npz", **result)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
