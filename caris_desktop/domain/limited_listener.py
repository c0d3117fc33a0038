"""Listening socket with a connection limit that applies before a byte is read.

Network strangers need no token to hold connections open. Each address, and all together, may have a limited number at a
time; others are closed at once. This computer's own connections count separately, so that no stranger locks out its
user.
"""

import ipaddress
import logging
import socket
import urllib.parse
from collections import Counter
from typing import Any

from caris_desktop.domain.address import is_loopback_host

PER_ADDRESS = 8
IN_ALL = 32
_BACKLOG = 64
_log = logging.getLogger(__name__)


class LimitedListener(socket.socket):
    """Listening socket for ``asyncio.start_server`` and ``websockets.serve`` (their ``sock``). Only for the loop's
    thread.
    """

    def __init__(self, family: int, *, per_address: int = PER_ADDRESS, in_all: int = IN_ALL) -> None:
        super().__init__(family, socket.SOCK_STREAM)
        self._per_address = per_address
        self._in_all = in_all
        self._open: Counter[str] = Counter()
        self._refused = 0

    def accept(self) -> tuple[socket.socket, Any]:
        """``socket.accept`` that closes connections over the limit."""
        while True:
            accepted, address = super().accept()
            place = _place_of(str(address[0]))
            if self._may_come(place):
                self._open[place] += 1
                return _Counted(accepted, self._open, place), address
            accepted.close()
            self._refused += 1
            if self._refused & (self._refused - 1) == 0:  # 1, 2, 4, 8, ...: a flood does not fill the disk
                _log.warning("%d connections more than can be served were closed at once", self._refused)

    def _may_come(self, place: str) -> bool:
        if place == _HERE:
            return self._open[place] < self._in_all
        return self._open[place] < self._per_address and self._open.total() - self._open[_HERE] < self._in_all


class _Counted(socket.socket):
    """Connection that counts until it is closed."""

    def __init__(self, accepted: socket.socket, counted: Counter[str], place: str) -> None:
        super().__init__(accepted.family, accepted.type, accepted.proto, fileno=accepted.detach())
        self._counted: Counter[str] | None = counted
        self._place = place

    def close(self) -> None:
        super().close()
        counted, self._counted = self._counted, None
        if counted is not None:
            counted[self._place] -= 1
            if counted[self._place] <= 0:
                del counted[self._place]


_HERE = "this computer"


def _place_of(host: str) -> str:
    """Unit of the limit: an IPv4 address, or the IPv6 network of one subscriber."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    mapped = getattr(address, "ipv4_mapped", None)
    if (mapped or address).is_loopback:
        return _HERE
    if address.version == 4 or mapped is not None:
        return str(mapped or address)
    return str(ipaddress.ip_network((address, 64), strict=False))


def listen_limited(host: str, port: int, *, per_address: int = PER_ADDRESS, in_all: int = IN_ALL) -> LimitedListener:
    """Listen at ``host``, a name or a number. Raises OSError."""
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    family, _, _, _, address = min(found, key=lambda one: one[0] != socket.AF_INET)
    listener = LimitedListener(family, per_address=per_address, in_all=in_all)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(_BACKLOG)
        listener.setblocking(False)
    except OSError:
        listener.close()
        raise
    return listener


def is_own_host(hosts: list[str], *, only_loopback: bool = False) -> bool:
    """Whether a request's Host header names this computer by number, as ``localhost`` or by its own name.

    This rejects DNS rebinding: a web page whose own name points here.
    """
    if len(hosts) != 1:
        return False
    try:
        host = (urllib.parse.urlsplit(f"//{hosts[0]}").hostname or "").rstrip(".")
    except ValueError:
        return False
    if is_loopback_host(host):
        return True
    if only_loopback:
        return False
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return host in (socket.gethostname().lower(), f"{socket.gethostname().lower()}.local")
    return True


def quiet_handshakes(name: str) -> logging.Logger:
    """Logger for a server that strangers can reach: failed handshakes and scans are not logged."""
    logger = logging.getLogger(f"{name}.strangers")
    logger.setLevel(logging.CRITICAL)
    return logger
