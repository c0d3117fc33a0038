"""References in a file are listed once, and none is used before the user's confirmation."""

import json
import os
from dataclasses import replace
from pathlib import Path

import platformdirs
import pytest

from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live import confirmed_files
from caris_desktop.live.confirmed_files import ConfirmationNeededError, FileQuestion, accept, question_words
from caris_desktop.robot.profile import load_profile
from caris_desktop.scenario.scenario_file import load_scenario
from tests.support.plugins import install

PLAIN = "version: 1\ntitle: Shared\nlayout: {panel: video}\n"
HOSTILE = (
    PLAIN
    + """\
robot: ws://evil.example:9090
cameras:
  - {source: /etc/passwd}
  - {source: "https://user:secret@evil.example/cam#token-env=MY_CAMERA_KEY"}
  - {source: "0"}
perception: {model: https://evil.example/m.pt, sha256: SHA, server: wss://evil.example}
listening: {engine: server, server: https://evil.example/v1, model: /home/me/model}
speech: {name: "piper:/net/evil.example/voice.onnx"}
assistant: {model: "openai:gpt", models: ["ollama:other-cloud"]}
recording: {lsl: true, lsl_words: true}
face: {page: network}
controls:
  - {id: lamp, title: Lamp, kind: button, moves: false, publish: {topic: /leds, type: std_msgs/Bool}}
  - {id: go, title: A lamp, kind: button, moves: false, publish: {topic: /move_base/goal, type: a/B}}
  - {id: quiz, title: Next, kind: button, moves: false, call: {service: /quiz/next, type: std_srvs/Trigger}}
  - {id: free, title: Free, kind: button, call: {service: /e_stop/reset, type: std_srvs/Trigger}}
""".replace("SHA", "a" * 64)
)


def asked(path: Path) -> FileQuestion | None:
    try:
        confirmed_files.check_scenario(load_scenario(path))
    except ConfirmationNeededError as needed:
        return needed.question
    return None


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_everything_that_a_scenario_names_is_listed(tmp_path: Path) -> None:
    question = asked(written(tmp_path / "s.yaml", HOSTILE))
    assert question is not None
    listed = {(one.kind, one.text) for one in question.named}
    assert listed == {
        ("address", "ws://evil.example:9090"),
        ("address", "https://evil.example/cam"),
        ("address", "wss://evil.example"),
        ("address", "https://evil.example/v1"),
        ("variable", "MY_CAMERA_KEY"),
        ("path", "/etc/passwd"),
        ("path", "/net/evil.example/voice.onnx"),
        ("path", "/dev/video0"),
        ("model", "https://evil.example/m.pt"),
        ("model", "/home/me/model"),
        ("model", "openai:gpt"),
        ("model", "ollama:other-cloud"),
        ("network", "recording.lsl is on"),
        ("network", "recording.lsl_words is on"),
        ("network", "face.page is on"),
        ("motion", "A lamp: /move_base/goal (a/B)"),
        ("held", "Next: /quiz/next (std_srvs/Trigger)"),
        ("stop_release", "Free: /e_stop/reset (std_srvs/Trigger)"),
    }
    assert "user:secret" not in question_words(question)
    assert all(one.text in question_words(question) for one in question.named)


def test_the_answer_is_retained_for_the_file_and_a_change_requests_what_is_new(tmp_path: Path) -> None:
    path = written(tmp_path / "s.yaml", PLAIN + "robot: ws://lab:9090\n")
    question = asked(path)
    assert question is not None
    assert not question.is_changed
    accept(question)
    assert asked(path) is None
    written(path, PLAIN + "robot: ws://lab:9090\nphrases: [Hello.]\n")
    assert asked(path) is None, "nothing that it names is new"
    written(path, PLAIN + "robot: ws://lab:9090\nassistant: {model: 'openai:gpt'}\n")
    changed = asked(path)
    assert changed is not None
    assert changed.is_changed
    assert [one.text for one in changed.named if one not in changed.known] == ["openai:gpt"]
    assert asked(written(tmp_path / "copy.yaml", PLAIN + "robot: ws://lab:9090\n")) is None, "the same content"
    other = asked(written(tmp_path / "other.yaml", PLAIN + "robot: ws://lab:9090\nphrases: [No.]\n"))
    assert other is not None
    assert not other.is_changed


