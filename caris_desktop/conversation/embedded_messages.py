"""Messages between the console and the process of the embedded language model."""

from caris_desktop.domain.events import Problem
from caris_desktop.domain.plugins import Plugin
from caris_desktop.domain.value_class import Value

SLOTS = 3
"""Parallel requests. Each finds the beginning of its last prompt still cached: the first word came after 0.1 s, but
after 1.9 s with 350 tokens read again. All slots share one memory and cost what one costs.
"""
REPLIES_SLOT = 0
"""Slot of questions about what a participant said. Each question continues the previous one, which only this slot has
read. A cancelled question leaves the slot at its first word.
"""


class EmbeddedReady(Value):
    """The model is served at ``url`` for clients with ``key``. ``plugin``: the one that it is of, if any."""

    url: str
    model: str
    key: str
    plugin: Plugin | None = None


class EmbeddedFailed(Value):
    """This process cannot run an embedded model."""

    problem: Problem


class ModelAdded(Value):
    """A model file of the user can be used from now on, as ``embedded:NAME``.

    ``title`` is the file's own, ``sha256`` its checksum; ``answer``: the model's answer to a question, with times.
    """

    name: str
    title: str
    size_bytes: int
    memory_bytes: int
    sha256: str
    answer: str


class CloseEmbedded(Value):
    """End the server process."""
