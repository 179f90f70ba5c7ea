"""`track-range evaluate`: measurements against a user's own labels."""

from __future__ import annotations

from track_range.cli.lazy import Lazy, lazy_app

app = lazy_app(
    {
        "tracks": Lazy(
            "track_range.cli.evaluate.tracks",
            "HOTA, MOTA, IDF1 and related metrics of tracks, by KITTI's or MOTChallenge's rules.",
        ),
        "stereo": Lazy(
            "track_range.cli.evaluate.stereo",
            "Distance error of stereo matchers on pairs with true disparities, side by side.",
        ),
        "detections": Lazy(
            "track_range.cli.evaluate.detections",
            "Average precision and speed of detectors on labelled images, side by side.",
        ),
        "ranges": Lazy(
            "track_range.cli.evaluate.ranges",
            "Error of distances from boxes against labels with 3-D boxes, all methods side by side; no video needed.",
        ),
    },
)
