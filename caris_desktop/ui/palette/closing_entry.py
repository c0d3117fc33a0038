"""Palette item that quits the program."""

from collections.abc import Callable

from caris_desktop.domain.translation import tr
from caris_desktop.ui.palette.palette_item import PaletteItem
from caris_desktop.ui.palette.setting_entries import TWICE


def closing_entry(close: Callable[[], object], *, replay: bool) -> PaletteItem:
    """Quit item; the console's needs a second Enter, because closing a panel has nearly the same words."""
    return PaletteItem(
        tr("Close this window") if replay else tr("Close the console"),
        tr("Window") if replay else tr(TWICE),
        "x",
        "",
        close,
        also=tr("quit exit end leave program"),
        deliberate=not replay,
        again=tr("Press Enter again to close the console"),
        id="Window: Close this window" if replay else "Close the console",
    )
