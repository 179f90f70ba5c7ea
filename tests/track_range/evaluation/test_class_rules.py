"""`evaluate tracks` on random sequences of KITTI, MOT17 and MOT20, against the rules and metrics of
TrackEval in loops.

The rules and metrics below follow TrackEval 1.3.0, box by box, and share nothing with ours but
SciPy's assignment. Files are written and read, so that classes, types, flags and numbering of
frames count, too.
"""

from __future__ import annotations

import itertools
import json
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from track_range.evaluation.sequences.evaluation import evaluate_tracks
from track_range.evaluation.sequences.settings import TrackEvaluationSettings

N_FRAMES = 12
KITTI_TYPES = ("Car", "Car", "Van", "Pedestrian", "Person", "Truck", "DontCare")
MOT_NUMBERS = (1, 1, 1, 2, 3, 6, 7, 8, 9, 12)


class Row(NamedTuple):
    frame: int
    id: int
    kind: str
    box: tuple[float, float, float, float]  # left, top, right, bottom
    is_clear: bool = True  # neither occluded, truncated nor flagged as not evaluated


def overlap(a, b, *, of_first: bool = False) -> float:
    """IoU of two boxes, or the fraction of the first in the second."""
    width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    common = max(width, 0.0) * max(height, 0.0)
    area_a, area_b = (a[2] - a[0]) * (a[3] - a[1]), (b[2] - b[0]) * (b[3] - b[1])
    return common / (area_a if of_first else area_a + area_b - common)


def pairs_of(truth: list[Row], results: list[Row]) -> list[tuple[int, int]]:
    """The assignment with the largest sum of IoU of at least 0.5."""
    score = np.array([[overlap(t.box, r.box) for r in results] for t in truth]).reshape(
        len(truth), len(results)
    )
    score[score < 0.5] = 0
    return [(i, j) for i, j in zip(*linear_sum_assignment(-score), strict=True) if score[i, j] > 0]


def kitti_rules(
    truth: list[Row], results: list[Row], kind: str, other: str
) -> tuple[list[Row], list[Row]]:
    asked = [row for row in truth if row.kind.lower() in (kind, other) and row.id >= 0]
    own = [row for row in results if row.kind.lower() == kind]
    pairs = pairs_of(asked, own)
    removed = {j for i, j in pairs if asked[i].kind.lower() == other or not asked[i].is_clear}
    for j in set(range(len(own))) - {j for _, j in pairs}:
        box = own[j].box
        regions = [row.box for row in truth if row.kind == "DontCare"]
        if box[3] - box[1] <= 25 or any(
            overlap(box, region, of_first=True) > 0.5 for region in regions
        ):
            removed.add(j)
    kept = [row for row in asked if row.kind.lower() == kind and row.is_clear]
    return kept, [row for j, row in enumerate(own) if j not in removed]


def mot_rules(
    truth: list[Row], results: list[Row], distractors: tuple[str, ...]
) -> tuple[list[Row], list[Row]]:
    removed = {j for i, j in pairs_of(truth, results) if truth[i].kind in distractors}
    kept = [row for row in truth if row.kind == "1" and row.is_clear]
    return kept, [row for j, row in enumerate(results) if j not in removed]


