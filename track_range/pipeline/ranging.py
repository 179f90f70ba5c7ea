"""RangingStage: distances of the tracks of a frame by every method, and what they show of the scale
of the drive.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from typing import Any, Self, TypeVar

from track_range.detection.lanes.lines import LaneLines
from track_range.foundation.errors import Note, named_errors
from track_range.foundation.files.input_files import counted
from track_range.pipeline.clock import StageClock
from track_range.ranging.measurement.dense_map import DenseMap
from track_range.ranging.measurement.focal_scale import FocalScale
from track_range.ranging.measurement.growth import Growth
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.measurement.rig_scale import CALIBRATED, RigScale
from track_range.ranging.methods.method import MethodError, Ranger, checked_ranges
from track_range.ranging.registry import methods
from track_range.ranging.size_models.drive_scale import DriveScale, ScaleEvidence
from track_range.ranging.size_models.network_scale import NetworkDistances
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.ego_motion import Ego
from track_range.tracking.tracks import Tracks

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class FrameRanges:
    """Distances of the tracks of a frame by the methods that ran."""

    ranges: Mapping[str, Ranges]  # by name of the method, in the order of execution
    evidence: tuple[ScaleEvidence, ...] = ()  # of the scale of the drive
    # the same before the correction of the scale of the rig, by the methods that have it
    of_rig: Mapping[str, Ranges] = field(default_factory=dict)
    alignment: Alignment | None = None  # of the pair in the frame; None = that of its rig
    # of the methods that measure all pixels, by name
    dense: Mapping[str, DenseMap] = field(default_factory=dict)
    rig: RigScale = CALIBRATED  # by which `ranges` are corrected
    # those of depth networks before the correction of their scales
    by_network: Mapping[str, NetworkDistances] = field(default_factory=dict)
    # methods that are not fused, and show nothing of the drive to the others
    shown_only: frozenset[str] = frozenset()

    @property
    def to_fuse(self) -> Mapping[str, Ranges]:
        """The distances that are fused, by name of the method."""
        if not self.shown_only:
            return self.ranges
        return {name: one for name, one in self.ranges.items() if name not in self.shown_only}

    @property
    def by_size(self) -> Ranges | None:
        """Distances by size, without the correction of the drive's scale; None = no method measures
        them.
        """
        return next((item.by_size for item in self.evidence if item.by_size is not None), None)

    @property
    def by_rig(self) -> Ranges | None:
        """Distances with the scale of the rig, before its correction; None = no method has it."""
        return next((self.of_rig[name] for name in self.of_rig if name in self.to_fuse), None)

    def at_scale(self, scale: DriveScale) -> Self:
        """The distances with the scales of the rig and of networks as this frame shows them."""
        rig, corrected = scale.rig, dict[str, Ranges]()
        if rig != self.rig:
            corrected = {name: rig.corrected(ranges) for name, ranges in self.of_rig.items()}
        for name, item in self.by_network.items():
            if (network := scale.network.get(name)) is not None:
                corrected[name] = network.corrected(item.ranges, item.class_id)
        if not corrected:
            return self
        dense = {
            name: replace(dense, scale=rig) if name in self.of_rig else dense
            for name, dense in self.dense.items()
        }
        return replace(self, ranges={**self.ranges, **corrected}, rig=rig, dense=dense)

    @property
    def growth(self) -> Growth | None:
        """Growth of the tracks in the images; None = no method measures it."""
        listed = self.to_fuse.values()
        return next((item.growth for item in listed if item.growth is not None), None)


def stretched(dense: Mapping[str, DenseMap], focal: FocalScale) -> dict[str, DenseMap]:
    """Dense maps whose depths have the true focal length."""
    if not focal.log_factor:
        return dict(dense)
    return {name: one.stretched(focal.log_factor) for name, one in dense.items()}


@dataclass(slots=True)
class RangingStage:
    """The ranging methods by name, in the order of execution
    (`ranging.registry.create_rangers`).
    """

    rangers: Mapping[str, Ranger]
    shown_only: frozenset[str] = frozenset()  # names of those that are not fused
    _reads: Mapping[str, tuple[str, ...]] = field(
        default_factory=lambda: {method.name: method.reads for method in methods()}
    )
    # with the scale of the rig, in the order of the registry
    _of_rig: tuple[str, ...] = field(
        default_factory=lambda: tuple(method.name for method in methods() if method.has_rig_scale)
    )
    has_depths: bool = False  # whether a method measured the depths of all pixels so far
    _lanes: LaneLines | None = None
    # values by method and invalid column
    _n_invalid: Counter[tuple[str, str]] = field(default_factory=Counter)
    # messages of methods that failed at the end
    _failures: dict[str, None] = field(default_factory=dict)

    def start(self, frame: Frame) -> None:
        """Start the methods that work in the background, before the tracks are known."""
        for name, ranger in self.rangers.items():
            with _named(name, ranger, f", frame {frame.index}"):
                ranger.start(frame)

    def measure(
        self,
        tracks: Tracks,
        frame: Frame,
        lanes: LaneLines | None,
        ego: Ego,
        scale: DriveScale,
        clock: StageClock,
    ) -> FrameRanges:
        """Distances of the tracks by every method; each is timed under its name.

        Raises MethodError if a ranger of another package failed, or did not return ranges of these
        tracks.
        """
        ranges, of_rig = dict[str, Ranges](), dict[str, Ranges]()
        evidence: list[ScaleEvidence] = []
        by_network = dict[str, NetworkDistances]()
        for name, ranger in self.rangers.items():
            others = self._read_by(name, ranges)
            with clock.stage(name):
                try:
                    self._update(ranger, ego, lanes)
                    measured = ranger.measure_at_scale(tracks, frame, others, scale)
                except Exception:  # named here, since a context takes longer than some methods
                    with _named(name, ranger, f", frame {frame.index}"):
                        raise
                ranges[name] = checked_ranges(name, measured.ranges, tracks, self._n_invalid)
            if measured.by_network is not None and name not in self.shown_only:
                by_network[name] = measured.by_network
            shown = measured.evidence
            if name in self._of_rig:
                of_rig[name] = ranges[name]
                ranges[name] = scale.rig.corrected(ranges[name])
                shown = None if shown is None else shown.of_rig(scale.rig)
            if shown is not None and name not in self.shown_only:
                evidence.append(shown)
        self._lanes = lanes
        by_registry = {name: of_rig[name] for name in self._of_rig if name in of_rig}
        return FrameRanges(
            ranges,
            tuple(evidence),
            by_registry,
            frame.alignment,
            self._dense(scale.rig),
            scale.rig,
            by_network,
            self.shown_only,
        )

    def _read_by(self, name: str, ranges: Mapping[str, Ranges]) -> dict[str, Ranges]:
        """The distances that a method reads: what is only shown is for others that are only
        shown.
        """
        hidden = frozenset() if name in self.shown_only else self.shown_only
        read = [other for other in self._reads.get(name, ()) if other not in hidden]
        return {other: ranges[other] for other in read if other in ranges}

    def _update(self, ranger: Ranger, ego: Ego, lanes: LaneLines | None) -> None:
        """Tell a method what the image shows of the road, the motion of the camera and the lane."""
        if ego.road is not None:
            ranger.update_road(ego.road)
        if ego.step is not None:
            ranger.update_motion(ego.step)
        if lanes is not None and lanes is not self._lanes:
            ranger.update_lanes(lanes)

    def skip(self, tracks: Tracks, frame: Frame) -> FrameRanges:
        """No distances of the tracks: the image of the frame, which was started, shows nothing of
        its time.
        """
        for name, ranger in self.rangers.items():
            with _named(name, ranger, f", frame {frame.index}"):
                ranger.skip(frame)
        unmeasured = Ranges.unmeasured(tracks.track_id)
        return FrameRanges(dict.fromkeys(self.rangers, unmeasured), shown_only=self.shown_only)

    def _dense(self, rig: RigScale) -> dict[str, DenseMap]:
        dense = {name: ranger.dense for name, ranger in self.rangers.items()}
        known = {name: one for name, one in dense.items() if one is not None}
        of_rig = {
            name: replace(one, scale=rig) for name, one in known.items() if name in self._of_rig
        }
        self.has_depths |= any(one.is_depth for one in known.values())
        return {**known, **of_rig}

    def notes(self) -> tuple[str, ...]:
        """Notes for the user: of the methods at their end, and on invalid values and methods."""
        notes = [
            note
            for of_method in self._answers(lambda ranger: tuple(ranger.notes))
            for note in of_method
        ]
        self.summary()  # its failures are notes, too
        for name in self.rangers:
            counts = {
                column: n for (method, column), n in self._n_invalid.items() if method == name and n
            }
            if counts:
                reasons = ", ".join(f"{column} in {n}" for column, n in counts.items())
                skipped = (
                    f"skipped {counted(sum(counts.values()), 'value')}, since only positive and "
                    "finite values are valid"
                )
                sentence = f"Ranging method {name!r}: {skipped} ({reasons})."
                notes.append(Note(sentence, "method-values-invalid", "warning", "methods"))
        failures = [Note(text, "method-failed", "error", "methods") for text in self._failures]
        return (*notes, *failures)

    def summary(self) -> dict[str, Any]:
        """Entries of the methods for summary.json."""
        answers = self._answers(lambda ranger: ranger.summary())
        return {key: value for entries in answers for key, value in entries.items()}

    def _answers(self, ask: Callable[[Ranger], _T]) -> list[_T]:
        """The answers of the methods at the end, without the methods that fail then: the distances
        are complete.
        """
        answers = []
        for name, ranger in self.rangers.items():
            try:
                with _named(name, ranger, ", end of the run"):
                    answers.append(ask(ranger))
            except MethodError as error:
                self._failures.setdefault(str(error))
        return answers

    def close(self, clock: StageClock) -> None:
        """End the methods' threads, and add their time to the clock."""
        for name, ranger in self.rangers.items():
            with _named(name, ranger, ", end of the run"):
                ranger.close()
            clock.add(name, ranger.background_s)


def _named(name: str, ranger: Ranger, where: str) -> AbstractContextManager[None]:
    return named_errors(type(ranger).__module__, f"ranging method {name!r}{where}", MethodError)
