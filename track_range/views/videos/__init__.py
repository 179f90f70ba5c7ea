"""Videos that a run writes: the annotated video, and clips of events."""
