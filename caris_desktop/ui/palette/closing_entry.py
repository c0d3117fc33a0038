"""How the program is closed, for whoever types quit."""

from collections.abc import Callable

from caris_desktop.domain.translation import tr
from caris_desktop.ui.palette.entry import Entry
from caris_desktop.ui.palette.setting_entries import TWICE


def closing_entry(close: Callable[[], object], *, replay: bool) -> Entry:
    """Of the console never by one Enter too many: whoever closes a panel looks for nearly the same words."""
    return Entry(
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
