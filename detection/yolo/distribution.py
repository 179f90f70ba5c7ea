"""Layouts of networks whose box sides are distributions over distances: NanoDet and PicoDet.

    outputs, for R + 1 = 8 bins and n(s) = ceil(h / s) ceil(w / s) cells                 cell centre    family
    scores [1, n(s), C] and bins [1, n(s), 32] for each stride s of 8, 16, 32            (i + 1/2) s    NanoDet
    the same, of 8, 16, 32, 64                                                           (i + 1/2) s    PicoDet
    [1, sum of n(s), C + 32], strides 8, 16, 32                                          (i + 1/2) s    NanoDet
    [1, sum of n(s), C + 32], strides 8, 16, 32, 64                                      i s            NanoDet-Plus

Scores are probabilities, bins are logits, in the order left, top, right, bottom. The outputs are recognised by shape,
in any order: their names are numbers of nodes. (Li et al., "Generalized Focal Loss", 2020, equations 5 and 6; Yu et
al., "PP-PicoDet", 2021; NanoDet's and PaddleDetection's heads, for the centres of the cells.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from track_range.detection.yolo.decoders import Candidates
from track_range.detection.yolo.input_format import IMAGENET_MEAN, IMAGENET_STD, InputFormat
from track_range.detection.yolo.network_outputs import NetworkOutputs, YoloModel
from track_range.foundation.arrays import FloatArray, FloatArray32

_N_BINS = 8  # number of bins per side, R + 1 with the R = 7 of all published NanoDet and PicoDet networks
_STRIDES_PX = {3: (8, 16, 32), 4: (8, 16, 32, 64)}  # by number of levels

_NANODET_INPUT = InputFormat(
    pad_grey=0, colours="bgr", divisor=1.0, mean=(103.53, 116.28, 123.675), std=(57.375, 57.12, 58.395)
)
_NANODET_PLUS_INPUT = replace(_NANODET_INPUT, placement="stretch", pad_grey=114)
_PICODET_INPUT = InputFormat(placement="stretch", mean=IMAGENET_MEAN, std=IMAGENET_STD)


@dataclass(frozen=True, slots=True)
class Level:
    """Outputs of the cells of one stride."""

    scores_output: int  # index of the output, which may be that of the bins, too
    bins_output: int
    rows: slice  # rows of the outputs
    score_columns: slice  # of the C scores
    bin_columns: slice  # of the 4 (R + 1) bins
    centre_px: FloatArray  # (n, 2) centre of each cell in the network's corner coordinates
    stride_px: int  # unit of the distances


def decode_distributions(
    levels: Sequence[Level], input_hw: tuple[int, int], outputs: Sequence[FloatArray32], min_score: FloatArray
) -> Candidates:
    """Candidates of scores and distributions of the distances from a cell's centre to the four sides of the box.

        P(k) = exp(t_k) / sum over j of exp(t_j)          k = 0 .. R
        distance = s * sum over k of k P(k)
        left = x - distance_0, top = y - distance_1, right = x + distance_2, bottom = y + distance_3

    Boxes are clipped to the input, as in the original implementations.
    """
    boxes, scores = [], []
    for level in levels:
        level_scores = outputs[level.scores_output][0, level.rows, level.score_columns]
        kept = np.flatnonzero(~(level_scores.max(axis=1) < float(min_score.min())))
        t = outputs[level.bins_output][0, level.rows, level.bin_columns][kept].astype(np.float64)
        t = t.reshape(-1, 4, _N_BINS)
        powers = np.exp(t - t.max(axis=2, keepdims=True))
        distance = level.stride_px * (powers @ np.arange(_N_BINS)) / powers.sum(axis=2)
        centre = level.centre_px[kept]
        boxes.append(np.concatenate([centre - distance[:, :2], centre + distance[:, 2:]], axis=1))
        scores.append(level_scores[kept])
    height, width = input_hw
    clipped = np.clip(np.concatenate(boxes), 0, np.array([width, height, width, height], np.float64))
    return Candidates.of(clipped, np.concatenate(scores), min_score)


def scores_and_bins(network: NetworkOutputs) -> YoloModel | None:
    """Match of scores [1, n(s), C] and bins [1, n(s), 32] for each of three or four strides, in any order.

    If C is also 32, the scores of a stride are the output that comes first, as in all exports.
    """
    strides_px = _STRIDES_PX.get(len(network.shapes) // 2)
    if strides_px is None or len(network.shapes) % 2 or len(list(network.matrices())) != len(network.shapes):
        return None
    levels, n_classes = [], set()
    for stride_px in strides_px:
        centre_px = _centres(network.input_hw, stride_px, offset=0.5)
        outputs = [(i, width) for i, n, width in network.matrices() if n == len(centre_px)]
        bins = [i for i, width in outputs if width == 4 * _N_BINS]
        if len(outputs) != 2 or not bins:
            return None
        (scores,) = (i for i, _ in outputs if i != bins[-1])
        levels.append(Level(scores, bins[-1], slice(None), slice(None), slice(None), centre_px, stride_px))
        n_classes.add(network.shapes[scores][2])
    if len(n_classes) != 1:
        return None
    is_picodet = len(strides_px) == len(_STRIDES_PX[4])
    return YoloModel(
        "PicoDet" if is_picodet else "NanoDet",
        f"scores and distances of {len(levels)} strides, {_N_BINS} bins",
        n_classes.pop(),
        _PICODET_INPUT if is_picodet else _NANODET_INPUT,
        partial(decode_distributions, levels, network.input_hw),
        score_outputs=tuple(level.scores_output for level in levels),
    )


def score_and_bin_rows(network: NetworkOutputs) -> YoloModel | None:
    """Match of one output [1, n, C + 32] with the cells of three or four strides.

    With three strides, YOLOX's rows of 5 + C' columns have the same shape: C is then the number of explicit names, else
    80 or 20.
    """
    for i, n_rows, n_columns in network.matrices():
        n_classes = n_columns - 4 * _N_BINS
        for strides_px in _STRIDES_PX.values():
            is_plus = len(strides_px) == len(_STRIDES_PX[4])
            centres = [_centres(network.input_hw, stride, offset=0.0 if is_plus else 0.5) for stride in strides_px]
            is_certain = is_plus or n_classes == network.n_names or (network.n_names is None and n_classes in (80, 20))
            if n_rows != sum(map(len, centres)) or n_classes < 1 or not is_certain:
                continue
            ends = np.cumsum([len(centre) for centre in centres]).tolist()
            columns = slice(0, n_classes), slice(n_classes, n_columns)
            levels = tuple(
                Level(i, i, slice(end - len(centre), end), *columns, centre, stride)
                for centre, end, stride in zip(centres, ends, strides_px, strict=True)
            )
            return YoloModel(
                "NanoDet-Plus" if is_plus else "NanoDet",
                f"rows {[1, n_rows, n_columns]}: classes, distances of {len(levels)} strides, {_N_BINS} bins",
                n_classes,
                _NANODET_PLUS_INPUT if is_plus else _NANODET_INPUT,
                partial(decode_distributions, levels, network.input_hw),
            )
    return None


def _centres(input_hw: tuple[int, int], stride_px: int, *, offset: float) -> FloatArray:
    """(n, 2) x and y of the centres of a stride's cells, row by row: (column + offset) s, (row + offset) s."""
    n_rows, n_columns = (-(-side // stride_px) for side in input_hw)
    x, y = np.meshgrid(np.arange(n_columns), np.arange(n_rows))
    return np.asarray((np.stack([x, y], axis=-1).reshape(-1, 2) + offset) * stride_px, np.float64)
