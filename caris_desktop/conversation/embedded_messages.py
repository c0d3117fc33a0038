"""What the console and the process of the embedded language model tell each other."""

from dataclasses import dataclass

from caris_desktop.domain.events import Problem


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