def metrics(frames: list[tuple[list[Row], list[Row]]]) -> dict[str, float]:
    """HOTA, MOTA, IDF1 and counts of one sequence in per cent, from the boxes of each frame that
    count."""
    n_truth, n_results = (sum(len(pair[k]) for pair in frames) for k in (0, 1))
    of_truth, of_results = (Counter(row.id for pair in frames for row in pair[k]) for k in (0, 1))
    likely: Counter[tuple[int, int]] = Counter()
    common: Counter[tuple[int, int]] = Counter()
    tables = []
    for truth, results in frames:
        table = {(t.id, r.id): overlap(t.box, r.box) for t in truth for r in results}
        tables.append(table)
        for t, r in table:
            row = sum(v for (i, _), v in table.items() if i == t)
            column = sum(v for (_, j), v in table.items() if j == r)
            if (total := row + column - table[t, r]) > 0:
                likely[t, r] += table[t, r] / total
            common[t, r] += table[t, r] >= 0.5
    matched: list[list[tuple[int, int, float]]] = []
    tp = switches = 0
    last: dict[int, int] = {}
    before: dict[int, int] = {}
    for (truth, results), table in zip(frames, tables, strict=True):
        ids = [t.id for t in truth], [r.id for r in results]
        alignment = {
            key: likely[key] / (of_truth[key[0]] + of_results[key[1]] - likely[key])
            for key in table
        }
        matched.append(
            assigned(ids, {key: alignment[key] * value for key, value in table.items()}, table)
        )
        if not truth or not results:
            continue
        bonus = {
            key: 1000 * (before.get(key[0]) == key[1]) + v if v >= 0.5 else 0
            for key, v in table.items()
        }
        pairs = [pair for pair in assigned(ids, bonus, table) if bonus[pair[:2]] > 0]
        tp += len(pairs)
        switches += sum(t in last and last[t] != r for t, r, _ in pairs)
        before = {t: r for t, r, _ in pairs}
        last |= before
    hota = []
    for alpha in np.arange(0.05, 0.99, 0.05):
        pairs = [pair for frame in matched for pair in frame if pair[2] >= alpha - 1e-15]
        n_pairs = Counter(pair[:2] for pair in pairs)
        det = len(pairs) / max(n_truth + n_results - len(pairs), 1)
        ass = sum(n * n / (of_truth[t] + of_results[r] - n) for (t, r), n in n_pairs.items()) / max(
            len(pairs), 1
        )
        hota.append(np.sqrt(det * ass))
    truth_ids, result_ids = list(of_truth), list(of_results)
    idtp = sum(common[pair[:2]] for pair in assigned((truth_ids, result_ids), common, common))
    return {
        "hota": 100 * float(np.mean(hota)),
        "mota": 100 * (tp - (n_results - tp) - switches) / n_truth,
        "idf1": 100 * 2 * idtp / (n_truth + n_results),
        "fp": n_results - tp,
        "fn": n_truth - tp,
        "idsw": switches,
    }


def assigned(ids, score, value) -> list[tuple[int, int, float]]:
    """Pairs of identities with the largest total score, each with its value."""
    table = np.array([[score[t, r] for r in ids[1]] for t in ids[0]], float).reshape(
        len(ids[0]), len(ids[1])
    )
    rows, columns = linear_sum_assignment(-table)
    return [
        (ids[0][i], ids[1][j], value[ids[0][i], ids[1][j]])
        for i, j in zip(rows, columns, strict=True)
    ]


def sequence(
    rng: np.random.Generator, kinds: tuple, result_kinds: tuple
) -> tuple[list[Row], list[Row]]:
    """Random objects that move, and tracks of them with noise, gaps, exchanged identities and false
    boxes."""
    truth, results = [], []
    start = rng.uniform([0, 0, 15, 15], [400, 150, 90, 90], (9, 4))
    drawn = rng.choice(len(kinds), 9)
    tracked_kind = rng.choice(len(result_kinds), 14)
    for f, n in itertools.product(range(N_FRAMES), range(9)):
        x, y = start[n, :2] + f * np.array([3.0, 0.5])
        box = np.round([x, y, x + start[n, 2], y + start[n, 3]], 2)
        kind = str(kinds[drawn[n]])
        if rng.random() < 0.8:
            truth.append(
                Row(
                    f,
                    -1 if kind == "DontCare" else n,
                    kind,
                    tuple(box.tolist()),
                    bool(rng.random() < 0.75),
                )
            )
        if rng.random() < 0.8:
            noisy = np.round(box + rng.normal(0, 2.5, 4), 2)
            identity = n + 20 if f < rng.integers(4, 30) else 20 + (n + 1) % 9
            if identity not in {row.id for row in results if row.frame == f}:
                results.append(
                    Row(f, identity, str(result_kinds[tracked_kind[n]]), tuple(noisy.tolist()))
                )
        if n < 3:
            x, y, w, h = np.round(rng.uniform([0, 0, 10, 15], [450, 180, 60, 60]), 2)
            results.append(
                Row(
                    f,
                    40 + n,
                    str(result_kinds[tracked_kind[9 + n]]),
                    (x, y, round(x + w, 2), round(y + h, 2)),
                )
            )
    return truth, results


