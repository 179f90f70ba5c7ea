"""What never moves in the images of a recording, before a run."""

from collections.abc import Callable
from contextlib import closing

from track_range.detection.fixed_parts import FixedParts
from track_range.recording.recording import Recording

# compared images after which more say little, and longest part of a recording that is read for them
_N_IMAGES, _READ_S = 20, 60.0


def shown_fixed_parts(recording: Recording, reopen: Callable[[], Recording]) -> FixedParts:
    """What the first images of a recording of one camera show of it: without them, text would be a
    road user for the first seconds. Of a pair and a live source it is learnt in the run.

    `reopen` opens the recording once more, from its start.
    """
    parts = FixedParts()
    if recording.pair is not None or recording.live is not None:
        return parts
    estimate = recording.calibration.estimate
    with closing(reopen()) as opened:
        again = opened if estimate is None else opened.with_camera(estimate)
        for frame in again.near_keyframes(0.0).frames:
            parts.add(frame.left, frame.time_s)
            if parts.n_images >= _N_IMAGES or frame.time_s > _READ_S:
                break
    return parts
