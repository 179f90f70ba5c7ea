"""Accuracy and speed of the tracker and of its peers on the same stored boxes, by the official rules.

Protocol, accuracy: KITTI tracking cars and pedestrians (public RRC boxes of 13 sequences, 12 with pedestrians), MOT15
(6 training sequences) and MOT17-05-FRCNN with its stored appearance embeddings; no images. Evaluation by the rules of
KITTI and MOTChallenge, boxes rounded to two decimals as in result files, counts summed over the sequences of a set.
Time steps are 0.1 s on KITTI, 1 / frameRate on MOT. All trackers have their default settings, one instance per
sequence. track-range gets all boxes; peers with two thresholds get boxes with a confidence from 0.1, peers with one
threshold from 0.5 (0.3 on MOT17). Rows with +embeddings use the stored embeddings; track-range uses them except for
"sort". "offline" is the default of `track-range track`, which refines tracks with later frames. All other rows are
online, and `track-range` is compared with the peers.

Protocol, speed: `tracking_sets.scene`, boxes only; mean over all but the first 20 frames, in microseconds of processor
time. Trackers alternate for `--rounds` rounds, one at a time on one thread; median of the rounds. The time is that of
the tracker's update with the conversion of its input. A peer is stopped after 20 s per scene; a dash means that it did
not finish the first 20 frames.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.inputs import tracking_sets
from benchmarks.inputs.drives import REAL_DATA
from benchmarks.inputs.tracking_sets import N_WARM_UP, SETS, scene, sequences_of
from benchmarks.peers.peer_runs import ONE_THREAD, PeerResult, create_environments, names_in, run_peers
from benchmarks.peers.peer_trackers import PEERS, Array
from track_range.detection.detections import Detections
from track_range.evaluation.sequences.tracking import track_sequence
from track_range.tracking.deepsort import AppearanceSettings, DeepSortSettings, DeepSortTracker
from track_range.tracking.evaluation.scores import TrackingCounts


@dataclass(frozen=True, slots=True)
class Variant:
    """A configuration of `track-range track`.

    Attributes:
        settings: settings of the tracker.
        is_online: False = tracks are refined with later frames.
        needs_embeddings: True = without embeddings it is the same as another variant.
    """

    settings: DeepSortSettings
    is_online: bool = True
    needs_embeddings: bool = False


VARIANTS: Mapping[str, Variant] = {
    "track-range": Variant(DeepSortSettings()),
    "track-range, sort": Variant(
        DeepSortSettings(appearance=AppearanceSettings(max_cosine_distance=0.0)), needs_embeddings=True
    ),
    "track-range, offline": Variant(DeepSortSettings(), is_online=False),
}
"""Configurations of track-range by their name in the table."""

COMPARED = "track-range"
"""Variant that is compared with the peers."""

SCENES: Mapping[int, int] = {10: 120, 50: 120, 200: 60, 1000: 30}
"""Number of frames of a scene, with warm-up, by number of objects."""

MAX_SCENE_S = 20.0
"""Processor time in s after which a peer is stopped."""

_JOBS = 2
"""Number of parallel processes."""

_FIGURES = {"hota": "HOTA", "idf1": "IDF1", "mota": "MOTA", "deta": "DetA", "assa": "AssA"}
"""Headings of metrics in per cent."""

_COUNTS = {"idsw": "IDsw", "fp": "FP", "fn": "FN"}
"""Headings of counts."""

Scores = dict[str, float]
Figures = dict[str, Any]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this workload."""
    parser.add_argument("--data", type=Path, default=REAL_DATA, help="folder with kitti_labels and mot")
    parser.add_argument("--sets", nargs="*", default=list(SETS), choices=SETS, help="data sets; none = no accuracy")
    parser.add_argument("--rounds", type=int, default=3, help="rounds for the time; 0 = no speed")
    parser.add_argument("--peers", action="store_true", help="also run the trackers of other packages")
    folder = Path(".venv/peers")
    parser.add_argument(
        "--environments",
        type=Path,
        default=folder,
        help="folder of the peers' virtual environments, created if missing",
    )


def measure(options: argparse.Namespace) -> Figures:
    """Run all trackers, print the tables, and return their figures."""
    os.environ.update(ONE_THREAD)  # for the processes that are started below
    pythons = create_environments(options.environments) if options.peers else {}
    accuracy, versions = _accuracy(options.sets, options.data, pythons)
    for name, rows in accuracy.items():
        _print_accuracy(name, rows)
    margins = {name: _margins(rows) for name, rows in accuracy.items()} if pythons else {}
    _print_margins(margins)
    speed = _speed(pythons, options.rounds)
    _print_speed(speed)
    figures = {"accuracy": accuracy, "ahead": margins, "us_per_frame": speed}
    return {"protocol": __doc__, "versions": versions, **figures}


