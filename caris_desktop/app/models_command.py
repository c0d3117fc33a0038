"""``caris-desktop models``: language models of the user that run in this program, from GGUF files."""

import argparse
import asyncio
import queue
import signal
import ssl
import sys
from pathlib import Path
from urllib.parse import urlsplit

from caris_desktop.app import process_entry_points
from caris_desktop.app.arguments import ServerArgumentsError, add_server_arguments, read_server_arguments
from caris_desktop.conversation.embedded_server import (
    EMBEDDED_MODEL,
    EmbeddedFailed,
    ModelAdded,
    embedded_problem,
    serve_model,
)
from caris_desktop.conversation.models.embedded_models import added_models, remove_model
from caris_desktop.conversation.models.endpoint import LanguageModelError
from caris_desktop.domain.address import before_port
from caris_desktop.domain.limited_listener import listen_limited
from caris_desktop.domain.model_files import WrongChecksum
from caris_desktop.live.child_process import ChildProcess, ProcessSpec
from caris_desktop.recording.terminal import reporting

# Answers at a time are limited by the model's slots; idle connections occupy a thread of the server each.
_CONSOLES = 8
_CONNECTIONS = 32
_CHUNK_BYTES = 65_536


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "action",
        nargs="?",
        default="list",
        choices=("list", "add", "remove", "serve"),
        metavar="ACTION",
        help=(
            "list: the added models; add: check a file, ask its model a question, and add it; remove: delete one; "
            "serve: answer other programs and consoles, with the API of OpenAI, until Ctrl+C"
        ),
    )
    parser.add_argument(
        "model", nargs="?", default="", metavar="FILE or NAME",
        help="to add: a GGUF file, as for llama.cpp, Ollama or LM Studio; to remove and to serve: a name from the list "
        "(serve: the built-in model if none is given)",
    )  # fmt: skip
    parser.add_argument("--name", default="", help="name of the added model in scenarios (default: the file's name)")
    add_server_arguments(parser, port=8080)


@reporting(LanguageModelError, ServerArgumentsError)
def run(arguments: argparse.Namespace) -> int:
    """Exit status 0 if done."""
    if arguments.action in ("add", "remove") and not arguments.model:
        print(f"{arguments.action} requires a {'file' if arguments.action == 'add' else 'name'}.", file=sys.stderr)
        return 2
    if arguments.action == "serve":
        return _serve(arguments)
    if arguments.action == "add":
        return _add(Path(arguments.model), arguments.name)
    if arguments.action == "remove":
        remove_model(arguments.model)
        print(f"{arguments.model} is removed.")
        return 0
    for model in added_models():
        print(f"embedded:{model.name:<40} {model.size_bytes / 1e9:6.2f} GB  {model.path}")
    if not added_models():
        print("No models were added. Add one with: caris-desktop models add FILE")
    return 0


def _add(file: Path, name: str) -> int:
    print("Checking the file and asking the model a question. Large models take a minute…", flush=True)
    messages: queue.SimpleQueue[ModelAdded | EmbeddedFailed | None] = queue.SimpleQueue()
    child = ChildProcess(
        ProcessSpec("model-addition", process_entry_points.model_addition, (file, name)),
        on_message=lambda message, _raw: messages.put(message),
        on_exit=lambda _code: messages.put(None),
    )
    child.start()
    try:
        message = messages.get()
    finally:
        child.stop(grace_s=2.0)
    match message:
        case ModelAdded(title=title, memory_bytes=memory, size_bytes=size, sha256=sha256, answer=answer):
            print(f"{title or message.name}: {size / 1e9:.2f} GB, needs about {memory / 1e9:.1f} GB of memory.")
            print(f"SHA-256 {sha256}")
            print(f"{answer}.")
            print(f"It is added. In a scenario: assistant: model: embedded:{message.name}")
            return 0
        case EmbeddedFailed(problem):
            print(f"{problem.what} {problem.meaning} {problem.advice}", file=sys.stderr)
        case _:
            print(
                f"Reading {file.name} ended the process. The model was not added. The file may be damaged; the log has "
                "details.",
                file=sys.stderr,
            )
    return 1


def _serve(arguments: argparse.Namespace) -> int:
    token, tls = read_server_arguments(arguments, sent="questions")
    try:
        server = serve_model(token, arguments.model, clients=_CONSOLES)
    except (FileNotFoundError, WrongChecksum, RuntimeError) as error:
        problem = embedded_problem(error)
        print(f"{problem.what} {problem.advice}", file=sys.stderr)
        return 1
    try:
        asyncio.run(_forward(urlsplit(str(server.listening_address)).port or 0, arguments, tls))
    except OSError as error:
        print(f"Port {arguments.port} of {arguments.host} cannot be used ({error.strerror}).", file=sys.stderr)
        return 1
    return 0


async def _forward(model_port: int, arguments: argparse.Namespace, tls: ssl.SSLContext | None) -> None:
    """Pass connections on to the model's server, whose library listens on loopback and is built without TLS."""
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)

    async def connect(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        model_reader, model_writer = await asyncio.open_connection("127.0.0.1", model_port)
        copies = [asyncio.create_task(_copy(reader, model_writer)), asyncio.create_task(_copy(model_reader, writer))]
        try:
            # The model stops answering when nobody listens any longer.
            await asyncio.wait(copies, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for copy in copies:
                copy.cancel()
            writer.close()
            model_writer.close()

    listener = listen_limited(arguments.host, arguments.port, per_address=_CONNECTIONS)
    async with await asyncio.start_server(connect, sock=listener, ssl=tls) as server:
        host, port = server.sockets[0].getsockname()[:2]
        print(
            f"{arguments.model or EMBEDDED_MODEL} is available at http{'' if tls is None else 's'}://"
            f"{before_port(host)}:{port}/v1; press Ctrl+C to stop.",
            flush=True,
        )
        await stop.wait()
        server.close()


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    try:
        while data := await reader.read(_CHUNK_BYTES):
            writer.write(data)
            await writer.drain()
    except OSError:
        pass  # one end is gone; the caller closes the other
