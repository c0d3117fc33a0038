"""Preflight checks computed from the state."""

from dataclasses import replace
from typing import Any

import pytest

from caris_desktop.domain.actor import WIZARD
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.translation import LocalizedText, tr, use_translator
from caris_desktop.live.services.preflight_service import ChecklistItem, Facts, automatic_checks, ticked_checks
from caris_desktop.live.status import (
    AssistantStatus,
    DriveStatus,
    LinkStatus,
    ListeningStatus,
    MicrophoneStatus,
    PerceptionStatus,
    PreflightCheck,
    SpeechStatus,
    VoiceStatus,
)
from caris_desktop.people.presence import PersonRow
from caris_desktop.robot.profile import load_profile
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.scenario.scenario_model import BlurSettings, ManualCheck, PanelLeaf, Permissions, Place, Scenario
from caris_desktop.ui.event_messages import check_state
from tests.ui.samples import TOUR

EVERYTHING = Permissions(audio_recording=True, transcription=True, own_voice=True, face=True)
ROBOT = replace(load_profile("simulated"), name="tiago")
MUTE = replace(ROBOT, speech=None)
STUDY = replace(TOUR, permissions=EVERYTHING, voice="computer")
LINKED = LinkStatus("connected", "TIAGo", clock_offset_ms=3.0, clock_uncertainty_ms=1.0)
GOOD = Facts(
    STUDY, ROBOT, LINKED, link_for_s=60.0, robot_freshness="fresh", robot_ahead_ms=3.0,
    drive=DriveStatus(guard="clear"), cameras={"front": "fresh"}, scan="fresh", pose="fresh", has_map=True,
    charge_fraction=0.8, free_bytes=90_000_000_000, bytes_per_hour=3e9, microphone=MicrophoneStatus("on"), loud=True,
    listening=ListeningStatus("ready"), speech=SpeechStatus(ready=True), voice=VoiceStatus("computer"),
    perception=PerceptionStatus("ready"), assistant=AssistantStatus("ready", "SmolLM2"),
)  # fmt: skip


def by_id(facts: Facts) -> dict[str, PreflightCheck]:
    return {check.id: check for check in automatic_checks(facts)}


def person(*consents: Any) -> PersonRow:
    return PersonRow("p-1", 1, "Person 1", True, 0, 0, consents=consents)


def covering(scenario: Scenario, who: Any) -> Scenario:
    return replace(scenario, blur=BlurSettings(who))


def test_a_robot_that_works_passes_every_check() -> None:
    checks = by_id(GOOD)
    assert set(checks) == {
        "robot", "emergency_stop", "video", "guard", "battery", "position", "clock", "disk", "microphone", "listening",
        "voice", "people", "model",
    }  # fmt: skip
    assert {check.state for check in checks.values()} == {"passed"}
    assert not any(check.asks_first or check.manual for check in checks.values())


def test_the_record_has_them_in_english_and_the_window_in_the_wizards_language() -> None:
    facts = replace(GOOD, link=replace(LINKED, state="lost"), free_bytes=3_000_000_000, perception=PerceptionStatus())
    checks = automatic_checks(facts)
    texts = [text for check in checks for text in (check.title, check.detail, check.advice) if text]
    use_translator(lambda text, _meant, _number: f"<{text}>")
    try:
        assert automatic_checks(facts) == checks
        assert all(tr(text) == f"<{text}>" or isinstance(text, LocalizedText) for text in texts)
        assert {tr(checks[0].title), tr(checks[0].detail)} == {"<Robot is connected>", "<TIAGo is not connected.>"}
    finally:
        use_translator(None)
    assert all(isinstance(text, LocalizedText) for text in texts), "text and values apart, for whoever translates them"


