"""``caris-desktop check``: preflight check on the command line. Each line says ok, or what to do."""

import argparse
import contextlib
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from caris_desktop.app import composition
from caris_desktop.app.arguments import add_console_arguments
from caris_desktop.conversation.listening.engines import EngineUnavailableError, NoEngineError, find_recogniser
from caris_desktop.conversation.listening.server_engine import ServerEngine
from caris_desktop.conversation.speech_checks import probe_language_model, probe_sound
from caris_desktop.domain.address import is_loopback, without_credentials
from caris_desktop.domain.media_checks import PictureError, fitted
from caris_desktop.domain.plugin_process import why_unusable
from caris_desktop.domain.plugins import PluginError, find
from caris_desktop.domain.value_class import Value
from caris_desktop.perception.backends.remote_detector import RemoteDetector
from caris_desktop.perception.cameras.camera_process import open_camera
from caris_desktop.perception.cameras.camera_source import CameraError, ChosenCamera, parse_camera
from caris_desktop.perception.cameras.device_camera import found_cameras
from caris_desktop.perception.detector import DetectorAwayError
from caris_desktop.perception.weights import DetectorChoice, WeightsError, find_weights
from caris_desktop.robot.discovery import load_profile_blocking
from caris_desktop.robot.link import check_robot, robot_queue_advice
from caris_desktop.robot.profile_model import ProfileError
from caris_desktop.scenario.scenario_model import Scenario, plugin_panels

ENOUGH_FREE_BYTES = 5 * 10**9
_SECOND_OF_SOUND = 16_000


