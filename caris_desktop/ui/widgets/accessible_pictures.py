"""Video and map as sentences for screen readers."""

from collections.abc import Iterable

from caris_desktop.domain.translation import tr
from caris_desktop.ui.widgets.frame_view import FrameView
from caris_desktop.ui.widgets.map_view import MapView

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
        return _sentences(view.words_without_picture())
    listed = ", ".join(names)
    people = tr("In the picture: {names}").format(names=listed) if listed else tr("Nobody in the picture")
    return _sentences((people, *_chips(view.chips)))


def map_description(view: MapView, lidar: str = "") -> str:
    """Robot position and goal, the ``lidar`` text, people, places and label texts. Metres in the map."""
    state, sentences = view.map_state, list[str]()
    if state.pose is not None:
        # Rounded to half a metre: small changes are noise to a listener.
        at = {"x": round(state.pose.x_m * 2) / 2, "y": round(state.pose.y_m * 2) / 2}
        sentences.append(tr("The robot is at {x:.1f} m, {y:.1f} m").format(**at))
    else:
        sentences.append(tr("The robot's position is unknown"))
    if state.goal is not None:
        sentences.append(tr("The robot is going to {place}").format(place=state.goal.place or tr("a point")))
    if lidar:
        sentences.append(lidar)
    if state.people:
        sentences.append(tr("People: {names}").format(names=", ".join(name for _place, name, _named in state.people)))
    if state.places:
        sentences.append(tr("Places: {names}").format(names=", ".join(place.name for place in state.places)))
    return _sentences((*sentences, *_chips(state.chips)))


def _chips(chips: Iterable[tuple[str, str]]) -> list[str]:
    return [text for text, role in chips if role == "warning"]


def _sentences(parts: Iterable[str]) -> str:
    return " ".join(f"{part.rstrip('.')}." for part in parts if part)
