"""A small transcription server, which answers as it is told."""

import json
import threading
from collections.abc import Iterator
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
    """Answers with ``status`` and ``body`` after ``wait_s``; keeps what was asked."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.status, self.body, self.wait_s = 200, json.dumps(VERBOSE).encode(), 0.0
        self.asked: list[tuple[str, dict[str, str], bytes]] = []
        self.over = threading.Event()

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/v1"


class _Handler(BaseHTTPRequestHandler):
    server: Server

    def do_POST(self) -> None:
        asked = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.asked.append((self.path, dict(self.headers), asked))
        self.server.over.wait(self.server.wait_s)
        self.send_response(self.server.status)
        self.send_header("Content-Length", str(len(self.server.body)))
        self.end_headers()
        self.wfile.write(self.server.body)

    def log_message(self, *_args: Any) -> None:
        """Says nothing."""


@contextmanager
def serving() -> Iterator[Server]:
    running = Server()
    thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield running
    finally:
        running.over.set()
        running.shutdown()
        running.server_close()
        thread.join()
