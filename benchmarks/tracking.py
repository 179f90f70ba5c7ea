"""Our tracker and its peers on the same stored boxes, by the official rules; and their time per frame.

Protocol, accuracy: KITTI tracking cars and pedestrians (public RRC boxes of 13 sequences, 12 with pedestrians), MOT15
(6 training sequences) and MOT17-05-FRCNN with the appearance vectors stored with it; no images. KITTI's and
MOTChallenge's own rules of what counts; results rounded to two decimals, as files are; sequences of a set summed. Time
steps are 0.1 s on KITTI, 1 / frameRate on MOT. Every tracker at its defaults, one instance per sequence. Ours gets all
boxes; peers of two thresholds those from 0.1 on; peers of one threshold those from 0.5 on (0.3 on MOT17). Rows that end
in +vectors get the stored vectors; ours gets them unless it says sort. Our row that looks ahead is `track-range track`
as it comes: it has seen the whole file. All others are online, and `track-range` is the one held against peers.

Protocol, speed: `tracking_sets.scene`, boxes alone; the first 20 frames do not count; mean of the others, microseconds
of processor time, since other programs' share of the machine is not the tracker's. All trackers take turns, `--rounds`
times, each alone on one thread; median of the rounds. Timed is the tracker's own update with the conversion that its
input requires. A peer leaves a scene after 20 s; a dash is one that was not through its first 20 frames by then.
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
from benchmarks.peers.peer_runs import ONE_THREAD, Answer, made_environments, names_in, run_peers
from benchmarks.peers.peer_trackers import PEERS, Array
from track_range.detection.detections import Detections
from track_range.sequences.tracking import track_sequence
from track_range.tracking.deepsort import AppearanceSettings, DeepSortSettings, DeepSortTracker
from track_range.tracking.evaluation import TrackingCounts


@dataclass(frozen=True, slots=True)
class Own:
    """One of our rows: `track-range track` with these options; `needs_vectors`: the same as another row without."""

    settings: DeepSortSettings
    is_online: bool = True
    needs_vectors: bool = False


OURS: Mapping[str, Own] = {
    "track-range": Own(DeepSortSettings()),
    "track-range, sort": Own(
        DeepSortSettings(appearance=AppearanceSettings(max_cosine_distance=0.0)), needs_vectors=True
    ),
    "track-range, looks ahead": Own(DeepSortSettings(), is_online=False),
}
BEST = "track-range"
"""The row that is held against peers."""

SCENES: Mapping[int, int] = {10: 120, 50: 120, 200: 60, 1000: 30}
"""Objects: frames, with those that do not count."""

MAX_SCENE_S = 20.0
_JOBS = 2
_FIGURES = {"hota": "HOTA", "idf1": "IDF1", "mota": "MOTA", "deta": "DetA", "assa": "AssA"}
_COUNTS = {"idsw": "IDsw", "fp": "FP", "fn": "FN"}

Scores = dict[str, float]
Figures = dict[str, Any]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this workload."""
    parser.add_argument("--data", type=Path, default=REAL_DATA, help="folder with kitti_labels and mot")
    parser.add_argument("--sets", nargs="*", default=list(SETS), choices=SETS, help="none = no accuracy")
    parser.add_argument("--rounds", type=int, default=3, help="turns of every tracker for its time; 0 = no speed")
    parser.add_argument("--peers", action="store_true", help="run other people's trackers too")
    folder = Path(".venv/peers")
    parser.add_argument("--environments", type=Path, default=folder, help="of the peers; made where it is missing")


def measure(options: argparse.Namespace) -> Figures:
    """Run everything, print the tables, and return their figures."""
    os.environ.update(ONE_THREAD)  # before the processes that track begin
    pythons = made_environments(options.environments) if options.peers else {}
    accuracy, versions = _accuracy(options.sets, options.data, pythons)
    for name, rows in accuracy.items():
        _tell_accuracy(name, rows)
    margins = {name: _margins(rows) for name, rows in accuracy.items()} if pythons else {}
    _tell_margins(margins)
    speed = _speed(pythons, options.rounds)
    _tell_speed(speed)
    told = {"accuracy": accuracy, "ahead": margins, "us_per_frame": speed}
    return {"protocol": __doc__, "versions": versions, **told}


def _accuracy(
    set_names: Sequence[str], data: Path, pythons: Mapping[str, Path]
) -> tuple[dict[str, dict[str, Figures]], dict[str, str]]:
    """Figures by set and tracker, and the versions of the peers' packages; ours first, then peers as they are done."""
    by_set = {name: sequences_of(name, data) for name in set_names}
    for name in (name for name, found in by_set.items() if not found):
        print(f"{name}: no such boxes in {data}; left out.", flush=True)
    sequences = [each for found in by_set.values() for each in found]
    counts: dict[tuple[str, str], list[Future[TrackingCounts]]] = {}
    versions = {}
    with ProcessPoolExecutor(_JOBS, multiprocessing.get_context("spawn")) as pool:
        for name, each in product(OURS, sequences):
            if each.has_vectors or not OURS[name].needs_vectors:
                counts.setdefault((each.set_name, name), []).append(pool.submit(_own_counts, name, each))
        for name, answer in _answers(pythons, sequences):
            versions[PEERS[name].package] = answer.version
            for i, tracks in answer.tracks.items():
                each = sequences[i]
                counts.setdefault((each.set_name, name), []).append(pool.submit(_counts, each, *tracks))
        rows = {key: _scores([each.result() for each in found]) for key, found in counts.items()}
    return {s: {name: row for (of, name), row in rows.items() if of == s} for s in by_set if by_set[s]}, versions


