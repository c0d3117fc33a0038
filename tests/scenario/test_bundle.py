"""Scenario as one file: lossless round trip, refusal of other contents, and no overwritten file."""

import json
import random
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from caris_desktop.domain.intents import SameName
from caris_desktop.robot.profile import own_profile_file
from caris_desktop.scenario import bundle as bundles
from caris_desktop.scenario.bundle import Bundle, BundledFile, BundleError, PartKind, read_bundle, unpack, write_bundle
from caris_desktop.scenario.scenario_file import MAX_FILE_BYTES, load_scenario, own_file_called

SCENARIO = """\
# Ours
version: 1
title: Visit
robot: lab
face:
  face: round
layout: {panel: video}
"""
ROBOT, FACE = BundledFile("robot", "lab", "name: one\n"), BundledFile("face", "round", "title: Round\n")
GIVEN = Bundle(BundledFile("scenario", "visit", SCENARIO), (ROBOT, FACE))
ABOUT = {"about.json": json.dumps({"format": "caris-scenario", "version": 1})}

NEWER = {"about.json": json.dumps({"format": "caris-scenario", "version": 2})}

Known = Callable[[PartKind, str], tuple[Path, str] | None]


@pytest.fixture
def folders(tmp_path: Path) -> dict[PartKind, Path]:
    return {"scenario": tmp_path / "scenarios", "robot": tmp_path / "robots", "face": tmp_path / "faces"}


@pytest.fixture
def known(folders: dict[PartKind, Path]) -> Known:
    def there(kind: PartKind, name: str) -> tuple[Path, str] | None:
        path = folders[kind] / f"{name}.yaml"
        return (path, path.read_text(encoding="utf-8")) if path.is_file() else None

    return there


def packed(path: Path, entries: dict[str, str | bytes], *, about: dict[str, str] = ABOUT) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in {**about, **entries}.items():
            archive.writestr(name, content)
    return path


def test_no_file_gets_the_name_of_a_device(tmp_path: Path, folders: dict[PartKind, Path], known: Known) -> None:
    """On Windows, ``nul.yaml`` swallows what is written to it."""
    scenario = BundledFile("scenario", "Con", SCENARIO.replace("lab", "nul"))
    write_bundle(Bundle(scenario, (BundledFile("robot", "nul", "name: one\n"),)), tmp_path / "a.caris")
    unpacked = unpack(read_bundle(tmp_path / "a.caris"), folders, known)
    assert {path.name for path in tmp_path.rglob("*.yaml")} == {"Con-2.yaml", "nul-2.yaml"}
    assert load_scenario(unpacked.path).robot == "nul-2"
    for name in ("aux", "COM1"):
        with pytest.raises(BundleError, match="not a valid name"):
            unpack(GIVEN, folders, lambda kind, _name: (folders[kind], ""), [SameName("robot", "lab", name)])
    assert [own_profile_file(title).name for title in ("Con", "Pepper")] == ["con-1.yaml", "pepper.yaml"]
    assert own_file_called("AUX").name == "aux-1.yaml"


def test_a_bundle_unpacks_as_it_was_packed(tmp_path: Path, folders: dict[PartKind, Path], known: Known) -> None:
    write_bundle(GIVEN, tmp_path / "a.caris")
    write_bundle(GIVEN, tmp_path / "b.caris")
    assert (tmp_path / "a.caris").read_bytes() == (tmp_path / "b.caris").read_bytes(), "its checksum means something"
    assert read_bundle(tmp_path / "a.caris") == GIVEN
    unpacked = unpack(GIVEN, folders, known)
    assert unpacked.renamed == ()
    assert unpacked.path.read_text(encoding="utf-8") == SCENARIO
    assert load_scenario(unpacked.path).robot == "lab"
    assert (folders["robot"] / "lab.yaml").read_text() == ROBOT.text
    assert (folders["face"] / "round.yaml").read_text() == FACE.text
    again = unpack(GIVEN, folders, known)
    assert again == unpacked, "the same file once more changes nothing"
    assert len(list(folders["robot"].iterdir())) == 1


def test_nothing_is_replaced_and_the_scenario_refers_to_its_own(folders: dict[PartKind, Path], known: Known) -> None:
    for folder, name in (("scenario", "visit"), ("robot", "lab"), ("face", "round")):
        folders[folder].mkdir()  # type: ignore[index]
        (folders[folder] / f"{name}.yaml").write_text("title: Mine\n")  # type: ignore[index]
    unpacked = unpack(GIVEN, folders, known)
    assert [(part.kind, name) for part, name in unpacked.renamed] == [
        ("robot", "lab-2"), ("face", "round-2"), ("scenario", "visit-2")
    ]  # fmt: skip
    scenario = load_scenario(unpacked.path)
    assert (scenario.robot, scenario.face.face) == ("lab-2", "round-2")
    assert unpacked.path.read_text(encoding="utf-8").startswith("# Ours\n"), "the rest is as its author wrote it"
    assert (folders["robot"] / "lab-2.yaml").read_text() == ROBOT.text
    for kind, name in (("scenario", "visit"), ("robot", "lab"), ("face", "round")):
        assert (folders[kind] / f"{name}.yaml").read_text() == "title: Mine\n"  # type: ignore[index]


