"""What is checked before a recording, from how everything stands: plain functions, a check each.

A check that the scenario has no need of is not there. What a detail tells changes only when somebody could see the
difference, since each change is recorded.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import field, replace
from functools import partial

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.address import without_credentials
from caris_desktop.domain.events import PreflightState
from caris_desktop.domain.streams import Freshness
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import dataclass
from caris_desktop.live.distant_ear import ear_of
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
from caris_desktop.robot.profile import RobotProfile
from caris_desktop.scenario.model import Scenario
from caris_desktop.scenario.preflight import ManualCheck, manual_checks

SIMULATED = "simulated"
_CONNECTS_WITHIN_S = 10.0
_CLOCK_KNOWN_WITHIN_S = 30.0
_CLOCK_UNCERTAIN_MS = 50.0
_CLOCK_AHEAD_MS = 1000.0
# A simulation's clock begins at zero: that it is another time says nothing.
_TIME_OF_ITS_OWN_MS = 1e9
_BATTERY_EMPTY, _BATTERY_LOW = 0.15, 0.3
# An hour of video, where nothing is known of what this study's sessions take.
_USUAL_HOUR_BYTES = 2e9


@dataclass(frozen=True, slots=True)
class Facts:
    """How everything stands, as far as checks ask.

    ``link_for_s`` is how long the link has been as it is. ``cameras`` are the cameras with how fresh their pictures
    are; ``robot_heard``, ``scan`` and ``pose`` are how fresh that is, ``robot_silent_s`` for how long the robot has
    sent nothing. ``robot_ahead_ms`` is what its clock is ahead of this computer's, None where that is not known.
    ``microphone_chosen`` is False where the wizard has chosen none. ``loud``: something was heard at it.
    """

    scenario: Scenario
    robot: RobotProfile | None = None
    link: LinkStatus = field(default_factory=LinkStatus)
    link_for_s: float = 0.0
    robot_heard: Freshness = "none"
    robot_silent_s: float = 0.0
    robot_ahead_ms: float | None = None
    drive: DriveStatus = field(default_factory=DriveStatus)
    cameras: Mapping[str, Freshness] = field(default_factory=dict)
    scan: Freshness = "none"
    pose: Freshness = "none"
    has_map: bool = False
    charge_fraction: float | None = None
    free_bytes: int | None = None
    bytes_per_hour: float | None = None
    microphone: MicrophoneStatus = field(default_factory=MicrophoneStatus)
    microphone_chosen: bool = True
    loud: bool = False
    listening: ListeningStatus = field(default_factory=ListeningStatus)
    speech: SpeechStatus = field(default_factory=SpeechStatus)
    voice: VoiceStatus = field(default_factory=VoiceStatus)
    perception: PerceptionStatus = field(default_factory=PerceptionStatus)
    assistant: AssistantStatus = field(default_factory=AssistantStatus)
    people: tuple[PersonRow, ...] = ()

    @property
    def connected(self) -> bool:
        return self.link.state in ("connected", "trouble")


@dataclass(frozen=True, slots=True)
class Tick:
    """A check by hand was looked after."""

    at_ns: int
    actor: Actor


def automatic_checks(facts: Facts) -> tuple[PreflightCheck, ...]:
    """Those that the scenario has need of, in the order in which one looks after them."""
    return tuple(check for look in _LOOKS if (check := look(facts)) is not None)


def ticked_checks(
    scenario: Scenario, ticks: Mapping[str, Tick], why_open: str = "", taken_back: Collection[str] = ()
) -> tuple[PreflightCheck, ...]:
    """The scenario's own. ``why_open`` says why those that were ``taken_back`` are open again."""
    return tuple(
        _ticked(manual, ticks.get(of), why_open if of in taken_back else "")
        for manual in manual_checks(scenario.preflight)
        for of in (manual_id(manual),)
    )


def manual_id(manual: ManualCheck) -> str:
    return f"by hand: {manual.check}"


def _ticked(manual: ManualCheck, tick: Tick | None, why_open: str) -> PreflightCheck:
    check = PreflightCheck(
        manual_id(manual),
        manual.check,
        detail=why_open,
        advice=manual.advice,
        manual=True,
        needed=manual.needed,
    )
    return check if tick is None else replace(check, state="passed", detail="", actor=tick.actor, checked_ns=tick.at_ns)


def _as_sentence(detail: str) -> str:
    return f"{detail[:1].upper()}{detail[1:].removesuffix('.')}."


def _waits_for_robot(check: Callable[[PreflightState, str], PreflightCheck]) -> PreflightCheck:
    return check("not checked", tr("Known once the robot is connected."))


def no_answer_advice(robot: RobotProfile | None) -> str:
    """What to do about a robot that does not answer."""
    if robot is not None and robot.name == SIMULATED:
        return tr("Start one: “Try it with the simulated robot” under Set up, in the Window menu.")
    return tr("Switch it on, and look at its network and its address: Window menu, Robot. It is tried again by itself.")