def _answers(pythons: Mapping[str, Path], sequences: Sequence[tracking_sets.Sequence]) -> Iterator[tuple[str, Answer]]:
    """Every peer's answer, in the table's order; a process runs some peers, since it takes seconds to begin."""
    jobs = [(place, names_in(place)[i : i + 4]) for place in pythons for i in range(0, len(names_in(place)), 4)]
    with ThreadPoolExecutor(_JOBS) as threads:
        for answers in threads.map(lambda job: run_peers(pythons[job[0]], job[1], sequences), jobs):
            yield from answers.items()


def _own_counts(name: str, sequence: tracking_sets.Sequence) -> TrackingCounts:
    """Of one of our rows, as the command tracks."""
    own = OURS[name]
    tracker = DeepSortTracker(own.settings)
    n_frames, fps = sequence.n_frames, sequence.fps
    done = track_sequence(sequence.found, tracker, n_frames=n_frames, fps=fps, is_online=own.is_online)
    frame = np.repeat(np.arange(len(done.frames)), [len(each) for each in done.frames])
    track_id = np.concatenate([each.track_id for each in done.frames])
    return sequence.counts(frame, track_id, np.concatenate([each.xyxy_px for each in done.frames]))


def _counts(sequence: tracking_sets.Sequence, frame: Array, track_id: Array, xyxy_px: Array) -> TrackingCounts:
    """Of a peer's tracks; an identity that it gave twice in one frame counts once."""
    _, first = np.unique(np.stack([frame, track_id]), axis=1, return_index=True)
    return sequence.counts(frame[first], track_id[first], xyxy_px[first])


def _scores(counts: Sequence[TrackingCounts]) -> Figures:
    scores = asdict(TrackingCounts.sum_of(counts).scores())
    return {name: float(scores[name]) for name in _FIGURES} | {name: int(scores[name]) for name in _COUNTS}


def _margins(rows: Mapping[str, Scores]) -> dict[str, Figures]:
    """By figure: the best peer, and how far we are ahead of it."""
    peers = [name for name in rows if name in PEERS]
    found: dict[str, Figures] = {}
    for figure in ("hota", "idf1") if peers else ():
        best = max(peers, key=lambda name: rows[name][figure])
        found[figure] = {"best_peer": best, "ahead": rows[BEST][figure] - rows[best][figure]}
    return found


def _speed(pythons: Mapping[str, Path], n_rounds: int) -> dict[str, dict[int, float]]:
    """Microseconds per frame by tracker and number of objects; NaN where a tracker was too slow."""
    scenes = [scene(n, n_frames=n_frames) for n, n_frames in SCENES.items()]
    rounds: dict[str, list[list[float]]] = {}
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as alone:
        for _ in range(n_rounds):
            rounds.setdefault(BEST, []).append(alone.submit(_own_times, scenes).result())
            for place, python in pythons.items():
                names = names_in(place, with_vectors=False)
                for name, answer in run_peers(python, names, scenes, max_s=MAX_SCENE_S).items():
                    times = [_mean_us(answer.us[i]) for i in range(len(scenes))]
                    rounds.setdefault(name, []).append(times)
    medians = {name: np.median(times, axis=0).tolist() for name, times in rounds.items()}
    return {name: dict(zip(SCENES, each, strict=True)) for name, each in medians.items()}


def _own_times(scenes: Sequence[tracking_sets.Sequence]) -> list[float]:
    found = []
    for each in scenes:
        tracker, us = DeepSortTracker(), []
        for frame in range(each.n_frames):
            given = each.found.at(frame)
            began_s = time.process_time()
            tracker.update(Detections.of(given.xyxy_px, given.score, given.class_id), frame / each.fps, None)
            us.append(1e6 * (time.process_time() - began_s))
        found.append(_mean_us(np.array(us)))
    return found


def _mean_us(us: Array) -> float:
    return float(np.mean(us[N_WARM_UP:])) if len(us) > N_WARM_UP else float("nan")


def _tell_accuracy(set_name: str, rows: Mapping[str, Scores]) -> None:
    table = _table(f"{set_name}: per cent and counts", ["tracker", *_FIGURES.values(), *_COUNTS.values()])
    ranked = [*(name for name in rows if name not in PEERS)]
    ranked += sorted((name for name in rows if name in PEERS), key=lambda name: -rows[name]["hota"])
    for name in ranked:
        figures, counts = ([rows[name][key] for key in keys] for keys in (_FIGURES, _COUNTS))
        table.add_row(name, *(f"{value:.1f}" for value in figures), *(str(value) for value in counts))
    Console(width=120).print(table)


def _tell_margins(margins: Mapping[str, Mapping[str, Figures]]) -> None:
    for set_name, figures in margins.items():
        told = (f"{_FIGURES[key]} {each['ahead']:+.1f} of {each['best_peer']}" for key, each in figures.items())
        print(f"{set_name}: {BEST} against the best peer: {', '.join(told)}", flush=True)


def _tell_speed(rows: Mapping[str, Mapping[int, float]]) -> None:
    table = _table("us per frame, boxes alone, by number of objects", ["tracker", *map(str, SCENES)])
    for name, times in sorted(rows.items(), key=lambda row: np.nan_to_num(row[1][200], nan=np.inf)):
        table.add_row(name, *("-" if np.isnan(us) else f"{us:,.0f}" for us in times.values()))
    if rows:
        Console(width=120).print(table)


def _table(title: str, headings: Sequence[str]) -> Table:
    table = Table(title=title, box=box.SIMPLE_HEAD, padding=0, title_justify="left")
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="right" if i else "left", no_wrap=True)
    return table
