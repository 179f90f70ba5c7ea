"""Run other people's trackers over boxes: `python peer_trackers.py IN.npz OUT_FOLDER NAME...` -> OUT_FOLDER/NAME.npz.

A script for the interpreter that a peer is installed in, so it imports the standard library, numpy and the peer alone.
All run at their published defaults, a fresh instance per sequence, and get the frame rate where they ask for it.

    IN   n; for sequence i: i/begin (frames + 1) rows at which frames begin, i/xyxy_px (N, 4), i/score (N,),
         i/descriptor (N, D), i/fps, i/size_px (2), i/min_score (trackers of one threshold do not see boxes below),
         i/max_s (seconds of processor time after which a sequence that is only timed is left)
    OUT  for sequence i: i/frame, i/track_id (M,), i/xyxy_px (M, 4), i/us (frames): processor time of the tracker's own
         update with the conversion that its input requires, not of reading its answer; version

abewley/sort is no package: `trackers`' SORT stands for it.
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
"""Boxes (N, 4), scores (N,), descriptors (N, D) -> what the tracker says."""
Read = Callable[[Any], tuple[Array, Array]]
"""What it said -> identities (M,), boxes (M, 4)."""

LOW_SCORE = 0.1
"""Trackers of two thresholds see every box from here on."""


@dataclass(frozen=True)
class Stream:
    """What a tracker is told of a sequence beforehand."""

    fps: float
    size_px: tuple[int, int]
    has_vectors: bool


@dataclass(frozen=True)
class Peer:
    """One row of the table.

    Attributes:
        package: as it is installed, of `environment`.
        make: the tracker of this name, ready for a stream.
        name: its class; "" = the package has one.
        sees_weak: it has two thresholds, and sees weak boxes too.
        has_vectors: it gets the stored appearance vectors, and runs where there are some.
    """

    package: str
    environment: str
    make: Callable[[str, Stream], tuple[Update, Read]]
    name: str = ""
    sees_weak: bool = False
    has_vectors: bool = False


def _trackers(name: str, stream: Stream) -> tuple[Update, Read]:
    supervision = importlib.import_module("supervision")
    tracker = getattr(importlib.import_module("trackers"), name)(frame_rate=stream.fps)

    def update(xyxy: Array, score: Array, _: Array) -> Any:
        class_id = np.zeros(len(xyxy), int)
        return tracker.update(supervision.Detections(xyxy.astype(np.float32), None, score.astype(np.float32), class_id))

    def read(said: Any) -> tuple[Array, Array]:
        if said.tracker_id is None:
            return _nobody()
        sure = said.tracker_id >= 0
        return said.tracker_id[sure], said.xyxy[sure]

    return update, read


def _boxmot(name: str, stream: Stream) -> tuple[Update, Read]:
    """Without pictures there is no camera motion to estimate, and without vectors no network to download for them."""
    boxmot = importlib.import_module("boxmot")
    known: dict[str, dict[str, Any]] = {
        "ByteTrack": {"frame_rate": round(stream.fps)},
        "BotSort": {"frame_rate": round(stream.fps), "use_cmc": False},
        "OccluBoost": {"use_cmc": False},
        "BoostTrack": {"use_cmc": False},
        "DeepOcSort": {"cmc_off": True},
        "HybridSort": {"cmc_method": None},
        "SFSORT": dict(zip(("frame_width", "frame_height"), stream.size_px, strict=True)),
    }
    constant = known.get(name, {})
    if name in _WITH_LOOKS:
        constant["use_embeddings"] = stream.has_vectors
    tracker = getattr(boxmot, name)(**constant)
    if name == "StrongSort":  # which has no switch for it
        tracker.cmc, tracker._requires_frame = None, False
    needs_vectors, unlike = tracker.use_embeddings, _Unlike()
    structures, torch = importlib.import_module("boxmot.structures"), importlib.import_module("torch")

    def update(xyxy: Array, score: Array, vectors: Array) -> Any:
        if not needs_vectors:
            rows = np.concatenate([xyxy, score[:, None], np.zeros((len(xyxy), 1))], axis=1)
            return tracker.update(rows.astype(np.float32))
        vectors = vectors if vectors.shape[1] else unlike(len(xyxy))
        boxes = structures.Boxes(torch.from_numpy(xyxy.astype(np.float32)))
        scores, class_id = torch.from_numpy(score.astype(np.float32)), torch.zeros(len(xyxy), dtype=torch.int64)
        looks = torch.from_numpy(vectors.astype(np.float32))
        return tracker.update(structures.Detections(boxes, scores, class_id, "frame", embeddings=looks))

    def read(said: Any) -> tuple[Array, Array]:
        if needs_vectors:
            return said.track_ids.numpy(), said.geometry.values.numpy()
        return said[:, 4].astype(int), said[:, :4]

    return update, read


_WITH_LOOKS = ("BotSort", "OccluBoost", "BoostTrack", "DeepOcSort", "HybridSort")


def _norfair(name: str, stream: Stream) -> tuple[Update, Read]:
    """The package has no default distance: IoU and corners' distances at several thresholds were tried for it.

    Reported is what was seen in this frame; its predictions of lost objects cost 11 HOTA on KITTI's cars. IoU, at any
    overlap, with boxes as found serves it best on KITTI, corners within 50 px with its filtered boxes on MOT15.
    """
    norfair = importlib.import_module("norfair")
    limit = {"iou": 1.0, "mean_euclidean": 50.0}[name]
    tracker = norfair.Tracker(distance_function=name, distance_threshold=limit)
    now = [0]

    def update(xyxy: Array, score: Array, _: Array) -> Any:
        now[0] += 1
        pairs = zip(xyxy.reshape(-1, 2, 2), score, strict=True)
        return tracker.update([norfair.Detection(box, scores=np.array([s, s]), data=now[0]) for box, s in pairs])

    def read(said: Any) -> tuple[Array, Array]:
        seen = [each for each in said if each.last_detection.data == now[0]]
        boxes = [each.last_detection.points if name == "iou" else each.estimate for each in seen]
        return _gathered([each.id for each in seen], [box.reshape(4) for box in boxes])

    return update, read


def _deep_sort_realtime(_: str, stream: Stream) -> tuple[Update, Read]:
    tracker = importlib.import_module("deep_sort_realtime.deepsort_tracker").DeepSort(embedder=None)
    unlike = _Unlike()

    def update(xyxy: Array, score: Array, vectors: Array) -> Any:
        ltwh = np.concatenate([xyxy[:, :2], xyxy[:, 2:] - xyxy[:, :2]], axis=1)
        boxes = [(box, s, "object") for box, s in zip(ltwh.tolist(), score.tolist(), strict=True)]
        return tracker.update_tracks(boxes, embeds=list(vectors if vectors.shape[1] else unlike(len(xyxy))))

    def read(said: Any) -> tuple[Array, Array]:
        seen = [each for each in said if each.is_confirmed() and each.time_since_update == 0]
        return _gathered([int(each.track_id) for each in seen], [each.to_ltrb(orig=True) for each in seen])

    return update, read


def _motpy(_: str, stream: Stream) -> tuple[Update, Read]:
    motpy = importlib.import_module("motpy")
    tracker = motpy.MultiObjectTracker(dt=1 / stream.fps)
    number: dict[str, int] = {}

    def update(xyxy: Array, score: Array, _: Array) -> Any:
        return tracker.step([motpy.Detection(box=box, score=s) for box, s in zip(xyxy, score.tolist(), strict=True)])

    def read(said: Any) -> tuple[Array, Array]:
        return _gathered([number.setdefault(each.id, len(number) + 1) for each in said], [each.box for each in said])

    return update, read


def _gathered(track_id: list[int], boxes: list[Array]) -> tuple[Array, Array]:
    return np.array(track_id, int), np.array(boxes, float).reshape(-1, 4)


def _nobody() -> tuple[Array, Array]:
    return _gathered([], [])


class _Unlike:
    """Vectors for trackers that insist on looks where there are none: random, so that nothing looks like anything.

    Constant ones, with which all looks alike, serve deep-sort-realtime and StrongSort by 1 HOTA better on KITTI, and by
    3 to 8 worse on MOT.
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
        "trackers-bytetrack": Peer("trackers", "trackers", _trackers, "ByteTrackTracker", sees_weak=True),
        "trackers-ocsort": Peer("trackers", "trackers", _trackers, "OCSORTTracker"),
        "trackers-botsort": Peer("trackers", "trackers", _trackers, "BoTSORTTracker", sees_weak=True),
        "trackers-cbiou": Peer("trackers", "trackers", _trackers, "CBIoUTracker", sees_weak=True),
        "deep-sort-realtime": Peer("deep-sort-realtime", "trackers", _deep_sort_realtime),
        "deep-sort-realtime+vectors": Peer("deep-sort-realtime", "trackers", _deep_sort_realtime, has_vectors=True),
        "motpy": Peer("motpy", "trackers", _motpy),
        "norfair-iou": Peer("norfair", "norfair", _norfair, "iou"),
        "norfair-euclidean": Peer("norfair", "norfair", _norfair, "mean_euclidean"),
    }
    weak = ("ByteTrack", "BotSort", "SFSORT", "OccluBoost", "BoostTrack", "HybridSort")
    with_looks = (*_WITH_LOOKS, "StrongSort")
    for name in ("ByteTrack", "SFSORT", "OcSort", *with_looks):
        rows[f"boxmot-{name.lower()}"] = Peer("boxmot", "boxmot", _boxmot, name, name in weak)
        if name in with_looks:
            rows[f"boxmot-{name.lower()}+vectors"] = Peer("boxmot", "boxmot", _boxmot, name, name in weak, True)
    return rows


