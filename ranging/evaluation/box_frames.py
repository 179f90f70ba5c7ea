"""Labelled boxes as the tracks of frames, and the rangers of a sequence that measure them."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from track_range.foundation.arrays import IntArray
from track_range.ranging.cameras.evidence import SeenFrame
from track_range.ranging.cameras.scale_check import ScaleCheck
from track_range.ranging.evaluation.box_evaluation import frame_rows
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import Ranger, checked_ranges
from track_range.ranging.size_models.drive_scale import DriveScale, ScaleEvidence
from track_range.ranging.size_models.network_scale import NetworkDistances
from track_range.ranging.truth.errors import MethodColumn
from track_range.ranging.truth.labelled_boxes import BoxSet
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.ego_motion import Ego, EgoMotion
from track_range.tracking.tracks import Tracks


def as_frames(boxes: BoxSet, class_id: IntArray) -> Iterator[tuple[IntArray, Tracks, Frame, bool]]:
    """For each frame: row indices, tracks, blank image of the right size, and whether the frame
    starts a sequence.

    Labels without identities belong to separate images, each of which is a sequence.
    """
    sequence = -1
    for rows in frame_rows(boxes):
        n = len(rows)
        label_id = boxes.track_id[rows]
        is_image = bool((label_id < 0).any())
        track_id = np.arange(1, n + 1) if is_image else label_id + 1
        tracks = Tracks(
            track_id, boxes.xyxy_px[rows], class_id[rows], np.ones(n), np.ones(n, np.bool_)
        )
        width_px, height_px = boxes.size_px[rows[0]].tolist()
        blank = np.broadcast_to(np.zeros(1, np.uint8), (height_px, width_px, 3))
        frame = Frame(int(boxes.frame[rows[0]]), float(boxes.time_s[rows[0]]), blank, None)
        yield rows, tracks, frame, is_image or int(boxes.sequence[rows[0]]) != sequence
        sequence = int(boxes.sequence[rows[0]])


def ranges_in_frame(column: MethodColumn, tracks: Tracks, rows: IntArray) -> Ranges:
    """Ranges of the tracks of one frame, whose row indices are `rows`."""
    systematic_m = None if column.sigma_systematic_m is None else column.sigma_systematic_m[rows]
    is_fallback = column.is_fallback is None or bool(column.is_fallback[rows].all())
    return Ranges(
        tracks.track_id,
        column.distance_m[rows],
        column.sigma_m[rows],
        systematic_m,
        is_fallback=is_fallback,
    )


class SequenceRangers:
    """Rangers of one sequence with the scale of its drive.

    `reads` are the names of the methods that each reads. With a `check`, the distances of networks
    are corrected by the evidence of the drive, as in a run; `of_rig` are the methods with the scale
    of the pair.
    """

    def __init__(
        self,
        rangers: Mapping[str, Ranger],
        reads: Mapping[str, Collection[str]],
        check: ScaleCheck | None = None,
        of_rig: Sequence[str] = (),
    ) -> None:
        self._rangers, self._reads = rangers, reads
        self._check, self._of_rig = check, of_rig
        self._scale = DriveScale()

    def measure(
        self, tracks: Tracks, frame: Frame, before: Mapping[str, Ranges]
    ) -> dict[str, Ranges]:
        """Ranges of the next frame, by name; `before` are those of methods measured before."""
        measured: dict[str, Ranges] = {}
        evidence: list[ScaleEvidence] = []
        by_network: dict[str, NetworkDistances] = {}
        for name, ranger in self._rangers.items():
            known = {**before, **measured}
            others = {other: known[other] for other in self._reads[name] if other in known}
            in_frame = ranger.measure_at_scale(tracks, frame, others, self._scale)
            if in_frame.evidence:
                evidence.append(in_frame.evidence)
            if in_frame.by_network is not None:
                by_network[name] = in_frame.by_network
            measured[name] = checked_ranges(name, in_frame.ranges, tracks)
        self._scale = self._scale.after(evidence, frame.time_s)
        by_size = next((item.by_size for item in evidence if item.by_size is not None), None)
        if self._check is not None and by_network and by_size is not None:
            by_rig = next((measured[name] for name in self._of_rig if name in measured), None)
            ego = Ego(motion=EgoMotion())
            self._check.update(
                SeenFrame(tracks, by_size, by_rig, ego, frame.time_s, by_network=by_network)
            )
            self._scale = replace(self._scale, network=self._check.network_scales)
            for name, item in by_network.items():
                measured[name] = self._scale.network[name].corrected(item.ranges, item.class_id)
        return measured


def unmeasured(n: int) -> MethodColumn:
    """Distances of N boxes that are not measured, to be filled."""
    return MethodColumn(*np.full((3, n), np.nan))


def store(column: MethodColumn, rows: IntArray, ranges: Ranges) -> None:
    """Store the ranges of a frame in the column's rows."""
    column.distance_m[rows], column.sigma_m[rows] = ranges.distance_m, ranges.sigma_m
    if column.is_fallback is not None:
        column.is_fallback[rows] = ranges.is_fallback
    if column.sigma_systematic_m is not None and ranges.sigma_systematic_m is not None:
        column.sigma_systematic_m[rows] = ranges.sigma_systematic_m


def without_empty_systematic(column: MethodColumn) -> MethodColumn:
    """The column, without systematic sigmas if it has none."""
    systematic_m = column.sigma_systematic_m
    if systematic_m is None or np.isfinite(systematic_m).any():
        return column
    return replace(column, sigma_systematic_m=None)
