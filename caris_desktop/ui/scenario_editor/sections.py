"""Sections of the form: which keys each has, and their order."""

from caris_desktop.domain.schema_fields import Key, choices_of, keys_of
from caris_desktop.domain.schema_labels import title_of
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass
from caris_desktop.scenario.scenario_model import Scenario

_ORDER: dict[str, tuple[str, str]] = {
    QT_TR_NOOP("About"): ("info", QT_TR_NOOP("What this scenario is called and what it is for.")),
    QT_TR_NOOP("Phrases"): (
        "chat-text",
        QT_TR_NOOP(
            "What the robot says at one key. F10 chooses the next group, whose phrases are on F1 to F8 then. {name} "
            "stands for whom it is said to, {place} for where the robot goes or stands; other words in braces are "
            "asked for."
        ),
    ),
    QT_TR_NOOP("Protocol"): (
        "list-numbers",
        QT_TR_NOOP("The steps of the study, in order. The wizard sees the present one above the panels."),
    ),
    QT_TR_NOOP("Places"): (
        "map-pin",
        QT_TR_NOOP("Where the robot can be sent by name. Drive it there, then take over where it is now."),
    ),
    QT_TR_NOOP("What is allowed"): (
        "shield-check",
        QT_TR_NOOP("What is switched off has no button and no key in this scenario. What changes is shown beside it."),
    ),
    QT_TR_NOOP("Assistant"): (
        "sparkle",
        QT_TR_NOOP("The language model: what it is told, and how much it does by itself."),
    ),
    QT_TR_NOOP("Robot and cameras"): ("robot", QT_TR_NOOP("Which robot, how fast, with which cameras.")),
    QT_TR_NOOP("Voice and sound"): ("speaker-high", QT_TR_NOOP("Who speaks, and which microphone hears.")),
    QT_TR_NOOP("Listening"): ("ear", QT_TR_NOOP("How what is said near the robot becomes text.")),
    QT_TR_NOOP("People"): ("users", QT_TR_NOOP("How people are found and recognised, and who is made unrecognisable.")),
    QT_TR_NOOP("Recording"): ("record", QT_TR_NOOP("What recordings of this scenario need.")),
    QT_TR_NOOP("Panels"): (
        "layout",
        QT_TR_NOOP(
            "Where the panels are. It is easier to move them in the main window, and to save that as the layout."
        ),
    ),
}


@dataclass(frozen=True, slots=True)
class Section:
    """Section of the form: ``words`` explain it, ``keys`` are its keys of the file."""

    title: str
    icon: str
    words: str
    keys: tuple[Key, ...]


def sections() -> tuple[Section, ...]:
    """Sections from the schema: a key with a new or no section is put at the end."""
    found: dict[str, list[Key]] = {title: [] for title in _ORDER}
    for key in keys_of(Scenario):
        if len(choices_of(key.form.kind)) != 1:
            found.setdefault(key.form.rule.section or title_of(key), []).append(key)
    return tuple(
        Section(title, *_ORDER.get(title, ("sliders", "")), tuple(keys)) for title, keys in found.items() if keys
    )
