"""Results of a fleet: records of clips, the data set, and the state of the run."""
