"""Listening socket with a limit on connections that have not authenticated.

Network strangers need no token to hold connections open. Each address, and all together, may have a limited number at a
time. One more replaces a random one of the address that has the most, as in max-min fairness: an address with a single
connection keeps it while fewer than IN_ALL other addresses connect. Addresses that authenticated before are replaced
last. This computer's own connections count separately, so that no stranger locks out its user.
"""

import contextlib
import ipaddress
import logging
import random
import socket
import urllib.parse
from collections import Counter, deque
from typing import Any

from caris_desktop.domain.address import is_loopback_host

PER_ADDRESS = 8
IN_ALL = 32
# Under a flood, a client whose connection finds the queue full tries again after 1 s, 3 s and 7 s.
_BACKLOG = 1024
# Connections handled before the event loop serves the accepted ones: a flood of refusals must not hold it up.
_AT_ONCE = 32
_ADMITTED_PLACES = 64
_CHANCE = random.SystemRandom()
_log = logging.getLogger(__name__)


class LimitedListener(socket.socket):
    """Listening socket for ``asyncio.start_server`` and ``websockets.serve`` (their ``sock``). Only for the loop's
    thread. The server calls ``admit`` for clients that authenticated, and limits their number itself.
    """

    def __init__(self, family: int, *, per_address: int, chance: random.Random) -> None:
        super().__init__(family, socket.SOCK_STREAM)
        self._per_address = per_address
        self._chance = chance
        self._waiting: list[_Waiting] = []
        self._admitted_places: deque[str] = deque(maxlen=_ADMITTED_PLACES)
        self._left_in_turn = _AT_ONCE
        self._closed = 0

    def listen(self, backlog: int = _BACKLOG, /) -> None:
        """``socket.listen`` with a longer queue than that of asyncio, which listens again with its own default."""
        super().listen(max(backlog, _BACKLOG))

    def accept(self) -> tuple[socket.socket, Any]:
        """``socket.accept`` that closes connections over the limit."""
        try:
            while self._left_in_turn:
                self._left_in_turn -= 1
                accepted, address = super().accept()
                place = _place_of(str(address[0]))
                if self._make_room(place):
                    return _Waiting(accepted, self._waiting, place, address), address
                accepted.close()
            raise BlockingIOError  # noqa: TRY301 - the end of a turn, like an empty queue
        except BlockingIOError:
            self._left_in_turn = _AT_ONCE
            raise

    def admit(self, peer_name: Any) -> None:
        """Stop counting a connection whose client has authenticated."""
        for one in [one for one in self._waiting if one.peer_name == peer_name]:
            self._waiting.remove(one)
            if one.place not in self._admitted_places:
                self._admitted_places.append(one.place)

    def _make_room(self, place: str) -> bool:
        """End a connection if one more is too many; False where the new one must be closed instead."""
        rivals = [one for one in self._waiting if (one.place == _HERE) == (place == _HERE)]
        held = Counter(one.place for one in rivals)
        full_place = held[place] >= (IN_ALL if place == _HERE else self._per_address)
        if not full_place and len(rivals) < IN_ALL:
            return True
        self._closed += 1
        if self._closed & (self._closed - 1) == 0:  # 1, 2, 4, 8, ...: a flood does not fill the disk
            _log.warning("%d connections more than can be served were closed", self._closed)
        exposed = [one for one in rivals if one.place not in self._admitted_places] or rivals
        most = max(held[one.place] for one in exposed)
        if full_place or (held[place] and held[place] + 1 >= most):
            if self._left_in_turn < _AT_ONCE - 1:
                return False
            most, exposed = held[place], [one for one in rivals if one.place == place]
        else:
            self._left_in_turn = 0
        self._chance.choice([one for one in exposed if held[one.place] == most]).end()
        return True


class _Waiting(socket.socket):
    """Connection that counts until it is admitted, ended or closed."""

    def __init__(self, accepted: socket.socket, waiting: "list[_Waiting]", place: str, peer_name: Any) -> None:
        super().__init__(accepted.family, accepted.type, accepted.proto, fileno=accepted.detach())
        self._waiting = waiting
        self.place = place
        self.peer_name = peer_name
        waiting.append(self)

    def end(self) -> None:
        """End the connection for its server, which then closes it."""
        self._waiting.remove(self)
        with contextlib.suppress(OSError):  # the peer has ended it
            self.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        super().close()
        if self in self._waiting:
            self._waiting.remove(self)


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


def listen_limited(
    host: str, port: int, *, per_address: int = PER_ADDRESS, chance: random.Random = _CHANCE
) -> LimitedListener:
    """Listen at ``host``, a name or a number. ``chance`` chooses what is closed. Raises OSError."""
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    family, _, _, _, address = min(found, key=lambda one: one[0] != socket.AF_INET)
    listener = LimitedListener(family, per_address=per_address, chance=chance)
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
