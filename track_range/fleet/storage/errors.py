"""StorageError: why a file or folder cannot be read or written, by kind; conversion of the
libraries' errors.
"""

from __future__ import annotations

import errno
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

from track_range.foundation.errors import UserError
from track_range.foundation.files.atomic_files import describe
from track_range.foundation.files.input_files import printable, shortened

StorageFault = Literal["missing", "permission", "full", "network", "other"]
"""No such file, folder or bucket; no permission or credentials; no space left; an error that may
disappear when the call is repeated (network, overload); another error."""

_MAX_REASON = 140  # largest number of characters of a library's error text in a message

_NETWORK_ERRORS = (
    *(
        errno.EIO,
        errno.ESTALE,
        errno.ETIMEDOUT,
        errno.EAGAIN,
        errno.ECONNREFUSED,
        errno.ECONNRESET,
        errno.EPIPE,
    ),
    *(errno.ECONNABORTED, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.EHOSTDOWN),
)
_ERRNO_FAULTS: dict[int, StorageFault] = {
    **dict.fromkeys((errno.ENOENT, errno.ENOTDIR), "missing"),
    **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), "permission"),
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT), "full"),
    **dict.fromkeys(_NETWORK_ERRORS, "network"),
}

_STATUS_FAULTS: dict[int, StorageFault] = {  # by HTTP status; from 500 on "network", else "other"
    **dict.fromkeys((401, 403), "permission"),
    **dict.fromkeys((404, 410), "missing"),
    **dict.fromkeys((408, 429), "network"),
}
# of pyarrow's stores by kind; the first that matches counts
_TEXT_FAULTS: dict[StorageFault, str] = {
    "permission": r"ACCESS_?DENIED|INVALID_\w*(?:KEY|SIGNATURE|TOKEN)|SIGNATURE_DOES_NOT|EXPIRED_?TOKEN|UNAUTHENTICATED"
    r"|MISSING_AUTH|UNRECOGNIZED_CLIENT|NOT_INITIALIZED|PERMISSION_DENIED|status 40[13]|AccountProblem|OAuth2 access",
    "missing": r"\bNO_SUCH_(?:KEY|BUCKET|UPLOAD)|\b(?:RESOURCE_)?NOT_FOUND\b|status 404|Bucket  not found",
    "full": r"QuotaExceeded|InsufficientStorage|StorageFull|status 507|No space left",
    "network": r"\bNETWORK_|\bSLOW_DOWN|\b(?:SERVICE_)?UNAVAILABLE\b|\bINTERNAL(?:_FAILURE|_ERROR)?\b|\bTHROTTLING"
    r"|\bREQUEST_TIME|\bDEADLINE_EXCEEDED|\bRESOURCE_EXHAUSTED|\bABORTED\b|\bcurlCode\b|\bCURL error"
    r"|status (?:408|429|5\d\d)|timed? ?out|onnection (?:reset|closed|refused)|resolve host",
}
_MAX_TEXT = 4000  # characters of a text that are read; servers may answer with whole pages
# names in such texts
_NAMES = re.compile(r"(?s)^When .*?: (?=AWS Error)|(?<!\w)'.*?'(?!\w)|(?<=No such object: ).*")
_NOISE = re.compile(  # parts of such texts that do not help a user
    r"(?s)^When .*?: (?=AWS Error)|^google::cloud::Status\(|PerformWork\(\) - | error_info=.*|: No response.*"
    r"|(?:Permanent error|Retry policy \w+), with a last message of |curlCode: \d+, (?:.*; Details: )?"
    r"|\s*\(Request ID: .*?\)|\.? Detail: .*"
)
_SECRETS = re.compile(
    r"(?i)((?:access.?key(?:.?id)?|secret\w{0,40}|token|signature|credential|authorization|password)\s*[=:]\s*)[\w%+/=.~-]+"
)

_ADVICE: dict[StorageFault, str] = {
    "missing": "; check the name",
    "permission": "; check the credentials and permissions",
    "full": "; free space, or choose another place",
    "network": "; check the connection and the endpoint, or try again later",
    "other": "",
}


class StorageError(UserError):
    """A file, folder or bucket that cannot be read or written, for a reason of a kind."""

    def __init__(self, message: str, kind: StorageFault = "other") -> None:
        super().__init__(message)
        self.kind: StorageFault = kind

    def __reduce__(self) -> tuple[type[StorageError], tuple[str, StorageFault]]:
        return type(self), (str(self), self.kind)

    @property
    def is_transient(self) -> bool:
        """Whether the same call may succeed later."""
        return self.kind == "network"


@contextmanager
def storage_errors(address: object, action: str) -> Iterator[None]:
    """Context in which errors of the operating system, pyarrow and aiohttp become a StorageError.

    Messages contain the address, without credentials, and the action as a participle: "read",
    "written".
    """
    aiohttp: Any = sys.modules.get("aiohttp")
    web_error = () if aiohttp is None else (aiohttp.ClientError,)
    try:
        yield
    except (OSError, ValueError, NotImplementedError, *web_error) as error:
        raise storage_error(address, action, error) from error


def storage_error(address: object, action: str, error: Exception) -> StorageError:
    """The error of one file or folder; see `storage_errors`."""
    # fsspec reports each failure of a request for the size as a missing file, with the reason as
    # its cause
    if isinstance(error, FileNotFoundError) and isinstance(error.__cause__, Exception):
        error = error.__cause__
    fault = fault_of(error)
    address = printable(str(address))
    if fault == "missing" and action == "read":
        return StorageError(f"{address}: no such file or folder{_ADVICE[fault]}.", fault)
    return StorageError(
        f"{address}: cannot be {action} ({reason_of(error)}){_ADVICE[fault]}.", fault
    )


def fault_of(error: Exception) -> StorageFault:
    """Kind of an error of the operating system, pyarrow or aiohttp."""
    status = getattr(error, "status", None)
    if status is not None:
        return _STATUS_FAULTS.get(status, "network" if status >= 500 else "other")
    if isinstance(error, FileNotFoundError):
        return "missing"
    if (number := getattr(error, "errno", None)) in _ERRNO_FAULTS:
        return _ERRNO_FAULTS[number]
    is_web = type(error).__module__.startswith("aiohttp") and not isinstance(error, ValueError)
    if is_web or isinstance(error, TimeoutError | ConnectionError):
        return "network"
    text = _NAMES.sub("", str(error)[:_MAX_TEXT])
    return next(
        (fault for fault, pattern in _TEXT_FAULTS.items() if re.search(pattern, text)), "other"
    )


def reason_of(error: Exception) -> str:
    """Text of an error without credentials and names of objects."""
    if (status := getattr(error, "status", None)) is not None:
        return f"HTTP status {status} {getattr(error, 'message', '')}".strip()
    text = describe(error) if isinstance(error, OSError) and error.errno is not None else str(error)
    text = text[:_MAX_TEXT]
    text = _SECRETS.sub(r"\1...", " ".join(_NOISE.sub("", text).split())).strip(" .:")
    return shortened(text or type(error).__name__, _MAX_REASON)
