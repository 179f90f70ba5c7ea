"""Accuracy and speed of the tracker and of its peers on the same stored boxes, by the official
rules.

Evaluation by the rules of KITTI and MOTChallenge, counts summed over the sequences of a set. Rows
with +embeddings use the stored embeddings; track-range uses them except for "sort". "offline" is
the default of `track-range track`, which refines tracks with later frames; all other rows are
online.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.accuracy.tracking.peer_runs import (
    ONE_THREAD,
    PeerResult,
    create_environments,
    names_in,
    run_peers,
)
from benchmarks.accuracy.tracking.peer_trackers import PEERS, Array
from benchmarks.harness import Figures, option, workload
from benchmarks.inputs import tracking_sets
from benchmarks.inputs.drives import REAL_DATA
from benchmarks.inputs.tracking_sets import N_WARM_UP, SETS, scene, sequences_of
from track_range.detection.detections import Detections
from track_range.tracking.deepsort import AppearanceSettings, DeepSortSettings, DeepSortTracker
from track_range.tracking.evaluation.scores import TrackingCounts


@dataclass(frozen=True, slots=True)
class Variant:
    """A configuration of `track-range track`; one that needs embeddings is the same as another
    without them.
    """

    settings: DeepSortSettings
    is_online: bool = True
    needs_embeddings: bool = False


VARIANTS: Mapping[str, Variant] = {
    "track-range": Variant(DeepSortSettings(is_smoothed=True)),
    "track-range, sort": Variant(
        DeepSortSettings(is_smoothed=True, appearance=AppearanceSettings(max_cosine_distance=0.0)),
        needs_embeddings=True,
    ),
    "track-range, offline": Variant(DeepSortSettings(is_smoothed=True), is_online=False),
}
"""Configurations of track-range by their name in the table."""

COMPARED = "track-range"

SCENES: Mapping[int, int] = {10: 120, 50: 120, 200: 60, 1000: 30}
"""Number of frames of a scene, with warm-up, by number of objects."""

MAX_SCENE_S = 20.0  # processor time in s after which a peer is stopped
_JOBS = 2  # parallel processes

_PER_CENT = ("hota", "idf1", "mota", "deta", "assa")
_COUNTS = ("idsw", "fp", "fn")

Scores = dict[str, float]


@workload(
    option("--data", default=REAL_DATA, help="folder with kitti_labels and mot"),
    option("--sets", default=SETS, nargs="*", choices=SETS, help="data sets; none = no accuracy"),
    option("--every", default=1, help="use every K-th frame only, as of a time lapse"),
    option("--backwards", default=False, help="from the last frame to the first one"),
    option("--rounds", default=3, help="rounds for the time; 0 = no speed"),
    option("--peers", default=False, help="also run the trackers of other packages"),
    option(
        "--environments",
        default=Path(".venv/peers"),
        help="folder of the peers' virtual environments",
    ),
)
def tracking(options: Namespace) -> Figures:
    os.environ.update(ONE_THREAD)  # for the processes that are started below
    pythons = create_environments(options.environments) if options.peers else {}
    accuracy, versions = _accuracy(options, pythons)
    margins = {name: _margins(rows) for name, rows in accuracy.items()} if pythons else {}
    speed = _speed(pythons, options.rounds)
    return {"accuracy": accuracy, "ahead": margins, "us_per_frame": speed, "versions": versions}


def _accuracy(
    options: Namespace, pythons: Mapping[str, Path]
) -> tuple[dict[str, dict[str, Figures]], dict[str, str]]:
    by_set = {
        name: [sequence.every(options.every) for sequence in sequences_of(name, options.data)]
        for name in options.sets
    }
    if options.backwards:
        by_set = {name: [part.backwards() for part in of_set] for name, of_set in by_set.items()}
    for name in (name for name, of_set in by_set.items() if not of_set):
        print(
            f"{options.data}: expected the data set {name}, found none; it is skipped.", flush=True
        )
    sequences = [sequence for of_set in by_set.values() for sequence in of_set]
    counts: dict[tuple[str, str], list[Future[TrackingCounts]]] = {}
    versions = {}
    with ProcessPoolExecutor(_JOBS, multiprocessing.get_context("spawn")) as pool:
        for name, sequence in product(VARIANTS, sequences):
            if sequence.has_embeddings or not VARIANTS[name].needs_embeddings:
                counts.setdefault((sequence.set_name, name), []).append(
                    pool.submit(_variant_counts, name, sequence)
                )
        for name, result in _peer_results(pythons, sequences):
            versions[PEERS[name].package] = result.version
            for i, tracks in result.tracks.items():
                sequence = sequences[i]
                counts.setdefault((sequence.set_name, name), []).append(
                    pool.submit(_counts, sequence, *tracks)
                )
        rows = {
            key: _scores([future.result() for future in futures]) for key, futures in counts.items()
        }
    return {
        s: {name: row for (of, name), row in rows.items() if of == s} for s in by_set if by_set[s]
    }, versions


def _peer_results(
    pythons: Mapping[str, Path], sequences: Sequence[tracking_sets.Sequence]
) -> Iterator[tuple[str, PeerResult]]:
    """Results of all peers, in the order of the table; one process runs four peers, since its start
    takes seconds.
    """
    jobs = [
        (environment, names_in(environment)[i : i + 4])
        for environment in pythons
        for i in range(0, len(names_in(environment)), 4)
    ]
    with ThreadPoolExecutor(_JOBS) as threads:
        for results in threads.map(lambda job: run_peers(pythons[job[0]], job[1], sequences), jobs):
            yield from results.items()


def _variant_counts(name: str, sequence: tracking_sets.Sequence) -> TrackingCounts:
    variant = VARIANTS[name]
    boxes, _ = sequence.tracked(DeepSortTracker(variant.settings), is_online=variant.is_online)
    return sequence.counts(boxes)


def _counts(
    sequence: tracking_sets.Sequence, frame: Array, track_id: Array, xyxy_px: Array
) -> TrackingCounts:
    """Counts of a peer's tracks; of an identity twice in one frame the first is used."""
    _, first = np.unique(np.stack([frame, track_id]), axis=1, return_index=True)
    return sequence.counts(sequence.boxes(frame[first], track_id[first], xyxy_px[first]))


