"""What can go wrong between a process and an object store: attempts again, then one clear line.

The text of a library's error is never shown: it can hold a signed address. Of it only the status and the code of the
answer are taken.
"""

from __future__ import annotations

import errno
import random
import re
import time
from collections.abc import Callable
from typing import TypeVar

from upvl_cli.errors import StorageError

Result = TypeVar("Result")

# Doubling pauses of half a second on average at first: some 15 seconds in all, on top of those of the library below.
_ATTEMPTS = 6
_FIRST_PAUSE_S = 0.5

_STATUS = re.compile(r"status code: (\d{3})")
_CODE = re.compile(r"<Code>(\w{1,60})</Code>")
_CREDENTIALS = (
    "check the credentials of this process (environment, profile or role) and the policy of the bucket"
)
_FINAL = {
    "PermissionDeniedError": ("the credentials do not allow it", _CREDENTIALS),
    "UnauthenticatedError": ("the credentials are missing or not valid", _CREDENTIALS),
    "NotSupportedError": ("the store cannot do that", "use a store that answers conditional writes"),
}
# What writing the local copy can end with: a store never answers so, and another attempt meets the same disk.
_OF_DISK = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG, errno.EIO}
_EXPIRED = {"ExpiredToken", "ExpiredTokenException", "RequestTimeTooSkewed", "InvalidAccessKeyId"}


class Conflict(Exception):
    """A conditional write was refused, as the object is there or has changed."""


def attempt(action: Callable[[], Result], address: str, doing: str) -> Result:
    """Return what an action gives, and try again after pauses that grow where another attempt can help.

    Args:
        action: One request; it can be made twice without harm.
        address: The address of the object, for messages.
        doing: What was tried, as in "cannot be read".

    Raises:
        FileNotFoundError: There is no such object.
        Conflict: The condition of a write does not hold.
        StorageError: Another attempt cannot help, or none did.
    """
    for number in range(1, _ATTEMPTS + 1):
        try:
            return action()
        except Exception as error:
            kind = type(error).__name__
            if kind in ("AlreadyExistsError", "PreconditionError"):
                raise Conflict from None
            final = _final_reason(error)
            if isinstance(error, FileNotFoundError) and final is None:
                raise FileNotFoundError(2, "no such object", address) from None
            if not _is_of_store(error):
                raise
            if isinstance(error, OSError) and error.errno in _OF_DISK:
                raise StorageError(
                    f"{address} cannot be {doing}: the local copy cannot be written ({error.strerror}); make room in "
                    "the folder of UPVL_CACHE, or name another one"
                ) from None
            if final or number == _ATTEMPTS:
                reason, remedy = final or _reason_after_attempts(error)
                raise StorageError(f"{address} cannot be {doing}: {reason}; {remedy}") from None
        time.sleep(_FIRST_PAUSE_S * 2 ** (number - 1) * random.uniform(0.5, 1.5))
    raise AssertionError("unreachable")


def _is_of_store(error: Exception) -> bool:
    """Whether an error is one of the library below, or of the connection, and not a bug of ours."""
    return type(error).__module__.partition(".")[0] == "obstore" or isinstance(error, (OSError, ValueError))


def _final_reason(error: Exception) -> tuple[str, str] | None:
    """Return the reason and the remedy where another attempt cannot help; None where it can."""
    text, kind = str(error), type(error).__name__
    code = match.group(1) if (match := _CODE.search(text)) else ""
    if code == "NoSuchBucket":
        return "there is no such bucket", "create it, or correct its name"
    if code in _EXPIRED:
        return f"the store answered {code}", _CREDENTIALS
    if kind in _FINAL:
        return _FINAL[kind]
    status = int(match.group(1)) if (match := _STATUS.search(text)) else 0
    if 400 <= status < 500 and status not in (404, 408, 409, 412, 429):
        return f"the store answered {status}{' ' + code if code else ''}", (
            "check the region (AWS_REGION) and the address of the store (AWS_ENDPOINT_URL)"
            if status in (400, 301)
            else _CREDENTIALS
        )
    if "NoCredentials" in text or "Received None from session" in text or "credential" in text.lower():
        return "no credentials were found", _CREDENTIALS
    return None


def _reason_after_attempts(error: Exception) -> tuple[str, str]:
    text = str(error)
    code = match.group(1) if (match := _CODE.search(text)) else ""
    status = match.group(1) if (match := _STATUS.search(text)) else ""
    answer = " ".join(part for part in ("the store answered", status, code) if part) if status else ""
    reason = answer or "the store does not answer, or the connection broke"
    return (
        f"{reason} ({_ATTEMPTS} attempts)",
        "check the network and the address of the store, then run again: what was finished is kept",
    )
