"""Network addresses as they may be shown and recorded."""

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
    shown = f"[{host}]" if ":" in host else host
    return f"{parts.scheme}://{shown}{f':{port}' if port else ''}{parts.path}"


def is_loopback(url: str) -> bool:
    """Whether ``url`` names this machine."""
    host = urlsplit(url).hostname or ""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
