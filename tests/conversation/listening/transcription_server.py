"""Small transcription server with scripted answers."""

import contextlib
import json
import re
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

VERBOSE = {
    "language": "en",
    "segments": [
        {"start": 0.0, "end": 1.0, "text": " Where is", "avg_logprob": -0.2, "no_speech_prob": 0.01},
        {"start": 1.0, "end": 2.0, "text": " the lab?", "avg_logprob": -0.2, "no_speech_prob": 0.01},
        {"start": 2.0, "end": 3.0, "text": " Thank you.", "avg_logprob": -0.9, "no_speech_prob": 0.9},
    ],
}


class Server(ThreadingHTTPServer):
    """Answers with ``status`` and ``body`` after ``wait_s``, or from ``answers``; records the requests."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.status, self.body, self.wait_s = 200, json.dumps(VERBOSE).encode(), 0.0
        self.asked: list[tuple[str, dict[str, str], bytes]] = []
        self.over = threading.Event()
        self.answers: Callable[[dict[str, str]], tuple[int, bytes]] | None = None
        self.fields: list[dict[str, str]] = []
        self.connections = 0
        self._open: set[socket.socket] = set()

    def get_request(self) -> tuple[socket.socket, Any]:
        self.connections += 1
        request, address = super().get_request()
        self._open.add(request)
        return request, address

    def drop_connections(self) -> None:
        """Close connections, as a server does with idle ones."""
        for connection in self._open:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        self._open.clear()

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/v1"


class _Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"

    def do_POST(self) -> None:
        asked = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.asked.append((self.path, dict(self.headers), asked))
        self.server.fields.append(
            {name.decode(): value.decode() for name, value in re.findall(rb'name="(\w+)"\r\n\r\n([^\r]*)\r\n', asked)}
        )
        self.server.over.wait(self.server.wait_s)
        status, body = self.server.status, self.server.body
        if self.server.answers is not None:
            status, body = self.server.answers(self.server.fields[-1])
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_args: Any) -> None:
        """No log output."""


@contextmanager
def serving() -> Iterator[Server]:
    running = Server()
    thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield running
    finally:
        running.over.set()
        running.drop_connections()
        running.shutdown()
        running.server_close()
        thread.join()
