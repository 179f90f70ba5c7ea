"""Workloads on fleets of recordings: throughput, costs and faults."""
