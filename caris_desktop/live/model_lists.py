"""Language models offered by servers on this computer, listed in the background. GUI thread."""

import os
from collections.abc import Callable, Coroutine
from typing import Any

from PySide6.QtCore import QObject, Signal

from caris_desktop.conversation.models.connection import models_here
from caris_desktop.conversation.models.embedded_models import added_models
from caris_desktop.conversation.models.endpoint import LanguageModelError, ModelEndpoint, ollama_url, openai_url
from caris_desktop.live.background_worker import AsyncioThread, new_timer

_FIRST_AFTER_MS = 3000
_EVERY_MS = 60_000
ListModels = Callable[[], Coroutine[Any, Any, tuple[str, ...]]]


async def local_models() -> tuple[str, ...]:
    """Models that the user added, and those of local Ollama and OpenAI-compatible servers, named as in a scenario.

    No other server is queried. Each has five seconds.
    """
    found = [f"embedded:{model.name}" for model in added_models()]
    for provider, url in (("ollama", ollama_url), ("openai", openai_url)):
        try:
            endpoint = ModelEndpoint("ollama" if provider == "ollama" else "openai", url(os.environ), "")
        except LanguageModelError:
            continue  # reported when such a model is chosen
        found += [f"{provider}:{name}" for name in await models_here(endpoint)]
    return tuple(found)


class ModelLists(QObject):
    """Refreshes the list every minute; ``found`` reports changes."""

    found = Signal()
    _listed = Signal(object)

    def __init__(self, asyncio_thread: AsyncioThread, list_models: ListModels, parent: QObject) -> None:
        super().__init__(parent)
        self._asyncio = asyncio_thread
        self._list_models = list_models
        self.models: tuple[str, ...] = ()
        self._timer = new_timer(self, self._query, single_shot=True)
        self._listed.connect(self._on_listed)

    def start(self) -> None:
        if not self._timer.isActive():
            self._timer.start(_FIRST_AFTER_MS)

    def refresh(self) -> None:
        self._timer.start(0)

    def stop(self) -> None:
        self._timer.stop()

    def _query(self) -> None:
        self._timer.start(_EVERY_MS)
        self._asyncio.submit(self._list())

    async def _list(self) -> None:
        self._listed.emit(await self._list_models())

    def _on_listed(self, models: tuple[str, ...]) -> None:
        if models != self.models:
            self.models = models
            self.found.emit()
