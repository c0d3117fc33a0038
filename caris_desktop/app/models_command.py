"""``caris-desktop models``: language models of the user that run in this program, from GGUF files."""

import argparse
import queue
import sys
from pathlib import Path

from caris_desktop.app import process_entry_points
from caris_desktop.conversation.embedded_messages import EmbeddedFailed, ModelAdded
from caris_desktop.conversation.models.embedded_models import added_models, remove_model
from caris_desktop.conversation.models.failure_texts import LanguageModelError
from caris_desktop.live.child_process import ChildProcess, ProcessSpec


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "action",
        nargs="?",
        default="list",
        choices=("list", "add", "remove"),
        metavar="ACTION",
        help="list: the added models; add: check a file, ask its model a question, and add it; remove: delete one",
    )
    parser.add_argument(
        "model", nargs="?", default="", metavar="FILE or NAME",
        help="to add: a GGUF file, as for llama.cpp, Ollama or LM Studio; to remove: a name from the list",
    )  # fmt: skip
    parser.add_argument("--name", default="", help="name of the added model in scenarios (default: the file's name)")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 0 if done."""
    if arguments.action != "list" and not arguments.model:
        print(f"{arguments.action} requires a {'file' if arguments.action == 'add' else 'name'}.", file=sys.stderr)
        return 2
    try:
        if arguments.action == "add":
            return _add(Path(arguments.model), arguments.name)
        if arguments.action == "remove":
            remove_model(arguments.model)
            print(f"{arguments.model} is removed.")
            return 0
    except LanguageModelError as error:
        print(error, file=sys.stderr)
        return 1
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
