"""Search for Piper voices by name, path and language, without other files."""

import json
from pathlib import Path

import pytest

from caris_desktop.conversation.voices.voice_selection import (
    NoSuchVoiceError,
    best_for,
    find_piper_voice,
    piper_voices,
    voice_folders,
)


def put_voice(folder: Path, name: str, *, language: str = "", **config: object) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    model = folder / f"{name}.onnx"
    model.write_bytes(b"onnx")
    content = {"audio": {"sample_rate": 22050}, "phoneme_id_map": {"a": [1]}, "espeak": {"voice": language}, **config}
    model.with_name(f"{model.name}.json").write_text(json.dumps(content))
    return model


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    put_voice(tmp_path, "en_GB-alba-medium", language="en-gb-x-rp")
    put_voice(tmp_path, "de_DE-thorsten-low", language="de")
    put_voice(tmp_path, "mine", language="de-at")
    (tmp_path / "yolov8n.onnx").write_bytes(b"onnx")
    put_voice(tmp_path, "detector", phoneme_id_map=None)
    (tmp_path / "list.onnx").write_bytes(b"onnx")
    (tmp_path / "list.onnx.json").write_text("[1, 2]")
    return tmp_path


def test_voices_are_listed_with_their_languages_and_other_networks_are_not(folder: Path) -> None:
    assert {voice.name: voice.language for voice in piper_voices([folder])} == {
        "de_DE-thorsten-low": "de-DE",
        "en_GB-alba-medium": "en-GB",
        "mine": "de-at",
    }


@pytest.mark.parametrize(
    ("language", "name"),
    [("de", "de_DE-thorsten-low"), ("de-AT", "mine"), ("de_DE", "de_DE-thorsten-low"), ("en-US", "en_GB-alba-medium")],
)
def test_the_best_of_a_language_is_of_its_country_where_there_is_one(folder: Path, language: str, name: str) -> None:
    found = best_for(language, piper_voices([folder]))
    assert found is not None and found.name == name
    assert best_for("fr", piper_voices([folder])) is None


def test_a_voice_is_named_by_name_or_path_and_no_name_leaves_the_folders(folder: Path, tmp_path: Path) -> None:
    inner = put_voice(tmp_path / "inner", "other", language="en")
    assert find_piper_voice("mine", [tmp_path / "nowhere", folder]).model == folder / "mine.onnx"
    assert find_piper_voice("inner/other.onnx", [folder]).model == inner
    assert find_piper_voice(str(inner), [folder]).model == inner
    for name, why in (("../secret", "outside"), ("nobody", "not on this computer"), ("yolov8n", "no Piper .onnx.json")):
        with pytest.raises(NoSuchVoiceError, match=why):
            find_piper_voice(name, [folder])


def test_they_lie_next_to_the_scenario_in_a_models_folder_or_in_the_offline_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CARIS_MODELS_DIR", str(tmp_path / "models"))
    put_voice(tmp_path / "models" / "piper", "twice")
    first = put_voice(tmp_path / "scenarios", "twice")
    folders = voice_folders(str(tmp_path / "scenarios"))
    assert find_piper_voice("twice", folders).model == first
    assert [voice.model for voice in piper_voices(folders) if voice.name == "twice"] == [first]
    assert find_piper_voice("twice", voice_folders("")).model == tmp_path / "models" / "piper" / "twice.onnx"
