"""Anonymization: heads and number plates are made unrecognisable in the images of results."""

from track_range.views.anonymization.look_ahead import LIVE, OFFLINE, LookAhead, anonymized_results

__all__ = ["LIVE", "OFFLINE", "LookAhead", "anonymized_results"]
