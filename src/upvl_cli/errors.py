"""Failures that a user can mend: one clear line and exit code 2. Anything else is a bug."""

from __future__ import annotations


class UpvlError(Exception):
    """An expected failure; the message says what, where, what was expected and what to do."""


class BadInput(UpvlError):
    """A file or an array is not what it has to be."""


class BadSetting(UpvlError):
    """A value in `stages/*.toml` or on the command line is unknown, misspelled or out of range."""


class OutOfMemory(UpvlError):
    """A stage needs more memory than there is."""


class NotMade(UpvlError):
    """A shard that is needed has not been made, or was made with other settings."""


class StorageError(UpvlError):
    """An object store did not do what was asked, after several attempts where another attempt can help."""


def one_line(error: BaseException) -> str:
    """Return the message of an error without line breaks: what a user sees is one line."""
    return " ".join(str(error).split())
