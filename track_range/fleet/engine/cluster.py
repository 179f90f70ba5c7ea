"""The Ray cluster of a fleet: one of this machine alone for the time of the run, or an existing one.

A cluster of this machine listens on the loopback interface only, with a random token, so that other users of the
machine cannot run code in it; nothing is written to the home folder. Its files are in the temporary folder, and are
removed at the end.
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
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from track_range.fleet.errors import FleetError
from track_range.fleet.settings import FleetSettings
from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import counted, shortened
from track_range.foundation.library_telemetry import disable_telemetry
from track_range.foundation.processes import n_usable_cores
from track_range.run.interrupts import ignore_interrupts

_OBJECT_STORE_BYTES = 80 * 2**20
"""Object store of a cluster of this machine: Ray's minimum is 75 MB, and only settings and records pass through it."""

_MAX_FOLDER = 40
"""Longest temporary folder for Ray, whose sockets have paths of at most 107 characters."""

_CONNECT_S = 15.0
"""Time limit for reaching the address of a cluster, s."""

_HTTP2_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes((0, 0, 0, 4, 0, 0, 0, 0, 0))
"""Start of a connection with HTTP/2, with an empty frame of settings (RFC 9113, 3.4)."""

_TYPE_BYTE, _SETTINGS_TYPE = 3, 4
"""Index of the type in the header of a frame, and type of a frame of settings (RFC 9113, 4.1 and 6.5)."""

_END_S = 5.0
"""Time in which Ray's processes end after a shutdown, s."""

_MAX_PORT = 65_535

_FOLDER_PREFIX = "tr-ray-"

_LOCAL_VARIABLES = {
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # the address of the node is that of the loopback interface
}
"""Environment of a cluster of this machine."""


_TOKEN = secrets.token_hex(32)
"""Token of the clusters of this process; Ray reads it once."""


class RayMissingError(UserError):
    """Ray is not installed."""


@dataclass(frozen=True, slots=True)
class Cluster:
    """Cluster of a fleet.

    Attributes:
        is_local: whether all workers are on the machine of this driver.
        node: id of the node of this driver.
        n_workers: number of workers to start.
    """

    is_local: bool
    node: str
    n_workers: int


@contextmanager
def connected(settings: FleetSettings) -> Iterator[Cluster]:
    """The cluster of the settings, until the end of the block.

    Raises:
        RayMissingError: Ray is not installed.
        FleetError: there is no cluster at the address, or no node of it is large enough for a worker.
    """
    disable_telemetry()
    if find_spec("ray") is None:
        raise RayMissingError("fleet run requires the package ray: install it with pip install 'track-range[fleet]'.")
    if settings.address is None:
        with _local_cluster(settings) as cluster:
            yield cluster
        return
    with _existing_cluster(settings) as cluster:
        yield cluster


