"""Robot actions that a language model may propose, and validation of its answers.

``proposable_here`` lists everything: intents with lists or ranges for their arguments. The model only selects; anything
else in its answer is refused.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Any, Literal

from caris_desktop.domain import intents
from caris_desktop.domain.control_definitions import RobotControl
from caris_desktop.domain.intents import INTENTS, Intent, Permission
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value

Range = tuple[float, float]
ActionName = Literal["go_to", "look", "nod", "use", "photo"]
NONE = "none"
_KINDS: Mapping[ActionName, type[Intent]] = {
    "go_to": intents.GoToPlace,
    "look": intents.LookAt,
    "nod": intents.Nod,
    "use": intents.UseControl,
    "photo": intents.TakePhoto,
}
"""Of what the table marks as proposable: replies are suggested instead (``Say``), and no model knows points of the map
(``GoToPoint``)."""
_LONGEST_ANSWER = 4000
_MOST_LISTED = 40


class Offer(Value):
    """Available choices; empty lists or None where there are none."""

    actions: tuple[ActionName, ...] = ()
    places: tuple[str, ...] = ()
    controls: Mapping[str, RobotControl] = field(default_factory=dict)
    pan_deg: Range = (0.0, 0.0)
    tilt_deg: Range = (0.0, 0.0)


class Proposed(Value):
    """Proposed action: ``words`` for the wizard, translatable, and whether the robot may move."""

    intent: Intent
    words: str
    moves: bool


class NotOfferedError(ValueError):
    """Answer outside of the offer; the text is for the record."""


def proposable_here(
    permissions: object,
    *,
    places: Sequence[str] = (),
    controls: Sequence[RobotControl] = (),
    pan_range_rad: Range | None = None,
    tilt_range_rad: Range | None = None,
) -> Offer:
    """Actions that the scenario permits and the robot supports. ``permissions`` has a bool for each Permission."""

    def permits(permission: Permission) -> bool:
        return getattr(permissions, permission, False) is True

    usable = {
        control.id: control
        for control in controls
        if _can_be_chosen(control) and (permits("driving") or not control.is_motion)
    }
    head = pan_range_rad is not None and tilt_range_rad is not None
    there = {"go_to": bool(places), "look": head, "nod": head, "use": bool(usable), "photo": True}
    actions = tuple(
        name
        for name, kind in _KINDS.items()
        if there[name] and INTENTS[kind].proposable and all(map(permits, INTENTS[kind].permissions))
    )
    return Offer(
        actions,
        tuple(places[:_MOST_LISTED]) if "go_to" in actions else (),
        dict(list(usable.items())[:_MOST_LISTED]) if "use" in actions else {},
        _degrees(pan_range_rad),
        _degrees(tilt_range_rad),
    )


def _can_be_chosen(control: RobotControl) -> bool:
    """Exclude text fields, which are unbounded, and controls with a confirmation."""
    bounded = control.kind in ("button", "toggle", "slider", "choice")
    return bounded and control.effect is not None and not control.confirm and not control.releases_stop


def _degrees(range_rad: Range | None) -> Range:
    lowest, highest = range_rad or (0.0, 0.0)
    # Rounded inwards, within the head's limits.
    return math.ceil(math.degrees(lowest)), math.floor(math.degrees(highest))


def schema_of(offer: Offer) -> dict[str, Any]:
    """JSON schema of an answer: one of these actions, or none."""
    properties: dict[str, Any] = {"action": {"type": "string", "enum": [NONE, *offer.actions]}}
    if offer.places:
        properties["place"] = {"type": "string", "enum": list(offer.places)}
    if "look" in offer.actions:
        for name, (lowest, highest) in (("pan_deg", offer.pan_deg), ("tilt_deg", offer.tilt_deg)):
            properties[name] = {"type": "integer", "minimum": int(lowest), "maximum": int(highest)}
    if offer.controls:
        properties["control"] = {"type": "string", "enum": list(offer.controls)}
        properties["value"] = {"type": ["string", "number", "boolean"]}
    return {"type": "object", "properties": properties, "required": ["action"], "additionalProperties": False}


def proposed_in(answer: str, offer: Offer) -> Proposed | None:
    """Proposal in an answer, None if there is none. Raises NotOfferedError."""
    if len(answer) > _LONGEST_ANSWER:
        raise NotOfferedError("the answer is too long")
    try:
        data = _json_in(answer)
    except (ValueError, RecursionError):
        raise NotOfferedError("the answer is not valid JSON") from None
    if not isinstance(data, dict):
        raise NotOfferedError("the answer is not a JSON object")
    action = data.get("action")
    if action in (NONE, None, ""):
        return None
    match action:
        case "go_to" if action in offer.actions:
            place = data.get("place")
            if not isinstance(place, str) or place not in offer.places:
                raise NotOfferedError(f"{_bounded_text(place)} is not a place in this scenario")
            return Proposed(intents.GoToPlace(place), localized(QT_TR_NOOP("Go to {place}"), place=place), moves=True)
        case "look" if action in offer.actions:
            return _checked_gaze(data.get("pan_deg", 0), data.get("tilt_deg", 0), offer)
        case "nod" if action in offer.actions:
            return Proposed(intents.Nod(), QT_TR_NOOP("Nod"), moves=True)
        case "photo" if action in offer.actions:
            return Proposed(intents.TakePhoto(), QT_TR_NOOP("Take a photo"), moves=False)
        case "use" if action in offer.actions:
            return _use(data.get("control"), data.get("value"), offer)
    raise NotOfferedError(f"{_bounded_text(action)} is not one of the permitted actions")


def _json_in(answer: str) -> Any:
    """JSON in an answer; without schema support it may be fenced or between sentences. Raises ValueError."""
    try:
        return json.loads(answer)
    except ValueError:
        return json.loads(answer[answer.find("{") : answer.rfind("}") + 1])


def _checked_gaze(pan_deg: Any, tilt_deg: Any, offer: Offer) -> Proposed:
    for angle, (lowest, highest) in ((pan_deg, offer.pan_deg), (tilt_deg, offer.tilt_deg)):
        if not _is_number(angle) or not lowest <= angle <= highest:
            raise NotOfferedError(f"the head cannot turn to {_bounded_text(angle)} degrees")
    words = localized(
        _GAZES[_direction(pan_deg, "left", "right"), _direction(tilt_deg, "down", "up")],
        pan=f"{abs(pan_deg):.0f}",
        tilt=f"{abs(tilt_deg):.0f}",
    )
    return Proposed(intents.LookAt(math.radians(pan_deg), math.radians(tilt_deg)), words, moves=True)


def _direction(angle_deg: float, more: str, less: str) -> str:
    return more if angle_deg > 0 else less if angle_deg < 0 else ""


_GAZES = {
    ("", ""): QT_TR_NOOP("Look straight ahead"),
    ("left", ""): QT_TR_NOOP("Look {pan}° to the left"),
    ("right", ""): QT_TR_NOOP("Look {pan}° to the right"),
    ("", "down"): QT_TR_NOOP("Look {tilt}° down"),
    ("", "up"): QT_TR_NOOP("Look {tilt}° up"),
    ("left", "down"): QT_TR_NOOP("Look {pan}° to the left and {tilt}° down"),
    ("left", "up"): QT_TR_NOOP("Look {pan}° to the left and {tilt}° up"),
    ("right", "down"): QT_TR_NOOP("Look {pan}° to the right and {tilt}° down"),
    ("right", "up"): QT_TR_NOOP("Look {pan}° to the right and {tilt}° up"),
}


def _use(name: Any, value: Any, offer: Offer) -> Proposed:
    control = offer.controls.get(name) if isinstance(name, str) else None
    if control is None:
        raise NotOfferedError(f"{_bounded_text(name)} is not a permitted control")
    match control.kind:
        case "button":
            value, words = True, control.title
        case "toggle" if isinstance(value, bool):
            words = localized(QT_TR_NOOP("{title}: on") if value else QT_TR_NOOP("{title}: off"), title=control.title)
        case "slider" if _is_number(value) and control.lowest <= value <= control.highest:
            value, words = float(value), f"{control.title}: {value:g} {control.unit}".rstrip()
        case "choice":
            chosen = next((one for one in control.choices if _is_same(value, one.value) or value == one.title), None)
            if chosen is None:
                raise NotOfferedError(f"{_bounded_text(value)} is not an option of “{control.title}”")
            value, words = chosen.value, f"{control.title}: {chosen.title}"
        case _:
            raise NotOfferedError(f"{_bounded_text(value)} is not a valid value for “{control.title}”")
    return Proposed(intents.UseControl(control.id, value), words, moves=control.is_held_by_stop)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e12


def _is_same(value: Any, other: Any) -> bool:
    return type(value) is type(other) and bool(value == other)


def _bounded_text(value: Any) -> str:
    """Bounded text of any value, for the record."""
    return repr(value)[:60]