def test_another_use_of_the_same_address_is_asked(tmp_path: Path) -> None:
    path = written(tmp_path / "s.yaml", PLAIN + "cameras: [{source: 'https://lab.example/v1'}]\n")
    question = asked(path)
    assert question is not None
    accept(question)
    text = "listening: {engine: server, server: 'https://lab.example/v1'}\n"
    changed = asked(written(path, PLAIN + "cameras: [{source: 'https://lab.example/v1'}]\n" + text))
    assert changed is not None
    assert [one.place for one in changed.named if one not in changed.known] == ["listening.server"]


def test_another_model_under_the_same_name_is_asked(tmp_path: Path) -> None:
    model = tmp_path / "mine.onnx"
    model.write_bytes(b"one")
    path = written(tmp_path / "s.yaml", PLAIN + "perception: {model: mine.onnx}\n")
    question = asked(path)
    assert question is not None
    accept(question)
    assert asked(path) is None
    model.write_bytes(b"another")
    assert asked(path) is not None


def test_a_picture_next_to_the_scenario_is_its_own_and_a_link_out_of_there_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "study"
    folder.mkdir()
    monkeypatch.chdir(folder)
    (folder / "film.mp4").write_bytes(b"film")
    assert asked(written(folder / "s.yaml", PLAIN + "cameras: [{source: 'film.mp4?loop'}]\n")) is None
    (tmp_path / "private.mp4").write_bytes(b"film")
    (folder / "link.mp4").symlink_to(tmp_path / "private.mp4")
    (folder / "film.mp4?").mkdir()
    outside = "film.mp4?/../../private.mp4"  # a folder of that name leads out, the film of that name does not
    for source in ("link.mp4", "../private.mp4", str(tmp_path / "private.mp4"), "../study/../private.mp4", outside):
        question = asked(written(folder / "s.yaml", PLAIN + f"cameras: [{{source: '{source}'}}]\n"))
        assert question is not None, source
        assert [(one.kind, one.text) for one in question.named] == [("path", source)]


def test_a_profile_lists_where_it_connects_and_which_variable_it_reads(tmp_path: Path) -> None:
    (tmp_path / "ca.pem").write_text("certificate")
    path = tmp_path / "robot.yaml"
    path.write_text(
        "version: 1\nros: 1\nvelocity: {topic: /cmd_vel}\naddress: ws://evil.example:9090\n"
        "security: {ca_file: ca.pem, rosauth_secret_env: OPENAI_API_KEY}\n"
        "speech: {web: {url: 'http://evil.example/$value', stop: 'http://other.example/'}}\n",
        encoding="utf-8",
    )
    profile = load_profile(str(path))
    with pytest.raises(ConfirmationNeededError) as needed:
        confirmed_files.check_profile(profile, str(path))
    question = needed.value.question
    assert {(one.kind, one.text, one.place) for one in question.named} == {
        ("address", "ws://evil.example:9090", "address"),
        ("path", str(tmp_path / "ca.pem"), "security.ca_file"),
        ("variable", "OPENAI_API_KEY", "security.rosauth_secret_env"),
        ("address", "http://evil.example/$value", "speech.web.url"),
        ("address", "http://other.example/", "speech.web.stop"),
    }
    accept(question)
    confirmed_files.check_profile(profile, str(path))
    (tmp_path / "ca.pem").write_text("another")
    with pytest.raises(ConfirmationNeededError):
        confirmed_files.check_profile(profile, str(path))


def test_shipped_files_need_no_question() -> None:
    for path in layouts_dir().glob("*.yaml"):
        assert asked(path) is None
    for name in ("simulated", "tiago", "turtlebot4"):
        confirmed_files.check_profile(load_profile(name), name)
    confirmed_files.check_profile(load_profile("ws://somewhere:9090?ros=1"), "ws://somewhere:9090?ros=1")


