"""Texts for numbers, times and events."""

import time
from collections.abc import Iterator

import pytest

from caris_desktop.domain import clock
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import (
    AlarmChanged,
    ControlUsed,
    DriveEnded,
    EmergencyStopChanged,
    GamepadChanged,
    Gap,
    GoalChanged,
    GuardChanged,
    LevelChanged,
    LinkQuality,
    MappingChanged,
    MapRequestChanged,
    Marked,
    PersonRenamed,
    PlacesChanged,
    PreflightChecked,
    Problem,
    ProposalChanged,
    ProtocolEnded,
    ProtocolOpened,
    StepEntered,
    StepTicked,
    StopRequested,
    UtteranceChanged,
)
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import CameraState
from caris_desktop.domain.translation import localized, tr, use_translator
from caris_desktop.live.status import LinkStatus
from caris_desktop.ui import event_messages, text_formatting
from caris_desktop.ui.text_formatting import purpose_title
from tests.support.translated_messages import untranslated_part


@pytest.mark.parametrize(("seconds", "text"), [(0.0412, "41 ms"), (0.13, "0.1 s"), (12.4, "12 s"), (185.0, "3 min")])
def test_ages(seconds: float, text: str) -> None:
    assert text_formatting.age(seconds) == text


@pytest.mark.parametrize(("seconds", "text"), [(763, "12:43"), (3723, "1:02:03"), (-4, "00:00")])
def test_elapsed(seconds: float, text: str) -> None:
    assert text_formatting.elapsed(seconds) == text


@pytest.mark.parametrize(("count", "text"), [(950, "950 B"), (184e6, "184 MB"), (41.3e9, "41.3 GB"), (2e12, "2000 GB")])
def test_sizes(count: float, text: str) -> None:
    assert text_formatting.size(count) == text


def test_long_lines_are_shortened_in_the_middle_of_nothing() -> None:
    assert text_formatting.shortened("a  b\nc") == "a b c"
    assert text_formatting.shortened("word " * 20, 12) == "word word w…"


def name_of(person_id: str) -> str:
    return {"p1": "Luis", "p-1": "Luis"}.get(person_id, "Somebody")