def _robot(facts: Facts) -> PreflightCheck:
    check = partial(PreflightCheck, "robot", tr("Robot is connected"))
    link = facts.link
    name = link.robot or tr("the robot")
    way = no_answer_advice(facts.robot)
    match link.state:
        case "connecting" if facts.link_for_s < _CONNECTS_WITHIN_S:
            return check("pending", tr("Connecting to {robot}.").format(robot=name))
        case "connecting":
            if link.address:
                address = without_credentials(link.address)
                silent = tr("{robot} does not answer at {address}.").format(robot=name, address=address)
            else:
                silent = tr("{robot} does not answer yet.").format(robot=name)
            return check("major", silent, way)
        case "lost" | "closed":
            return check("major", tr("{robot} is not connected.").format(robot=name), way)
        case "trouble":
            return check(
                "minor",
                tr("The connection to {robot} is unsteady.").format(robot=name),
                tr("Move closer to the router."),
            )
    if facts.robot_heard in ("stale", "lost"):
        return check(
            "minor" if facts.robot_heard == "stale" else "major",
            tr("{robot} was last heard %n s ago.", "", round(facts.robot_silent_s)).format(robot=name),
            tr("Check the robot’s computer and the network."),
        )
    tells = facts.robot is None or facts.robot.odometry is not None or facts.robot.scan is not None
    if facts.robot_heard == "none" and tells:
        silent = tr("{robot} is connected and has said nothing yet.").format(robot=name)
        if facts.link_for_s < _CONNECTS_WITHIN_S:
            return check("pending", silent)
        return check("minor", silent, tr("Start its sensors, and check the topic names of its profile."))
    return check("passed", tr("{robot} is connected.").format(robot=name))


def _practice(facts: Facts) -> PreflightCheck | None:
    """A simulated robot is named, so that nobody takes practice for data."""
    if facts.robot is None or facts.robot.name != SIMULATED:
        return None
    return PreflightCheck(
        "practice",
        tr("A real robot"),
        "minor",
        tr("The robot is simulated: what is recorded is practice."),
        tr("Tick “Practice run” when you start, or connect your robot."),
    )


def _emergency_stop(facts: Facts) -> PreflightCheck | None:
    if not facts.scenario.permissions.driving:
        return None
    check = partial(PreflightCheck, "emergency_stop", tr("Emergency stop is released"))
    if facts.drive.emergency_stop:
        return check(
            "major",
            tr("It is pressed: the robot will not move."),
            tr("Release it at the top right when everybody is clear of the robot."),
        )
    if not facts.connected:
        return _waits_for_robot(check)
    return check("passed", tr("The robot can move."))


def _video(facts: Facts) -> PreflightCheck | None:
    permissions = facts.scenario.permissions
    if not (permissions.video_recording or permissions.photos or permissions.driving):
        return None
    check = partial(PreflightCheck, "video", tr("Pictures come"))
    if not facts.cameras and facts.robot is not None and not facts.robot.cameras and not permissions.video_recording:
        return None  # it has no camera, and nobody needs one
    late = [name for name, freshness in facts.cameras.items() if freshness == "stale"]
    missing = [name for name, freshness in facts.cameras.items() if freshness in ("none", "lost")]
    of_robot = {camera.name for camera in facts.robot.cameras} if facts.robot is not None else set()
    if not facts.connected and (not facts.cameras or (missing and of_robot.issuperset(missing))):
        return _waits_for_robot(check)
    if not facts.cameras:
        if facts.link_for_s < _CONNECTS_WITHIN_S:
            return check("pending", tr("Waiting for the first picture."))
        return check("major", tr("No camera has sent a picture."), tr("Check the camera and its cable."))
    if missing:
        return check(
            "major",
            tr("No picture comes from {cameras}.").format(cameras=", ".join(missing)),
            tr("Check the camera and its cable."),
        )
    if late:
        return check(
            "minor",
            tr("Pictures come late from {cameras}.").format(cameras=", ".join(late)),
            tr("Check the network; other programs may use it up."),
        )
    return check("passed", tr("Pictures come from {cameras}.").format(cameras=", ".join(facts.cameras)))


