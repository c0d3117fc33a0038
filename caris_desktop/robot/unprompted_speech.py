"""Unprompted speech of the robot, reported on its own topic and recorded as the robot's utterances."""

import asyncio
import secrets
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.robot.speaking_time import LONGEST_UTTERANCE_S, estimated_duration_s
from caris_desktop.robot.transport import RosbridgeClient, RosbridgeTopic
from caris_desktop.ros.dialect import Dialect, type_name
from caris_desktop.ros.message_conversion import decode_string

LONGEST_TEXT = 1000
_ASKED_AT_MOST = 100
_PART_AT_LEAST = 8


class UnpromptedSpeech:
    """Reports the robot's own sentences; requested ones are reported by its speech backend.

    The robot does not report their end, so both times are estimated.
    """

    def __init__(
        self, ros: RosbridgeClient, dialect: Dialect, topic: str | None, *, emit: Callable[[UtteranceChanged], None]
    ) -> None:
        self._emit = emit
        self._asked: deque[tuple[int, str]] = deque(maxlen=_ASKED_AT_MOST)
        self._now: UtteranceChanged | None = None
        self._timer: asyncio.TimerHandle | None = None
        if topic is not None:
            listening = RosbridgeTopic(
                ros, topic, type_name(dialect, "std_msgs", "String"), queue_length=10, every_message=True
            )
            listening.subscribe(self._take)

    def asked(self, text: str) -> None:
        """Note a requested text."""
        self._asked.append((now_ns(), _plain(text)))

    def close(self) -> None:
        self._finish()

    def _take(self, message: Any) -> None:
        text = " ".join(decode_string(message).split())[:LONGEST_TEXT]
        if not text or self._was_asked(text):
            return
        self._finish()
        self._now = UtteranceChanged(
            now_ns(), f"r-{secrets.token_hex(4)}", "robot", text, "heard", "started", voice="robot", estimated=True
        )
        self._emit(self._now)
        self._timer = asyncio.get_running_loop().call_later(estimated_duration_s(text), self._finish)

    def _was_asked(self, text: str) -> bool:
        since_ns = now_ns() - int(LONGEST_UTTERANCE_S * 1e9)
        plain = _plain(text)
        recent = [asked for at_ns, asked in self._asked if at_ns > since_ns]
        # Some robots report a long text in parts.
        return plain in recent or (len(plain) >= _PART_AT_LEAST and any(plain in asked for asked in recent))

    def _finish(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        ended, self._now, self._timer = self._now, None, None
        if ended is not None:
            self._emit(replace(ended, stamp_ns=now_ns(), state="finished"))


def _plain(text: str) -> str:
    return "".join(character for character in text.casefold() if character.isalnum())