class Finding(Value):
    """Result line of one check: ``advice`` says what to do if it is not ok."""

    subject: str
    ok: bool
    text: str
    advice: str = ""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_console_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Exit status 0 if everything is ready."""
    ready = True
    for finding in _findings(arguments):
        ready = ready and finding.ok
        mark = "ok  " if finding.ok else "FIX "
        print(f"{mark} {finding.subject:<15} {finding.text}", flush=True)
        if not finding.ok and finding.advice:
            print(f"     {'':<15} {finding.advice}", flush=True)
    print("Ready for a session." if ready else "Not everything is ready: see the lines marked FIX.")
    return 0 if ready else 1


def _findings(arguments: argparse.Namespace) -> Iterator[Finding]:
    try:
        scenario = composition.find_scenario(arguments.scenario or "tour-guide", accept_named=arguments.accept_named)
        yield Finding("Scenario", True, f"{scenario.title} ({scenario.path})")
    except composition.StartError as error:
        yield Finding("Scenario", False, str(error), "Correct the file, or choose another --scenario.")
        scenario = composition.find_scenario("tour-guide")
    yield _robot(arguments.robot or scenario.robot, accept_named=arguments.accept_named)
    yield Finding("Cameras here", True, ", ".join(found_cameras()) or "none connected to this computer")
    yield from _cameras(arguments.camera, scenario)
    yield detector_finding(scenario)
    yield from plugin_findings(scenario)
    sound = probe_sound()
    yield Finding("Sound", sound.ok, sound.text, sound.advice)
    if scenario.permissions.transcription and not scenario.listening.model.startswith("plugin:"):
        yield recogniser_finding(scenario)
    if scenario.permissions.assistant:
        for model in dict.fromkeys((scenario.assistant.model, *scenario.assistant.models)):
            if not model.startswith("plugin:"):
                found = probe_language_model(model, local_only=not scenario.permissions.cloud_models)
                yield Finding("Language model", found.ok, found.text, found.advice)
    yield from _disk(arguments)


def _robot(name: str, *, accept_named: bool) -> Finding:
    try:
        composition.confirm_robot(name, accept_named=accept_named)
    except composition.StartError as error:
        return Finding("Robot", False, str(error), "Confirm it, or choose another --robot.")
    try:
        profile = load_profile_blocking(name)
    except ProfileError as error:
        return Finding("Robot", False, str(error), "Correct the profile, or choose another --robot.")
    wrong = check_robot(profile, profile.address)
    if wrong:
        return Finding("Robot", False, wrong[0], " ".join(wrong[1:]))
    advice = robot_queue_advice(profile, profile.address)
    return Finding("Robot", True, f"{profile.title} responds at {profile.address}{'. ' if advice else ''}{advice}")


def _cameras(texts: Sequence[str] | None, scenario: Scenario) -> Iterator[Finding]:
    """Findings for this computer's cameras; the robot's are reported with the robot."""
    given = [(text, "") for text in texts] if texts else [(camera.source, camera.name) for camera in scenario.cameras]
    for text, name in given:
        try:
            chosen = parse_camera(text, name=name)
            if chosen.kind != "robot":
                yield _camera(chosen)
        except CameraError as error:
            yield Finding("Camera", False, str(error), error.advice)


def _camera(chosen: ChosenCamera) -> Finding:
    """Finding for one camera. Raises CameraError."""
    camera = open_camera(chosen)
    try:
        picture = camera.read()
        image_bgr = None if picture is None else fitted(picture.image)
    except PictureError as refused:
        return Finding("Camera", False, f"A frame from {chosen.name} {refused}.", "Check the camera's settings.")
    finally:
        camera.close()
    if image_bgr is None:
        return Finding("Camera", False, f"{chosen.name} delivers no frames.", "Choose another --camera.")
    height_px, width_px = image_bgr.shape[:2]
    return Finding("Camera", True, f"{chosen.name} delivers frames of {width_px}x{height_px} pixels")


def detector_finding(scenario: Scenario) -> Finding:
    settings = composition.detector_settings(scenario)
    if settings.server and not settings.other_computers and not is_loopback(settings.server):
        return Finding(
            "Person detector",
            False,
            f"The scenario does not permit models on other computers, but uses {without_credentials(settings.server)}.",
            "Remove perception.server from the scenario, or permit cloud_models.",
        )
    if settings.server:
        try:
            remote = RemoteDetector(settings.server, confidence=1.0)
        except DetectorAwayError as error:
            return Finding(
                "Person detector", False, f"{error}.", "Start 'caris-desktop perceive --serve' on that computer."
            )
        remote.close()
        return Finding("Person detector", True, remote.label)
    try:
        # Without a plug-in that fails, the usual file is used.
        is_plugin = settings.model.source.startswith("plugin:")
        weights = find_weights(DetectorChoice() if is_plugin else settings.model, allow_download=False)
    except WeightsError as error:
        return Finding("Person detector", False, f"{error}.", f"{error.advice}.")
    return Finding("Person detector", True, f"{weights.label} ({weights.path})")


def plugin_findings(scenario: Scenario) -> Iterator[Finding]:
    """Findings for the plug-ins that the scenario names; each is imported in a process of its own."""
    try:
        used = [find("trackers", scenario.perception.tracker)]
        if scenario.perception.model.startswith("plugin:"):
            used.append(find("detectors", scenario.perception.model.partition(":")[2]))
        if scenario.permissions.assistant:
            models = dict.fromkeys((scenario.assistant.model, *scenario.assistant.models))
            names = [name for provider, _, name in (each.partition(":") for each in models) if provider == "plugin"]
            used += [find("language_models", name) for name in names]
        speech = dict.fromkeys((scenario.speech.name, scenario.listening.model))
        sources = dict.fromkeys(camera.source for camera in scenario.cameras)
        used += [find("cameras", source.split(":")[1]) for source in sources if source.startswith("plugin:")]
        used += [find("panels", name.partition(":")[2]) for name in plugin_panels(scenario)]
        used += [find("speech", name.partition(":")[2]) for name in speech if name.startswith("plugin:")]
    except PluginError as error:  # removed since the scenario was read
        yield Finding("Plug-in", False, f"{error.plugin.name}: {error}.", "Install it, or remove its name.")
        return
    for plugin in used:
        if not plugin.is_built_in:
            wrong = why_unusable(plugin)
            text = f"{plugin.title} ({plugin.package}): {wrong}." if wrong else f"{plugin.title} ({plugin.package})"
            yield Finding("Plug-in", not wrong, text, "Update it, or remove its name from the scenario.")


def recogniser_finding(scenario: Scenario) -> Finding:
    settings = replace(composition.recogniser_settings(scenario), allow_download=False)
    try:
        if settings.engine != "server":
            return Finding("Speech to text", True, str(find_recogniser(settings)))
        with contextlib.closing(ServerEngine(settings)) as engine:
            began_s = time.monotonic()
            # Soft noise: some servers do not answer to silence.
            noise = np.random.default_rng(0).normal(0.0, 0.003, _SECOND_OF_SOUND).astype(np.float32)
            engine.transcribe(noise, "", careful=True)
            took_s, request_form = time.monotonic() - began_s, engine.request_form
    except NoEngineError as error:
        return Finding("Speech to text", False, error.what, error.advice)
    except EngineUnavailableError as error:
        advice = "Check the server, and check listening.server and listening.model in the scenario."
        return Finding("Speech to text", False, error.what, advice)
    answer = f"{engine.model} transcribes one second of audio in {took_s:.1f} s"
    return Finding("Speech to text", True, f"{answer}; {request_form}" if request_form else answer)


def _disk(arguments: argparse.Namespace) -> Iterator[Finding]:
    try:
        study = composition.open_study(arguments.study)
    except composition.StartError as error:
        yield Finding("Study folder", False, str(error), "Choose another --study.")
        return
    free_bytes = shutil.disk_usage(study.path).free
    enough = free_bytes >= ENOUGH_FREE_BYTES
    yield Finding(
        "Disk",
        enough,
        f"{free_bytes / 1e9:.0f} GB free for {study.path}",
        ""
        if enough
        else "A session with video takes about 1 GB per hour: free some disk space or choose another --study.",
    )
