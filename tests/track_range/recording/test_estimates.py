"""When the alignment is estimated from frames that come one by one, also after a stop of the
vehicle."""

import pytest

from track_range.recording.pairs.aligner import ONE_BY_ONE
from track_range.recording.pairs.estimates import AlignmentEstimates
from track_range.recording.sources.open_video import open_video
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rectification import Rectifier
from track_range.stereo.rig_formats.reading import load_rig


@pytest.mark.slow
@pytest.mark.parametrize("n_static", [0, 285])
def test_estimates_after_a_stop(render_drive, n_static):
    """Frames of a stationary vehicle do not use up those from which the alignment is estimated."""
    drive = render_drive(seed=5, seconds=6.0)
    pairs = [
        (left.image, right.image)
        for left, right in zip(open_video(drive.left), open_video(drive.right), strict=True)
    ]
    height_px, width_px = pairs[0][0].shape[:2]
    rig, _ = load_rig(drive.rig, size_px=(width_px, height_px))
    rectifier = Rectifier(rig)
    estimates = AlignmentEstimates(rectifier.rig, ONE_BY_ONE.estimates_s)
    made = []
    for index, (left, right) in enumerate([pairs[0]] * n_static + pairs):
        estimate = estimates.add(Frame(index, index / 10, *rectifier.rectify(left, right)))
        if estimate is not None:
            made.append((index - n_static, estimate))
            if estimate.is_last:
                break
    frames, made = zip(*made, strict=True)
    assert frames[0] in range(8, 14)
    assert len(frames) >= 3
    assert frames[-1] >= 40
    assert [one.is_last for one in made] == [False] * (len(made) - 1) + [True]
    assert made[-1].alignment.measured.source.endswith("48 frames")
