"""Connections to object stores, with credentials from the places that their own tools use; none is kept or shown."""

from __future__ import annotations

import os
import re
from datetime import timedelta
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from upvl_cli.errors import BadSetting, StorageError

if TYPE_CHECKING:
    from obstore.store import ObjectStore

SCHEMES = ("s3", "gs", "az")

# The whole of a request, its body included: a part of a large object is 8 MiB, which a slow line needs a minute for.
TIMEOUT_VARIABLE = "UPVL_STORE_TIMEOUT_S"
_TIMEOUT_S = 120.0
_CONNECT_TIMEOUT = timedelta(seconds=10)
_ENDPOINT = re.compile(r"https?://[A-Za-z0-9.\[\]:-]+(/[A-Za-z0-9._~/-]*)?")


@lru_cache(maxsize=64)
def connect(scheme: str, bucket: str) -> ObjectStore:
    """Return the connection of this process to a bucket.

    Args:
        scheme: One of `SCHEMES`.
        bucket: Name of the bucket; of the container for `az`.

    Raises:
        BadSetting: The library for object stores is not installed, or a value of the environment makes no sense.
        StorageError: No credentials can be found.
    """
    try:
        from obstore.store import AzureStore, GCSStore, S3Store
    except ModuleNotFoundError:
        raise BadSetting(
            f"{scheme}://{bucket} needs the package obstore; run: pip install 'upvl[storage]'"
        ) from None
    options: dict[str, Any] = {
        "client_options": {"timeout": _timeout(), "connect_timeout": _CONNECT_TIMEOUT},
        "retry_config": {"max_retries": 2, "retry_timeout": timedelta(seconds=60)},
    }
    endpoint = _endpoint() if scheme == "s3" else ""
    try:
        if scheme == "gs":
            return GCSStore(bucket, **options)
        if scheme == "az":
            return AzureStore(bucket, **options)
        options["client_options"]["allow_http"] = endpoint.startswith("http://")
        return S3Store(bucket, **options, **_aws_options(endpoint))
    except Exception as error:
        # The message of the library could hold a value of the environment.
        raise StorageError(
            f"{scheme}://{bucket} cannot be opened ({type(error).__name__}): a credential or an option of the store "
            "in the environment is missing or makes no sense; check it with the store's own tool"
        ) from None


def _timeout() -> timedelta:
    text = os.environ.get(TIMEOUT_VARIABLE)
    try:
        seconds = _TIMEOUT_S if text is None else float(text)
    except ValueError:
        seconds = 0.0
    if not 0.1 <= seconds <= 86400:
        raise BadSetting(f"{TIMEOUT_VARIABLE} is {text!r}, expected seconds, a number from 0.1 to 86400")
    return timedelta(seconds=seconds)


def _endpoint() -> str:
    """Return the address of a store of one's own; "" for Amazon's.

    Raises:
        BadSetting: It is no address. It is not shown: it could hold a password.
    """
    for variable in ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL"):
        text = os.environ.get(variable)
        if text and not _ENDPOINT.fullmatch(text):
            raise BadSetting(
                f"{variable} is no address of a store; expected https://host or http://host:port"
            )
        if text:
            return text
    return ""


def _aws_options(endpoint: str) -> dict[str, Any]:
    """Return the region, the address and, where keys stand in a profile, what reads them."""
    found: dict[str, Any] = {}
    if endpoint:
        found["endpoint"] = endpoint
        # Names of buckets in the path of the address: what stores of one's own understand.
        found["virtual_hosted_style_request"] = False
    if os.environ.get("AWS_ACCESS_KEY_ID") or not _has_profiles():
        return found
    try:
        from obstore.auth.boto3 import Boto3CredentialProvider
    except ModuleNotFoundError:
        return found
    provider = Boto3CredentialProvider()
    return found | {"credential_provider": provider} | provider.config


def _has_profiles() -> bool:
    """Whether there is a profile of Amazon's tools: it can name keys, a role or a single sign-on."""
    files = (
        os.environ.get("AWS_SHARED_CREDENTIALS_FILE", "~/.aws/credentials"),
        os.environ.get("AWS_CONFIG_FILE", "~/.aws/config"),
    )
    return "AWS_PROFILE" in os.environ or any(Path(name).expanduser().is_file() for name in files)
