"""Process that adds a language model file of the user: it checks the file, asks the model a question, and copies it.

A process of its own, since a file from elsewhere may end the library that reads it.
"""

import logging
import os
import secrets
from multiprocessing.connection import Connection
from pathlib import Path

from caris_desktop.conversation.embedded_server import EmbeddedFailed, ModelAdded, embedded_problem, serve_model
from caris_desktop.conversation.models.embedded_models import NOT_ADDED, inspect_model, model_name, store_model
from caris_desktop.conversation.models.endpoint import EMBEDDED_KEY, LanguageModelError
from caris_desktop.conversation.speech_checks import probe_language_model
from caris_desktop.domain.process_priority import step_back
from caris_desktop.domain.translation import QT_TR_NOOP, localized

_log = logging.getLogger(__name__)
_NICENESS = 10


def run_model_addition(connection: Connection, file: Path, name: str = "") -> None:
    """Process entry point: send ModelAdded or EmbeddedFailed once, and end at once with the server's threads."""
    step_back(_NICENESS)
    message: ModelAdded | EmbeddedFailed
    try:
        message = _add(file, name)
    except LanguageModelError as error:
        _log.info("%s was not added: %s", file, error)
        message = EmbeddedFailed(embedded_problem(error))
    except Exception as error:
        _log.exception("%s was not added", file)
        message = EmbeddedFailed(embedded_problem(error))
    try:
        connection.send(message)
        connection.close()
    except OSError:
        _log.info("the console is gone")
    logging.shutdown()
    os._exit(0)


def _add(file: Path, name: str) -> ModelAdded:
    name = model_name(file, name)
    found = inspect_model(file)
    key = os.environ[EMBEDDED_KEY] = secrets.token_urlsafe(32)
    try:
        server = serve_model(key, name, file)
    except RuntimeError as error:
        raise LanguageModelError(
            localized(QT_TR_NOOP("{name} cannot be loaded ({error})."), name=file.name, error=error), NOT_ADDED,
            QT_TR_NOOP("Its kind of model may be newer than this program: update it, or choose another model."),
        ) from error  # fmt: skip
    answer = probe_language_model(f"embedded:{name}", local_only=True, embedded_url=str(server.listening_address))
    if not answer.ok:
        raise LanguageModelError(answer.text, NOT_ADDED, answer.advice)
    model, checksum = store_model(file, name)
    return ModelAdded(model.name, found.title, found.size_bytes, found.memory_bytes, checksum, answer.text)
