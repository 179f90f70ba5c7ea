"""A Ray cluster of this machine for the tests of a session: starting one takes seconds."""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

from track_range.foundation.library_telemetry import disable_telemetry

OBJECT_STORE_BYTES = 80 * 2**20

ACCESS_KEY, SECRET_KEY = "test-access-key", "test-secret-key"
"""Credentials of the tests' object storage, which workers have in their environment."""

_VARIABLES = {
    "RAY_AUTH_TOKEN": "tests" * 8,
    "AWS_ACCESS_KEY_ID": ACCESS_KEY,
    "AWS_SECRET_ACCESS_KEY": SECRET_KEY,
    "AWS_EC2_METADATA_DISABLED": "true",
    "RAY_worker_niceness": "0",
}
"""Environment of Ray's processes.

With Ray's niceness of 15, workers beside other busy processes get so little time that clips exceed
their limits.
"""


@contextmanager
def ray_cluster(n_cpus: int = 4) -> Iterator[Any]:
    """A cluster with one node, to which nodes can be added; this process is connected to it."""
    disable_telemetry()
    with mock.patch.dict(os.environ, _VARIABLES), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import ray
        from ray.cluster_utils import Cluster

        logging.getLogger("ray").setLevel(logging.ERROR)
        arguments = {
            "num_cpus": n_cpus,
            "object_store_memory": OBJECT_STORE_BYTES,
            "include_dashboard": False,
        }
        cluster = Cluster(initialize_head=True, head_node_args=arguments)
        try:
            ray.init(address=cluster.address, log_to_driver=False, configure_logging=False)
            yield cluster
        finally:
            ray.shutdown()
            cluster.shutdown()
