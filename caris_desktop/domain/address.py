"""Network addresses: as they may be shown and recorded, and whether they are this machine's."""

import ipaddress
from urllib.parse import urlsplit


def without_credentials(address: str) -> str:
    """``address`` without user, password, query and fragment; empty where it cannot be told what is a secret in it."""
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError:
        return ""
    if not (parts.scheme and host):
        return address if "@" not in address and "?" not in address else ""
    return f"{parts.scheme}://{before_port(host)}{f':{port}' if port else ''}{parts.path}"


def before_port(host: str) -> str:
    """``host`` as an address holds it: a number of IPv6 in brackets."""
    return f"[{host}]" if ":" in host else host


def is_loopback(url: str) -> bool:
    """Whether ``url`` names this machine."""
    return is_loopback_host(urlsplit(url).hostname or "")


def is_same_server(one: str, other: str) -> bool:
    """Whether both addresses name the same host and port; a secret for one may go to the other then."""
    try:
        places = [(urlsplit(each).scheme, urlsplit(each).hostname, urlsplit(each).port) for each in (one, other)]
    except ValueError:
        return False
    ports = {"http": 80, "ws": 80, "https": 443, "wss": 443}
    first, second = ((host, port or ports.get(scheme)) for scheme, host, port in places)
    return first == second and first[0] is not None


def is_encrypted_or_local(url: str) -> bool:
    """Whether ``url`` is `https://` or `wss://`, or names this machine: nobody on the way reads along."""
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
