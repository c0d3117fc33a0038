"""Start-up shortcuts for commands with a window. Imported before Qt."""

import builtins
import gc


def begin() -> None:
    """Import Qt cheaply, and collect no garbage until the window is shown.

    PySide6 replaces Python's ``import`` for ``from __feature__ import snake_case``: it reads and keeps the source of
    each module imported later, in search of PySide6. Nothing here uses that. Objects created until the first window
    stay, so that collections would only traverse them in vain.
    :class:`~caris_desktop.live.garbage_collection.GarbageCollector` collects from then on.
    """
    gc.disable()
    plain_import = builtins.__import__
    import PySide6.QtCore  # noqa: F401 - that it is imported now is the point

    builtins.__import__ = plain_import
