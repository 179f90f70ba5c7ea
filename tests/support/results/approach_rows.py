"""Rows of tracks with one approach that counts."""

import numpy as np

from track_range.results.rows.rows import Rows

NAN = np.nan


def approach_rows(*values):
    """Rows of (time, track, class, observed, filtered m, its sigma, closing, its sigma,
    TTC)."""
    names = (
        *("time_s", "track_id", "class", "observed", "fused_kf_m", "fused_kf_sigma_m"),
        *("closing_mps", "closing_sigma_mps", "ttc_front_s"),
    )
    return Rows({name: np.array([row[k] for row in values]) for k, name in enumerate(names)})


ROWS = approach_rows(
    *((time_s, 1, "car", 1, 20.0, 0.4, NAN, NAN, NAN) for time_s in (-0.2, -0.1, 0.0)),
    # a supported approach: three frames over 0.2 s that agree on a contact at 2.0 s
    (0.3, 1, "car", 1, 17.0, 0.4, 10.0, 1.0, 1.7),
    (0.4, 1, "car", 1, 16.0, 0.4, 10.0, 1.0, 1.6),
    (0.5, 1, "car", 1, 15.0, 0.3, 10.0, 1.0, 1.5),
    (1.0, 1, "car", 0, 3.0, 0.1, 30.0, 1.0, 0.4),  # predicted
    (1.5, 1, "car", 1, 4.0, 2.5, 90.0, 46.0, NAN),  # too uncertain
    *((time_s, 2, "person", 1, 8.5, NAN, -1.0, 0.1, NAN) for time_s in (0.0, 0.1, 0.2)),
    (0.0, 3, "bus", 1, NAN, NAN, NAN, NAN, NAN),
    *((time_s, 4, "traffic light", 1, 2.0, 0.1, NAN, NAN, NAN) for time_s in (0.0, 0.1, 0.2)),
)
