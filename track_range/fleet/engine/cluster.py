"""The Ray cluster of a fleet: a cluster on this machine for the duration of the run, or an existing
cluster.

A cluster of this machine listens on the loopback interface only, with a random token, so that other
users of the machine cannot run code in it; nothing is written to the home folder. Its files are in
the temporary folder, and are removed at the end.
"""

from __future__ import annotations

import logging
import os
import secrets
import shutil
import socket
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from track_range.fleet.engine.worker import remove_dead_folders
from track_range.fleet.errors import FleetError
from track_range.fleet.settings import FleetSettings, size_bytes
from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import counted, shortened
from track_range.foundation.library_telemetry import disable_telemetry
from track_range.foundation.processes import n_usable_cores
from track_range.run.interrupts import ignore_interrupts

# on this machine: above Ray's minimum of 75 MB, for settings and records
_OBJECT_STORE_BYTES = 80 * 2**20
# longest temporary folder for Ray, whose sockets have paths of at most 107 characters
_MAX_FOLDER = 40
_CONNECT_S = 15.0  # time limit for reaching the address of a cluster, s
_END_S = 5.0  # time in which Ray's processes end after a shutdown, s
_FOLDER_PREFIX = "tr-ray-"
_TOKEN = secrets.token_hex(32)  # token of the clusters of this process; Ray reads it once

# environment of this process, which Ray reads when it is imported: no paragraph for what the driver
# reports by clip
_VARIABLES = {"RAY_DEDUP_LOGS_SKIP_REGEX": "A worker died or was killed"}
# environment of a cluster of this machine: the node has the address of the loopback interface
_LOCAL_VARIABLES = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}


class RayMissingError(UserError):
    """Ray is not installed."""


@contextmanager
def connected(settings: FleetSettings) -> Iterator[int]:
    """Connection to the cluster of the settings; the number of workers to start.

    Raises RayMissingError: Ray is not installed; FleetError: there is no cluster at the address, or
    no node of it is large enough for a worker.
    """
    disable_telemetry()
    if find_spec("ray") is None:
        raise RayMissingError(
            "fleet run requires the package ray: install it with pip install 'track-range[fleet]'."
        )
    os.environ.update(_VARIABLES)
    with (
        _local_cluster(settings)
        if settings.address is None
        else _existing_cluster(settings) as n_workers
    ):
        yield n_workers


