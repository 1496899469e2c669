"""Connections: who says nothing does not keep a place, and one address does not take all."""

import asyncio
import ipaddress
from collections import Counter
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

HEAD_PATIENCE_S = 10.0
"""A connection without a whole request head for so long is closed."""
CONNECTIONS = 4000
"""At once; a browser has up to six."""
ADDRESS_CONNECTIONS = 256
"""At once of one address beyond this machine. A proxy or a tunnel here brings many people."""

_open: Counter[str] = Counter()


class PatientProtocol(H11Protocol):
    """uvicorn's HTTP/1.1, which by itself waits for ever for the first request."""

    _address = ""
    _refused = False
    _clock: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Somebody has connected."""
        peer = transport.get_extra_info("peername")
        self._address = str(peer[0]) if peer else ""
        _open[self._address] += 1
        if not is_here(self._address) and _open[self._address] > ADDRESS_CONNECTIONS:
            self._refused = True
            transport.abort()
            return
        super().connection_made(transport)
        self._watch()

    def data_received(self, data: bytes) -> None:
        """Bytes have come."""
        if not self._refused:
            super().data_received(data)
            self._watch()

    def eof_received(self) -> None:
        """The other side sends no more."""
        if not self._refused:
            super().eof_received()

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection is over."""
        _open[self._address] -= 1
        if _open[self._address] <= 0:
            del _open[self._address]
        self._stop_watching()
        if not self._refused:
            super().connection_lost(exc)

    def _watch(self) -> None:
        """Give the head its time; a byte now and then gives no more."""
        if self.conn.their_state is not h11.IDLE:
            self._stop_watching()
        elif self._clock is None:
            self._clock = self.loop.call_later(HEAD_PATIENCE_S, self._give_up)

    def _stop_watching(self) -> None:
        if self._clock is not None:
            self._clock.cancel()
            self._clock = None

    def _give_up(self) -> None:
        self._clock = None
        if self.conn.their_state is h11.IDLE and not self.transport.is_closing():
            self.transport.close()


def is_here(address: Any) -> bool:
    """Whether a peer is on this machine."""
    try:
        return ipaddress.ip_address(str(address).partition("%")[0]).is_loopback
    except ValueError:
        return False