def test_files_written_for_the_user_keep_the_answer(tmp_path: Path) -> None:
    path = written(tmp_path / "s.yaml", PLAIN + "robot: ws://lab:9090\n")
    question = asked(path)
    assert question is not None
    accept(question)
    scenario = load_scenario(path)
    copy = load_scenario(written(tmp_path / "own.yaml", PLAIN + "robot: ws://lab:9090\nnotes: Mine\n"))
    confirmed_files.carry(scenario, copy)
    assert asked(tmp_path / "own.yaml") is None
    more = load_scenario(written(tmp_path / "more.yaml", PLAIN + "robot: ws://elsewhere:9090\n"))
    with pytest.raises(ConfirmationNeededError):
        confirmed_files.carry(scenario, more)


@pytest.mark.logs("what was confirmed of files cannot be read")
@pytest.mark.parametrize("content", ["", "{}", "[]", '{"files": [1]}', '{"files": [{}]}', "[" * 100_000, "\x00"])
def test_a_store_that_cannot_be_read_asks_again(tmp_path: Path, content: str) -> None:
    store = platformdirs.user_config_path("caris-desktop", appauthor=False) / "confirmed-files.json"
    store.parent.mkdir(parents=True, exist_ok=True)
    store.write_text(content)
    question = asked(written(tmp_path / "s.yaml", PLAIN + "robot: ws://lab:9090\n"))
    assert question is not None
    accept(question)
    assert asked(tmp_path / "s.yaml") is None
    assert store.stat().st_mode & 0o077 == 0


def test_nothing_steers_a_terminal_from_a_question(tmp_path: Path) -> None:
    source = json.dumps("https://evil\u202e.example/\x1b]0;x\x07")
    question = asked(written(tmp_path / "s.yaml", PLAIN + f"cameras: [{{source: {source}}}]\n"))
    assert question is not None
    assert question_words(replace(question, title="A\x1b[2J")).replace("\n", "").isprintable()


def test_plug_ins_are_listed_with_their_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = {"trackers": "steady", "detectors": "seeing", "language_models": "wise"}
    for group, name in (*names.items(), ("speech", "loud"), ("speech", "ear"), ("cameras", "eye")):
        install(tmp_path / "packages", group, name, "raise SystemError('imported')", monkeypatch)
    text = "perception: {tracker: steady, model: 'plugin:seeing'}\nassistant: {model: 'plugin:wise'}\n"
    text += "speech: {name: 'plugin:loud'}\nlistening: {model: 'plugin:ear'}\n"
    text += "cameras: [{source: 'plugin:eye:/dev/lidar0'}]\n"
    question = asked(written(tmp_path / "s.yaml", PLAIN + text))
    assert question is not None
    assert {(one.kind, one.text) for one in question.named} == {
        ("plugin", "steady (lab-steady 2.1)"), ("plugin", "seeing (lab-seeing 2.1)"), ("plugin", "wise (lab-wise 2.1)"),
        ("plugin", "loud (lab-loud 2.1)"), ("plugin", "ear (lab-ear 2.1)"),
        ("plugin", "eye (lab-eye 2.1)"), ("path", "/dev/lidar0"),
    }  # fmt: skip
    assert "code of others" in question_words(question)
    assert asked(written(tmp_path / "own.yaml", PLAIN + "perception: {tracker: botsort}\n")) is None


@pytest.mark.parametrize("named", ["pipe", "films", "/dev/zero", "/proc/self/pagemap"])
def test_a_question_needs_no_file_without_end(tmp_path: Path, named: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "films").mkdir()
    with (tmp_path / "films" / "one.onnx").open("wb") as film:
        film.truncate(1 << 40)
    target = str(tmp_path / named)
    question = asked(written(tmp_path / "s.yaml", f"{PLAIN}robot: {target}\nperception: {{model: {target}}}\n"))
    assert question is not None
    assert [one.text for one in question.named] == [target, target]
