"""Model files of the user: inspection, refusal, storage by name."""

import re
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from gguf import GGUFReader, GGUFValueType, GGUFWriter

from caris_desktop.conversation.embedded_server import find_embedded_weights, missing_for_embedded
from caris_desktop.conversation.models.embedded_models import (
    added_models,
    find_added,
    inspect_model,
    model_name,
    remove_model,
    store_model,
)
from caris_desktop.conversation.models.endpoint import LanguageModelError, served_name
from caris_desktop.domain.model_files import WrongChecksum, check_file

Rewrite = Callable[[str, Any], Any]


@pytest.fixture(scope="module")
def weights() -> Path:
    weights = find_embedded_weights()
    if weights is None:
        pytest.skip(missing_for_embedded())
    return weights


@pytest.fixture(autouse=True)
def data_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    return tmp_path / "data"


def rewritten(weights: Path, target: Path, change: Rewrite) -> Path:
    """Header of ``weights`` with other values, None leaves one out, and one small tensor."""
    reader = GGUFReader(weights)
    writer = GGUFWriter(target, "llama")
    for name, field in reader.fields.items():
        if name.startswith(("GGUF.", "general.architecture", "tokenizer.ggml")):
            continue
        value = change(name, field.contents())
        if value is not None:
            of = field.types[-1] if field.types[0] == GGUFValueType.ARRAY else None
            writer.add_key_value(name, value, field.types[0], sub_type=of)
    change_added = change("split.count", None)
    if change_added is not None:
        writer.add_uint16("split.count", change_added)
    writer.add_tensor("output_norm.weight", reader.tensors[-1].data)
    writer.write_header_to_file()
    writer.write_kv_data_to_file()
    writer.write_tensors_to_file()
    writer.close()
    return target


def test_size_and_memory_of_a_file_come_from_its_header(weights: Path) -> None:
    found = inspect_model(weights)
    assert found.title.startswith("Smollm2 135M")
    assert found.size_bytes == weights.stat().st_size
    # 30 layers of 3 heads with 64 keys and 64 values for 4096 tokens, 16 bits each
    assert found.memory_bytes - found.size_bytes == 30 * 3 * (64 + 64) * 4096 * 2 + 300_000_000


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda name, value: None if name == "tokenizer.chat_template" else value, "no chat template"),
        (lambda name, value: 3 if name == "split.count" else value, "one of 3 parts"),
        (lambda name, value: 10**6 if name == "llama.block_count" else value, "needs [0-9.]+ GB of memory"),
    ],
)
def test_a_file_that_cannot_serve_is_refused_in_words(
    weights: Path, tmp_path: Path, change: Rewrite, expected: str
) -> None:
    with pytest.raises(LanguageModelError, match=expected) as refused:
        inspect_model(rewritten(weights, tmp_path / "changed.gguf", change))
    assert refused.value.meaning == "The model was not added." and refused.value.advice


@pytest.mark.long("0.01", "0.9999")
@pytest.mark.parametrize("share", [0.0, 0.0001, 0.01, 0.5, 0.9999])
def test_a_cut_off_file_is_refused(weights: Path, tmp_path: Path, share: float) -> None:
    cut = tmp_path / "cut.gguf"
    cut.write_bytes(weights.read_bytes()[: round(weights.stat().st_size * share)])
    with pytest.raises(LanguageModelError, match=r"damaged or cut off|not a GGUF file"):
        inspect_model(cut)


def test_other_files_are_refused(tmp_path: Path) -> None:
    other = tmp_path / "notes.gguf"
    other.write_text("GGML")
    for file, expected in ((other, "not a GGUF file"), (tmp_path, "cannot be read"), (tmp_path / "no", "cannot be")):
        with pytest.raises(LanguageModelError, match=expected):
            inspect_model(file)


def test_a_model_is_found_by_name_only_and_its_file_is_compared(tmp_path: Path, data_folder: Path) -> None:
    file = tmp_path / "Qwen 2.5 (3B).gguf"
    file.write_bytes(b"GGUF, some weights")
    model, checksum = store_model(file, model_name(file))
    assert (model.name, model.path) == ("Qwen-2.5-3B", find_added("Qwen-2.5-3B"))
    assert model.path.is_relative_to(data_folder) and stat.S_IMODE(model.path.parent.stat().st_mode) == 0o700
    assert check_file(model.path) == checksum
    assert store_model(file, model.name)[0] == model, "the same again changes nothing"
    assert [each.name for each in added_models()] == [model.name]

    another = tmp_path / "another.gguf"
    another.write_bytes(b"GGUF, other weights")
    with pytest.raises(LanguageModelError, match="another model named"):
        store_model(another, model.name)
    file.write_bytes(b"GGUF, replaced after it was added")
    with pytest.raises(WrongChecksum):
        check_file(model.path)

    remove_model(model.name)
    assert not added_models() and not any(model.path.parent.iterdir()) and file.exists()
    with pytest.raises(LanguageModelError, match="no model named"):
        find_added(model.name)


@pytest.mark.parametrize("name", ["../secret", "/etc/passwd", "a/b", ".hidden", "", "a b", "x" * 81])
def test_no_name_leads_out_of_the_folder(name: str, tmp_path: Path) -> None:
    with pytest.raises(LanguageModelError):
        find_added(name)
    assert served_name(f"embedded:{name}") is None
    if name:
        with pytest.raises(LanguageModelError, match="cannot be the name"):
            model_name(tmp_path / "model.gguf", name)


def test_the_command_adds_a_model_that_answers(weights: Path, tmp_path: Path, data_folder: Path) -> None:
    if missing := missing_for_embedded():
        pytest.skip(missing)

    def run(*words: str) -> tuple[int, str]:
        done = subprocess.run(
            [sys.executable, "-m", "caris_desktop", "models", *words],
            capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip
        return done.returncode, done.stdout + done.stderr

    status, text = run("add", str(weights), "--name", "small")
    assert status == 0, text
    assert "model: embedded:small" in text and check_file(weights) in text
    assert re.search(r"answers “.*Paris.*” \(first word after", text)
    assert "embedded:small" in run("list")[1]
    cut = tmp_path / "cut.gguf"
    cut.write_bytes(weights.read_bytes()[:1_000_000])
    status, text = run("add", str(cut))
    assert status == 1 and "cut.gguf is damaged or cut off" in text and "Traceback" not in text
    assert run("remove", "small")[0] == 0
    assert "No models were added" in run("list")[1]
