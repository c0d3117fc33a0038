"""Sections of the form: which keys each has, and their order."""

from caris_desktop.domain.schema_fields import Key, keys_of
from caris_desktop.domain.schema_labels import title_of
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.scenario.scenario_model import Scenario

_ORDER: dict[str, tuple[str, str]] = {
    QT_TR_NOOP("About"): ("info", QT_TR_NOOP("Title and purpose of this scenario.")),
    QT_TR_NOOP("Phrases"): (
        "chat-text",
        QT_TR_NOOP(
            "Phrases that the robot says at the press of a key. F10 selects the next group and puts its "
            "phrases on F1 to F8. {name} stands for the person addressed, {place} for the robot's goal or "
            "current place; the wizard is asked for other words in braces."
        ),
    ),
    QT_TR_NOOP("Protocol"): (
        "list-numbers",
        QT_TR_NOOP("The steps of the study, in order. The wizard sees the current step above the panels."),
    ),
    QT_TR_NOOP("Places"): (
        "map-pin",
        QT_TR_NOOP(
            "Places that the robot can be sent to by name. Drive the robot there, then use its current position."
        ),
    ),
    QT_TR_NOOP("What is allowed"): (
        "shield-check",
        QT_TR_NOOP(
            "A permission that is off has no button and no key in this scenario. The preview shows what changes."
        ),
    ),
    QT_TR_NOOP("Assistant"): (
        "sparkle",
        QT_TR_NOOP("The language model: its instructions and its level of automation."),
    ),
    QT_TR_NOOP("Robot and cameras"): ("robot", QT_TR_NOOP("Robot, speed limits and cameras.")),
    QT_TR_NOOP("Voice and sound"): ("speaker-high", QT_TR_NOOP("Who speaks, and which microphones are used.")),
    QT_TR_NOOP("Listening"): ("ear", QT_TR_NOOP("Transcription of speech near the robot.")),
    QT_TR_NOOP("People"): ("users", QT_TR_NOOP("How people are detected and recognised, and who is blurred.")),
    QT_TR_NOOP("Recording"): ("record", QT_TR_NOOP("Recording settings of this scenario.")),
    QT_TR_NOOP("Panels"): (
        "layout",
        QT_TR_NOOP(
            "Positions of the panels. It is easier to move them in the main window and save that as the layout."
        ),
    ),
}


class Section(Value):
    """Section of the form: ``words`` explain it, ``keys`` are its keys of the file."""

    title: str
    icon: str
    words: str
    keys: tuple[Key, ...]


def sections() -> tuple[Section, ...]:
    """Sections from the schema: a key with a new or no section is put at the end."""
    found: dict[str, list[Key]] = {title: [] for title in _ORDER}
    for key in keys_of(Scenario):
        if len(key.form.choices) != 1:
            found.setdefault(key.form.rule.section or title_of(key), []).append(key)
    return tuple(
        Section(title, *_ORDER.get(title, ("sliders", "")), tuple(keys)) for title, keys in found.items() if keys
    )
