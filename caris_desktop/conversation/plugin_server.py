"""Language models of plug-ins: their interface, and the process that serves one on loopback as the embedded one is."""

import contextlib
import json
import logging
import secrets
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, ClassVar, Protocol

from caris_desktop.domain.plugins import LOAD_WITHIN_S, Plugin, PluginCall, PluginError, PluginFailed, load, watched
from caris_desktop.domain.translation import QT_TR_NOOP
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