def _guard(facts: Facts) -> PreflightCheck | None:
    robot, drive = facts.robot, facts.drive
    if not facts.scenario.permissions.driving or (robot is not None and robot.scan is None):
        return None
    check = partial(PreflightCheck, "guard", tr("LIDAR and guard against obstacles"))
    if robot is None or not facts.connected:
        return _waits_for_robot(check)
    if facts.scan == "none" and facts.link_for_s < _CONNECTS_WITHIN_S:
        return check("pending", tr("Waiting for the first scan."))
    if facts.scan in ("none", "lost"):
        return check(
            "major", tr("The LIDAR sends nothing, so obstacles are not seen."), tr("Check the LIDAR on the robot.")
        )
    if drive.guard == "overridden":
        return check("minor", tr("The guard was switched off."), tr("Switch it on in the Drive panel."))
    if drive.guard == "blind":
        return check(
            "major",
            _as_sentence(drive.guard_detail or tr("The guard cannot see.")),
            tr("Check the LIDAR on the robot."),
        )
    if not robot.guard.on:
        return check(
            "minor", tr("The robot’s profile has no guard of the console’s."), tr("Make sure that its own guard works.")
        )
    if facts.scan == "stale":
        return check("minor", tr("Scans come late, so the robot is slowed down."), tr("Check the network."))
    return check("passed", tr("Obstacles are seen, and the guard is on."))


def _battery(facts: Facts) -> PreflightCheck | None:
    if facts.robot is None or facts.robot.battery is None:
        return None
    check = partial(PreflightCheck, "battery", tr("Battery lasts"))
    charge = facts.charge_fraction
    if not facts.connected:
        return _waits_for_robot(check)
    if charge is None:
        return check("pending", tr("The robot has not told its charge yet."))
    state: PreflightState = "major" if charge < _BATTERY_EMPTY else "minor" if charge < _BATTERY_LOW else "passed"
    advice = "" if state == "passed" else tr("Charge the robot first.")
    return check(state, tr("{charge} % left.").format(charge=round(charge * 100)), advice)


def _position(facts: Facts) -> PreflightCheck | None:
    if not (facts.scenario.permissions.driving and facts.scenario.places):
        return None
    check = partial(PreflightCheck, "position", tr("Robot knows where it is"))
    if not facts.connected:
        return _waits_for_robot(check)
    if facts.link_for_s < _CONNECTS_WITHIN_S and (not facts.has_map or facts.pose == "none"):
        return check("pending", tr("Waiting for the map and the robot’s position."))
    if not facts.has_map:
        return check(
            "major",
            tr("There is no map, so it cannot go to places."),
            tr("Start the robot’s navigation, or load a map in the Map panel."),
        )
    if facts.pose == "none":
        return check(
            "major",
            tr("Its position on the map is not known, so it cannot go to places."),
            tr("Say where it is with “Robot is here” in the Map panel."),
        )
    if facts.pose != "fresh":
        return check("minor", tr("Its position is old."), tr("Drive a little and watch the map."))
    return check("passed", tr("Map and position are there."))


def _clock(facts: Facts) -> PreflightCheck:
    check = partial(PreflightCheck, "clock", tr("Robot’s clock is known"))
    link = facts.link
    if not facts.connected:
        return _waits_for_robot(check)
    if link.clock_offset_ms is None or link.clock_uncertainty_ms is None:
        if facts.link_for_s < _CLOCK_KNOWN_WITHIN_S:
            return check("pending", tr("It is being compared with this computer’s."))
        return check(
            "minor",
            tr("The robot does not tell its time, so its stamps cannot be placed exactly."),
            tr("Start rosapi on the robot."),
        )
    if link.clock_uncertainty_ms > _CLOCK_UNCERTAIN_MS:
        return check("minor", tr("It is known to no better than 50 ms."), tr("Check the network to the robot."))
    ahead_ms = facts.robot_ahead_ms
    if ahead_ms is not None and _CLOCK_AHEAD_MS < abs(ahead_ms) < _TIME_OF_ITS_OWN_MS:
        return check(
            "minor",
            tr("It is more than a second off; the recording corrects that."),
            tr("Set the robot’s clock by the network (NTP) to make its own logs agree."),
        )
    return check("passed", tr("It is compared with this computer’s all the time."))


def _disk(facts: Facts) -> PreflightCheck:
    check = partial(PreflightCheck, "disk", tr("Disk has room for an hour"))
    free = facts.free_bytes
    if free is None:
        return check("pending", tr("The disk is being looked at."))
    hours = free / (facts.bytes_per_hour or _USUAL_HOUR_BYTES)
    if hours < 1.0:
        return check("major", tr("There is room for %n minutes.", "", int(hours * 60)), tr("Free some disk space."))
    if hours < 2.0:
        return check("minor", tr("There is room for little more than an hour."), tr("Free some disk space."))
    if hours >= 24.0:
        return check("passed", tr("There is room for more than a day."))
    return check("passed", tr("There is room for %n hours.", "", int(hours)))


