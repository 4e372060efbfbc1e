"""Where drives or results lie: a folder of this machine, or one of an object store."""

from __future__ import annotations

import re
from pathlib import Path

from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.storage.connect import SCHEMES

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*):/+(.*)", re.DOTALL)
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{1,254}")  # of a bucket or a container


def location(text: str | Path, *, of_drives: bool = False) -> Path:
    """Return the path that a text names.

    Args:
        text: A local path, or an address such as `s3://bucket/folder`.
        of_drives: Whether it holds drives, which do not change while a process runs, so that folders are listed once.

    Raises:
        BadSetting: The address has an unknown scheme, holds credentials, or names no bucket or a strange folder.
    """
    from upvl_cli.pipeline.storage.drive_path import DrivePath
    from upvl_cli.pipeline.storage.remote_path import RemotePath

    match = _SCHEME.fullmatch(str(text))
    if match is None:
        return Path(text).expanduser()
    scheme, rest = match.groups()
    if scheme not in SCHEMES:
        raise BadSetting(
            f"{scheme}://...: unknown kind of address; expected a local folder, "
            f"{', '.join(f'{known}://' for known in SCHEMES)}"
        )
    bucket, *parts = rest.rstrip("/").split("/")
    if "@" in bucket or ":" in bucket:
        raise BadSetting(
            f"{scheme}://...: the address holds credentials or a port, which does not belong there; give credentials "
            "in the environment, a profile or a role, and the address of a store of your own in AWS_ENDPOINT_URL"
        )
    if not _NAME.fullmatch(bucket):
        raise BadSetting(
            f"{scheme}://{bucket}: expected the name of a bucket, as in {scheme}://bucket/folder"
        )
    if any(part in ("", ".", "..") or not part.isprintable() for part in parts):
        raise BadSetting(f"{scheme}://{bucket}/...: the folder has an empty part, '.' or '..'; write it out")
    return (DrivePath if of_drives else RemotePath)(f"{scheme}:", bucket, *parts)