@pytest.mark.parametrize(
    ("check_id", "state", "changed"),
    [
        ("robot", "pending", {"link": LinkStatus("connecting"), "link_for_s": 1.0}),
        ("robot", "major", {"link": LinkStatus("connecting"), "link_for_s": 11.0}),
        ("robot", "minor", {"link": replace(LINKED, state="trouble")}),
        ("robot", "major", {"link": replace(LINKED, state="lost")}),
        ("robot", "minor", {"robot_freshness": "stale"}),
        ("robot", "major", {"robot_freshness": "lost", "robot_silent_s": 3.2}),
        ("robot", "pending", {"robot_freshness": "none", "link_for_s": 1.0}),
        ("robot", "minor", {"robot_freshness": "none"}),
        ("robot", "passed", {"robot_freshness": "none", "robot": RobotProfile(name="base", title="Base")}),
        ("practice", "minor", {"robot": load_profile("simulated")}),
        ("emergency_stop", "major", {"drive": DriveStatus(emergency_stop=True)}),
        ("emergency_stop", "not checked", {"link": LinkStatus("lost")}),
        ("video", "major", {"cameras": {"front": "fresh", "desk": "lost"}}),
        ("video", "minor", {"cameras": {"front": "stale"}}),
        ("video", "major", {"cameras": {}}),
        ("video", "pending", {"cameras": {}, "link_for_s": 1.0}),
        ("video", "not checked", {"cameras": {}, "link": LinkStatus("lost")}),
        ("guard", "major", {"scan": "lost"}),
        ("guard", "minor", {"scan": "stale"}),
        ("guard", "major", {"drive": DriveStatus(guard="blind", guard_detail="the laser is covered")}),
        ("guard", "minor", {"drive": DriveStatus(guard="overridden")}),
        ("guard", "pending", {"scan": "none", "link_for_s": 1.0}),
        ("battery", "minor", {"charge_fraction": 0.2}),
        ("battery", "major", {"charge_fraction": 0.1}),
        ("battery", "pending", {"charge_fraction": None}),
        ("position", "major", {"has_map": False}),
        ("position", "major", {"pose": "none"}),
        ("position", "minor", {"pose": "lost"}),
        ("clock", "pending", {"link": LinkStatus("connected"), "link_for_s": 5.0}),
        ("clock", "minor", {"link": LinkStatus("connected")}),
        ("clock", "minor", {"link": replace(LINKED, clock_uncertainty_ms=80.0)}),
        ("clock", "minor", {"robot_ahead_ms": -4_000.0}),
        ("clock", "passed", {"robot_ahead_ms": -1.7e12}),
        ("disk", "pending", {"free_bytes": None}),
        ("disk", "major", {"free_bytes": 2_000_000_000}),
        ("disk", "minor", {"free_bytes": 4_000_000_000}),
        ("disk", "passed", {"free_bytes": 9_000_000_000, "bytes_per_hour": None}),
        ("microphone", "not checked", {"microphone": MicrophoneStatus(), "loud": False}),
        ("microphone", "pending", {"loud": False}),
        ("microphone", "pending", {"microphone": MicrophoneStatus("starting"), "loud": False}),
        ("microphone", "major", {"microphone": MicrophoneStatus("failed", detail="Not plugged in.")}),
        ("microphone", "minor", {"microphone_chosen": False}),
        ("listening", "pending", {"listening": ListeningStatus("loading")}),
        ("listening", "minor", {"listening": ListeningStatus("failed")}),
        ("listening", "not checked", {"listening": ListeningStatus()}),
        ("voice", "pending", {"speech": SpeechStatus()}),
        ("voice", "major", {"speech": SpeechStatus(detail="the voice stopped")}),
        ("voice", "major", {"speech": SpeechStatus(ready=True, detail="no sound device: speech cannot be heard")}),
        ("voice", "not checked", {"voice": VoiceStatus("robot"), "link": LinkStatus("lost")}),
        ("voice", "passed", {"voice": VoiceStatus("robot"), "speech": SpeechStatus()}),
        ("voice", "minor", {"voice": VoiceStatus("robot"), "robot": MUTE}),
        ("voice", "minor", {"voice": VoiceStatus("both"), "robot": MUTE}),
        ("voice", "major", {"voice": VoiceStatus("robot"), "robot": MUTE, "speech": SpeechStatus(detail="stopped")}),
        ("people", "pending", {"perception": PerceptionStatus("loading")}),
        ("people", "minor", {"perception": PerceptionStatus("failed")}),
        ("people", "major", {"perception": PerceptionStatus("failed"), "scenario": covering(STUDY, "everybody")}),
        ("consent", "pending", {"scenario": covering(STUDY, "without_consent")}),
        ("consent", "minor", {"scenario": covering(STUDY, "without_consent"), "people": (person(),)}),
        ("consent", "passed", {"scenario": covering(STUDY, "without_consent"), "people": (person("video"),)}),
        ("model", "pending", {"assistant": AssistantStatus("starting")}),
        ("model", "minor", {"assistant": AssistantStatus("failed")}),
    ],
)
def test_each_check_says_how_that_stands_and_what_to_do(check_id: str, state: str, changed: dict[str, Any]) -> None:
    check = by_id(replace(GOOD, **changed))[check_id]
    assert check.state == state
    assert check_state(check, ClockAnchor(0, 0)).endswith("."), "a sentence"
    assert bool(check.advice) or state not in ("minor", "major")


