"""Values of a pipeline as bytes: what its parts learnt, without what is opened again.

Objects are pickled by their values. Not pickled are the `resources` of a pipeline, such as its
networks and its background, which have names: a pipeline that is opened in the same way has the
same ones. Threads are started again, calls in the background are waited for, and objects that are
used there are moved to the background of the new pipeline.
"""

import io
import pickle
import threading
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import cv2

from track_range.foundation.background import Background, BackgroundObject
from track_range.foundation.errors import UserError

STATE_VERSION = 2  # of the content of a state
_WAIT_S = 60.0  # longest time for calls in the background, which take some seconds
_LOCK_TYPES = (type(threading.Lock()), type(threading.RLock()))


class StateError(UserError, ValueError):
    """A pipeline whose state cannot be stored, or a state that cannot be restored."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PipelineState:
    """What a pipeline knows after a frame, for `tr.Pipeline.restore`; can be pickled.

    Attributes:
        version: version of the content.
        made_by: version of track-range that made it, the only one that can restore it.
        n_frames: number of frames so far.
        opened_with: the arguments of the pipeline.
        content: the values, in Python's pickle format: restore only states of a source that you
            trust.
    """

    made_by: str
    n_frames: int
    opened_with: bytes
    content: bytes
    version: int = STATE_VERSION

    def __repr__(self) -> str:
        size_mb = len(self.content) / 1e6
        return f"PipelineState({self.n_frames} frames, {size_mb:.1f} MB, version {self.made_by})"


def check_version(state: object, version: str) -> None:
    """Raises StateError unless a state is one of this version of track-range."""
    if not isinstance(state, PipelineState):
        raise StateError(
            f"state: expected a PipelineState of Pipeline.state(), found {type(state).__name__}."
        )
    if (state.version, state.made_by) != (STATE_VERSION, version):
        raise StateError(
            f"state: expected one of track-range {version} (format {STATE_VERSION}), found one of "
            f"{state.made_by} (format {state.version}); only the version that made a state can "
            "restore it: start a new drive with the frames from now on."
        )


def dumped(values: object, resources: Mapping[str, object]) -> bytes:
    """The values as bytes; StateError names what cannot be stored."""
    buffer = io.BytesIO()
    try:
        _Pickler(buffer, resources).dump(values)
    except TimeoutError as error:
        raise StateError(
            f"state: expected an estimate in the background within {_WAIT_S:.0f} s, found none; "
            "store the state later."
        ) from error
    except (TypeError, AttributeError, pickle.PicklingError) as error:
        raise StateError(
            f"state: expected parts that can be pickled, found one that cannot ({error}); give an "
            "own detector or tracker `__getstate__`."
        ) from error
    return buffer.getvalue()


def loaded(content: bytes, resources: Mapping[str, object]) -> Any:
    """The values of `dumped`, with the resources of another pipeline; StateError for others."""
    try:
        return _Unpickler(io.BytesIO(content), resources).load()
    except Exception as error:  # damaged bytes cause errors of any kind
        raise StateError(
            f"state: expected the content of Pipeline.state(), found other bytes ({error})."
        ) from error


class _Pickler(pickle.Pickler):
    def __init__(self, buffer: io.BytesIO, resources: Mapping[str, object]) -> None:
        super().__init__(buffer, pickle.HIGHEST_PROTOCOL)
        # bound methods are new objects at each access, but equal
        self._names = {id(value): name for name, value in resources.items() if value is not None}

    def persistent_id(self, obj: Any) -> str | None:
        return self._names.get(id(obj))

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, BackgroundObject):
            # the calls before it are done then
            content = obj.call(_own_bytes).result(_WAIT_S)
            return _adopted, (obj.background, content)
        if isinstance(obj, Future):
            error = obj.exception(_WAIT_S)
            return _done, (None if error else obj.result(), error)
        if isinstance(obj, ThreadPoolExecutor):
            return _thread, (obj._thread_name_prefix,)
        if isinstance(obj, cv2.StereoMatcher):
            return _matcher, (type(obj).__name__, _parameters(obj))
        if isinstance(obj, _LOCK_TYPES):
            return threading.Lock, ()
        return NotImplemented


class _Unpickler(pickle.Unpickler):
    def __init__(self, buffer: io.BytesIO, resources: Mapping[str, object]) -> None:
        super().__init__(buffer)
        self._resources = resources

    def persistent_load(self, pid: str) -> Any:
        return self._resources[pid]


def _own_bytes(target: object) -> bytes:
    """An object that is used in the background, as bytes."""
    return dumped(target, {})


def _from_bytes(content: bytes) -> Any:
    return loaded(content, {})


def _adopted(background: Background, content: bytes) -> BackgroundObject[Any]:
    return background.create(_from_bytes, content)


def _done(result: object, error: BaseException | None) -> Future[Any]:
    future: Future[Any] = Future()
    if error is None:
        future.set_result(result)
    else:
        future.set_exception(error)
    return future


def _thread(name: str) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, thread_name_prefix=name)


def _parameters(matcher: cv2.StereoMatcher) -> dict[str, Any]:
    """The parameters of a matcher of OpenCV by name."""
    names = [name.removeprefix("get") for name in dir(matcher) if name.startswith("get")]
    names = [name for name in names if hasattr(matcher, f"set{name}")]
    return {name: getattr(matcher, f"get{name}")() for name in names}


def _matcher(kind: str, parameters: Mapping[str, Any]) -> cv2.StereoMatcher:
    matcher: cv2.StereoMatcher = getattr(cv2, kind).create()
    for name, value in parameters.items():
        getattr(matcher, f"set{name}")(value)
    return matcher