@contextmanager
def _local_cluster(settings: FleetSettings) -> Iterator[int]:
    n_cores = n_usable_cores()
    n_requested = settings.workers or max(1, n_cores // settings.threads)
    # Ray requires a token on a new cluster, and would write one to the home folder
    variables = {**_LOCAL_VARIABLES, "RAY_AUTH_TOKEN": os.environ.get("RAY_AUTH_TOKEN", _TOKEN)}
    with _environment(variables), _ray_folder() as folder:
        import ray

        try:
            # Ray's dashboard process asks the metadata services of three cloud providers for the
            # kind of machine, also where the dashboard and the usage statistics are disabled; it
            # does not start at a port that is in use
            with socket.create_server(("127.0.0.1", 0)) as occupied:
                _init(
                    address="local",
                    num_cpus=max(n_cores, n_requested * settings.threads),
                    include_dashboard=False,
                    dashboard_port=occupied.getsockname()[1],
                    object_store_memory=_OBJECT_STORE_BYTES,
                    _temp_dir=str(folder),
                )
            yield _fitting(settings, n_requested)
        finally:
            with ignore_interrupts():
                ray.shutdown()


@contextmanager
def _existing_cluster(settings: FleetSettings) -> Iterator[int]:
    import ray

    is_ours = not ray.is_initialized()
    try:
        if is_ours:
            _check_reachable(str(settings.address))
            _init(address=str(settings.address))
        nodes: list[dict[str, Any]] = ray.nodes()  # type: ignore[no-untyped-call]
        n_cores = int(sum(node["Resources"].get("CPU", 0) for node in nodes if node["Alive"]))
        yield settings.workers or max(1, n_cores // settings.threads)
    finally:
        if is_ours:
            with ignore_interrupts():
                ray.shutdown()


def _check_reachable(address: str) -> None:
    """Raise FleetError unless a server of a cluster listens at HOST:PORT; Ray itself would wait for
    minutes.
    """
    # the latter is a Ray Client, which has its own time limit
    if address == "auto" or "://" in address:
        return
    host, _, port = address.rpartition(":")
    try:
        with socket.create_connection(
            (host.strip("[]"), int(port)), timeout=_CONNECT_S
        ) as connection:
            if os.environ.get("RAY_USE_TLS", "0") == "0":
                # the server of a cluster (gRPC) speaks first; most others wait for a request
                connection.recv(1)
    except ValueError as error:
        raise _no_cluster(address, "expected HOST:PORT or auto") from error
    except (OSError, OverflowError) as error:
        raise _no_cluster(address, error) from error


def _no_cluster(address: str, reason: object) -> FleetError:
    return FleetError(
        f"--address {shortened(address)}: expected a running Ray cluster "
        f"({shortened(str(reason), 120)}); start one with `ray start --head`, or omit --address."
    )


def _init(**options: Any) -> None:
    """Start a cluster, at the second try if needed, or join a cluster; raises FleetError if this is
    not possible.
    """
    import ray

    logging.getLogger("ray").setLevel(logging.CRITICAL)
    try:
        try:
            ray.init(log_to_driver=False, configure_logging=False, **options)
        # also the plain one of Ray's time limit of 30 s for a start, on a busy machine
        except Exception:
            if options["address"] != "local":
                raise
            ray.shutdown()
            ray.init(log_to_driver=False, configure_logging=False, **options)
    except Exception as error:
        reason = shortened(" ".join(str(error).split()).rstrip("."), 120)
        if options["address"] != "local":
            raise _no_cluster(options["address"], reason) from error
        raise FleetError(
            f"Ray failed to start on this machine in two attempts ({reason}); repeat the command "
            "when the machine is less busy, or process each clip with `track-range run`, without "
            "Ray."
        ) from error


def _fitting(settings: FleetSettings, n_requested: int) -> int:
    """Number of workers for which this machine has memory and GPUs; FleetError: too little for the
    requested number.
    """
    import ray

    resources: Mapping[str, float] = ray.cluster_resources()  # type: ignore[no-untyped-call]
    memory, gpus = resources.get("memory", 0.0), resources.get("GPU", 0.0)
    size, n_gpus = settings.worker_memory, settings.gpus_per_worker
    memory_text, gpu_text = (
        f"--worker-memory {size}: expected memory",
        f"--gpus-per-worker {n_gpus:g}: expected GPUs",
    )
    n_fitting = n_requested
    for needed, available, requirement, stock, remedy in (
        (
            size_bytes(size),
            memory,
            memory_text,
            f"{memory / 1e9:.1f} GB for all workers",
            "less memory",
        ),
        (n_gpus, gpus, gpu_text, f"{gpus:g}", "a smaller fraction"),
    ):
        n_fitting = min(n_fitting, int(available / needed)) if needed else n_fitting
        if n_fitting < n_requested and (settings.workers is not None or not n_fitting):
            workers = counted(n_requested, "worker")
            raise FleetError(
                f"{requirement} for {workers}, found {stock}; give fewer --workers or {remedy}."
            )
    return n_fitting


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _ray_folder() -> Iterator[Path]:
    """Folder for Ray's sockets and logs; folders of killed drivers are removed."""
    parent = Path(tempfile.gettempdir())
    if len(str(parent)) > _MAX_FOLDER - 20:
        parent = Path("/tmp")  # noqa: S108 - the folder below has a random name and is only for this user
    remove_dead_folders(parent, _FOLDER_PREFIX)
    try:
        folder = Path(tempfile.mkdtemp(prefix=f"{_FOLDER_PREFIX}{os.getpid()}-", dir=parent))
    except OSError as error:
        raise FleetError(
            f"{parent}: cannot be written ({error.strerror}); set TMPDIR to another folder."
        ) from error
    try:
        yield folder
    finally:
        with ignore_interrupts():
            end_s = time.monotonic() + _END_S
            # Ray's processes write logs until they have ended
            while folder.exists() and time.monotonic() < end_s:
                shutil.rmtree(folder, ignore_errors=True)
                time.sleep(0.1)