@pytest.mark.parametrize(
    ("event", "entry"),
    [
        (LinkQuality(1, 12.0), None),
        (LevelChanged(1, "replies", "act"), ("Session", "Suggested replies: Automatic (after a countdown)")),
        (
            ProposalChanged(1, "a-1", "displayed", "t-1", 1, "GoToPlace", {"place": "Kitchen"}, "small"),
            ("Said", "Proposed: go to Kitchen"),
        ),
        (
            ProposalChanged(1, "a-1", "vetoed", "t-1", 1, "UseControl", {"control": "wave", "value": True}, "small"),
            ("Said", "Proposal rejected: use wave"),
        ),
        (
            ProposalChanged(1, "a-1", "refused", "t-1", 1, "", {}, "small", "the answer is not valid JSON"),
            ("Problems", "A proposal was refused: the answer is not valid JSON"),
        ),
        (EmergencyStopChanged(1, latched=True, by="robot"), ("Moved", "Emergency stop activated by the robot")),
        (GoalChanged(1, "g", "reached", Pose2D(0, 0, 0), "Kitchen"), ("Moved", "Arrived at Kitchen")),
        (GoalChanged(1, "g", "active", Pose2D(0, 0, 0), "Kitchen"), None),
        (
            GoalChanged(1, "g", "failed", Pose2D(0, 0, 0), "Kitchen", detail="the way is blocked"),
            ("Problems", "Could not reach Kitchen: the way is blocked"),
        ),
        (UtteranceChanged(1, "u", "robot", "Hi", "typed", "requested"), None),
        (UtteranceChanged(1, "u", "robot", "Hi", "typed", "interrupted"), ("Said", "Cut short: “Hi”")),
        (
            UtteranceChanged(1, "u", "robot", "Hi {p-1}, see {place}", "phrase", "started"),
            ("Said", "Robot: “Hi Luis, see {place}”"),
        ),
        (PersonRenamed(1, "p1"), ("People", "Named Luis")),
        (GuardChanged(1, "overridden"), ("Moved", "Obstacle guard turned off")),
        (GuardChanged(1, "slowing", 0.5), None),
        (
            GuardChanged(1, "blind", None, "the LIDAR does not cover this direction"),
            ("Problems", "The obstacle guard allows crawl speed only: the LIDAR does not cover this direction"),
        ),
        (MapRequestChanged(1, "r", "save", "lab", "succeeded"), ("Session", "The map lab was saved")),
        (
            MapRequestChanged(1, "r", "start_mapping", "", "failed", "the robot refused"),
            ("Problems", "The mapping mode was not changed: the robot refused"),
        ),
        (MappingChanged(1, mapping=True), ("Session", "The robot is building the map")),
        (PlacesChanged(1, "Kitchen", None), ("Session", "Place Kitchen removed")),
        (ControlUsed(1, "r", "wave", True, "requested"), None),
        (
            ControlUsed(1, "r", "wave", True, "failed", "the robot refused"),
            ("Problems", "Robot: wave failed: the robot refused"),
        ),
        (ControlUsed(1, "r", "screen", "Hi", "succeeded"), ("Session", "Robot: screen “Hi”")),
        (ControlUsed(1, "r", "volume", 35.0, "succeeded"), None),
        (GamepadChanged(1, "id", "Pad", connected=False), ("Session", "Pad was unplugged")),
        (
            Gap(1, "frame", 3, "the disk was slow"),
            ("Problems", "3 frames were not recorded: the disk was slow"),
        ),
        (Problem(1, "warning", "Late", "Slow.", "Wait."), ("Problems", "Late. Slow.")),
        (AlarmChanged(1, "a", "pace", "raised", "warning", "Late", "", ""), None),
        (AlarmChanged(1, "a", "pace", "raised", "warning", "Late", "", "", told=False), ("Problems", "Late")),
        (
            AlarmChanged(1, "a", "pace", "ended", "warning", "Late", "", "", actor="console"),
            ("Problems", "Ended: Late"),
        ),
        (
            AlarmChanged(1, "a", "pace", "ended", "warning", "Late", "", "", actor="script"),
            ("Problems", "Dismissed: Late · by a script"),
        ),
        (StepEntered(1, "arm", "Robot arm", 3), ("Session", "Step 3: Robot arm")),
        (
            StepEntered(1, "arm", "Robot arm", 3, "branch", branch="Asks again", actor="wizard:Ada"),
            ("Session", "Step 3: Robot arm (Asks again) · by wizard Ada"),
        ),
        (StepTicked(1, "arm", "Coffee"), ("Session", "Ticked off: Coffee")),
        (StepTicked(1, "arm", "Coffee", on=False), ("Session", "Unticked: Coffee")),
        (ProtocolEnded(1, "arm"), ("Session", "The protocol ended")),
        (ProtocolOpened(1), None),
        (StopRequested(1), ("Moved", "Stop")),
        (StopRequested(1, "wizard"), ("Moved", "Stop")),
        (StopRequested(1, "wizard:Ada"), ("Moved", "Stop · by wizard Ada")),
        (Marked(1, "Laughs", actor="script"), ("Session", "Marked: Laughs · by a script")),
        (
            UtteranceChanged(1, "u", "robot", "Hm", "filler", "started", actor="console"),
            ("Said", "Robot: “Hm” · by the console"),
        ),
        (
            UtteranceChanged(1, "u", "robot", "Hm", "filler", "started", actor="model"),
            ("Said", "Robot: “Hm” · by the language model"),
        ),
        # The reason already implies the console.
        (DriveEnded(1, "The link was lost", "console"), ("Moved", "Driving ended: The link was lost")),
        (
            GoalChanged(
                1, "g", "cancelled", Pose2D(0, 0, 0), "Kitchen", detail="the connection was lost", actor="console"
            ),
            ("Moved", "Going to Kitchen was cancelled: the connection was lost"),
        ),
        (object(), None),
    ],
)
def test_events_become_sentences(event: object, entry: tuple[str, str] | None) -> None:
    assert event_messages.event_sentence(event, name_of) == entry


