"""Interval of the rate of rare events."""

from scipy.special import gammaincinv

_TAIL = 0.025  # probability beyond each end of a 95 % interval


def rate_interval(n: int, duration: float) -> tuple[float, float]:
    """95 % interval of the rate of a Poisson process with n events in a duration > 0, per its unit.

    The exact, central interval (Garwood, "Fiducial limits for the Poisson distribution", 1936); its
    lower end is 0 for n = 0, and its upper end is then 3.69 / duration.
    """
    low = float(gammaincinv(n, _TAIL)) if n > 0 else 0.0
    high = float(gammaincinv(n + 1, 1 - _TAIL))
    return low / duration, high / duration