def test_a_failed_file_prevents_all_others(tmp_path: Path, folders: dict[PartKind, Path], known: Known) -> None:
    (tmp_path / "scenarios").write_text("in the way")
    with pytest.raises(BundleError, match="Nothing was imported"):
        unpack(GIVEN, folders, known)
    assert list(folders["robot"].iterdir()) == [] and list(folders["face"].iterdir()) == []


@pytest.mark.parametrize(
    "name",
    ["../x.yaml", "/etc/x.yaml", "scenario/../../x.yaml", "robot/.x.yaml", "robot/a/b.yaml", "robot\\\\x.yaml",
     "run.py",      "scenario/x.yaml.py", "scenario/", "face/C:x.yaml", "scenario/ä.yaml"],
)  # fmt: skip
def test_no_path_leaves_its_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(BundleError, match=r"Allowed: scenario/NAME\.yaml"):
        read_bundle(packed(tmp_path / "a.caris", {"scenario/visit.yaml": SCENARIO, name: "x: 1"}))


def test_a_decompression_bomb_is_refused_before_it_expands(tmp_path: Path) -> None:
    swelling = packed(tmp_path / "a.caris", {"scenario/visit.yaml": b"#" * (20 * MAX_FILE_BYTES)})
    assert swelling.stat().st_size < MAX_FILE_BYTES
    with pytest.raises(BundleError, match="too large"):
        read_bundle(swelling)
    many = {f"face/f{number}.yaml": "x: 1" for number in range(bundles.MOST_PARTS)}
    with pytest.raises(BundleError, match=r"contains \d+ files"):
        read_bundle(packed(tmp_path / "b.caris", {"scenario/visit.yaml": SCENARIO, **many}))
    (tmp_path / "c.caris").write_bytes(b"0" * (bundles.MAX_BUNDLE_BYTES + 1))
    with pytest.raises(BundleError, match="too large"):
        read_bundle(tmp_path / "c.caris")


@pytest.mark.parametrize(
    ("entries", "about", "said"),
    [
        ({}, ABOUT, "0 scenarios"),
        ({"scenario/a.yaml": SCENARIO, "scenario/b.yaml": SCENARIO}, ABOUT, "2 scenarios"),
        ({"scenario/a.yaml": SCENARIO}, {}, "is not a scenario file"),
        ({"scenario/a.yaml": SCENARIO}, NEWER, "another version"),
        ({"scenario/a.yaml": SCENARIO.replace("Visit", "!!python/object:os.system x")}, ABOUT, "a.yaml, line 3"),
        ({"scenario/a.yaml": b"\xff\xfe"}, ABOUT, "damaged"),
    ],
)  # fmt: skip
def test_the_contents_are_checked(
    tmp_path: Path, entries: dict[str, str | bytes], about: dict[str, str], said: str
) -> None:
    with pytest.raises(BundleError, match=said):
        read_bundle(packed(tmp_path / "a.caris", entries, about=about))


@pytest.mark.parametrize("packing", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_damaged_file_is_refused_or_means_the_same(tmp_path: Path, packing: int) -> None:
    with zipfile.ZipFile(tmp_path / "a.caris", "w", packing) as archive:
        for name, text in {**ABOUT, "scenario/visit.yaml": SCENARIO, "robot/lab.yaml": ROBOT.text}.items():
            archive.writestr(name, text)
    whole = (tmp_path / "a.caris").read_bytes()
    chance = random.Random(5)  # noqa: S311 - a test, not cryptography
    refused = 0
    for _ in range(200):
        damaged = bytearray(whole)
        for _ in range(chance.randint(1, 4)):
            damaged[chance.randrange(len(damaged))] = chance.randrange(256)
        (tmp_path / "b.caris").write_bytes(damaged[: chance.choice((len(damaged), chance.randrange(len(damaged))))])
        try:
            assert read_bundle(tmp_path / "b.caris").scenario.text == SCENARIO
        except BundleError:
            refused += 1
    assert refused > 100


def test_replaced_files_come_back_where_the_rest_cannot_be_written(
    tmp_path: Path, folders: dict[PartKind, Path], known: Known
) -> None:
    mine = folders["robot"] / "lab.yaml"
    mine.parent.mkdir(parents=True, exist_ok=True)
    mine.write_text("title: Mine\n")
    (tmp_path / "scenarios").write_text("in the way")
    with pytest.raises(BundleError, match="Nothing was imported"):
        unpack(GIVEN, folders, known, [SameName("robot", "lab")])
    assert mine.read_text() == "title: Mine\n"
    assert [path.name for path in mine.parent.glob("*.yaml")] == ["lab.yaml"]
