from dataclasses import replace
from pathlib import Path

import pytest

from caris_desktop.conversation.face.face_file import Face, FaceError, face_names, load_face, parse_face, save_face


def test_the_faces_that_come_with_the_program_can_be_worn(tmp_path: Path) -> None:
    assert {"calm", "lively"} <= set(face_names(tmp_path))
    for name in face_names(tmp_path):
        assert load_face(name, tmp_path).name == name


def test_a_changed_face_is_loaded_and_goes_before_the_shipped_one(tmp_path: Path) -> None:
    mine = replace(load_face("calm", tmp_path), blink_every_s=9.0, ink="#00ff00")
    save_face(mine, tmp_path)
    assert load_face("calm", tmp_path) == mine
    assert not list(tmp_path.glob("*.tmp"))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("version: 1\ntitle: A\nink: red\n", "line 3"),
        ("version: 1\ntitle: A\neyes:\n  width: 900\n", "line 4"),
        ("version: 1\ntitle: A\nexpressions:\n  - {name: a}\n  - {name: a}\n", "line 5"),
        ("version: 1\ntitle: A\nmouht: {}\n", "mouth"),
        ("version: 2\ntitle: A\n", "line 1"),
        ("- a\n", "line 1"),
        ("title: !!python/object:os.system {}\n", "line 1"),
    ],
)
def test_a_mistake_is_reported_with_its_line(text: str, told: str) -> None:
    with pytest.raises(FaceError, match=told):
        parse_face(text, file_name="mine.yaml", name="mine")


@pytest.mark.parametrize("name", ["../calm", "a/b", "", "no-such-face", ".", "/etc/passwd"])
def test_a_name_leads_to_no_other_folder(tmp_path: Path, name: str) -> None:
    own = tmp_path / "faces"
    own.mkdir()
    save_face(Face("Outside", name="calm"), tmp_path)
    with pytest.raises(FaceError):
        load_face(name, own)
    if name != "no-such-face":
        with pytest.raises(FaceError):
            save_face(Face("A", name=name), own)
    assert list(own.iterdir()) == []