def test_a_link_that_is_lost_leaves_nothing_of_the_robot_checked() -> None:
    lost = by_id(replace(GOOD, link=LinkStatus("lost"), cameras={}, robot_freshness="none"))
    assert {name for name, check in lost.items() if check.state == "not checked"} == {
        "emergency_stop", "video", "guard", "battery", "position", "clock", "microphone",
    }  # fmt: skip


def test_the_robots_own_camera_and_microphone_wait_for_it_while_it_is_away() -> None:
    """No error is reported for their cables."""
    robot = load_profile("simulated")
    away = replace(
        GOOD, robot=robot, link=LinkStatus("lost"), cameras={robot.cameras[0].name: "lost"},
        microphone=MicrophoneStatus("failed", detail="no sound comes from it"), loud=False,
    )  # fmt: skip
    lost = by_id(away)
    assert (lost["video"].state, lost["microphone"].state) == ("not checked", "not checked")
    both = by_id(replace(away, cameras={**away.cameras, "desk": "lost"}))
    assert both["video"].state == "major" and "desk" in both["video"].detail
    at_the_desk = by_id(replace(away, robot=replace(robot, audio=None)))
    assert at_the_desk["microphone"].state == "major"


def test_a_shipped_profile_is_reported_to_point_to_this_computer() -> None:
    silent = replace(GOOD, link=LinkStatus("connecting", "TIAGo", address="ws://127.0.0.1:9090"))
    assert "Its address is this computer." in by_id(silent)["robot"].advice
    elsewhere = replace(silent, robot=replace(ROBOT, address="ws://tiago-0c:9090"))
    assert "Turn on the robot" in by_id(elsewhere)["robot"].advice


def test_of_a_robot_that_does_not_answer_the_address_is_reported_and_what_to_do() -> None:
    link = LinkStatus("connecting", "TIAGo", "ws://me:secret@10.0.0.7:9090")
    check = by_id(replace(GOOD, link=link, link_for_s=11.0))["robot"]
    assert "10.0.0.7:9090" in check.detail and "secret" not in check.detail
    assert "Set up" not in check.advice
    simulated = by_id(replace(GOOD, link=link, link_for_s=11.0, robot=load_profile("simulated")))["robot"]
    assert "Try it with the simulated robot" in simulated.advice


NOTHING = Permissions(
    photos=False, video_recording=False, driving=False, assistant=False, naming_people=False, robot_controls=False,
    cloud_models=False,
)  # fmt: skip


@pytest.mark.parametrize(
    ("permission", "its_checks"),
    [
        ("driving", {"emergency_stop", "video", "guard", "position"}),
        ("video_recording", {"video"}),
        ("photos", {"video"}),
        ("audio_recording", {"microphone"}),
        ("transcription", {"microphone", "listening"}),
        ("naming_people", {"people"}),
        ("assistant", {"model"}),
    ],
)
def test_only_what_the_scenario_needs_is_checked(permission: str, its_checks: set[str]) -> None:
    bare = {"robot", "battery", "clock", "disk", "voice"}
    places = (Place("Kitchen", TOUR.places[0].pose_in_map),)
    quiet = replace(GOOD, scenario=Scenario("Bare", PanelLeaf("speak"), permissions=NOTHING, places=places))
    assert set(by_id(quiet)) == bare
    allowed = replace(quiet.scenario, permissions=replace(NOTHING, **{permission: True}))
    assert set(by_id(replace(quiet, scenario=allowed))) == bare | its_checks


def test_a_robot_is_not_requested_what_it_has_not() -> None:
    plain = replace(GOOD, robot=RobotProfile(name="base", title="Base"))
    assert not {"guard", "battery"} & set(by_id(plain))
    no_places = replace(GOOD, scenario=replace(STUDY, places=()))
    assert "position" not in by_id(no_places)


def test_the_scenarios_own_checks_are_ticked() -> None:
    scenario = replace(
        STUDY,
        preflight=("Consent form signed", ManualCheck("Lights on", "Switch them on.", needed=False), "Lights on"),
    )
    signed, lights = ticked_checks(scenario, {})
    assert (signed.state, signed.manual, signed.asks_first) == ("not checked", True, True)
    assert (lights.title, lights.advice, lights.asks_first) == ("Lights on", "", True), "the last of a title counts"
    ticked = ticked_checks(scenario, {signed.id: ChecklistItem(5, WIZARD)}, "The link was lost.", [lights.id])
    assert (ticked[0].state, ticked[0].actor, ticked[0].checked_ns, ticked[0].detail) == ("passed", WIZARD, 5, "")
    assert not ticked[0].asks_first
    assert ticked[1].detail == "The link was lost."
    never = ticked_checks(scenario, {}, "The link was lost.", [lights.id])
    assert never[0].detail == "", "what was not ticked was not taken back"
