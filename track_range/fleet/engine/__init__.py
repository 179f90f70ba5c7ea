"""Engine of a fleet: Ray's cluster, workers, driver, attempts and limits.

Every module that imports Ray is in this package, which disables its telemetry first.
"""

from track_range.foundation.library_telemetry import disable_telemetry

disable_telemetry()
