r"""Numbers of threads and queue lengths for reading videos (for the pipeline see `track_range.pipeline`).

    recorded pair    left file  -> [thread: decode] -> FRAMES_AHEAD frames --\
                     right file -> [thread: decode] -> FRAMES_AHEAD frames ---> caller's thread: pair, rectify
    one video        caller's thread: decode, undistort
    live             camera -> [thread: receive, decode] -> newest LIVE_FRAMES frames -> caller's thread

Reading threads run at low priority, so that inference goes first when there are fewer cores than busy threads.
"""

from track_range.foundation.processes import n_usable_cores

# FFmpeg's per video; few, as two videos are decoded in parallel
DECODER_THREADS = 1 if n_usable_cores() <= 2 else 2

# Frames decoded ahead per video of a pair, and frames that wait for the check of synchronisation
# (at first twice as many); a frame of 1242x375 px takes 1.4 MB.
FRAMES_AHEAD = 4
LIVE_FRAMES = 8  # newest frames of a live stream that are stored; pairs are formed from them

MAX_LOOK_AHEAD_BYTES = 1_000_000_000
"""Buffer size for the frames that are read for the alignment before the run, in the decoder's
format (YUV 4:2:0).

At 1.5 bytes per pixel it holds 8 s at 30 Hz of two videos of 1280x720, or 4 s of 1920x1080. If more
frames are needed, the files are read again from the start.
"""