def _scores(counts: Sequence[TrackingCounts]) -> Figures:
    scores = asdict(TrackingCounts.sum_of(counts).scores())
    return {name: float(scores[name]) for name in _PER_CENT} | {
        name: int(scores[name]) for name in _COUNTS
    }


def _margins(rows: Mapping[str, Scores]) -> dict[str, Figures]:
    peers = [name for name in rows if name in PEERS]
    margins: dict[str, Figures] = {}
    for metric in ("hota", "idf1") if peers else ():
        best = max(peers, key=lambda name: rows[name][metric])
        margins[metric] = {"best_peer": best, "ahead": rows[COMPARED][metric] - rows[best][metric]}
    return margins


def _speed(pythons: Mapping[str, Path], n_rounds: int) -> dict[str, dict[int, float]]:
    """Microseconds per frame by tracker and number of objects; NaN = the tracker was stopped."""
    scenes = [scene(n, n_frames=n_frames) for n, n_frames in SCENES.items()]
    rounds: dict[str, list[list[float]]] = {}
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as alone:
        for _ in range(n_rounds):
            rounds.setdefault(COMPARED, []).append(alone.submit(_mean_times_us, scenes).result())
            for environment, python in pythons.items():
                names = names_in(environment, with_embeddings=False)
                for name, result in run_peers(python, names, scenes, max_s=MAX_SCENE_S).items():
                    times = [_mean_us(result.us[i]) for i in range(len(scenes))]
                    rounds.setdefault(name, []).append(times)
    medians = {name: np.median(times, axis=0).tolist() for name, times in rounds.items()}
    return {name: dict(zip(SCENES, times, strict=True)) for name, times in medians.items()}


def _mean_times_us(scenes: Sequence[tracking_sets.Sequence]) -> list[float]:
    means = []
    for sequence in scenes:
        tracker, us = DeepSortTracker(VARIANTS[COMPARED].settings), []
        for frame in range(sequence.n_frames):
            boxes = sequence.detected.at(frame)
            start_s = time.process_time()
            tracker.update(
                Detections.of(boxes.xyxy_px, boxes.score, boxes.class_id),
                frame / sequence.fps,
                None,
            )
            us.append(1e6 * (time.process_time() - start_s))
        means.append(_mean_us(np.array(us)))
    return means


def _mean_us(us: Array) -> float:
    return float(np.mean(us[N_WARM_UP:])) if len(us) > N_WARM_UP else float("nan")
