"""Gallery: what each track has looked like so far, and how far boxes' looks are from it.

    distance = 1 - cos(track's descriptor, box's descriptor), least over what the track keeps      in [0, 2]

as in DeepSORT (Wojke et al., 2017), with a running mean and the last few descriptors in place of the last hundred. On
simulated drives the mean and three (4 slots) tell road users apart as well as a track's whole past of up to 20 does,
and better than the mean alone: equal-error rates 4, 9, 7 % against 5, 9, 7 % and 10, 11, 8 % after 0.1, 0.6, 1.2 s.
A row of zeros stands for looks that nobody could tell; it is at distance inf from everything.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from track_range.detection.detections import Descriptors
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape

_SPARSE = 0.1
"""Share of pairs below which they are compared one by one: a pair alone costs ten times one in a matrix product."""

_PAIR_BLOCK = 256


def unit_rows(descriptor: npt.NDArray[np.floating]) -> Descriptors:
    """(N, D) rows brought to length 1; rows that are zero or not finite become zeros."""
    finite = np.isfinite(descriptor).all(axis=1, keepdims=True)
    rows = np.where(finite, descriptor, 0.0).astype(np.float64)
    rows /= np.maximum(np.abs(rows).max(axis=1, keepdims=True, initial=0.0), np.finfo(np.float64).tiny)
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 0.5), np.float32)


@dataclass(frozen=True, slots=True)
class Gallery:
    """What each track has looked like: a running mean and the last descriptors; never written to.

    Attributes:
        kept: (N, K, D) float32 of length 1, slot 0 the mean, then the newest first; zeros where nothing is known, and
            a track with one descriptor has it in every slot. D = 0 = nobody describes.
        mean_memory: share of the old mean that a new descriptor leaves.
    """

    kept: npt.NDArray[np.float32]
    mean_memory: float = 0.9

    def __post_init__(self) -> None:
        check_shape("kept", self.kept, (None, None, None))
        if self.kept.shape[1] < 1:
            raise ValueError("kept: at least one slot per track wanted, none got")

    def __len__(self) -> int:
        return len(self.kept)

    @classmethod
    def empty(cls, *, n_kept: int) -> Gallery:
        """Of no tracks, with `n_kept` slots, the mean's among them."""
        return cls(np.zeros((0, n_kept, 0), np.float32))

    @property
    def is_known(self) -> BoolArray:
        """(N,) which tracks have a descriptor."""
        return np.asarray(self.kept[:, 0].any(axis=1))

    def select(self, keep: BoolArray | IntArray) -> Gallery:
        """The tracks that a mask or an index array names, in its order."""
        return Gallery(self.kept[keep], self.mean_memory)

    def joined(self, other: Gallery) -> Gallery:
        """These tracks, then the other's; tracks that nobody described fit descriptors of any length.

        Raises:
            ValueError: the numbers of slots, or the lengths of descriptors, differ.
        """
        length = _common_length(self.kept, other.kept)
        return Gallery(
            np.concatenate([_lengthened(self.kept, length), _lengthened(other.kept, length)]), self.mean_memory
        )

    def begun(self, descriptor: Descriptors) -> Gallery:
        """These tracks, then a new one for each row of `descriptor` (M, D), of length 1 or zeros.

        Raises:
            ValueError: the descriptors are of another length than these tracks'.
        """
        new = np.repeat(np.asarray(descriptor, np.float32)[:, None], self.kept.shape[1], axis=1)
        return self.joined(Gallery(new, self.mean_memory))

    def appended(self, rows: IntArray, descriptor: Descriptors) -> Gallery:
        """With one more descriptor (M, D) for each of M tracks, `rows`, no track twice; rows of zeros change nothing.

        Raises:
            ValueError: the descriptors are of another length than these tracks'.
        """
        known = descriptor.any(axis=1)
        if not known.any():
            return self
        rows, new = rows[known], descriptor[known]
        kept = np.array(_lengthened(self.kept, _common_length(self.kept, new[:, None])))
        old = kept[rows]
        mean = unit_rows(self.mean_memory * old[:, 0] + (1 - self.mean_memory) * new)
        shifted = np.concatenate([mean[:, None], new[:, None], old[:, 1:-1]], axis=1)[:, : old.shape[1]]
        is_first: BoolArray = np.logical_not(old[:, :1].any(axis=2, keepdims=True))
        kept[rows] = np.where(is_first, new[:, None], shifted)
        return Gallery(kept, self.mean_memory)

    def cosine_distance(self, descriptor: Descriptors, among: BoolArray | None = None) -> FloatArray:
        """(N, M) least distance of each track's descriptors from each box's (M, D); inf where one of them is unknown.

        Args:
            descriptor: of boxes, of length 1 or zeros.
            among: (N, M) the pairs that matter, where that is known; the others are inf. Few are told faster.

        Raises:
            ValueError: the descriptors are of another length than these tracks'.
        """
        distance = np.full((len(self), len(descriptor)), np.inf)
        if not distance.size or not self.kept.shape[2] or not descriptor.shape[1]:
            return distance
        _common_length(self.kept, descriptor[:, None])
        wanted: BoolArray = np.logical_and(self.is_known[:, None], descriptor.any(axis=1))
        if among is not None:
            wanted &= among
        if np.count_nonzero(wanted) < _SPARSE * wanted.size:
            rows, columns = np.nonzero(wanted)
            distance[rows, columns] = self._distance_of_pairs(rows, columns, descriptor)
        else:
            best = self.kept[:, 0] @ descriptor.T
            for slot in range(1, self.kept.shape[1]):
                np.maximum(best, self.kept[:, slot] @ descriptor.T, out=best)
            np.subtract(1.0, best, out=distance, where=wanted)
        return np.asarray(np.maximum(distance, 0.0))  # rounding

    def _distance_of_pairs(self, rows: IntArray, columns: IntArray, descriptor: Descriptors) -> FloatArray:
        """(P,) for each pair of a track and a box."""
        best = np.empty(len(rows))
        for start in range(0, len(rows), _PAIR_BLOCK):
            part = slice(start, start + _PAIR_BLOCK)
            best[part] = (self.kept[rows[part]] @ descriptor[columns[part], :, None])[..., 0].max(axis=1)
        return 1.0 - best


def _common_length(a: Descriptors, b: Descriptors) -> int:
    """D of two (N, K, D) arrays, 0 fitting any."""
    lengths = {a.shape[2], b.shape[2]} - {0}
    if len(lengths) > 1:
        raise ValueError(f"descriptors of one length wanted, {a.shape[2]} and {b.shape[2]} numbers got")
    return max(lengths, default=0)


def _lengthened(kept: Descriptors, length: int) -> Descriptors:
    """(N, K, length): zeros where nobody described."""
    return kept if kept.shape[2] == length else np.zeros((*kept.shape[:2], length), np.float32)
