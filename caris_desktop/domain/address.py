"""Network addresses: credentials removed for display and recording, and loopback checks."""

import ipaddress
import re
from urllib.parse import urlsplit

_OF_PLUGIN = re.compile(r"([a-z][a-z0-9._-]+):(?!//)([^\s@?#]*)")


def without_credentials(address: str) -> str:
    """``address`` without user, password, query and fragment; empty if secrets cannot be told apart from the rest."""
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError:
        return ""
    if not (parts.scheme and host):
        return address if "@" not in address and "?" not in address else ""
    return f"{parts.scheme}://{before_port(host)}{f':{port}' if port else ''}{parts.path}"


def plugin_address(address: str) -> tuple[str, str] | None:
    """Name of a robot plug-in and its target from an address such as ``ros2:5``; None for other addresses."""
    found = _OF_PLUGIN.fullmatch(address)
    return None if found is None else (found[1], found[2])


def before_port(host: str) -> str:
    """``host`` as part of an address: IPv6 numbers in brackets."""
    return f"[{host}]" if ":" in host else host


def is_loopback(url: str) -> bool:
    """Whether ``url`` names this machine."""
    return is_loopback_host(urlsplit(url).hostname or "")


def is_same_server(one: str, other: str) -> bool:
    """Whether both addresses name the same host and port, so that a secret for one may be sent to the other."""
    try:
        places = [(urlsplit(each).scheme, urlsplit(each).hostname, urlsplit(each).port) for each in (one, other)]
    except ValueError:
        return False
    ports = {"http": 80, "ws": 80, "https": 443, "wss": 443}
    first, second = ((host, port or ports.get(scheme)) for scheme, host, port in places)
    return first == second and first[0] is not None


def is_encrypted_or_local(url: str) -> bool:
    """Whether ``url`` is encrypted (`https://`, `wss://`, `rtsps://`) or names this machine."""
    try:
        parts = urlsplit(url)
        host = parts.hostname or ""
    except ValueError:
        return False
    return bool(host) and (parts.scheme.rpartition("+")[2] in ("https", "wss", "rtsps") or is_loopback_host(host))


def is_loopback_host(host: str) -> bool:
    """Whether ``host``, a name or a number, is this machine."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