def kitti_text(rng, rows, *, are_truth: bool) -> str:
    lines = []
    for row in rows:
        unclear = [("1", "0"), ("0", "3"), ("1.2", "1")][rng.integers(3)]
        flags = (
            ("0", "2") if row.is_clear and are_truth else ("0.5", "0") if row.is_clear else unclear
        )
        box = " ".join(f"{edge:.2f}" for edge in row.box)
        lines.append(
            f"{row.frame} {row.id} {row.kind} {' '.join(flags)} -10 {box} -1 -1 -1 -1000 "
            "-1000 -1000 -10"
        )
    return "\n".join(lines) + "\n"


def mot_text(rows, *, are_truth: bool) -> str:
    lines = []
    for row in rows:
        left, top, right, bottom = row.box
        end = f"{int(row.is_clear)},{row.kind},0.5" if are_truth else "0.7,-1,-1,-1"
        place = f"{left + 1:.2f},{top + 1:.2f},{right - left:.2f},{bottom - top:.2f}"
        lines.append(f"{row.frame + 1},{row.id},{place},{end}")
    return "\n".join(lines) + "\n"


def differences(folder: Path, seed: int) -> list[float]:
    """Differences between our metrics and those above for one sequence by the rules of each
    benchmark."""
    rng = np.random.default_rng(seed)
    cases = []
    for kind, other, road_class in (("car", "van", "car"), ("pedestrian", "person", "person")):
        truth, results = sequence(rng, KITTI_TYPES, ("Car", "car", "Van", "Pedestrian", "Person"))
        texts = kitti_text(rng, truth, are_truth=True), kitti_text(rng, results, are_truth=False)
        cases.append(
            (
                "0001",
                road_class,
                texts,
                truth,
                results,
                lambda t, r, k=kind, o=other: kitti_rules(t, r, k, o),
            )
        )
    for name, distractors in (("MOT17-02", "2 7 8 12"), ("MOT20-01", "2 6 7 8 12")):
        truth, results = sequence(rng, MOT_NUMBERS, ("",))
        texts = mot_text(truth, are_truth=True), mot_text(results, are_truth=False)
        chosen = tuple(distractors.split())
        cases.append(
            (name, "person", texts, truth, results, lambda t, r, d=chosen: mot_rules(t, r, d))
        )
    values = []
    for name, road_class, texts, truth, results, rules in cases:
        paths = folder / f"{name}.txt", folder / f"{name}-tracks.txt"
        for path, text in zip(paths, texts, strict=True):
            path.write_text(text)
        frames = [
            rules(
                [row for row in truth if row.frame == f], [row for row in results if row.frame == f]
            )
            for f in range(N_FRAMES)
        ]
        if not any(pair[0] for pair in frames):
            continue
        expected = metrics(frames)
        settings = TrackEvaluationSettings(truth=paths[0], results=paths[1], road_class=road_class)
        found = evaluate_tracks(settings)["combined"]
        values += [abs(found[key] - value) for key, value in expected.items()]
    return values


@pytest.mark.parametrize("seed", range(8))
def test_rules_and_metrics(tmp_path: Path, seed: int) -> None:
    values = differences(tmp_path, seed)
    assert len(values) >= 12
    assert max(values) < 1e-9, json.dumps(values)
