"""Names of wizards and coders and the robot's address: only in exports that include them explicitly."""

import argparse
import json
import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from rosbags.rosbag1 import Reader

from caris_desktop.app import export_command
from caris_desktop.domain.events import LinkChanged, Problem, RobotChosen, StopRequested
from caris_desktop.recording.annotation.annotation_editing import add_annotation, add_tier
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument
from caris_desktop.recording.annotation.annotation_store import save_coder
from caris_desktop.recording.pseudonyms import FILE_NAME, pseudonyms_of
from caris_desktop.recording.session_export import FORMATS, ExportRequest, export_all
from caris_desktop.recording.studies.statistics import study_statistics
from tests.recording.told_session import at, heard, said, tell

ADDRESS = "ws://lab-robot.example.org:9090"
SECRETS = ("mia curie", "ann lee", "ann-lee", "lab-robot", "example.org")


def session(study: Path, name: str, wizard: str, *, coder: str = "", later_s: float = 0.0) -> Path:
    values = [
        RobotChosen(at(-1.0), "tiago", "TIAGo", ADDRESS, f"name: tiago\naddress: {ADDRESS}\n"),
        LinkChanged(at(-0.5), "control", "connected", ADDRESS),
        Problem(at(1.0), "warning", f"lab-robot.example.org does not answer ({ADDRESS}).", "It waits.", "Wait."),
        *heard(1, 2.0, 3.0, "Hi"),
        *said(2, 3.5, 3.6, 4.0, "Hello there"),
        StopRequested(at(5.0), "wizard:Mia Curie"),
        StopRequested(at(6.0), "wizard:Ann Lee"),
        StopRequested(at(7.0), "wizard:W7"),
    ]
    trial = {"participant": "P1", "wizard": wizard, "condition": "A"}
    folder = tell(study / "sessions" / name, values, lasts_s=9.0, trial=trial, later_s=later_s)
    path = folder / "session.json"
    head = json.loads(path.read_text())
    path.write_text(json.dumps({**head, "robot": {"profile": "tiago", "address": ADDRESS}}))
    if coder:
        document = add_tier(AnnotationDocument(), "Gaze", coder)
        document = add_annotation(document, document.tiers[0].tier_id, 500, 1500, "away")
        save_coder(folder, document, coder)
    return folder


def words_of(out: Path) -> dict[str, str]:
    """All text in an export in lower case, by file."""
    found = {}
    for path in out.rglob("*"):
        if not path.is_file():
            continue
        if path.suffix == ".parquet":
            table = pq.read_table(path)
            text = f"{table.to_pylist()} {table.schema.metadata}"
        elif path.suffix == ".mcap":
            with path.open("rb") as file:
                text = "".join(
                    message.data.decode("utf-8", "replace") for _, _, message in make_reader(file).iter_messages()
                )
        elif path.suffix == ".bag":
            with Reader(path) as bag:
                text = "".join(data.decode("utf-8", "replace") for _, _, data in bag.messages())
        else:
            text = path.read_bytes().decode("utf-8", "replace")
        found[path.relative_to(out).as_posix()] = f"{path.relative_to(out)} {text}".lower()
    return found


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    study = tmp_path_factory.mktemp("study")
    session(study, "one", "Mia Curie", coder="Ann Lee")
    return study


def test_no_export_says_who_made_the_recording_or_where_the_robot_is(study: Path, tmp_path: Path) -> None:
    request = ExportRequest((study / "sessions" / "one",), tuple(fmt.name for fmt in FORMATS), tmp_path / "out")
    finished = export_all(request)
    assert finished.problems == ()
    found = words_of(tmp_path / "out")
    assert len(found) > 40
    for name, text in found.items():
        assert not [secret for secret in SECRETS if secret in text], name
    for name, expected in (
        ("one/csv/session.csv", "trial.wizard,w1"),
        ("one/csv/session.csv", "robot.address,tiago"),
        ("one/csv/annotations.csv", ",c1,gaze,away"),
        ("one/csv/event_problem.csv", "tiago does not answer (tiago)."),
        ("one/html/report.html", "w1"),
        ("one/methods/methods.md", "one wizard: w1 (one session)"),
        ("one/eaf/one.eaf", 'annotator="c1"'),
        ("one/rocrate/one/annotations/c1.json", '"coder": "c1"'),
    ):
        text = next(text for file, text in found.items() if file.lower() == name)
        assert expected in text, (name, expected)
    # A wizard who is unknown to the study.
    stops = found["one/csv/event_stop_requested.csv"].splitlines()[1:]
    assert [line.rpartition(",")[2] for line in stops] == ["wizard:w1", "wizard:another", "wizard:w7"]
    # Spoken words of a session stay unchanged.
    assert "hello there" in found["one/csv/utterances.csv"]


