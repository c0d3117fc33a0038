"""What the console knows of itself, as panels read it from LiveState. Plain frozen values."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from caris_desktop.domain.events import LinkState, UtteranceChanged

Freshness = Literal["none", "fresh", "stale", "lost"]


@dataclass(frozen=True, slots=True)
class LinkStatus:
    state: LinkState = "connecting"
    robot: str = ""
    address: str = ""
    detail: str = ""
    round_trip_ms: float | None = None


@dataclass(frozen=True, slots=True)
class DriveStatus:
    """``allowed`` is False with a ``reason`` for the wizard; ``cap_reason`` says why speed is limited, if it is.

    ``target_*`` is what is asked for now (after caps), zero when nothing is held.
    """

    allowed: bool = False
    reason: str = "Not connected"
    cap_fraction: float = 1.0
    cap_reason: str = ""
    speed_fraction: float = 0.6
    target_forward_mps: float = 0.0
    target_turn_radps: float = 0.0
    max_forward_mps: float = 0.5
    max_turn_radps: float = 1.0
    emergency_stop: bool = False


@dataclass(frozen=True, slots=True)
class RecordingStatus:
    state: Literal["idle", "starting", "recording", "stopping", "failed"] = "idle"
    folder: Path | None = None
    started_ns: int = 0
    written_bytes: int = 0
    free_bytes: int | None = None
    detail: str = ""


@dataclass(frozen=True, slots=True)
class SpeechStatus:
    """``now`` is the utterance that is being spoken, None when quiet; ``waiting`` are those after it."""

    ready: bool = False
    voice: str = ""
    now: UtteranceChanged | None = None
    waiting: tuple[UtteranceChanged, ...] = ()
    detail: str = ""


@dataclass(frozen=True, slots=True)
class AssistantStatus:
    """``answer`` grows while ``state`` is answering and stays until the next question."""

    state: Literal["off", "starting", "ready", "answering", "failed"] = "off"
    model: str = ""
    exchange_id: str = ""
    question: str = ""
    answer: str = ""
    detail: str = ""


@dataclass(frozen=True, slots=True)
class PerceptionStatus:
    state: Literal["off", "loading", "ready", "failed"] = "off"
    model: str = ""
    detail: str = ""
    inference_ms: float | None = None
