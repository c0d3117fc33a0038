"""Entry points of the child processes; each imports its package in the child only.

The window's start imports this module, and needs little of what a recorder, detector or link requires.
"""

import logging
import multiprocessing.util
import os
import pkgutil
import threading
from multiprocessing.connection import Connection
from typing import Any

from caris_desktop.domain.value_class import Value


class EntryPoint(Value):
    """Function of a child process, as ``module:function``, which it imports when it is called."""

    name: str

    def __call__(self, connection: Connection, *arguments: Any) -> None:
        pkgutil.resolve_name(self.name)(connection, *arguments)


inference = EntryPoint("caris_desktop.perception.inference:run_inference")
camera = EntryPoint("caris_desktop.perception.cameras.camera_process:run_camera")
speech = EntryPoint("caris_desktop.conversation.synthesis:run_synthesis")
microphone = EntryPoint("caris_desktop.conversation.sound_devices:run_microphone")
playback = EntryPoint("caris_desktop.conversation.sound_devices:run_playback")
language_model = EntryPoint("caris_desktop.conversation.embedded_server:run_embedded_server")
model_addition = EntryPoint("caris_desktop.conversation.speech_checks:run_model_addition")
forgetting = EntryPoint("caris_desktop.live.erasure_run:run_forgetting")
control_link = EntryPoint("caris_desktop.robot.link:run_control_link")
media_link = EntryPoint("caris_desktop.robot.link:run_media_link")


def recorder(connection: Connection, *arguments: Any) -> None:
    from caris_desktop.perception import blur
    from caris_desktop.recording.recorder.recorder_process import run_recorder

    run_recorder(connection, *arguments, covering=blur)


def recogniser(connection: Connection, *arguments: Any) -> None:
    from caris_desktop.conversation.listening.recogniser import WORDS_THREAD, run_recogniser

    run_recogniser(connection, *arguments)
    if any(thread.name == WORDS_THREAD for thread in threading.enumerate()):
        # The model continues to compute for seconds; the libraries' system resources are released all the same.
        multiprocessing.util._exit_function()  # type: ignore[attr-defined]  # what it does itself at an ordinary end
        logging.shutdown()
        os._exit(0)
