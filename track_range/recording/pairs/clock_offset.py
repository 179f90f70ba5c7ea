"""searched_offset: the offset of the clocks of a pair, from the images of its first seconds."""

from contextlib import closing
from itertools import islice

from track_range.recording.cameras.calibration import RecordingCalibration
from track_range.recording.pairs.recorded_pair import RecordedPair
from track_range.stereo.alignment.common_moment import ClockOffset, TimedImages, found_offset
from track_range.stereo.alignment.sync_check import small_view

_SPAN_S = 12.0  # length of the part of each video that is searched
_MAX_IMAGES = 400  # of each video, in this part


def searched_offset(pair: RecordedPair, calibration: RecordingCalibration) -> ClockOffset:
    """What the images of the first seconds show, in addition to the present offset of the pair,
    which is read from its start again.
    """
    pair.restart()
    videos = pair.left, pair.right
    firsts = [next(iter(video)) for video in videos]
    sides = []
    for side, video in enumerate(videos):
        read = TimedImages([], [])
        with closing(iter(video)) as frames:
            for frame in islice(frames, _MAX_IMAGES):
                if frame.time_s - firsts[side].time_s > _SPAN_S:
                    break
                left, right = (frame, firsts[1]) if side == 0 else (firsts[0], frame)
                both = calibration.rectified(calibration.recorded(left, right, left.time_s))
                view = both.left if side == 0 or both.right is None else both.right
                read.times_s.append(frame.time_s)
                read.images.append(small_view(view))
        sides.append(read)
    return found_offset(*sides)