def _accuracy(
    set_names: Sequence[str], data: Path, pythons: Mapping[str, Path]
) -> tuple[dict[str, dict[str, Figures]], dict[str, str]]:
    """Figures by data set and tracker, variants first, and versions of the peers' packages."""
    by_set = {name: sequences_of(name, data) for name in set_names}
    for name in (name for name, of_set in by_set.items() if not of_set):
        print(f"{data}: expected the data set {name}, found none; it is skipped.", flush=True)
    sequences = [sequence for of_set in by_set.values() for sequence in of_set]
    counts: dict[tuple[str, str], list[Future[TrackingCounts]]] = {}
    versions = {}
    with ProcessPoolExecutor(_JOBS, multiprocessing.get_context("spawn")) as pool:
        for name, sequence in product(VARIANTS, sequences):
            if sequence.has_embeddings or not VARIANTS[name].needs_embeddings:
                counts.setdefault((sequence.set_name, name), []).append(pool.submit(_variant_counts, name, sequence))
        for name, result in _peer_results(pythons, sequences):
            versions[PEERS[name].package] = result.version
            for i, tracks in result.tracks.items():
                sequence = sequences[i]
                counts.setdefault((sequence.set_name, name), []).append(pool.submit(_counts, sequence, *tracks))
        rows = {key: _scores([future.result() for future in futures]) for key, futures in counts.items()}
    return {s: {name: row for (of, name), row in rows.items() if of == s} for s in by_set if by_set[s]}, versions


def _peer_results(
    pythons: Mapping[str, Path], sequences: Sequence[tracking_sets.Sequence]
) -> Iterator[tuple[str, PeerResult]]:
    """Results of all peers, in the order of the table; one process runs four peers, since its start takes seconds."""
    jobs = [
        (environment, names_in(environment)[i : i + 4])
        for environment in pythons
        for i in range(0, len(names_in(environment)), 4)
    ]
    with ThreadPoolExecutor(_JOBS) as threads:
        for results in threads.map(lambda job: run_peers(pythons[job[0]], job[1], sequences), jobs):
            yield from results.items()


def _variant_counts(name: str, sequence: tracking_sets.Sequence) -> TrackingCounts:
    """Counts of a variant, tracked as by the command."""
    variant = VARIANTS[name]
    tracker = DeepSortTracker(variant.settings)
    n_frames, fps = sequence.n_frames, sequence.fps
    frames = track_sequence(sequence.detected, tracker, n_frames=n_frames, fps=fps, is_online=variant.is_online).frames
    frame = np.repeat(np.arange(len(frames)), [len(tracks) for tracks in frames])
    track_id = np.concatenate([tracks.track_id for tracks in frames])
    return sequence.counts(frame, track_id, np.concatenate([tracks.xyxy_px for tracks in frames]))


def _counts(sequence: tracking_sets.Sequence, frame: Array, track_id: Array, xyxy_px: Array) -> TrackingCounts:
    """Counts of a peer's tracks; of an identity twice in one frame the first is used."""
    _, first = np.unique(np.stack([frame, track_id]), axis=1, return_index=True)
    return sequence.counts(frame[first], track_id[first], xyxy_px[first])


def _scores(counts: Sequence[TrackingCounts]) -> Figures:
    scores = asdict(TrackingCounts.sum_of(counts).scores())
    return {name: float(scores[name]) for name in _FIGURES} | {name: int(scores[name]) for name in _COUNTS}


def _margins(rows: Mapping[str, Scores]) -> dict[str, Figures]:
    """Best peer and lead over it, by metric."""
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
    """Mean time per frame of track-range on each scene in microseconds."""
    means = []
    for sequence in scenes:
        tracker, us = DeepSortTracker(), []
        for frame in range(sequence.n_frames):
            boxes = sequence.detected.at(frame)
            start_s = time.process_time()
            tracker.update(Detections.of(boxes.xyxy_px, boxes.score, boxes.class_id), frame / sequence.fps, None)
            us.append(1e6 * (time.process_time() - start_s))
        means.append(_mean_us(np.array(us)))
    return means


def _mean_us(us: Array) -> float:
    return float(np.mean(us[N_WARM_UP:])) if len(us) > N_WARM_UP else float("nan")


def _print_accuracy(set_name: str, rows: Mapping[str, Scores]) -> None:
    table = _table(f"{set_name}: per cent and counts", ["tracker", *_FIGURES.values(), *_COUNTS.values()])
    ranked = [*(name for name in rows if name not in PEERS)]
    ranked += sorted((name for name in rows if name in PEERS), key=lambda name: -rows[name]["hota"])
    for name in ranked:
        figures, counts = ([rows[name][key] for key in keys] for keys in (_FIGURES, _COUNTS))
        table.add_row(name, *(f"{value:.1f}" for value in figures), *(str(value) for value in counts))
    Console(width=120).print(table)


def _print_margins(margins: Mapping[str, Mapping[str, Figures]]) -> None:
    for set_name, figures in margins.items():
        leads = (f"{_FIGURES[key]} {row['ahead']:+.1f} ({row['best_peer']})" for key, row in figures.items())
        print(f"{set_name}: {COMPARED} minus the best peer: {', '.join(leads)}", flush=True)


def _print_speed(rows: Mapping[str, Mapping[int, float]]) -> None:
    table = _table("us per frame, boxes only, by number of objects", ["tracker", *map(str, SCENES)])
    for name, times in sorted(rows.items(), key=lambda row: np.nan_to_num(row[1][200], nan=np.inf)):
        table.add_row(name, *("-" if np.isnan(us) else f"{us:,.0f}" for us in times.values()))
    if rows:
        Console(width=120).print(table)


def _table(title: str, headings: Sequence[str]) -> Table:
    table = Table(title=title, box=box.SIMPLE_HEAD, padding=0, title_justify="left")
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="right" if i else "left", no_wrap=True)
    return table