@contextmanager
def _local_cluster(settings: FleetSettings) -> Iterator[Cluster]:
    n_cores = n_usable_cores()
    n_requested = settings.workers or max(1, n_cores // settings.threads)
    # Ray requires a token on a new cluster, and would write one to the home folder
    variables = {**_LOCAL_VARIABLES, "RAY_AUTH_TOKEN": os.environ.get("RAY_AUTH_TOKEN", _TOKEN)}
    with _environment(variables), _ray_folder() as folder:
        import ray

        try:
            with _without_usage_server():
                _init(
                    address="local",
                    num_cpus=max(n_cores, n_requested * settings.threads),
                    include_dashboard=False,
                    object_store_memory=_OBJECT_STORE_BYTES,
                    _temp_dir=str(folder),
                )
            n_workers = _fitting(settings, n_requested)
            yield Cluster(True, ray.get_runtime_context().get_node_id(), n_workers)
        finally:
            with ignore_interrupts():
                ray.shutdown()


@contextmanager
def _existing_cluster(settings: FleetSettings) -> Iterator[Cluster]:
    import ray

    is_ours = not ray.is_initialized()
    try:
        if is_ours:
            address = _resolved(str(settings.address))
            _check_reachable(address)
            _init(address=address)
        n_cores = int(sum(node["Resources"].get("CPU", 0) for node in _nodes() if node["Alive"]))
        n_requested = settings.workers or max(1, n_cores // settings.threads)
        yield Cluster(False, ray.get_runtime_context().get_node_id(), n_requested)
    finally:
        if is_ours:
            with ignore_interrupts():
                ray.shutdown()


@contextmanager
def _without_usage_server() -> Iterator[None]:
    """Context in which Ray starts no dashboard process.

    Without a dashboard, that process serves only Ray's usage statistics. Also where these are disabled, it asks the
    metadata services of three cloud providers for the kind of machine.
    """
    from ray._private import services

    start = services.start_api_server
    services.start_api_server = lambda *arguments, **options: (None, None)
    try:
        yield
    finally:
        services.start_api_server = start


def _resolved(address: str) -> str:
    """HOST:PORT of an address that may be "auto".

    Raises:
        FleetError: no cluster is running on this machine.
    """
    from ray._private import services

    if address != "auto":
        return address
    try:
        resolved = services.canonicalize_bootstrap_address(address)
    except (ConnectionError, RuntimeError, ValueError, OSError) as error:
        raise _no_cluster(address, error) from error
    if resolved is None:
        raise _no_cluster(address, "none is running on this machine")
    return str(resolved)


def _check_reachable(address: str) -> None:
    """Check that a gRPC server listens at HOST:PORT; Ray itself would wait for it without end.

    Raises:
        FleetError: nothing or another server listens there, or the address has another form.
    """
    if "://" in address:  # Ray Client, which has its own time limit
        return
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit() or int(port) > _MAX_PORT:
        raise _no_cluster(address, "expected HOST:PORT or auto")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=_CONNECT_S) as connection:
            is_grpc = os.environ.get("RAY_USE_TLS", "0") != "0" or _is_http2(connection)
    except OSError as error:
        raise _no_cluster(address, error) from error
    if not is_grpc:
        raise _no_cluster(address, "another server answers")


def _is_http2(connection: socket.socket) -> bool:
    """Whether a server answers the preface of HTTP/2 with its settings, as that of a Ray cluster (gRPC) does.

    Raises:
        OSError: it does not answer in time.
    """
    connection.sendall(_HTTP2_PREFACE)
    header = connection.recv(9)
    return len(header) > _TYPE_BYTE and header[_TYPE_BYTE] == _SETTINGS_TYPE


def _no_cluster(address: str, reason: object) -> FleetError:
    return FleetError(
        f"--address {shortened(address)}: expected a running Ray cluster ({shortened(str(reason), 120)}); start one "
        "with `ray start --head`, or omit --address."
    )


def _init(**options: Any) -> None:
    """Start or join a cluster.

    Raises:
        FleetError: it cannot be started or reached.
    """
    import ray

    logging.getLogger("ray").setLevel(logging.ERROR)
    with suppress(AttributeError):  # a paragraph for each worker that dies, which the driver reports by clip
        ray._private.worker._worker_logs_enabled = False
    try:
        ray.init(log_to_driver=False, configure_logging=False, **options)
    except (ConnectionError, RuntimeError, ValueError, TimeoutError, OSError, ray.exceptions.RayError) as error:
        if options["address"] == "local":
            raise FleetError(f"Ray cannot be started on this machine ({_reason(error)}).") from error
        raise _no_cluster(options["address"], _reason(error)) from error


def _fitting(settings: FleetSettings, n_requested: int) -> int:
    """Number of workers for which this machine has memory and GPUs.

    Raises:
        FleetError: there is too little for the requested number.
    """
    import ray

    resources: Mapping[str, float] = ray.cluster_resources()  # type: ignore[no-untyped-call]
    fitting = n_requested
    needs = {"memory": float(settings.worker_memory_bytes), "GPU": settings.gpus_per_worker}
    for name, needed in needs.items():
        if needed and (n_fitting := int(resources.get(name, 0.0) / needed)) < fitting:
            fitting = n_fitting
            if settings.workers is None and fitting:
                continue
            available = resources.get(name, 0.0)
            if name == "memory":
                raise FleetError(
                    f"--worker-memory {settings.worker_memory}: expected memory for {counted(n_requested, 'worker')}, "
                    f"found {available / 1e9:.1f} GB for all of them; give fewer --workers or less memory."
                )
            raise FleetError(
                f"--gpus-per-worker {needed:g}: expected GPUs for {counted(n_requested, 'worker')}, found "
                f"{available:g}; give fewer --workers or a smaller fraction."
            )
    return fitting


def _nodes() -> list[dict[str, Any]]:
    import ray

    nodes: list[dict[str, Any]] = ray.nodes()  # type: ignore[no-untyped-call]
    return nodes


def _reason(error: BaseException) -> str:
    return shortened(" ".join(str(error).split()).rstrip("."), 120)


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Context with variables of the environment, which Ray's processes inherit."""
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
    """Folder for Ray's sockets and logs; those of drivers that were killed are removed."""
    parent = Path(tempfile.gettempdir())
    if len(str(parent)) > _MAX_FOLDER - 20:
        parent = Path("/tmp")  # noqa: S108 - the folder below has a random name and is only for this user
    for old in parent.glob(f"{_FOLDER_PREFIX}*-*"):
        pid = old.name.removeprefix(_FOLDER_PREFIX).partition("-")[0]
        if pid.isdigit() and not Path(f"/proc/{pid}").exists() and Path("/proc/self").exists():
            shutil.rmtree(old, ignore_errors=True)
    try:
        folder = Path(tempfile.mkdtemp(prefix=f"{_FOLDER_PREFIX}{os.getpid()}-", dir=parent))
    except OSError as error:
        raise FleetError(f"{parent}: cannot be written ({error.strerror}); set TMPDIR to another folder.") from error
    try:
        yield folder
    finally:
        with ignore_interrupts():
            _remove(folder)


def _remove(folder: Path) -> None:
    """Remove the folder of Ray; its processes write logs until they have ended."""
    end_s = time.monotonic() + _END_S
    while folder.exists():
        shutil.rmtree(folder, ignore_errors=True)
        if time.monotonic() > end_s:
            return
        time.sleep(0.1)
