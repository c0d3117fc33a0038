"""Messages between the console and the process of the embedded language model."""

from caris_desktop.domain.events import Problem
from caris_desktop.domain.value_class import dataclass

SLOTS = 3
"""So many are answered beside one another, and each finds what it began with last time still read: of 350 tokens read
anew the first word came after 1.9 s, of those read before after 0.1 s. All share one memory: they cost what one costs.
"""
REPLIES_SLOT = 0
"""Of those who ask about what a participant said. Each of these questions goes on where the one before it was, and that
only this slot has read; one that is not wanted any more is out of it with its first word.
"""


@dataclass(frozen=True, slots=True)
class EmbeddedReady:
    """The model is served at ``url`` for clients with ``key``."""

    url: str
    model: str
    key: str


@dataclass(frozen=True, slots=True)
class EmbeddedFailed:
    """This process cannot run an embedded model."""

    problem: Problem


@dataclass(frozen=True, slots=True)
class CloseEmbedded:
    """End the server process."""
