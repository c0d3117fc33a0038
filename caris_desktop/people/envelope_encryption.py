"""Envelope encryption: each person's data under a key of their own (AES-256-GCM), erased by deleting the key."""

import json
import logging
import secrets
from collections.abc import Iterable
from dataclasses import fields
from typing import TYPE_CHECKING

from caris_desktop.domain.foreign_json import parse_json
from caris_desktop.domain.value_class import Value

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.ciphers.aead import AESGCM

_log = logging.getLogger(__name__)
_NONCE_BYTES = 12
_KEY_BITS = 256


class About(Value):
    """The wizard's notes on a person. Someone without any counts as seen only, not as known."""

    name: str = ""
    group: str = ""
    tags: tuple[str, ...] = ()
    note: str = ""


def new_key() -> bytes:
    return _cipher().generate_key(_KEY_BITS)


def seal(key: bytes, person_id: str, content_kind: str, content: bytes) -> bytes:
    """Encrypt, bound to the person and field, so that content cannot be moved to another person."""
    nonce = secrets.token_bytes(_NONCE_BYTES)
    return nonce + _cipher()(key).encrypt(nonce, content, f"{person_id}/{content_kind}".encode())


def unseal(key: bytes, person_id: str, content_kind: str, content: bytes) -> bytes:
    """Decrypt; empty if damaged, so that one person's data does not block the others."""
    from cryptography.exceptions import InvalidTag

    try:
        return _cipher()(key).decrypt(
            content[:_NONCE_BYTES], content[_NONCE_BYTES:], f"{person_id}/{content_kind}".encode()
        )
    except (InvalidTag, ValueError):
        _log.warning("%s of %s cannot be read", content_kind, person_id)
        return b""


def _cipher() -> "type[AESGCM]":
    """Late import, since the first window must not wait for it."""
    from cryptography.hazmat.primitives.ciphers.aead import AESGCM

    return AESGCM


def about_bytes(about: About) -> bytes:
    return json.dumps({each.name: getattr(about, each.name) for each in fields(About)}, ensure_ascii=False).encode()


def about_of(written: bytes) -> About:
    content = parse_json(written)
    tags = content.get("tags")
    return About(
        str(content.get("name", "")),
        str(content.get("group", "")),
        tuple(map(str, tags)) if isinstance(tags, Iterable) else (),
        str(content.get("note", "")),
    )
