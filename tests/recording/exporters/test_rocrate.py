"""Archive of a session: readable by the rocrate package, complete, consistent with the files, without names."""

import csv
import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from mcap.reader import make_reader
from rocrate.rocrate import ROCrate

from caris_desktop.domain.events import Problem
from caris_desktop.domain.schema import to_jsonable
from caris_desktop.domain.sensing import RobotPose, StatusShown
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.exporters.rocrate import licence_of
from caris_desktop.recording.recorder.event_log import EventLog
from caris_desktop.recording.session.manifest import verify_manifest, write_manifest
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import ExportContext, ExportError, export_session
from tests.recording.told_session import at, tell
from tests.support.recorded_session import RecordedSession, make_session

EVIL = '<script>alert("x")</script>'


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> RecordedSession:
    """Session with annotations, an export inside, a link to the outside, and a file changed after the recording."""
    study = tmp_path_factory.mktemp("study")
    trial = {"study": EVIL, "participant": "P07", "condition": "B", "wizard": "Wilma Wizard"}
    made = make_session(
        study / "2026-11-21 session ü", seconds=3.0, utterance_every_s=1.0, photo_every_s=1.0, trial=trial
    )
    (made.folder / "annotations").mkdir()
    (made.folder / "annotations" / "anna.json").write_text("{}")
    (made.folder / "export-1").mkdir()
    (made.folder / "export-1" / "table.csv").write_text("a\n")
    (study / "secret.txt").write_text("names")
    (made.folder / "secret.txt").symlink_to(study / "secret.txt")
    (made.folder / "speech.txt").write_text("changed\n")
    return made


