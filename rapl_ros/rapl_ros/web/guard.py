"""Who may ask at all: host, origin, token, size. Stands in front of every route.

A page of another site can make a browser send requests here, but cannot forge ``Host``, ``Origin``
or ``Sec-Fetch-Site``, cannot read the token and cannot send JSON across origins unasked. Against
DNS rebinding only names that cannot be an attacker's are answered: loopback, IP addresses, this
machine's own name and those named by parameter.
"""

import asyncio
import hmac
import ipaddress
import re
import socket
from collections.abc import Callable, Iterable
from http import HTTPStatus
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rapl_ros.web.problems import RefusedError

API = "/api/"
OPERATORS = frozenset({"/api/live", "/api/camera.jpg", "/api/align", "/api/encoder"})
PROGRESS = "/api/progress"
"""Of everybody, it is for operators; of one annotator, for people."""
BODY_LIMIT = 16 * 1024
"""Bytes. A ranking takes some 300."""
BODY_PATIENCE_S = 10.0
SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
_HOST = re.compile(r"(?:\[([0-9a-fA-F:.]+)\]|([^:\[\]/@\s]+))(?::\d{1,5})?")
SECURITY_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob: data:; connect-src 'self'; form-action 'none'; base-uri 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "X-Frame-Options": "DENY",
}


class HostRule:
    """Which names this server answers to.

    :param host: address that it listens on.
    :param more: further names, e.g. that of a proxy in front.
    """

    def __init__(self, host: str, more: Iterable[str] = ()) -> None:
        self.is_local = is_loopback(host)
        own = {"localhost"}
        if not self.is_local:
            name = socket.gethostname().lower()
            own |= {name, f"{name.partition('.')[0]}.local", socket.getfqdn().lower()}
        self._names = own | {name.lower() for name in more if name}

    def allows(self, host: str) -> bool:
        """Tell whether a ``Host`` header names this server; the port may be a forwarded one."""
        match = _HOST.fullmatch(host)
        if match is None:
            return False
        name = (match[1] or match[2]).lower()
        if name in self._names:
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return False
        return address.is_loopback or not self.is_local


def is_loopback(host: str) -> bool:
    """Tell whether an address to listen on cannot be reached from another machine."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class Guard:
    """ASGI middleware that refuses what must not come through, and says so.

    :param token: that each request under ``/api/`` must bring; empty: none is asked for.
    :param operator_token: that opens everything, and alone what people who rank need not see or do.
    :param on_refusal: told code and message of each refusal; called on the server's thread.
    """

    def __init__(
        self,
        app: ASGIApp,
        hosts: HostRule,
        token: str,
        operator_token: str,
        on_refusal: Callable[[str, str], None],
    ) -> None:
        self._app, self._hosts = app, hosts
        self._token, self._operator_token = token, operator_token
        self._on_refusal = on_refusal

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":  # no websockets here
            await send({"type": "websocket.close", "code": 1008})
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in SECURITY_HEADERS.items():
                    headers[name] = value
                is_api = scope["path"].startswith(API)
                headers.setdefault("Cache-Control", "no-store" if is_api else "no-cache")
            await send(message)

        try:
            self._check(scope)
            if scope["method"] not in SAFE_METHODS:
                receive = await _whole_body(receive)
        except RefusedError as error:
            headers = Headers(scope=scope)
            what = (
                f"{scope['method']} {scope['path']!r} from {headers.get('origin', 'no origin')!r}"
            )
            self._on_refusal(error.code, f"{what}: {error}")
            await error.response()(scope, receive, send_with_headers)
            return
        await self._app(scope, receive, send_with_headers)

    def _check(self, scope: Scope) -> None:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if not self._hosts.allows(host):
            raise _forbidden("wrong_host", f"this server does not answer to the name {host!r}")
        origin = headers.get("origin")
        if origin is not None and re.sub(r"^https?://", "", origin).lower() != host.lower():
            raise _forbidden("wrong_origin", f"requests from {origin!r} are not taken")
        is_api = scope["path"].startswith(API)
        site = headers.get("sec-fetch-site", "none")
        if (is_api or scope["method"] not in SAFE_METHODS) and site not in ("none", "same-origin"):
            raise _forbidden("wrong_origin", "requests from another site are not taken")
        if is_api and self._token:
            self._check_token(scope, headers.get("authorization", ""))
        if scope["method"] not in SAFE_METHODS:
            kind = headers.get("content-type", "").partition(";")[0].strip().lower()
            if kind != "application/json":
                status = HTTPStatus.UNSUPPORTED_MEDIA_TYPE
                raise RefusedError(status, "not_json", f"content type {kind!r}, expected JSON")
            length = headers.get("content-length", "0")
            if not length.isdigit() or len(length) > 9 or int(length) > BODY_LIMIT:
                raise _too_large()

    def _check_token(self, scope: Scope, authorization: str) -> None:
        kind, _, given = authorization.partition(" ")
        if kind.lower() != "bearer":
            given = ""
        if _is_same(given, self._operator_token):
            return
        if not _is_same(given, self._token):
            text = "a token is needed; the address printed at start carries it"
            raise RefusedError(HTTPStatus.UNAUTHORIZED, "token_needed", text)
        if _is_for_operators(scope):
            text = "this needs the operator's token; the address printed for /live carries it"
            raise _forbidden("operators_only", text)


def _is_same(given: str, token: str) -> bool:
    return hmac.compare_digest(given.strip().encode(), token.encode())


def _is_for_operators(scope: Scope) -> bool:
    """Whether a request shows or does what people who rank need not: the system, other people."""
    if scope["path"] == PROGRESS:
        return not parse_qs(scope["query_string"].decode("latin-1")).get("annotator")
    return scope["path"] in OPERATORS


async def _whole_body(receive: Receive) -> Receive:
    """Read the body, within the limit, and return what gives it again in one piece."""
    parts, size, more = [], 0, True
    try:
        async with asyncio.timeout(BODY_PATIENCE_S):
            while more:
                message = await receive()
                if message["type"] == "http.disconnect":
                    break
                parts.append(message.get("body", b""))
                size += len(parts[-1])
                more = message.get("more_body", False)
                if size > BODY_LIMIT:
                    raise _too_large()
    except TimeoutError:
        status = HTTPStatus.REQUEST_TIMEOUT
        raise RefusedError(status, "too_slow", "the body did not arrive in time") from None
    body: Message | None = {"type": "http.request", "body": b"".join(parts), "more_body": False}

    async def give() -> Message:
        nonlocal body
        if body is None:
            return await receive()
        message, body = body, None
        return message

    return give


def _forbidden(code: str, message: str) -> RefusedError:
    return RefusedError(HTTPStatus.FORBIDDEN, code, message)


def _too_large() -> RefusedError:
    status = HTTPStatus.REQUEST_ENTITY_TOO_LARGE
    return RefusedError(status, "too_large", f"a body may have {BODY_LIMIT} bytes")
