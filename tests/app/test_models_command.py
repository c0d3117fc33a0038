"""``caris-desktop models serve``: a language model for other computers, with token and certificate."""

import signal
import ssl
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from caris_desktop.app import command_table
from caris_desktop.conversation.embedded_server import missing_for_embedded
from tests.support.certificates import Authority

TOKEN = "a token of enough characters"


@pytest.mark.skipif(bool(missing_for_embedded()), reason="the embedded model is not installed")
def test_another_computer_gets_answers_with_the_token_alone(tmp_path: Path) -> None:
    authority = Authority(tmp_path)
    ours = authority.issue("127.0.0.1")
    (tmp_path / "token").write_text(f"{TOKEN}\n")
    words = ["--host", "0.0.0.0", "--port", "0", "--token-file", str(tmp_path / "token")]
    words += ["--cert", str(ours.certificate), "--key", str(ours.key)]
    command = [sys.executable, "-m", "caris_desktop", "models", "serve", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            first = process.stdout.readline()
            assert "SmolLM2-135M-Instruct is available at https://0.0.0.0:" in first
            address = first.split(" is available at ")[1].split("/v1")[0].replace("0.0.0.0", "127.0.0.1")
            question = {"messages": [{"role": "user", "content": "Say hello."}], "max_tokens": 8}
            context = ssl.create_default_context(cafile=str(authority.file))
            context.verify_flags &= ~ssl.VERIFY_X509_STRICT  # set by Python 3.13
            with httpx.Client(base_url=address, verify=context, timeout=60) as client:
                assert client.get("/health").json() == {"status": "ok"}
                stranger, known = (
                    client.post("/v1/chat/completions", json=question, headers={"Authorization": f"Bearer {token}"})
                    for token in ("a guess of a stranger", TOKEN)
                )
            assert stranger.status_code == 401
            assert known.json()["choices"][0]["message"]["content"].strip()
        finally:
            process.send_signal(signal.SIGTERM)
        rest, wrong = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "Traceback" not in wrong
    assert TOKEN not in first + rest + wrong


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--host", "0.0.0.0"], "put a token of at least 16 characters"),
        (["--token-file", "short"], "is too short"),
        (["--token-file", "missing"], "missing cannot be read"),
        (["--host", "0.0.0.0", "--token-file", "token"], "could intercept the questions and the token"),
        (["not-added"], "not-added"),
    ],
)
def test_a_refused_start_is_reported(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "token").write_text(TOKEN)
    (tmp_path / "short").write_text("short")
    monkeypatch.chdir(tmp_path)
    assert command_table.run(["models", "serve", *words]) == 1
    assert said in capsys.readouterr().err
