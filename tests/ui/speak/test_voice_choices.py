"""Options of the voice."""

from caris_desktop.domain.intents import SetVoice
from caris_desktop.live.status import VoiceStatus
from caris_desktop.ui.speak.speak_field import voice_choices

SPOKEN = VoiceStatus(
    "computer", "", "en", 1.0, 0.5, used="piper:joe", choices=(("piper:joe", "en-US"), ("espeak:gmw/de", "de"))
)


def test_of_the_robots_own_voice_only_who_speaks_is_chosen() -> None:
    (outputs,) = voice_choices(VoiceStatus(choices=SPOKEN.choices))
    assert [(choice.text, choice.chosen) for choice in outputs] == [
        ("The robot speaks", True), ("This computer speaks", False), ("Both speak at once", False),
    ]  # fmt: skip


def test_each_choice_changes_one_thing_and_leaves_the_rest() -> None:
    by_text = {choice.text: choice for group in voice_choices(SPOKEN) for choice in group}
    assert [text for text, choice in by_text.items() if choice.chosen] == [
        "This computer speaks", "joe · en-US", "At normal speed", "At half volume",
    ]  # fmt: skip
    assert by_text["Both speak at once"].intent == SetVoice("both", "", "en", 1.0, 0.5)
    assert by_text["gmw/de (eSpeak) · de"].intent == SetVoice("computer", "espeak:gmw/de", "de", 1.0, 0.5)
    assert by_text["Quickly"].intent == SetVoice("computer", "", "en", 1.25, 0.5)
    assert by_text["At full volume"].intent == SetVoice("computer", "", "en", 1.0, 1.0)