@pytest.mark.parametrize("host", ["robot", "participant", "text", "hello"])
def test_the_name_of_a_robot_that_is_a_word_changes_no_other_text(host: str, tmp_path: Path) -> None:
    # Such as ws://robot:9090: the word is the speaker of each utterance, too.
    values = [
        RobotChosen(at(-1.0), "tiago", "TIAGo", f"ws://{host}:9090"),
        LinkChanged(at(0.5), "control", "lost", f"ws://{host}:9090", f"{host}:9090 does not answer"),
        *heard(1, 2.0, 3.0, "Hi"),
        *said(2, 3.5, 3.6, 4.0, "hello there"),
    ]
    tell(tmp_path / "sessions" / "s", values, lasts_s=9.0, robot={"profile": "tiago", "address": f"ws://{host}:9090"})
    (row,) = study_statistics(tmp_path, tmp_path / "statistics").measures
    assert (row["robot_utterances"], row["participant_utterances"], row["responses"]) == (1, 1, 1)
    export_all(ExportRequest((tmp_path / "sessions" / "s",), ("csv",), tmp_path / "out"))
    found = words_of(tmp_path / "out" / "s")
    assert "hello there" in found["utterances.csv"]
    assert "robot.address,tiago" in found["session.csv"]
    assert f"{host}:9090" not in "".join(found.values()) and "tiago does not answer" in found["event_link_changed.csv"]


def test_a_host_is_replaced_in_any_case(tmp_path: Path) -> None:
    address = "ws://Lab-7.Example.org:9090"
    values = [
        RobotChosen(at(-1.0), "tiago", "TIAGo", address),
        LinkChanged(
            at(0.5), "control", "lost", address, "Lab-7.Example.org does not answer, nor WSS://LAB-7.EXAMPLE.ORG"
        ),
    ]
    tell(tmp_path / "sessions" / "s", values, lasts_s=9.0, robot={"profile": "tiago", "address": address})
    export_all(ExportRequest((tmp_path / "sessions" / "s",), ("csv",), tmp_path / "out"))
    found = words_of(tmp_path / "out" / "s")
    assert "lab-7" not in "".join(found.values())
    assert "tiago does not answer, nor tiago" in found["event_link_changed.csv"]


def test_names_are_exported_where_a_person_chose_that(study: Path, tmp_path: Path) -> None:
    parser = argparse.ArgumentParser()
    export_command.add_arguments(parser)
    words = [str(study / "sessions" / "one"), "--to", "csv,methods,rocrate", "--with-names", str(tmp_path / "out")]
    assert export_command.run(parser.parse_args(words)) == 0
    found = words_of(tmp_path / "out")
    assert "trial.wizard,mia curie" in found["csv/session.csv"]
    assert f"robot.address,{ADDRESS}" in found["csv/session.csv"]
    assert "wizard:ann lee" in found["csv/event_stop_requested.csv"]
    assert "mia curie (one session)" in found["methods/methods.md"]
    assert '"coder": "ann lee"' in next(text for name, text in found.items() if "annotations/Ann" in name)


def test_a_pseudonym_stays_whose_it_is(tmp_path: Path) -> None:
    study = tmp_path / "study"
    second = session(study, "b", "Tom", coder="Zoe", later_s=100)
    assert pseudonyms_of([second]).wizard("Tom") == "W1"
    first = session(study, "a", "Mia", coder="Ann", later_s=0)
    coded = session(study, "c", "W2", later_s=200)
    for folders in ([first, second, coded], [first], [coded, first]):
        of = pseudonyms_of(folders)
        assert [of.wizard(name) for name in ("Tom", "tom ", "Mia", "W2")] == ["W1", "W1", "W3", "W2"]
        assert [of.coder(name) for name in ("Zoe", "Ann")] == ["C1", "C2"]
    kept = json.loads((study / FILE_NAME).read_text())
    assert (kept["wizards"], kept["coders"]) == ({"tom": "W1", "mia": "W3"}, {"Zoe": "C1", "Ann": "C2"})
    # Two sessions outside the study.
    for folder in (first, second):
        shutil.copytree(folder, tmp_path / "elsewhere" / folder.name)
    of = pseudonyms_of(sorted((tmp_path / "elsewhere").iterdir()))
    assert (of.wizard("Mia"), of.wizard("Tom"), of.coder("Zoe")) == ("W1", "W2", "C2")
    assert not list((tmp_path / "elsewhere").glob("*.json"))


def test_statistics_name_nobody(study: Path, tmp_path: Path) -> None:
    made = study_statistics(study, tmp_path / "statistics")
    assert [row["wizard"] for row in made.measures] == ["W1"]
    for name, text in words_of(tmp_path / "statistics").items():
        assert not [secret for secret in SECRETS if secret in text], name