def test_time_of_day_has_seconds() -> None:
    assert len(text_formatting.clock_time(clock.now_ns(), ClockAnchor.take()).split(":")) == 3


@pytest.fixture
def marked() -> Iterator[None]:
    """Translator that marks every text with its disambiguation."""
    use_translator(lambda text, meant, _number: f"<{text}|{meant}>" if meant else f"<{text}>")
    yield
    use_translator(None)


@pytest.mark.usefixtures("marked")
def test_no_word_is_made_small_or_large_after_it_was_translated() -> None:
    """German nouns keep their capital letter, and a separate word of one language is an ending in another."""
    assert text_formatting.camera_title("front") == "<{name} camera|a title>".format(name="Front")
    assert text_formatting.camera_in_text("front") == "<{name} camera|in a sentence, after “the”>".format(name="front")
    assert text_formatting.camera_in_text("OAK-D_camera") == "OAK-D camera"
    level = LevelChanged(1, "replies", "act")
    assert event_messages.event_sentence(level, name_of) == (
        "Session", "<<Suggested replies>: <Automatic (after a countdown)>>"
    )  # fmt: skip
    checked = PreflightChecked(1, "robot", "Robot", "minor", at_start=True)
    assert event_messages.check_line(checked) == ("Session", "<Started with: <Robot> (minor)>")


@pytest.mark.usefixtures("marked")
def test_a_session_says_what_it_was_for() -> None:
    assert purpose_title("practice") == "<Practice>"
    assert purpose_title("pilot study") == "pilot study", "as it was written"


def test_the_reason_of_a_process_is_in_the_wizards_language() -> None:
    why = localized("The server at {place} does not respond.", place="front door")
    lost, ended = (CameraState(0, "front", state, why) for state in ("lost", "ended"))
    link = LinkStatus("lost", "Robot", "ws://there", why)
    for say in (
        lambda: text_formatting.no_picture(2.0, lost),
        lambda: text_formatting.no_picture(None, ended),
        lambda: text_formatting.link_facts(link, {}, ClockAnchor.take()),
        lambda: "\n".join(event_messages.event_sentence(Gap(1, "frame", 3, why), name_of) or ()),
    ):
        assert "front door" in say()
        assert untranslated_part(say) == []


@pytest.mark.usefixtures("trial_language")
def test_the_reason_of_missing_values_is_found_again_in_the_record() -> None:
    gap = Gap(1, "frame", 3, "front door: left out, as the disk is nearly full")
    _, sentence = event_messages.event_sentence(gap, name_of) or ("", "")
    assert "[front door: " in sentence, "a name stays as it is"
    assert tr("the disk is nearly full") in sentence


@pytest.mark.parametrize("zone", ["Asia/Tokyo", "America/New_York"])
def test_times_that_no_calendar_holds_are_shown_all_the_same(monkeypatch: pytest.MonkeyPatch, zone: str) -> None:
    monkeypatch.setenv("TZ", zone)
    time.tzset()
    try:
        for text in ("0001-01-01T00:00:00Z", "9999-12-31T23:59:59Z", "2026-10-25T02:30:00"):
            assert text_formatting.local_time(text)[:4] in text
        for utc_ns in (10**30, -(10**30), 253_402_300_799 * 10**9, -62_135_596_800 * 10**9):
            assert text_formatting.local_moment(utc_ns).year in (1, 1969, 1970, 9999)
            assert len(text_formatting.clock_time(utc_ns, ClockAnchor(0, 0))) == len("14:02:11")
    finally:
        monkeypatch.undo()
        time.tzset()
