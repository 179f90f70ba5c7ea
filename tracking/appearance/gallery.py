"""Gallery: the appearance embeddings of each track, and their distances from the embeddings of
boxes.

    distance = min over the track's embeddings of 1 - cos(track's embedding, box's embedding)      in [0, 2]

as in DeepSORT (Wojke et al., 2017), with a running mean and the last few embeddings instead of the
last hundred. On simulated drives, the mean and three embeddings (4 slots) separate road users as
well as the last 20 embeddings, and better than the mean alone: equal-error rates of 4, 9, 7 %
against 5, 9, 7 % and 10, 11, 8 % after 0.1, 0.6, 1.2 s. A row of zeros is an unknown appearance;
its distance is inf.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from track_range.detection.detections import Descriptors
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape

# fraction of pairs to compare below which single pairs are faster than a matrix product of all: a
# tenth
_SPARSE = 0.1
_PAIR_BLOCK = 256  # pairs compared at once: larger blocks do not fit into the processor's cache


def unit_rows(embedding: npt.NDArray[np.floating]) -> Descriptors:
    """(N, D) rows scaled to length 1; rows that are zero or not finite become zeros."""
    finite = np.isfinite(embedding).all(axis=1, keepdims=True)
    rows = np.where(finite, embedding, 0.0).astype(np.float64)
    rows /= np.maximum(
        np.abs(rows).max(axis=1, keepdims=True, initial=0.0), np.finfo(np.float64).tiny
    )
    return np.asarray(
        rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 0.5), np.float32
    )


@dataclass(frozen=True, slots=True)
class Gallery:
    """Embeddings of N tracks, K each: a running mean and the most recent embeddings; immutable."""

    # (N, K, D) float32 of length 1; slot 0 is the mean, the others are the most recent, newest
    # first. Zeros = unknown; the first embedding of a track fills all slots; D = 0 = no embeddings.
    embedding: npt.NDArray[np.float32]
    mean_memory: float = 0.9  # weight of the old mean when an embedding is appended

    def __post_init__(self) -> None:
        check_shape("embedding", self.embedding, (None, None, None))
        if self.embedding.shape[1] < 1:
            raise ValueError("embedding: expected at least one slot per track, got none")

    def __len__(self) -> int:
        return len(self.embedding)

    @classmethod
    def empty(cls, *, nn_budget: int) -> Gallery:
        """A gallery without tracks, with `nn_budget` slots per track, one of them for the mean."""
        return cls(np.zeros((0, nn_budget, 0), np.float32))

    @property
    def is_known(self) -> BoolArray:
        """(N,) whether a track has an embedding."""
        return np.asarray(self.embedding[:, 0].any(axis=1))

    def select(self, rows: BoolArray | IntArray) -> Gallery:
        """The tracks that a mask or an index array selects, in its order."""
        return Gallery(self.embedding[rows], self.mean_memory)

    def concatenate(self, other: Gallery) -> Gallery:
        """The tracks of both galleries, `other`'s last; ValueError if their shapes differ."""
        length = _common_length(self.embedding, other.embedding)
        return Gallery(
            np.concatenate(
                [_lengthened(self.embedding, length), _lengthened(other.embedding, length)]
            ),
            self.mean_memory,
        )

    def initiate(self, embedding: Descriptors) -> Gallery:
        """These tracks and a new track for each row of `embedding` (M, D), of length 1 or zeros."""
        new = np.repeat(np.asarray(embedding, np.float32)[:, None], self.embedding.shape[1], axis=1)
        return self.concatenate(Gallery(new, self.mean_memory))

    def append(self, rows: IntArray, embedding: Descriptors) -> Gallery:
        """The gallery with one more embedding (M, D) for M different tracks, `rows`; zeros change
        nothing.
        """
        known = embedding.any(axis=1)
        if not known.any():
            return self
        rows, new = rows[known], embedding[known]
        embedding = np.array(
            _lengthened(self.embedding, _common_length(self.embedding, new[:, None]))
        )
        old = embedding[rows]
        mean = unit_rows(self.mean_memory * old[:, 0] + (1 - self.mean_memory) * new)
        shifted = np.concatenate([mean[:, None], new[:, None], old[:, 1:-1]], axis=1)[
            :, : old.shape[1]
        ]
        is_first: BoolArray = np.logical_not(old[:, :1].any(axis=2, keepdims=True))
        embedding[rows] = np.where(is_first, new[:, None], shifted)
        return Gallery(embedding, self.mean_memory)

    def cosine_distance(self, embedding: Descriptors, among: BoolArray | None = None) -> FloatArray:
        """(N, M) minimum distance of each track's embeddings from each box's embedding; inf where
        one is missing.

        `embedding` (M, D) has rows of length 1 or zeros; only the pairs `among` (N, M) are
        compared; all other distances are inf.
        """
        distance = np.full((len(self), len(embedding)), np.inf)
        if not distance.size or not self.embedding.shape[2] or not embedding.shape[1]:
            return distance
        _common_length(self.embedding, embedding[:, None])
        compared: BoolArray = np.logical_and(self.is_known[:, None], embedding.any(axis=1))
        if among is not None:
            compared &= among
        if np.count_nonzero(compared) < _SPARSE * compared.size:
            rows, columns = np.nonzero(compared)
            for start in range(0, len(rows), _PAIR_BLOCK):
                i, j = rows[start : start + _PAIR_BLOCK], columns[start : start + _PAIR_BLOCK]
                cosine = (self.embedding[i] @ embedding[j, :, None])[..., 0].max(axis=1)
                distance[i, j] = 1.0 - cosine.astype(np.float64)
        else:
            best = self.embedding[:, 0] @ embedding.T
            for slot in range(1, self.embedding.shape[1]):
                np.maximum(best, self.embedding[:, slot] @ embedding.T, out=best)
            np.subtract(1.0, best, out=distance, where=compared)
        return np.asarray(np.maximum(distance, 0.0))  # rounding


def _common_length(a: Descriptors, b: Descriptors) -> int:
    """D of two (N, K, D) arrays; one array may have D = 0."""
    lengths = {a.shape[2], b.shape[2]} - {0}
    if len(lengths) > 1:
        raise ValueError(
            f"expected embeddings of equal length, got {a.shape[2]} and {b.shape[2]} numbers"
        )
    return max(lengths, default=0)


def _lengthened(embedding: Descriptors, length: int) -> Descriptors:
    """(N, K, length) embeddings: zeros if D = 0."""
    return (
        embedding
        if embedding.shape[2] == length
        else np.zeros((*embedding.shape[:2], length), np.float32)
    )
