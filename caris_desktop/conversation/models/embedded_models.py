"""Language models that the user has added for the embedded server: GGUF files, found by name and checked by SHA-256."""

import os
import re
from functools import partial
from pathlib import Path
from typing import Any

from caris_desktop.conversation.models.endpoint import MODEL_NAME, LanguageModelError, shortened
from caris_desktop.domain.file_replacement import no_room, replace_file
from caris_desktop.domain.model_files import check_file, models_dirs
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value

CONTEXT_TOKENS = 4096
"""Of all slots of the server together: each takes as much of it as its prompt is long."""
SUFFIX = ".gguf"
_MAGIC = b"GGUF"
# Measured with SmolLM2 and Qwen2.5 of 0.5 B: code, vocabulary and the tensors of one batch.
_OTHER_BYTES = 300_000_000
_COPY_BYTES = 1 << 22
NOT_ADDED = QT_TR_NOOP("The model was not added.")


class ModelFile(Value):
    """Contents of a GGUF file: its own ``title``, size on disk, and the memory that serving it takes, in bytes."""

    title: str
    size_bytes: int
    memory_bytes: int


class AddedModel(Value):
    """Model of the user, named ``embedded:NAME`` in a scenario."""

    name: str
    path: Path
    size_bytes: int


def added_models() -> tuple[AddedModel, ...]:
    """Models of the user, sorted by name."""
    try:
        files = sorted(_folder().glob(f"*{SUFFIX}"))
    except OSError:
        return ()
    return tuple(AddedModel(file.stem, file, file.stat().st_size) for file in files if MODEL_NAME.fullmatch(file.stem))


def find_added(name: str) -> Path:
    """File of an added model. Raises LanguageModelError."""
    path = _folder() / f"{name}{SUFFIX}"
    if not MODEL_NAME.fullmatch(name) or not path.is_file():
        raise LanguageModelError(
            localized(QT_TR_NOOP("This computer has no model named “{name}”."), name=shortened(name)),
            QT_TR_NOOP("The assistant cannot answer with it; everything else works."),
            QT_TR_NOOP("Add its file: Add a model file… in the list of models, or caris-desktop models add FILE."),
        )
    return path


def model_name(file: Path, name: str = "") -> str:
    """``name``, or the file's own in permitted characters. Raises LanguageModelError if it is invalid."""
    chosen = name or re.sub(r"[^A-Za-z0-9._-]+", "-", file.name.removesuffix(SUFFIX)).strip("-._")[:80]
    if not MODEL_NAME.fullmatch(chosen):
        raise LanguageModelError(
            localized(QT_TR_NOOP("“{name}” cannot be the name of a model."), name=shortened(chosen)), NOT_ADDED,
            QT_TR_NOOP("Choose a name of letters, digits, dots, dashes and underscores (--name NAME)."),
        )  # fmt: skip
    return chosen


