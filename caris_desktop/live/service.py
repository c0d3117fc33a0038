"""What every part of the running console is."""

from collections.abc import Callable, Mapping
from typing import Any

from caris_desktop.domain.intents import Intent

Handler = Callable[[Any], None]
Handlers = Mapping[type[Intent], Handler]
