"""StorageError: why a file or folder cannot be read or written, by kind; conversion of the libraries' errors."""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from track_range.foundation.errors import UserError
from track_range.foundation.files.atomic_files import describe
from track_range.foundation.files.input_files import printable, shortened

StorageFault = Literal["missing", "permission", "full", "network", "other"]
"""Kind of a storage error: no such file, folder or bucket; no permission or credentials; no space left; an error that
may disappear when the call is repeated (network, overload); another one."""

_MAX_REASON = 140
"""Largest number of characters of a library's error text in a message."""

_ERRNO_FAULTS: dict[StorageFault, frozenset[int]] = {
    "missing": frozenset((errno.ENOENT, errno.ENOTDIR)),
    "permission": frozenset((errno.EACCES, errno.EPERM, errno.EROFS)),
    "full": frozenset((errno.ENOSPC, errno.EDQUOT)),
    "network": frozenset(
        (
            *(errno.EIO, errno.ESTALE, errno.ETIMEDOUT, errno.EAGAIN, errno.ECONNREFUSED, errno.ECONNRESET),
            *(errno.ECONNABORTED, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.EHOSTDOWN, errno.EPIPE),
        )
    ),
}
"""Operating system's error numbers by kind."""

_TEXT_FAULTS: tuple[tuple[StorageFault, re.Pattern[str]], ...] = (
    (
        "permission",
        re.compile(
            r"\bACCESS_DENIED|\bINVALID_ACCESS_KEY|\bSIGNATURE_DOES_NOT_MATCH|\bINVALID_SIGNATURE|\bEXPIRED_TOKEN"
            r"|\bINVALID_CLIENT_TOKEN|\bMISSING_AUTHENTICATION|\bUNRECOGNIZED_CLIENT|\bNOT_INITIALIZED|ExpiredToken"
            r"|\bOPT_IN_REQUIRED|\bPERMISSION_DENIED|\bUNAUTHENTICATED|status 40[13]|AccountProblem|OAuth2 access token"
        ),
    ),
    ("missing", re.compile(r"\bNO_SUCH_\w+|\bRESOURCE_NOT_FOUND|\bNOT_FOUND\b|status 404|Bucket '.*' not found")),
    ("full", re.compile(r"QuotaExceeded|InsufficientStorage|StorageFull|status 507|No space left")),
    (
        "network",
        re.compile(
            r"\bNETWORK_CONNECTION|\bSLOW_DOWN|\bSERVICE_UNAVAILABLE|\bINTERNAL_FAILURE|\bTHROTTLING|\bREQUEST_TIME"
            r"|\bUNAVAILABLE|\bDEADLINE_EXCEEDED|\bRESOURCE_EXHAUSTED|\bINTERNAL\b|\bABORTED\b|status (?:408|429|5\d\d)"
            r"|curlCode|[Tt]imed? ?out|CURL error|onnection (?:reset|closed|refused)|resolve host"
        ),
    ),
)
"""Texts of the errors of pyarrow's object stores (AWS, Google Cloud) by kind; the first that matches counts."""

_PLACE = re.compile(r"^When .*?: (?=AWS Error)", re.DOTALL)
"""Start of such a text, which contains names of objects."""

_AWS = re.compile(r"AWS Error (\w+)(?: \(HTTP status \d+\))? during \w+ operation:?\s*(.*)", re.DOTALL)
"""Code and text of an error of S3."""

_GOOGLE = re.compile(r".*?Status\((\w+): (?:.*?with a last message of )?(?:PerformWork\(\) - )?(.*)", re.DOTALL)
"""Code and text of an error of Google Cloud Storage."""

_NOISE = re.compile(
    r"\s*\(Request ID: [^)]*\)|^curlCode: \d+, .*; Details: |^curlCode: \d+, |^No response body\.?$"
    r"|\s*Detail: \[errno \d+\].*$|\s+error_info=.*$|^\[Errno \d+\] ",
    re.DOTALL,
)
"""Parts of these texts that are of no use to a user."""

_SECRETS = re.compile(
    r"(?i)((?:access.?key(?:.?id)?|secret\w*|token|signature|credential|authorization|password)\s*[=:]\s*)[\w%+/=.~-]+"
)
"""Credentials that a library's text may contain."""

_ADVICE: dict[StorageFault, str] = {
    "missing": "check the name",
    "permission": "check the credentials and permissions",
    "full": "free space, or choose another place",
    "network": "check the connection and the endpoint, or try again later",
    "other": "",
}


class StorageError(UserError):
    """A file, folder or bucket that cannot be read or written.

    Args:
        message: one sentence with the address.
        kind: kind of the fault.

    Attributes:
        kind: kind of the fault.
    """

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
    """Context in which errors of the operating system and of pyarrow become a StorageError.

    Args:
        address: file or folder, for messages, without credentials.
        action: what is done, as a participle: "read", "written".
    """
    try:
        yield
    except (OSError, ValueError, NotImplementedError) as error:
        raise storage_error(address, action, error) from error


def storage_error(address: object, action: str, error: Exception, kind: StorageFault | None = None) -> StorageError:
    """The error of one file or folder; see `storage_errors`. `kind`: None = derived from `error`."""
    fault = fault_of(error) if kind is None else kind
    address = printable(str(address))
    advice = f"; {_ADVICE[fault]}" if _ADVICE[fault] else ""
    if fault == "missing" and action == "read":
        return StorageError(f"{address}: no such file or folder{advice}.", fault)
    return StorageError(f"{address}: cannot be {action} ({reason_of(error)}){advice}.", fault)


def fault_of(error: Exception) -> StorageFault:
    """Kind of an error of the operating system or of pyarrow."""
    if isinstance(error, FileNotFoundError):
        return "missing"
    number = getattr(error, "errno", None)
    for fault, numbers in _ERRNO_FAULTS.items():
        if number in numbers:
            return fault
    text = _PLACE.sub("", str(error))
    if isinstance(error, TimeoutError | ConnectionError):
        return "network"
    return next((fault for fault, pattern in _TEXT_FAULTS if pattern.search(text)), "other")


def reason_of(error: Exception) -> str:
    """Text of an error without credentials, request numbers and the address."""
    text = describe(error) if isinstance(error, OSError) and error.errno is not None else str(error)
    code = ""
    if (match := _AWS.fullmatch(_PLACE.sub("", text))) is not None:
        code, text = match[1].replace("_", " ").lower(), match[2]
    elif (match := _GOOGLE.fullmatch(text)) is not None:
        code, text = match[1].replace("_", " ").lower(), match[2].strip(" )")
    text = _SECRETS.sub(r"\1...", " ".join(_NOISE.sub("", text).split())).strip(" .:")
    return shortened(text or code or type(error).__name__, _MAX_REASON)
