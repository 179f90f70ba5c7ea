r"""ImageTimes: which frames show a new moment, and when it was.

A frame may repeat the image before it: after a change of the frame rate, where a recorder fills a
gap, and while a camera hangs. It shows nothing new, and its time is not that of its image:

    25 images/s shown at 30 Hz    image   0    1    2    3    4    4    5    6    7    8    9    9
                                  frame   0    1    2    3    4    5    6    7    8    9   10   11
                                  moment  0  1.2  2.4  3.6  4.8    -    6  7.2  8.4  9.6 10.8    -

An image is a repetition if it differs from the last new one by no more than compression changes
it, although the images before it changed a lot: a camera that comes to rest changes less and less
before. If the frames of new images lie within one frame interval of a uniform rate, and the images
change equally whether a repetition lies between them or not, they were taken at that rate.
Otherwise (a recorder that repeats an image in the place of a lost one) each was taken at the time
of its frame.
"""

import math
from collections import Counter, deque
from statistics import median
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import Image
from track_range.foundation.errors import Note
from track_range.foundation.files.input_files import counted
from track_range.stereo.odometry.scene_cuts import SceneCuts

# side of the blocks in which small images are compared: compression changes single pixels by more
_BLOCK_PX = 5
# largest change of a block by compression, grey levels and relative to usual changes: on simulated
# and recorded drives it is up to 2.7 with x264 at a rate factor of 30, and up to 0.06 of the usual
# change with 1 Mbit/s of MPEG-4
_BLOCK_GREY, _BLOCK_FRACTION = 3.0, 0.08
# largest mean change by compression relative to usual ones, and smallest usual change in motion
_FRACTION, _MOVING_GREY = 0.2, 0.8
# change before a repetition relative to usual ones, above which the camera was not coming to rest
_STEADY_FRACTION = 0.6
# last new images, of whose changes the large ones are usual ones, relative to the largest: at the
# start, repetitions are not known yet
_N_USUAL, _MIN_USUAL, _LARGE_FRACTION = 8, 3, 0.25
_N_IMAGES, _N_CYCLES = 90, 8  # latest new images, and repetitions among them, that show a rate
_MIN_CYCLES = 3  # repetitions from which there is a rate
_N_UNSURE = 20  # images after a repetition in which others would follow, if there were a pattern
_REGULAR = 1.15  # largest spread of frame times about the rate, in frame intervals
# Growth of the change with the time between frames, as an exponent: it is 0.4 to 1 for images that
# were taken at the times of their frames.
_MAX_EXPONENT = 0.2
_FROZEN_S = 0.5  # time without a new image from which the camera hangs
_MAX_NOTED, _MAX_SPANS = 0.02, 5  # fraction of repetitions without a note; spans in a note
_PATTERN = 0.7  # fraction of repetitions at equal distances that are a pattern
_ORDINALS = ("", "", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth")


class ImageTime(NamedTuple):
    """What the image of a frame shows."""

    time_s: float  # moment of the image; of a repetition, the time of its frame
    is_repeated: bool = False  # whether it is the last new image once more
    # whether the time between new images is known: not after a repetition until a rate shows
    is_sure: bool = True
    starts_scene: bool = False  # whether it shows another scene since the image before


class _NewImage(NamedTuple):
    frame_s: float  # time of its frame
    grey: float  # mean change since the one before, grey levels; NaN = unknown
    n_repeated: int  # repetitions between the two


class ImageTimes:
    """Finds the repeated images of one stream, frame after frame; the state belongs to the
    instance.
    """

    def __init__(self) -> None:
        self._small: Image | None = None  # the last new image
        # mean change and that of the most different block, of the last new images
        self._usual: deque[tuple[float, float]] = deque(maxlen=_N_USUAL)
        self._images: deque[_NewImage] = deque(maxlen=_N_IMAGES)
        self._steps_s: deque[float] = deque(maxlen=_N_IMAGES)  # between frames
        self._last_s = math.nan  # time of the last frame
        self._n_row = 0  # repetitions since the last new image
        self._n_frames = self._n_single = 0  # frames; repetitions in short rows
        self._frozen_s: list[tuple[float, float]] = []  # first and last time of long rows
        self._periods: Counter[int] = Counter()  # frames from one row of repetitions to the next
        self._n_since = 0  # frames since the end of the last row
        self._cuts, self._cut_s = SceneCuts(), list[float]()  # times of the first images of scenes

    def update(self, image: Image, time_s: float, hidden: float = 0.0) -> ImageTime:
        """What the image (H, W) or (H, W, 3) of the next frame shows; a road user hides the part
        `hidden` of it.
        """
        self._n_frames += 1
        self._n_since += 1
        self._steps_s.append(time_s - self._last_s)
        self._last_s = time_s
        small, before = sampled(image), self._small
        if before is None or before.shape != small.shape:
            self._start(small, time_s)
            return ImageTime(time_s)
        difference = cv2.absdiff(small, before)
        grey = float(cv2.mean(difference)[0])
        block_grey = float(cv2.blur(difference, (_BLOCK_PX, _BLOCK_PX)).max())
        if self._repeats(grey, block_grey):
            self._n_row += 1
            return ImageTime(time_s, is_repeated=True)
        self._small = small
        starts_scene = self._cuts.update(small, time_s, hidden)
        if starts_scene:
            self._cut_s.append(self._images[-1].frame_s)
        self._usual.append((grey, block_grey))
        self._images.append(_NewImage(time_s, grey, self._n_row))
        self._end_row()
        return self._moment()._replace(starts_scene=starts_scene)

    def _start(self, small: Image, time_s: float) -> None:
        self._small = small
        self._usual.clear()
        self._images.clear()
        self._images.append(_NewImage(time_s, math.nan, 0))

    def _repeats(self, grey: float, block_grey: float) -> bool:
        """Whether an image with these changes, mean and largest, is the last new one once more."""
        largest = max((change for change, _ in self._usual), default=0.0)
        large = [changes for changes in self._usual if changes[0] > _LARGE_FRACTION * largest]
        if len(large) < _MIN_USUAL:
            return False
        usual_grey, usual_block = (median(changes) for changes in zip(*large, strict=True))
        was_moving = usual_grey >= _MOVING_GREY
        was_steady = self._usual[-1][0] >= _STEADY_FRACTION * usual_grey
        is_equal = block_grey <= max(_BLOCK_GREY, _BLOCK_FRACTION * usual_block)
        return bool(was_moving and was_steady and is_equal and grey <= _FRACTION * usual_grey)

    def _end_row(self) -> None:
        """Count the repetitions before a new image."""
        if not self._n_row:
            return
        span_s = self._images[-2].frame_s, self._images[-1].frame_s
        if span_s[1] - span_s[0] >= _FROZEN_S:
            self._frozen_s.append(span_s)
            self._images = deque([self._images[-1]._replace(n_repeated=0)], _N_IMAGES)
        else:
            self._n_single += self._n_row
            self._periods[self._n_since - 1] += 1
        self._n_row, self._n_since = 0, 1

    def _moment(self) -> ImageTime:
        """Moment of the last new image: at the rate of the images, if they have one."""
        images = list(self._images)
        frame_s, longest = images[-1].frame_s, max(image.n_repeated for image in images)
        if not longest:
            return ImageTime(frame_s)
        # images of equal places in the pattern: those after the longest rows of repetitions
        after = [i for i, image in enumerate(images) if image.n_repeated == longest][-_N_CYCLES:]
        if len(after) < _MIN_CYCLES:
            return ImageTime(frame_s, is_sure=len(images) - after[0] > _N_UNSURE)
        first, last = after[0], after[-1]
        times_s = np.array([image.frame_s for image in images])
        step_s = (times_s[last] - times_s[first]) / (last - first)
        moments_s = times_s[last] + step_s * (np.arange(len(images)) - last)
        spread_s = float(np.ptp((times_s - moments_s)[first:]))
        is_regular = spread_s <= _REGULAR * float(np.nanmedian(self._steps_s))
        if not is_regular or not _changes_equally(images[first:]):
            return ImageTime(frame_s)
        return ImageTime(float(moments_s[-1]))

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user about cuts and repeated images so far."""
        notes = []
        if self._cut_s:
            cuts = _listed([f"{cut_s:.1f} s" for cut_s in self._cut_s])
            notes.append(
                Note(
                    f"The images show another scene from {cuts} on: tracks, odometry and filters start "
                    "again there, but a tracker object of your own goes on; give scenes of another "
                    "camera on their own.",
                    "scene-changed",
                    "warning",
                    "left",
                )
            )
        frozen_s = list(self._frozen_s)
        if self._images and self._last_s - self._images[-1].frame_s >= _FROZEN_S and self._n_row:
            frozen_s.append((self._images[-1].frame_s, self._last_s))
        if frozen_s:
            spans = _listed([f"{start:.1f} to {end:.1f} s" for start, end in frozen_s])
            notes.append(
                Note(
                    f"The images do not change from {spans}, although the camera was moving: "
                    "distances are predicted there, and soon unknown; check the camera and its "
                    "recording.",
                    "images-frozen",
                    "error",
                    "left",
                )
            )
        if self._n_single > max(_MAX_NOTED * self._n_frames, 1):
            notes.append(
                Note(
                    f"{self._pattern} ({self._n_single} of {counted(self._n_frames, 'frame')}), as "
                    "after a change of the frame rate: repeated images are not measured, and speeds "
                    "are those between new images.",
                    "images-repeated",
                    "warning",
                    "left",
                )
            )
        return tuple(notes)

    @property
    def _pattern(self) -> str:
        """Which frames repeat the image before."""
        period, n = self._periods.most_common(1)[0]
        is_pattern = n >= _PATTERN * self._periods.total() and 1 < period < len(_ORDINALS)
        if is_pattern:
            return f"Every {_ORDINALS[period]} frame repeats the image before it"
        return "Frames repeat the image before them"


def _listed(values: list[str]) -> str:
    """The first values of a note, and how many more there are."""
    n_more = len(values) - _MAX_SPANS
    return ", ".join(values[:_MAX_SPANS]) + (f" and {n_more} more times" if n_more > 0 else "")


def sampled(image: Image) -> Image:
    """Means of 2x2 pixels in every fourth row and column: cheap, with changes above the noise in
    motion.
    """
    sample = np.ascontiguousarray(image[::4, ::4] if image.ndim == 2 else image[::4, ::4, 1])
    size_px = max(sample.shape[1] // 2, 1), max(sample.shape[0] // 2, 1)
    return np.asarray(cv2.resize(sample, size_px, interpolation=cv2.INTER_AREA), np.uint8)


def _changes_equally(images: list[_NewImage]) -> bool:
    """Whether images change as much after repetitions as after none."""
    measured = [image for image in images if image.grey > 0]
    frames = np.array([image.n_repeated + 1.0 for image in measured])
    greys = np.array([image.grey for image in measured])
    far = frames > frames.min()
    if not far.any():
        return True
    growth = math.log(float(np.median(greys[far]) / np.median(greys[~far])))
    return growth <= _MAX_EXPONENT * math.log(float(frames[far].mean() / frames.min()))
