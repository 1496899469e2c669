"""The HTTP server on a thread of its own."""

import errno
import resource
import secrets
import socket
import threading
from pathlib import Path

import psutil
import uvicorn
from starlette.types import ASGIApp

from rapl_core.atomic import write_atomically
from rapl_core.errors import RaplError
from rapl_ros.web.connections import CONNECTIONS, PatientProtocol

TOKEN_FILE = "web_token"
OPERATOR_TOKEN_FILE = "web_operator_token"
PORTS_TRIED = 20
STOP_S = 2.0
SPARE_FILES = 500
"""Open files of everything but connections."""


class AddressError(RaplError):
    """The address to listen on cannot be had."""


def listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens on ``host``: on ``port``, or the next free one after it.

    :param port: 0: any.
    :raises AddressError: if the host is not this machine's or all ports tried are taken.
    """
    tried = [0] if port == 0 else range(port, min(port + PORTS_TRIED, 65536))
    try:
        family, _, _, _, _ = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0]
    except socket.gaierror as error:
        raise AddressError(f"cannot listen on {host!r}: {error.strerror}") from error
    for candidate in tried:
        # The protocol by name: asyncio then sends small answers at once (TCP_NODELAY), which it
        # does not where it cannot see that it is TCP, and a browser waits 40 ms for the body.
        listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, candidate))
            listener.listen(1024)
        except OSError as error:
            listener.close()
            if error.errno != errno.EADDRINUSE:
                raise AddressError(
                    f"cannot listen on {host} port {candidate}: {error.strerror}"
                ) from error
            continue
        listener.set_inheritable(False)
        return listener
    raise AddressError(f"ports {port} to {port + len(tried) - 1} of {host} are all taken")


def address_of(listener: socket.socket) -> str:
    """Return the address at which a browser on this machine finds the server."""
    host, port = listener.getsockname()[:2]
    if host in ("0.0.0.0", "::"):
        host = socket.gethostname()
    return f"http://{f'[{host}]' if ':' in host else host}:{port}/"


def addresses_for_others(listener: socket.socket) -> list[str]:
    """Return the addresses at which other machines find a server that listens on all interfaces:
    names are often not known there."""
    host, port = listener.getsockname()[:2]
    if host not in ("0.0.0.0", "::"):
        return []
    found = [
        address.address
        for addresses in psutil.net_if_addrs().values()
        for address in addresses
        if address.family is socket.AF_INET and not address.address.startswith("127.")
    ]
    return [f"http://{address}:{port}/" for address in found]


def token_of(run_folder: Path, name: str = TOKEN_FILE) -> str:
    """Return a token of the run: made once, kept in a file that only its owner can read, so that a
    restarted server takes the same one."""
    path = run_folder / name
    try:
        kept = path.read_text().strip()
        if len(kept) >= 32:
            return kept
    except FileNotFoundError:
        pass
    token = secrets.token_urlsafe(32)
    write_atomically(path, token + "\n", "the token to", error=AddressError, mode=0o600)
    return token


class ServerThread:
    """uvicorn on a socket that listens already; connections wait until it is up."""

    def __init__(self, app: ASGIApp, listener: socket.socket) -> None:
        config = uvicorn.Config(
            app,
            log_level="warning",
            access_log=False,
            lifespan="off",
            server_header=False,
            timeout_graceful_shutdown=1,
            http=PatientProtocol,
            limit_concurrency=CONNECTIONS,
        )
        _allow_files(CONNECTIONS + SPARE_FILES)
        self._server = uvicorn.Server(config)
        self._listener = listener
        self._thread = threading.Thread(target=self._serve, name="web server", daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        self._server.run(sockets=[self._listener])

    @property
    def alive(self) -> bool:
        """Whether it serves."""
        return self._thread.is_alive()

    def close(self) -> None:
        """Stop serving."""
        self._server.should_exit = True
        self._thread.join(STOP_S)
        self._listener.close()


def _allow_files(number: int) -> None:
    """Raise the soft limit of open files, as far as it may be."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = number if hard == resource.RLIM_INFINITY else min(number, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
