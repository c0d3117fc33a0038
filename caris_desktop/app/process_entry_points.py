"""Entry functions of the child processes; each imports its package in the child only.

The window's start imports this module, and needs little of what a recorder, detector or link requires.
"""

import logging
import multiprocessing.util
import os
import threading
from multiprocessing.connection import Connection
from typing import Any


def recorder(connection: Connection, *arguments: Any) -> None:
    from caris_desktop.perception import blur
    from caris_desktop.recording.recorder.recorder_process import run_recorder

    run_recorder(connection, *arguments, covering=blur)


def inference(connection: Connection, *arguments: Any) -> None:
    from caris_desktop.perception.inference import run_inference

    run_inference(connection, *arguments)


def camera(connection: Connection, *arguments: Any) -> None:
    from caris_desktop.perception.cameras.camera_process import run_camera

    run_camera(connection, *arguments)


def speech(connection: Connection) -> None:
    from caris_desktop.conversation.synthesis import run_synthesis

    run_synthesis(connection)


def microphone(connection: Connection, *arguments: Any) -> None:
    from caris_desktop.conversation.sound_devices import run_microphone

    run_microphone(connection, *arguments)


def recogniser(connection: Connection, *arguments: Any) -> None:
    from caris_desktop.conversation.listening.recogniser import WORDS_THREAD, run_recogniser

    run_recogniser(connection, *arguments)
    if any(thread.name == WORDS_THREAD for thread in threading.enumerate()):
        # The model continues to compute for seconds; the libraries' system resources are released all the same.
        multiprocessing.util._exit_function()  # type: ignore[attr-defined]  # what it does itself at an ordinary end
        logging.shutdown()
        os._exit(0)


def playback(connection: Connection, *arguments: Any) -> None:
    from caris_desktop.conversation.sound_devices import run_playback

    run_playback(connection, *arguments)


def language_model(connection: Connection, model: str = "") -> None:
    from caris_desktop.conversation.embedded_server import run_embedded_server

    run_embedded_server(connection, model=model)


def model_addition(connection: Connection, *arguments: Any) -> None:
    from caris_desktop.conversation.speech_checks import run_model_addition

    run_model_addition(connection, *arguments)


def forgetting(connection: Connection, *arguments: Any) -> None:
    from caris_desktop.live.erasure_run import run_forgetting

    run_forgetting(connection, *arguments)


def control_link(connection: Connection, *arguments: Any) -> None:
    from caris_desktop.robot.link import run_control_link

    run_control_link(connection, *arguments)


def media_link(connection: Connection, *arguments: Any) -> None:
    from caris_desktop.robot.link import run_media_link

    run_media_link(connection, *arguments)
