"""What a window's start need not do. To be imported before anything of Qt, by who opens a window."""

import builtins
import gc


def begin() -> None:
    """Import Qt as cheaply as it comes, and collect no garbage until the window stands.

    PySide6 puts an ``import`` of its own in the place of Python's, for ``from __feature__ import snake_case``: it reads
    and keeps the source of each module that is imported from then on, to see whether it names PySide6. Nothing here
    uses that. What is imported and built on the way to the first window stays; walking through all of it again and
    again finds nothing. :class:`~caris_desktop.live.garbage.GarbageCollector` collects from then on.
    """
    gc.disable()
    plain_import = builtins.__import__
    import PySide6.QtCore  # noqa: F401 - that it is imported now is the point

    builtins.__import__ = plain_import
