"""Displayable parts of an address."""

import pytest

from caris_desktop.domain.address import without_credentials


@pytest.mark.parametrize(
    ("address", "kept"),
    [
        ("ws://user:secret@robot.local:9090/x?token=abc#part", "ws://robot.local:9090/x"),
        ("ws://[::1]:9090", "ws://[::1]:9090"),
        ("ws://127.0.0.1:9090", "ws://127.0.0.1:9090"),
        ("simulated", "simulated"),
        ("user:secret@robot", ""),
        ("ws://robot:port", ""),
        ("", ""),
    ],
)
def test_user_password_and_query_are_left_out(address: str, kept: str) -> None:
    assert without_credentials(address) == kept
