"""Pictures as sentences for screen readers."""

from collections.abc import Iterable

from caris_desktop.domain.translation import tr
from caris_desktop.ui.widgets.frame_view import FrameView

TOLD_EVERY_MS = 5000
"""Minimum interval in ms, long enough to hear a sentence to its end."""

_STILL_THERE_S = 5.0


class RecentlyVisible:
    """People seen recently: boxes come and go with single detections, and announcing each change would drown out all
    else.
    """

    def __init__(self) -> None:
        self._seen_s: dict[str, float] = {}

    def add(self, view: FrameView, now_s: float) -> None:
        """Add the visible people; call on each repaint."""
        self._seen_s.update({name: now_s for name, _named in view.visible_detections()})
        self._seen_s = {name: at_s for name, at_s in self._seen_s.items() if now_s - at_s <= _STILL_THERE_S}

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._seen_s)


def video_description(view: FrameView, names: Iterable[str]) -> str:
    """People in view and label texts, or the message in place of the picture."""
    if view.frame is None:
        return sentences(view.words_without_picture())
    listed = ", ".join(names)
    people = tr("In the picture: {names}").format(names=listed) if listed else tr("Nobody in the picture")
    return sentences((people, *warnings_in(view.chips)))


def warnings_in(chips: Iterable[tuple[str, str]]) -> list[str]:
    return [text for text, role in chips if role == "warning"]


def sentences(parts: Iterable[str]) -> str:
    return " ".join(f"{part.rstrip('.')}." for part in parts if part)