def _microphone(facts: Facts) -> PreflightCheck | None:
    permissions, microphone = facts.scenario.permissions, facts.microphone
    if not (permissions.audio_recording or permissions.transcription):
        return None
    check = partial(PreflightCheck, "microphone", tr("Microphone hears"))
    if not facts.microphone_chosen:
        return check(
            "minor",
            tr("No microphone is chosen: what the participant says is not kept."),
            tr("Choose one in the Window menu, under Participant’s microphone."),
        )
    if not facts.connected and ear_of(facts.scenario, facts.robot) == "robot":
        return _waits_for_robot(check)
    match microphone.state:
        case "failed":
            return check(
                "major",
                _as_sentence(tr(microphone.detail) or tr("It cannot be opened.")),
                tr("Plug it in, or choose another."),
            )
        case "starting":
            return check("pending", tr("It is being opened."))
    if facts.loud:
        return check("passed", tr("Something was heard."))
    if microphone.state == "on":
        return check("pending", tr("Nothing was heard yet."), tr("Say a few words where the participant will be."))
    return check("not checked", tr("Nobody has listened yet."), tr("Try it, and say a few words."))


def _listening(facts: Facts) -> PreflightCheck | None:
    if not facts.scenario.permissions.transcription:
        return None
    check = partial(PreflightCheck, "listening", tr("Speech becomes text"))
    listening = facts.listening
    match listening.state:
        case "ready":
            return check("passed", tr("The recogniser is ready."))
        case "failed":
            return check(
                "minor",
                _as_sentence(tr(listening.detail) or tr("The recogniser does not work.")),
                tr("Type notes instead, or restart the program."),
            )
        case "loading":
            return check("pending", tr("The recogniser is being loaded."))
    return check("not checked", tr("It begins when the microphone is open."))


def _voice(facts: Facts) -> PreflightCheck | None:
    if not facts.scenario.permissions.speech:
        return None
    check = partial(PreflightCheck, "voice", tr("Robot can speak"))
    speech, robot = facts.speech, facts.robot
    if facts.voice.output == "robot":
        if robot is None or not facts.connected:
            return _waits_for_robot(check)
        if robot.speech is not None:
            return check("passed", tr("It speaks with its own voice."))
    if speech.ready and speech.detail:
        return check("major", _as_sentence(tr(speech.detail)), tr("Check this computer’s sound."))
    if speech.ready:
        return check("passed", tr("The voice is ready."))
    if speech.detail:
        return check("major", _as_sentence(tr(speech.detail)), tr("Choose another voice in the Speak panel."))
    return check("pending", tr("The voice is being loaded."))


def _people(facts: Facts) -> PreflightCheck | None:
    scenario, perception = facts.scenario, facts.perception
    covers = scenario.covers_people
    if not (covers or scenario.permissions.naming_people):
        return None
    check = partial(
        PreflightCheck, "people", tr("People are found and pixelated") if covers else tr("People are found")
    )
    match perception.state:
        case "ready":
            return check("passed", tr("The detector is ready."))
        case "failed" if covers:
            return check(
                "major",
                tr("The detector does not work: every picture that is kept is pixelated as a whole."),
                tr("Restart the program; the Diagnostics panel has the details."),
            )
        case "failed":
            return check(
                "minor",
                tr("The detector does not work: nobody is found in the pictures."),
                tr("Restart the program; the Diagnostics panel has the details."),
            )
    return check("pending", tr("The detector is being loaded."))


def _consent(facts: Facts) -> PreflightCheck | None:
    """Where the scenario leaves only those who agreed unpixelated."""
    scenario = facts.scenario
    if not (scenario.covers_people and scenario.blur.who == "without_consent"):
        return None
    check = partial(PreflightCheck, "consent", tr("Consent is noted"))
    here = [person for person in facts.people if person.here]
    kind = "video" if scenario.permissions.video_recording else "photo"
    without = sum(kind not in person.consents for person in here)
    if not here:
        return check("pending", tr("Known once somebody is in front of the robot."))
    if without:
        return check(
            "minor",
            tr("Pixelated, as no consent is noted: {count} of those here.").format(count=without),
            tr("Note it in the People panel, if they agreed."),
        )
    return check("passed", tr("Everybody here has agreed."))


def _model(facts: Facts) -> PreflightCheck | None:
    if not facts.scenario.permissions.assistant:
        return None
    check = partial(PreflightCheck, "model", tr("Language model answers"))
    assistant = facts.assistant
    match assistant.state:
        case "ready" | "answering":
            return check("passed", tr("{model} is ready.").format(model=assistant.model or "–"))
        case "failed":
            return check(
                "minor",
                _as_sentence(tr(assistant.detail) or tr("It does not answer.")),
                tr("Choose another model in the Assistant panel; you can speak without one."),
            )
    return check("pending", tr("It is being loaded."))


_LOOKS: tuple[Callable[[Facts], PreflightCheck | None], ...] = (
    _robot,
    _practice,
    _emergency_stop,
    _video,
    _guard,
    _battery,
    _position,
    _clock,
    _disk,
    _microphone,
    _listening,
    _voice,
    _people,
    _consent,
    _model,
)
