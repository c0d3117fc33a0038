"""Handle of one voice engine process, for the process that supervises it."""

import json
import logging
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

from caris_desktop.conversation.synthesis_messages import SynthesisSettings

_log = logging.getLogger(__name__)
_PACKAGE_PARENT = Path(__file__).resolve().parents[3]

VOICE_FOLDER = "caris-voice-"
"""How the names of temporary folders begin in which a voice renders sound."""
EngineInbox = queue.SimpleQueue[tuple[int, Any]]


class VoiceEngine:
    """Engine process. Events arrive in ``inbox`` as (number, dict), with audio under ``sound``; None at its end."""

    def __init__(self, settings: SynthesisSettings, inbox: EngineInbox, *, number: int, look: bool) -> None:
        search_path = [str(_PACKAGE_PARENT), *filter(None, [os.environ.get("PYTHONPATH")])]
        self.number = number
        self._inbox = inbox
        self._folder = tempfile.mkdtemp(prefix=VOICE_FOLDER)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "caris_desktop.conversation.voice_engine"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(search_path), "PYTHONIOENCODING": "utf-8"},
        )
        for stream, read in ((self._process.stdout, self._read_events), (self._process.stderr, self._log_noise)):
            threading.Thread(target=read, args=(stream,), name=f"engine-{number}", daemon=True).start()
        self._send({**asdict(settings), "look": look, "files_folder": self._folder})

    def say(self, text: str, number: int) -> None:
        """Say a text; ``number`` is returned with its audio, which may arrive after cancellation."""
        self._send({"do": "say", "text": text, "number": number})

    def tune(self, rate: float, volume: float) -> None:
        self._send({"do": "tune", "rate": rate, "volume": volume})

    def silence(self) -> None:
        self._send({"do": "silence"})

    def prepare(self, texts: Sequence[str]) -> None:
        self._send({"do": "prepare", "texts": list(texts)})

    def draft(self, text: str) -> None:
        self._send({"do": "draft", "text": text})

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)

    def close(self, *, grace_s: float = 0.5) -> None:
        """Let it clean up, then kill it."""
        if self._process.stdin is not None:
            try:
                self._process.stdin.close()
            except BrokenPipeError:
                _log.debug("the voice engine was gone already")
        try:
            self._process.wait(grace_s)
        except subprocess.TimeoutExpired:
            _log.debug("the voice engine is killed")
        self.kill()

    def _send(self, command: dict[str, Any]) -> None:
        """Send a command; a dead engine is noticed in the inbox, not here."""
        stdin = self._process.stdin
        assert stdin is not None  # noqa: S101 - asked for above
        try:
            stdin.write(json.dumps(command).encode() + b"\n")
            stdin.flush()
        except (BrokenPipeError, ValueError):
            _log.info("the voice engine takes no more commands")

    def _read_events(self, stdout: IO[bytes]) -> None:
        for line in stdout:
            if not line.endswith(b"\n"):
                break
            event = json.loads(line)
            sound = stdout.read(event["bytes"])
            if len(sound) < event["bytes"]:
                break
            self._inbox.put((self.number, {**event, "sound": sound}))
        self._inbox.put((self.number, None))

    def _log_noise(self, stderr: IO[bytes]) -> None:
        for line in stderr:
            if not line.startswith(b"Audio saved to"):
                _log.info("voice engine: %s", line.decode("utf-8", "replace").rstrip())