PEERS: Mapping[str, Peer] = _rows()


def tracked(peer: Peer, given: Mapping[str, Array], i: int) -> dict[str, Array]:
    """One sequence's answer; see the module's docstring."""
    begin, max_s = given[f"{i}/begin"], float(given[f"{i}/max_s"])
    vectors = given[f"{i}/descriptor"][:, :] if peer.has_vectors else np.zeros((begin[-1], 0), np.float32)
    keep = given[f"{i}/score"] >= (LOW_SCORE if peer.sees_weak else float(given[f"{i}/min_score"]))
    size_px = (int(given[f"{i}/size_px"][0]), int(given[f"{i}/size_px"][1]))
    update, read = peer.make(peer.name, Stream(float(given[f"{i}/fps"]), size_px, peer.has_vectors))
    frames, us = [], []
    started_s = time.process_time()
    for rows in map(slice, begin[:-1], begin[1:]):
        own = keep[rows]
        boxes, score, looks = given[f"{i}/xyxy_px"][rows][own], given[f"{i}/score"][rows][own], vectors[rows][own]
        began_s = time.process_time()
        said = update(boxes, score, looks)
        us.append(1e6 * (time.process_time() - began_s))
        frames.append(read(said))
        if time.process_time() - started_s > max_s:
            break
    return {
        f"{i}/frame": np.repeat(np.arange(len(frames)), [len(track_id) for track_id, _ in frames]),
        f"{i}/track_id": np.concatenate([track_id for track_id, _ in frames]),
        f"{i}/xyxy_px": np.concatenate([np.asarray(xyxy, float).reshape(-1, 4) for _, xyxy in frames]),
        f"{i}/us": np.array(us),
    }


def main() -> None:
    """Run the named peers one after another; one that fails says so and leaves no file."""
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    with np.load(sys.argv[1], allow_pickle=False) as file:
        given = dict(file)
    for name in sys.argv[3:]:
        peer = PEERS[name]
        answer: dict[str, Array] = {"version": np.array(importlib.metadata.version(peer.package))}
        try:
            for i in range(int(given["n"])):
                if not peer.has_vectors or given[f"{i}/descriptor"].shape[1]:
                    answer |= tracked(peer, given, i)
        except Exception as error:  # somebody else's code may raise anything; the others are still to run
            print(f"{name}: left out, {type(error).__name__}: {error}", flush=True)
            continue
        np.savez(Path(sys.argv[2]) / f"{name}.npz", **answer)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
