"""Fleets: many recordings on a cluster, one result data set."""
