"""The alignment of frames that come one by one: when it is estimated, also after a stop of the
vehicle."""

import numpy as np
import pytest

from track_range.recording.open_video import open_video
from track_range.recording.pairs.auto_alignment import StepwiseAlignment
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
    alignment = StepwiseAlignment(rectifier.rig)
    estimated = []
    for index, (left, right) in enumerate([pairs[0]] * n_static + pairs):
        frame = Frame(index, index / 10, *rectifier.rectify(left, right))
        if alignment.add(frame, frame) is not None:
            estimated.append(index - n_static)
    assert estimated[0] in range(8, 14)
    assert len(estimated) >= 3
    assert estimated[-1] >= 40
    assert alignment.current.measured.source.endswith("48 frames")
    assert np.isfinite(alignment.at(0.0).offset_px)
