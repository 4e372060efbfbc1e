"""Run the site until it is stopped: which address it takes, who may ask, and what is logged."""

from __future__ import annotations

import secrets
import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.errors import BadSetting, one_line

if TYPE_CHECKING:
    from upvl_cli.pipeline.workspace import Workspace

LOOPBACK = ("127.0.0.1", "localhost", "::1")
_EVERYWHERE = ("0.0.0.0", "::")  # no address that a browser could open
_MOST_CONNECTIONS = 1000  # a browser opens six
_MIN_TOKEN = 16  # letters: shorter ones can be tried out


@dataclass(frozen=True)
class ServeOptions:
    """Where the server listens.

    Attributes:
        host: Address or name; another one than the own machine needs a token.
        port: Number of the port; 0 takes a free one.
        token: Secret that the first address has to hold; "" makes one where one is needed.
        access_log: Whether each request is written to the terminal.
    """

    host: str = LOOPBACK[0]
    port: int = 8700
    token: str = ""
    access_log: bool = False


def serve(workspace: Workspace, options: ServeOptions, on_ready: Callable[[str], None]) -> None:
    """Answer requests until Ctrl-C.

    Args:
        workspace: What is shown.
        options: Where the server listens.
        on_ready: Called with the address when it can be opened.

    Raises:
        BadSetting: A package is missing, the address cannot be taken, or the token is too short.
    """
    try:
        import starlette  # noqa: F401
        import uvicorn
    except ImportError as error:
        missing = error.name or "starlette"
        raise BadSetting(f"serve needs the package {missing}; run: pip install 'upvl[serve]'") from None
    from upvl_cli.web.guard import Access
    from upvl_cli.web.site import Site

    token = _token(options)
    listening = _listen(options)
    port = int(listening.getsockname()[1])
    # A name that leads here can be rebound by its owner; the names of this machine and numbers cannot.
    hosts = {*LOOPBACK, "[::1]", options.host.lower(), socket.gethostname().lower()}
    access = Access(frozenset(hosts), any_address=options.host not in LOOPBACK, token=token)
    site = Site(workspace)
    config = uvicorn.Config(
        site.application(access),
        access_log=options.access_log,
        log_level="info" if options.access_log else "error",
        server_header=False,
        proxy_headers=False,
        lifespan="off",
        ws="none",
        http="h11",
        h11_max_incomplete_event_size=2**14,
        timeout_keep_alive=10,
        limit_concurrency=_MOST_CONNECTIONS,
        timeout_graceful_shutdown=3,
    )
    try:
        site.warm_up()
        host = socket.gethostname() if options.host in _EVERYWHERE else options.host
        shown = f"[{host}]" if ":" in host else host
        on_ready(f"http://{shown}:{port}/" + (f"?token={token}" if token else ""))
        uvicorn.Server(config).run(sockets=[listening])
    finally:
        site.close()
        listening.close()


def _token(options: ServeOptions) -> str:
    if options.token and (
        len(options.token) < _MIN_TOKEN or not options.token.replace("-", "").replace("_", "").isalnum()
    ):
        raise BadSetting(
            f"--token has to be at least {_MIN_TOKEN} letters, digits, - or _; leave it out to have one made"
        )
    if options.token or options.host in LOOPBACK:
        return options.token
    return secrets.token_urlsafe(24)


def _listen(options: ServeOptions) -> socket.socket:
    family = socket.AF_INET6 if ":" in options.host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((options.host, options.port))
        listening.listen(256)
    except OSError as error:
        listening.close()
        raise BadSetting(
            f"cannot listen on {options.host} port {options.port}: {error.strerror or one_line(error)}; choose another "
            "with --host or --port"
        ) from None
    return listening
