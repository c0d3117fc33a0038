"""Shared parts of services for tests, without those that a test does not need."""

from typing import Any

from PySide6.QtCore import QObject

from caris_desktop.live.service import ServiceContext


def context_of(
    state: Any, bus: Any, parent: QObject | None, *, children: Any = None, slow_work: Any = None
) -> ServiceContext:
    return ServiceContext(state, bus, children, slow_work, parent)  # type: ignore[arg-type]
