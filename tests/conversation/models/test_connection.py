"""Connections to model servers: setup time before the first request, and trust in an address."""

import asyncio
import ssl
import subprocess
import sys

import pytest

from caris_desktop.conversation.models import connection
from caris_desktop.conversation.models.endpoint import ModelEndpoint


def opened(*addresses: str) -> None:
    async def open_each() -> None:
        for address in addresses:
            endpoint = ModelEndpoint("openai", address, "small")
            async with connection.connected(endpoint, local_only=False):
                pass

    asyncio.run(open_each())


def test_certificates_are_read_once_and_only_for_what_is_encrypted(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[ssl.SSLContext] = []
    default = ssl.create_default_context

    def noting(*arguments: object, **named: object) -> ssl.SSLContext:
        made.append(default(*arguments, **named))  # type: ignore[arg-type]
        return made[-1]

    monkeypatch.setattr(ssl, "create_default_context", noting)
    connection._certificates.cache_clear()
    opened("http://127.0.0.1:8080/v1", "http://127.0.0.1:8080/v1")
    assert made == []
    opened("https://models.example/v1", "https://models.example/v1", "https://other.example/v1")
    assert len(made) == 1
    assert made[0].verify_mode is ssl.CERT_REQUIRED and made[0].check_hostname
    connection._certificates.cache_clear()


def test_an_address_without_encryption_trusts_nobody_should_it_be_encrypted_after_all() -> None:
    context = connection._no_certificates()
    assert context.verify_mode is ssl.CERT_REQUIRED and context.check_hostname
    assert context.cert_store_stats()["x509_ca"] == 0


def test_nothing_of_it_is_read_when_the_program_starts() -> None:
    code = "import sys, caris_desktop.conversation.models.connection; sys.exit('httpx' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