@pytest.fixture(scope="module")
def out(made: RecordedSession, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("crates") / "crate"
    written = export_session(made.folder, "rocrate", out, ExportContext(licence="CC-BY-4.0"))
    assert set(written) == {path for path in out.rglob("*") if path.is_file()}
    return out


def described(crate: ROCrate) -> dict[str, Any]:
    return {entity.id: entity for entity in crate.get_entities()}


def test_the_crate_describes_every_file_truly(made: RecordedSession, out: Path) -> None:
    crate = ROCrate(out)
    files = {entity["name"]: entity for entity in crate.get_by_type("File") if entity.id != "ro-crate-metadata.json"}
    present = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert set(files) == present - {"ro-crate-metadata.json", "ro-crate-preview.html"}
    for name, entity in files.items():
        content = (out / name).read_bytes()
        assert entity["sha256"] == hashlib.sha256(content).hexdigest()
        assert int(entity["contentSize"]) == len(content)
        assert entity["description"]
        assert entity["encodingFormat"]
    name = made.folder.name
    assert files[f"{name}/video-front.mp4"]["encodingFormat"] == "video/mp4"
    assert files[f"{name}/events.mcap"]["encodingFormat"][1].id == "https://mcap.dev/spec"
    assert "changed after" in files[f"{name}/speech.txt"]["description"]
    assert "changed after" not in files[f"{name}/people.json"]["description"]
    assert not any("secret" in file or "export-1" in file for file in files)
    assert {part.id for part in crate.root_dataset["hasPart"]} >= {"FORMAT.md", "data_dictionary.csv"}


def test_requirements_of_an_archive(made: RecordedSession, out: Path) -> None:
    crate = ROCrate(out)
    root, session = crate.root_dataset, open_session(made.folder)
    assert root["license"].id == "https://creativecommons.org/licenses/by/4.0/"
    assert root["license"]["identifier"] == "CC-BY-4.0"
    assert root["temporalCoverage"] == f"{session.clock.utc(session.started_ns)}/{session.clock.utc(session.ended_ns)}"
    assert root["datePublished"]
    entities = described(crate)
    assert entities["#participant"]["identifier"] == "P07"
    recording = entities["#recording"]
    assert recording["instrument"]["name"] == "CARIS Desktop"
    assert recording["instrument"]["version"] == "0.test"
    assert (recording["startTime"], recording["endTime"]) == (
        session.clock.utc(session.started_ns), session.clock.utc(session.ended_ns)
    )  # fmt: skip
    # Every reference points to an entity of the crate or to the web.
    graph = json.loads((out / "ro-crate-metadata.json").read_text())["@graph"]
    ids = {entity["@id"] for entity in graph}
    assert len(ids) == len(graph)
    for reference in references(graph):
        assert reference in ids or reference.startswith("http"), reference


def references(value: Any) -> list[str]:
    if isinstance(value, dict):
        if set(value) == {"@id"}:
            return [value["@id"]]
        return [one for item in value.values() for one in references(item)]
    return [one for item in value for one in references(item)] if isinstance(value, list) else []


def test_the_session_inside_is_the_session(made: RecordedSession, out: Path) -> None:
    inside = out / made.folder.name
    assert verify_manifest(inside) == ["speech.txt was changed after the session closed."]
    session = open_session(inside)
    assert session.losses == ("speech.txt has 8 of 196 bytes.",)
    assert {**session.trial, "wizard": "Wilma Wizard"} == open_session(made.folder).trial
    assert sum(1 for _ in session.values()) == sum(1 for _ in open_session(made.folder).values())


def test_editing_the_crate_does_not_edit_the_recording(made: RecordedSession, out: Path) -> None:
    for copy in (out / made.folder.name).rglob("*"):
        if copy.is_file():
            original = made.folder / copy.relative_to(out / made.folder.name)
            assert not copy.samefile(original), copy


def test_the_wizards_name_is_nowhere_in_the_crate(made: RecordedSession, out: Path) -> None:
    for path in out.rglob("*"):
        if path.is_file():
            assert b"Wilma" not in path.read_bytes(), path
    values = [to_jsonable(value) for _, value in open_session(out / made.folder.name).values()]
    told = json.dumps(values)
    assert "Wilma" not in told
    assert str(made.folder.parent) not in told
    original, copy = (
        json.loads((folder / "session.json").read_text()) for folder in (made.folder, out / made.folder.name)
    )
    assert (original["trial"].pop("wizard"), copy["trial"].pop("wizard")) == ("Wilma Wizard", "W1")
    assert (original["robot"].pop("address"), copy["robot"].pop("address")) == ("ws://robot.local:9090", "temi")
    told = {file["name"]: file["bytes"] for file in copy.pop("files")}
    assert told == {
        file["name"]: (out / made.folder.name / file["name"]).stat().st_size
        for file in original.pop("files")
        if file["name"] != "speech.txt"
    } | {"speech.txt": 196}
    assert copy == original
    entities = described(ROCrate(out))
    assert "Pseudonyms replace" in entities["./"]["description"]
    assert "pseudonyms replace" in next(
        entity["description"] for entity in entities.values() if str(entity.get("name")).endswith("/session.json")
    )


def test_the_place_of_the_robot_is_nowhere_in_the_crate_but_the_record_is_complete(
    made: RecordedSession, out: Path
) -> None:
    inside = out / made.folder.name
    for path in out.rglob("*"):
        if path.is_file():
            assert b"robot.local" not in path.read_bytes(), path
    pairs = zip(open_session(made.folder).arrivals(), open_session(inside).arrivals(), strict=True)
    changed = []
    for (arrived_ns, spec, value), (copied_ns, copied_spec, copied) in pairs:
        assert (arrived_ns, spec) == (copied_ns, copied_spec)
        before, after = json.dumps(to_jsonable(value)), json.dumps(to_jsonable(copied))
        if before != after:
            assert after == before.replace("ws://robot.local:9090", "temi")
            changed.append(spec.name)
    assert sorted(changed) == ["event/link_changed", "event/robot_chosen", "status"]
    with (inside / "events.mcap").open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        values = [value for _, value in open_session(made.folder).values()]
        # Each pose is also written as a transform for other programs.
        assert summary.statistics.message_count == len(values) + sum(isinstance(value, RobotPose) for value in values)


def test_with_names_the_crate_is_the_session_as_it_was_recorded(made: RecordedSession, tmp_path: Path) -> None:
    export_session(made.folder, "rocrate", tmp_path / "out", ExportContext(with_names=True))
    for path in (tmp_path / "out" / made.folder.name).rglob("*"):
        if path.is_file():
            assert (
                path.read_bytes() == (made.folder / path.relative_to(tmp_path / "out" / made.folder.name)).read_bytes()
            )


@pytest.mark.logs(r"recording\.session_export: |anna\.json")
def test_a_header_before_a_repair_names_nobody_either(made: RecordedSession, tmp_path: Path) -> None:
    folder = shutil.copytree(made.folder, tmp_path / "s", symlinks=True)
    (folder / "recovered").mkdir()
    shutil.copy(folder / "session.json", folder / "recovered" / "session.json.original")
    (folder / "recovered" / "session.json.5.tmp").write_text('{"trial": {"wizard": "Wilma Wiz')
    write_manifest(folder)
    export_session(folder, "rocrate", tmp_path / "out")
    inside = tmp_path / "out" / "s"
    assert verify_manifest(inside) == []
    assert [path.name for path in (inside / "recovered").iterdir()] == ["session.json.original"]
    assert "Wilma" not in (inside / "recovered" / "session.json.original").read_text()


def test_a_record_that_names_folders_of_the_computer_is_reported(tmp_path: Path) -> None:
    problem = Problem(at(1.0), "info", "The layout was saved.", "It is in /home/anna/.config/layout.yaml.", "")
    folder = tell(tmp_path / "s", [problem], lasts_s=2.0)
    warnings: list[str] = []
    export_session(folder, "rocrate", tmp_path / "out", ExportContext(warn=warnings.append))
    assert "1 message(s) in events.mcap contain folder names" in warnings[0]


def test_the_record_can_be_read_by_what_lies_next_to_it(made: RecordedSession, out: Path) -> None:
    validators = {
        path.name.removesuffix(".schema.json").replace(".", "/"): jsonschema.Draft202012Validator(
            json.loads(path.read_text())
        )
        for path in (out / "schemas").iterdir()
    }
    with (out / made.folder.name / "events.mcap").open("rb") as file:
        checked: set[str] = set()
        for _, channel, message in make_reader(file).iter_messages():
            name = channel.topic.removeprefix("/")
            name = name if name in validators else name.partition("/")[0]
            if name in checked:
                continue
            validators[name].validate(json.loads(message.data))
            checked.add(name)
    assert checked == set(validators)
    with (out / "data_dictionary.csv").open(newline="") as file:
        rows = {(row["table"], row["field"]): row for row in csv.DictReader(file) if row["field"]}
    assert rows["event_command_sent", "twist.turn_radps"]["unit"] == "rad/s"
    assert rows["people_boxes", "boxes[].left_px"]["unit"] == "px"
    assert rows["map", "origin_in_map.x_m"]["unit"] == "m"
    assert ("map", "cells") not in rows, "the message has them as data"
    properties = {name: _fields(validator.schema) for name, validator in validators.items()}
    named = {(table, field) for table, field in rows if table in properties}
    assert {(table, field) for table, field in named if field not in properties[table]} == set()
    session = open_session(made.folder)
    text = (out / "FORMAT.md").read_text()
    assert f"{session.clock.anchor.utc_ns} + (stamp_ns - {session.clock.anchor.monotonic_ns})" in text


def _fields(schema: Any, before: str = "") -> set[str]:
    """Paths of the fields of a JSON schema, as the data dictionary names them."""
    found = set()
    for name, field in {**schema.get("properties", {}), **schema.get("patternProperties", {})}.items():
        path = f"{before}{name.strip('^$')}"
        found.add(path)
        for kind in (field, *field.get("anyOf", ())):
            found |= _fields(kind, f"{path}.") | _fields(kind.get("items", {}), f"{path}[].")
    return found


def test_the_page_for_people_is_escaped_and_says_what_is_there(out: Path) -> None:
    page = (out / "ro-crate-preview.html").read_text()
    assert "<script" not in page
    assert "&lt;script&gt;" in page
    assert 'href="https://creativecommons.org/licenses/by/4.0/"' in page
    assert "P07" in page
    assert "%C3%BC/events.mcap" in page


def test_the_wizards_name_is_not_in_the_metadata(out: Path) -> None:
    for name in ("ro-crate-metadata.json", "ro-crate-preview.html", "FORMAT.md"):
        assert "Wilma" not in (out / name).read_text()


def test_names_of_people_do_not_leave_the_study(made: RecordedSession, tmp_path: Path) -> None:
    folder = shutil.copytree(made.folder, tmp_path / "s", symlinks=True)
    session = open_session(folder)
    values = list(session.arrivals())
    (folder / "events.mcap").unlink()
    log = EventLog(DiskFile(folder / "events.mcap"), anchor=session.clock.anchor, metadata={})
    rows = [{"person_id": "p-1", "name": "Person 1"}, {"person_id": "p-2", "name": "Ada Lovelace"}]
    shown = StatusShown(session.started_ns, "persons", rows)
    for arrived_ns, value in [(session.started_ns, shown), *((arrived, value) for arrived, _, value in values)]:
        log.write(BY_TYPE[type(value)], value, arrived_ns)
    log.close()
    with pytest.raises(ExportError, match="names of people"):
        export_session(folder, "rocrate", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("chosen", "address", "name"),
    [
        ("", "#no-licence", "No licence was chosen"),
        ("MIT", "https://spdx.org/licenses/MIT", "MIT"),
        ("CC0-1.0", "https://creativecommons.org/publicdomain/zero/1.0/", "CC0-1.0"),
        ("https://example.org/terms", "https://example.org/terms", "https://example.org/terms"),
        ("javascript:alert(1)", "#licence", "javascript:alert(1)"),
        ("only for our partners", "#licence", "only for our partners"),
    ],
)
def test_licences(chosen: str, address: str, name: str) -> None:
    licence = licence_of(chosen)
    assert (licence["@id"], licence["name"]) == (address, name)


def test_a_missing_licence_is_stated(tmp_path: Path) -> None:
    made = make_session(tmp_path / "s", seconds=1.0, cameras=(), audio=())
    fractions: list[float] = []
    export_session(made.folder, "rocrate", tmp_path / "out", ExportContext(progress=fractions.append))
    assert ROCrate(tmp_path / "out").root_dataset["license"]["name"] == "No licence was chosen"
    assert "No licence was chosen" in (tmp_path / "out" / "ro-crate-preview.html").read_text()
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
