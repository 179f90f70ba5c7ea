"""Sessions of onnxruntime on any of its execution providers, including separate packages."""

import io
import re
from contextlib import redirect_stdout, suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import onnxruntime as ort

from track_range.detection.models.devices import ACCELERATORS, Device
from track_range.foundation.files.cache_folder import cache_folder
from track_range.foundation.files.input_files import shortened
from track_range.foundation.processes import n_limited_cores

# Without kernels for INT8; TensorRT has FP16. The packaged detector takes 3.2 ms with CUDA instead
# of 11.1 (H200).
_IN_FLOAT = ("cuda", "tensorrt", "coreml")
# of hardware, for a provider that supports several; the preferred one first
_KINDS = ("GPU", "CPU", "NPU")
# place in onnxruntime's source and the function's signature
_SOURCE = re.compile(r"^/\S+:\d+ .*[)\]] (?=[A-Z])")
_MAX_REASON = 160  # characters of a library's message


class OpenedSession(NamedTuple):
    """A session and where it runs."""

    session: Any  # onnxruntime's InferenceSession
    device: str
    reason: str  # why `device` is not the one that was asked for; "" = it is


def open_session(path: Path, device: Device, n_threads: int) -> OpenedSession:
    """A session on `device`, or on the next device that works: CUDA after TensorRT, the CPU last.

    `n_threads` is the number of CPU threads; 0 = one per core. Errors of the CPU's session are
    raised as they are.
    """
    requested = "cuda" if device == "auto" else device
    chain = {"cpu": (), "tensorrt": ("tensorrt", "cuda")}.get(requested, (requested,))
    missing = {name: why_missing(name) for name in chain}
    reasons = [reason for reason in missing.values() if reason]
    usable = [*(name for name in chain if not missing[name]), "cpu"]
    while True:
        try:
            session = _session(path, usable, n_threads)
            break
        except Exception as error:  # onnxruntime has dozens of unrelated types
            if usable == ["cpu"]:
                raise
            reasons.append(first_line(error, path))
            usable.pop(0)
    provider = session.get_providers()[0]
    used = next(
        (name for name, accelerator in ACCELERATORS.items() if accelerator.provider == provider),
        "cpu",
    )
    if used != requested:  # onnxruntime leaves out a provider whose libraries it cannot load
        reasons.append(f"its libraries cannot be loaded; install {ACCELERATORS[requested].needs}")
    return OpenedSession(session, used, "" if used == requested else reasons[0])


def why_missing(device: str) -> str:
    """Why a device other than the CPU cannot be used on this machine, with the package to install;
    "" = unknown.
    """
    accelerator = ACCELERATORS[device]
    if accelerator.provider in ort.get_available_providers() or _plugin_devices(device):
        return ""
    is_registered = bool(accelerator.plugin) and _is_registered(accelerator.plugin)
    return (
        f"{accelerator.needs} supports no hardware of this machine"
        if is_registered
        else f"install {accelerator.needs}"
    )


def first_line(error: Exception, path: Path) -> str:
    """First line of a library's message, with the name of the network's file in place of its
    path.
    """
    lines = str(error).replace(str(path), path.name).splitlines() or [type(error).__name__]
    return shortened(_SOURCE.sub("", lines[0]), _MAX_REASON)


def _session(path: Path, devices: list[str], n_threads: int) -> Any:
    """Session for devices in order of preference. Threads do not spin, since spinning slows down
    other programs.
    """
    options = ort.SessionOptions()
    options.intra_op_num_threads = n_threads or n_limited_cores()
    options.inter_op_num_threads = 1
    options.log_severity_level = 4  # failures are reported by our exceptions and notes
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    # On CPUs with AVX2 but no VNNI, sums of products of INT8 saturate at 16 bit without this option,
    # so that the same network finds fewer road users there.
    options.add_session_config_entry("session.x64quantprecision", "1")
    options.enable_mem_pattern = devices[0] != "directml"  # which does not support it
    network: bytes | str = str(path)
    if devices[0] in _IN_FLOAT:
        # imports onnx, which takes 0.4 s
        from track_range.detection.models.dequantize import float_network

        network = float_network(path) or network
    if devices[0] in ("cuda", "tensorrt"):
        _load_cuda()
    if plugin := _plugin_devices(devices[0]):
        options.add_provider_for_devices(plugin[:1], {})
        return ort.InferenceSession(network, options, enable_fallback=0)
    providers = [(ACCELERATORS[name].provider, _options(name)) for name in devices[:-1]]
    return ort.InferenceSession(
        network, options, providers=[*providers, ("CPUExecutionProvider", {})], enable_fallback=0
    )


def _options(device: str) -> dict[str, Any]:
    """Options of a provider."""
    if device == "coreml":
        return {"ModelFormat": "MLProgram"}  # NeuralNetwork, the default, knows fewer operators
    if device != "tensorrt":
        return {}
    options: dict[str, Any] = {"trt_fp16_enable": True}
    if cached := cache_folder():
        # without the folder, TensorRT builds its engine in each run, which takes minutes
        with suppress(OSError):
            (folder := cached / "engines").mkdir(parents=True, exist_ok=True)
            options |= {"trt_timing_cache_enable": True, "trt_engine_cache_enable": True}
            options["trt_engine_cache_path"] = str(folder)
    return options


@cache
def _load_cuda() -> None:
    """Load the libraries of CUDA and cuDNN that are installed as packages; the system finds other
    libraries.
    """
    with redirect_stdout(io.StringIO()), suppress(AttributeError):  # from onnxruntime 1.21
        ort.preload_dlls()


def _plugin_devices(device: str) -> list[Any]:
    """Onnxruntime's devices for a provider in a separate package, the preferred one first; none
    without the package.
    """
    accelerator = ACCELERATORS.get(device)
    if accelerator is None or not accelerator.plugin or not _is_registered(accelerator.plugin):
        return []
    usable = [entry for entry in ort.get_ep_devices() if entry.ep_name == accelerator.provider]
    return sorted(usable, key=lambda entry: _KINDS.index(entry.device.type.name))


@cache
def _is_registered(plugin: str) -> bool:
    """Whether the library of a package is registered with onnxruntime, which a process can do only
    once.
    """
    # not installed, for other versions of onnxruntime, or not for this machine
    with suppress(Exception):
        module = import_module(plugin)
        ort.register_execution_provider_library(module.get_ep_name(), module.get_library_path())
        return True
    return False
