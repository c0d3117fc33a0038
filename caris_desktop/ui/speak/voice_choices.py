"""Voice settings: output, voice, rate and volume."""

from caris_desktop.domain.events import VoiceOutput
from caris_desktop.domain.intents import SetVoice
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.status import VoiceStatus

_OUTPUTS: tuple[tuple[VoiceOutput, str], ...] = (
    ("robot", QT_TR_NOOP("The robot speaks")), ("computer", QT_TR_NOOP("This computer speaks")),
    ("both", QT_TR_NOOP("Both speak at once")),
)  # fmt: skip
_RATES = (
    (0.75, QT_TR_NOOP("Slowly")),
    (1.0, QT_TR_NOOP("At normal speed")),
    (1.25, QT_TR_NOOP("Quickly")),
    (1.5, QT_TR_NOOP("Very quickly")),
)
_ID_OF_NORMAL_SPEED = "At usual speed"  # in the usage history, however it is worded now
_VOLUMES = ((0.25, QT_TR_NOOP("Quietly")), (0.5, QT_TR_NOOP("At half volume")), (1.0, QT_TR_NOOP("At full volume")))


class VoiceLine(Value):
    """Menu entry. ``chosen``: the current value. ``id`` does not depend on language."""

    id: str
    text: str
    chosen: bool
    intent: SetVoice


def voice_choices(voice: VoiceStatus) -> list[list[VoiceLine]]:
    """Entries by group; those of this computer's voice only if it is used."""

    def choice(known_as: str, *, text: str = "", chosen: bool, **changes: object) -> VoiceLine:
        now: dict[str, object] = {
            "output": voice.output, "name": voice.name, "language": voice.language, "rate": voice.rate,
            "volume": voice.volume,
        }  # fmt: skip
        return VoiceLine(known_as, text or tr(known_as), chosen, SetVoice(**{**now, **changes}))  # type: ignore[arg-type]

    groups = [[choice(text, chosen=voice.output == output, output=output) for output, text in _OUTPUTS]]
    if voice.output == "robot":
        return groups
    groups.append(
        [
            choice(text, text=text, chosen=name in (voice.name, voice.used), name=name, language=language)
            for text, name, language in (
                (f"{_title(name)} · {voice_name}", name, voice_name) for name, voice_name in voice.choices
            )
        ]
    )
    groups.append(
        [
            choice(_ID_OF_NORMAL_SPEED if rate == 1.0 else text, text=tr(text), chosen=voice.rate == rate, rate=rate)
            for rate, text in _RATES
        ]
    )
    groups.append([choice(text, chosen=voice.volume == volume, volume=volume) for volume, text in _VOLUMES])
    return [group for group in groups if group]


def _title(name: str) -> str:
    """Voice title: ``piper:en_US-joe`` becomes ``joe``, ``espeak:german`` becomes ``german (eSpeak)``."""
    engine, _, voice = name.partition(":")
    return f"{voice} (eSpeak)" if engine == "espeak" else voice
