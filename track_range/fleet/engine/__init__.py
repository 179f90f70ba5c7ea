"""Engine of a fleet: Ray's cluster, workers, driver, attempts and limits."""
