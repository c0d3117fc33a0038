"""Shared parts of services for tests, without those that a test does not need."""

from typing import Any

from PySide6.QtCore import QObject

from caris_desktop.live.bus import Bus
from caris_desktop.live.service import ServiceContext
from caris_desktop.live.state import LiveState


def context_of(
    state: LiveState, bus: Bus, parent: QObject, *, children: Any = None, slow_work: Any = None
) -> ServiceContext:
    return ServiceContext(state, bus, children, slow_work, parent)
