"""The interval of a rate, against published limits and by coverage."""

import numpy as np
import pytest

from track_range.foundation.poisson import rate_interval


@pytest.mark.parametrize(
    ("n", "low", "high"),
    [(0, 0.0, 3.6889), (1, 0.0253, 5.5716), (2, 0.2422, 7.2247), (10, 4.7954, 18.3904)],
)
def test_limits_of_garwoods_table(n, low, high):
    assert rate_interval(n, 1.0) == pytest.approx((low, high), abs=1e-4)
    assert rate_interval(n, 4.0) == pytest.approx((low / 4, high / 4), abs=1e-4)


def test_the_interval_covers_the_rate():
    """Of a discrete distribution, the exact interval covers at least 95 %, here at most 99 %."""
    counts = np.random.default_rng(3).poisson(3.0, 2000)
    intervals = [rate_interval(int(n), 1.0) for n in counts]
    covered = np.mean([low <= 3.0 <= high for low, high in intervals])
    assert 0.95 <= covered <= 0.99