def inspect_model(file: Path, available_bytes: int | None = None) -> ModelFile:
    """Read the header of a GGUF file; ``available_bytes`` of memory is what this computer has.

    Raises LanguageModelError if the file is not GGUF, cut off, one part of several, without a chat template, or too
    large for the memory. Takes some seconds.
    """
    import psutil
    from gguf import GGUFReader

    size_bytes = _size_of(file)
    try:
        header = GGUFReader(file)
        field = header.get_field
        architecture = str(field("general.architecture").contents())  # type: ignore[union-attr]
        parts = _number(field("split.count"))
        template = field("tokenizer.chat_template")
        title = field("general.name")
        cache_bytes = _cache_bytes(header, architecture)
        end = max((tensor.data_offset + tensor.n_bytes for tensor in header.tensors), default=0)
    except (ValueError, IndexError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise _damaged(file) from error
    if parts > 1:
        raise LanguageModelError(
            localized(QT_TR_NOOP("{name} is one of {count} parts of a model."), name=file.name, count=parts), NOT_ADDED,
            QT_TR_NOOP("Join the parts to one file first, with llama-gguf-split --merge."),
        )  # fmt: skip
    if end > size_bytes or not end:
        raise _damaged(file)
    if template is None or not str(template.contents()).strip():
        raise LanguageModelError(
            localized(QT_TR_NOOP("{name} has no chat template: it continues texts only."), name=file.name),
            NOT_ADDED,
            QT_TR_NOOP("Choose the variant of the model for conversations, often named Instruct or Chat."),
        )
    memory_bytes = size_bytes + cache_bytes + _OTHER_BYTES
    available_bytes = psutil.virtual_memory().total if available_bytes is None else available_bytes
    if memory_bytes > available_bytes:
        raise LanguageModelError(
            localized(
                QT_TR_NOOP("{name} needs {needed} GB of memory, and this computer has {available} GB."),
                name=file.name, needed=f"{memory_bytes / 1e9:.1f}", available=f"{available_bytes / 1e9:.1f}",
            ),
            NOT_ADDED,
            QT_TR_NOOP("Choose a smaller model, or one with stronger quantization such as Q4_K_M."),
        )  # fmt: skip
    return ModelFile(shortened("" if title is None else str(title.contents()), 80), size_bytes, memory_bytes)


def store_model(file: Path, name: str) -> tuple[AddedModel, str]:
    """Put the file with the user's models under ``name``, and its SHA-256 beside it, which every start compares.

    On the same disk the file is linked rather than copied. Returns the model and its checksum. Raises
    LanguageModelError.
    """
    folder = _folder()
    target = folder / f"{name}{SUFFIX}"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        checksum = check_file(file)
        if target.exists():
            if check_file(target) == checksum:
                return AddedModel(name, target, target.stat().st_size), checksum
            raise LanguageModelError(
                localized(QT_TR_NOOP("There is another model named “{name}”."), name=name), NOT_ADDED,
                QT_TR_NOOP("Choose another name (--name NAME), or remove that model first."),
            )  # fmt: skip
        # First, so that there is never a model without one.
        replace_file(_checksum_file(target), f"{checksum}  {target.name}\n".encode("ascii"), durable=False)
        try:
            os.link(file.resolve(), target)
        except OSError:
            with file.open("rb") as opened:
                replace_file(target, iter(partial(opened.read, _COPY_BYTES), b""), durable=False)
    except OSError as error:
        raise LanguageModelError(
            localized(QT_TR_NOOP("The file cannot be copied to {folder} ({error})."), folder=folder, error=error),
            NOT_ADDED,
            QT_TR_NOOP("Free some space.") if no_room(error) else QT_TR_NOOP("Check the folder's permissions."),
        ) from error
    return AddedModel(name, target, target.stat().st_size), checksum


def remove_model(name: str) -> None:
    """Delete an added model. Raises LanguageModelError."""
    path = find_added(name)
    try:
        path.unlink()
        _checksum_file(path).unlink(missing_ok=True)
    except OSError as error:
        raise LanguageModelError(
            localized(QT_TR_NOOP("{path} cannot be deleted ({error})."), path=path, error=error),
            QT_TR_NOOP("The model is still there."), QT_TR_NOOP("Check the folder's permissions."),
        ) from error  # fmt: skip


def _folder() -> Path:
    return models_dirs()[-1] / "language"


def _checksum_file(path: Path) -> Path:
    return path.with_name(f"{path.name}.sha256")


def _size_of(file: Path) -> int:
    try:
        with file.open("rb") as opened:
            if opened.read(len(_MAGIC)) != _MAGIC:
                raise LanguageModelError(
                    localized(QT_TR_NOOP("{name} is not a GGUF file."), name=file.name), NOT_ADDED,
                    QT_TR_NOOP("Download the model in the format GGUF, as for llama.cpp, Ollama or LM Studio."),
                )  # fmt: skip
            return os.fstat(opened.fileno()).st_size
    except OSError as error:
        raise LanguageModelError(
            localized(QT_TR_NOOP("{name} cannot be read ({error})."), name=file.name, error=error), NOT_ADDED,
            QT_TR_NOOP("Check the file's name and permissions."),
        ) from error  # fmt: skip


def _damaged(file: Path) -> LanguageModelError:
    return LanguageModelError(
        localized(QT_TR_NOOP("{name} is damaged or cut off."), name=file.name), NOT_ADDED,
        QT_TR_NOOP("Download the file again, and compare its size with the publisher's."),
    )  # fmt: skip


def _cache_bytes(header: Any, architecture: str) -> int:
    """Size of keys and values of the whole context in 16 bits; a list of head counts has one for each layer."""

    def value(key: str, default: int = 0) -> int:
        return _number(header.get_field(f"{architecture}.{key}"), default)

    layers, heads, width = value("block_count"), max(1, value("attention.head_count")), value("embedding_length")
    key_width = value("attention.key_length", width // heads)
    value_width = value("attention.value_length", width // heads)
    return 2 * CONTEXT_TOKENS * layers * value("attention.head_count_kv", heads) * (key_width + value_width)


def _number(field: Any, default: int = 0) -> int:
    if field is None:
        return default
    found = field.contents()
    return int(max(found, default=default) if isinstance(found, list) else found)
