"""DriveVideo: a recorded drive before it is read, and the parts of it that are."""

import math
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace

from track_range.foundation.errors import UsageError
from track_range.recording.cameras.focal_sources import focal_guesses
from track_range.recording.cameras.known_lenses import UNKNOWN_LENS, GivenLens
from track_range.recording.recording import Recording, open_recording
from track_range.recording.sources.names import VideoName, source_of
from track_range.recording.sources.open_video import open_video
from track_range.recording.speed_source import open_speed
from track_range.recording.video.options import DEFAULTS, RecordingOptions
from track_range.stereo.geometry.focal_guess import FocalGuess, best_guess
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.self_calibration.turns import turning_spans
from track_range.stereo.speed.ego_speed import EgoSpeed

# length up to which all of a recording is read, and that of the parts of a longer one, seconds
_WHOLE_S, _PART_S = 30.0, 10.0
# Length in which turns are sought: decoding an hour would take minutes. Time between the images,
# time after keyframes in which they are, and the smallest turn that is read first.
_SCANNED_S, _SCAN_S, _BURST_S, _MIN_TURN_DEG = 180.0, 0.14, 0.25, 20.0
# starts of the parts of a longer recording, as fractions of it
_PARTS = (0.0, 0.5, 0.85)

_LEAST_PART_S = 1.0  # shortest rest of a drive that is worth reading

Part = tuple[float, float | None]
"""Start and length of a part of a drive, s; None = to the end."""

TIME_EPSILON_S = 0.004  # tolerance of times between frames, for frame rates that divide them


@dataclass(frozen=True, slots=True)
class DriveVideo:
    """What is known of a recorded drive before it is read."""

    name: VideoName
    size_px: tuple[int, int]  # width, height, with square pixels
    duration_s: float  # of the part that may be read; 0 = unknown
    guesses: tuple[FocalGuess, ...]  # of the focal length, from outside the images
    # how it is opened; `start_s` and `duration_s` are the part that may be read
    options: RecordingOptions = DEFAULTS
    speed: EgoSpeed | None = None  # of the camera, from outside the images; None = unknown

    @classmethod
    def of(cls, name: VideoName, lens: GivenLens = UNKNOWN_LENS) -> "DriveVideo":
        """The drive of a video; UsageError for a live source."""
        if not source_of(name).files:
            raise UsageError(
                f"{name}: expected a recorded video, found a live source; record the camera first."
            )
        with closing(open_video(name)) as reader:
            duration_s = (reader.n_frames or 0) / reader.fps if reader.fps else 0.0
            guesses = focal_guesses(reader, lens)
            return cls(name, reader.shown_size_px, duration_s, guesses)

    @classmethod
    def of_recording(cls, recording: Recording, speed: EgoSpeed | None = None) -> "DriveVideo":
        """The drive of the left or only camera of an opened recording without a calibration, which
        is opened again; `speed` is that of the camera, if it is given.
        """
        video, options = recording.videos[0], recording.options
        duration_s = (video.n_frames or 0) / video.fps if video.fps else 0.0
        return cls(
            video.path,
            recording.size_px,
            duration_s,
            recording.calibration.guesses,
            replace(options, topics=(), stereo_layout=None, start_utc=None),
            speed,
        )

    def with_speed(self, setting: str) -> "DriveVideo":
        """The drive with the speed of a setting of `open_speed`; its errors."""
        with self.opened(0.0, None) as recording:
            return replace(self, speed=open_speed(setting, recording).ego)

    def parts_s(self) -> list[Part]:
        """Start and length of each part that is read, None = to the end: those with the largest
        turns, else all of a short drive, or some of a long one.
        """
        start_s, length_s = self._span_s
        given_s = self.options.duration_s
        if 0 < length_s <= (_PART_S if self.speed is None else _WHOLE_S):
            return [(start_s, given_s)]  # straight parts, too, show the scale of a given speed
        with self.opened(start_s, min(length_s or _SCANNED_S, _SCANNED_S)) as recording:
            frames = every_step(_SCAN_S, recording.near_keyframes(_BURST_S).frames)
            images = ((frame.time_s, frame.left) for frame in frames)
            turns = turning_spans(images, span_s=_PART_S, min_turn_deg=_MIN_TURN_DEG)
        if turns:
            return [(turn.start_s, turn.end_s - turn.start_s) for turn in turns]
        return [(start_s, given_s)] if 0 < length_s <= _WHOLE_S else [*self._usual_parts_s]

    def rest_s(self, parts: Sequence[Part]) -> list[Part]:
        """Start and length of what these parts leave out of what is read of a drive without
        turns.
        """
        rest = [(first_s, first_s + part_s) for first_s, part_s in self._usual_parts_s]
        for first_s, part_s in parts:
            last_s = math.inf if part_s is None else first_s + part_s
            sides = [
                side
                for low_s, high_s in rest
                for side in ((low_s, min(high_s, first_s)), (max(low_s, last_s), high_s))
            ]
            rest = [side for side in sides if side[1] - side[0] >= _LEAST_PART_S]
        return [(low_s, high_s - low_s) for low_s, high_s in rest]

    @property
    def _usual_parts_s(self) -> list[tuple[float, float]]:
        """Start and length of all of a short drive, or of some parts of a long one."""
        start_s, length_s = self._span_s
        if length_s <= _WHOLE_S:
            return [(start_s, length_s or _WHOLE_S)]
        return [(start_s + fraction * length_s, _PART_S) for fraction in _PARTS]

    @property
    def _span_s(self) -> tuple[float, float]:
        """Start and length of what may be read; length 0 = unknown."""
        given_s, known_s = self.options.duration_s, self.duration_s
        length_s = known_s if given_s is None else min(given_s, known_s or given_s)
        return self.options.start_s, length_s

    @contextmanager
    def opened(self, start_s: float, duration_s: float | None) -> Generator[Recording]:
        """A part of the drive, opened with a focal length from the guesses and without a
        distortion.
        """
        options = replace(
            self.options,
            rig=None,
            lens_fov_deg=None,
            camera_model=None,
            focal_px=best_guess(self.guesses).focal_px,
            start_s=start_s,
            duration_s=duration_s,
            every=1,
        )
        with closing(open_recording(self.name, None, options)) as recording:
            yield recording

    def check_inside(
        self, name: str, expected: str, xyxy_px: tuple[float, float, float, float], time_s: float
    ) -> None:
        """Raise UsageError for a measurement outside the image or the video."""
        x1, y1, x2, y2 = xyxy_px
        width_px, height_px = self.size_px
        if x1 < -1 or y1 < -1 or x2 > width_px or y2 > height_px:
            raise UsageError(f"{name}: expected {expected.format(f'{width_px}x{height_px}')}.")
        if self.duration_s and time_s > self.duration_s + 1.0:
            raise UsageError(
                f"{name}: expected a time up to {self.duration_s:.1f} s, the end of the video."
            )


def every_step(step_s: float, frames: Iterable[Frame]) -> Iterator[Frame]:
    """Frames that are at least `step_s` apart."""
    last_s = -math.inf
    for frame in frames:
        if frame.time_s - last_s >= step_s - TIME_EPSILON_S:
            last_s = frame.time_s
            yield frame
