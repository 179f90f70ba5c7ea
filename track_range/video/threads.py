r"""Threads and queue depths of reading, in one place (the pipeline's own: `track_range.run.pipeline`).

    recorded pair    left file  -> [thread: decode] -> FRAMES_AHEAD frames --\
                     right file -> [thread: decode] -> FRAMES_AHEAD frames ---> pairs -> rectified frames (the caller's)
    one video        decoded by the caller's thread
    live             camera -> [thread: receive, decode] -> newest LIVE_FRAMES images -> the caller's thread

Reading threads run at low priority: with fewer cores than busy threads, inference goes first.
"""

from __future__ import annotations

import os

DECODER_THREADS = 1 if (os.cpu_count() or 1) <= 2 else 2
"""Threads of FFmpeg per video: left and right are decoded beside each other and beside a detector."""

FRAMES_AHEAD = 4
"""Frames decoded ahead per video of a pair; one of 1242x375 takes 1.4 MB."""

LIVE_FRAMES = 8
"""Newest images of a live stream that wait; pairs are formed among them."""

MAX_LOOK_AHEAD_BYTES = 1_000_000_000
"""Memory for the frames that alignment sees before the run does, in the decoder's format (YUV 4:2:0: 1.5 bytes/px).

It holds 8 s at 30 Hz of two videos of 1280x720, or 5 s of 1920x1080. Where more are looked at, none is kept, and the
files are read again from the start.
"""
