"""Single report of a silent microphone."""

from caris_desktop.conversation.listening.recogniser import SignalWatch
from caris_desktop.domain.sound_values import MICROPHONE, ROBOT_MICROPHONE


def _told_at(watch: SignalWatch, *, from_s: int, until_s: int, peak: float, source: str = MICROPHONE) -> list[int]:
    return [second for second in range(from_s, until_s) if watch.process(source, second * 1_000_000_000, peak)]


def test_a_silent_microphone_is_reported_once_and_again_only_after_it_was_heard() -> None:
    watch = SignalWatch()
    assert _told_at(watch, from_s=0, until_s=300, peak=0.0) == [45]
    assert _told_at(watch, from_s=300, until_s=301, peak=0.2) == []
    assert _told_at(watch, from_s=301, until_s=600, peak=0.0002) == [345]


def test_a_quiet_room_is_heard() -> None:
    assert _told_at(SignalWatch(), from_s=0, until_s=300, peak=0.002) == []


def test_each_microphone_counts_for_itself_and_not_while_it_is_closed() -> None:
    watch = SignalWatch()
    assert _told_at(watch, from_s=0, until_s=40, peak=0.0, source=ROBOT_MICROPHONE) == []
    watch.closed(ROBOT_MICROPHONE)
    assert _told_at(watch, from_s=100, until_s=140, peak=0.0, source=ROBOT_MICROPHONE) == []
    assert _told_at(watch, from_s=100, until_s=150, peak=0.0) == [145]
