"""The pipeline of a run: its stages in threads, the time spent in them, and the rate of the results."""
