"""Mutated foreign files: no program run, no other file written, no connection, and no terminal control sequence."""

import io
import json
import logging
import os
import random
import socket
import struct
import subprocess
import sys
import threading
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

import pytest

from caris_desktop.app import command_table, composition, console_command
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.foreign_text import parse_json, printable
from caris_desktop.live.confirmed_files import ConfirmationNeededError, scenario_references
from caris_desktop.live.logs import configure_logging
from caris_desktop.recording.session import events_file
from caris_desktop.recording.session.events_file import CHUNK, CHUNK_BODY, record
from caris_desktop.robot.profile import user_robots_dir
from caris_desktop.scenario.bundle import Bundle, BundledFile, BundleError, read_bundle, unpack, write_bundle
from tests.app.test_mutated_files import mutated
from tests.live.test_confirmed_files import HOSTILE

pytestmark = pytest.mark.logs("")
SEEDS = 200


def nothing(*_args: object, **_more: object) -> NoReturn:
    raise AssertionError("something outside was run or connected to")


@pytest.fixture(autouse=True)
def nothing_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    for place, name in ((os, "system"), (os, "kill"), (subprocess, "Popen"), (socket.socket, "connect")):
        monkeypatch.setattr(place, name, nothing)
    monkeypatch.setattr(socket, "getaddrinfo", nothing)


def test_no_mutation_of_a_scenario_gets_past_the_question(tmp_path: Path) -> None:
    path = tmp_path / "shared.yaml"
    asked = 0
    for seed in range(SEEDS):
        chance = random.Random(seed)  # noqa: S311 - a test, not cryptography
        path.write_bytes(mutated(HOSTILE.encode(), chance))
        try:
            scenario = composition._load_scenario(path)
        except ConfirmationNeededError as needed:
            asked += 1
            assert needed.question.named
        except UserFacingError:
            continue  # refused with a message
        else:
            assert scenario_references(scenario) == ()
    assert asked > SEEDS // 10
    assert [one.name for one in tmp_path.iterdir()] == ["shared.yaml"]


@pytest.mark.parametrize("text", ["~no.such.user/x.onnx", '"a\\0b.yaml"', '"a\\ud800b.yaml"'])
@pytest.mark.parametrize("key", ["perception: {model: TEXT}", "listening: {model: TEXT}", "robot: TEXT", "title: TEXT"])
def test_a_text_that_is_no_path_is_refused_and_does_not_end_the_program(tmp_path: Path, key: str, text: str) -> None:
    path = tmp_path / "shared.yaml"
    path.write_text(f"version: 1\nlayout: {{panel: video}}\n{key.replace('TEXT', text)}\n")
    if "title" not in key:
        path.write_text(f"{path.read_text()}title: Shared\n")
    if "title" in key and "~" in text:
        assert composition._load_scenario(path).title == text
    else:
        with pytest.raises(UserFacingError):
            composition._load_scenario(path)


def _bundle(tmp_path: Path) -> bytes:
    path = tmp_path / "whole.caris"
    robot = BundledFile("robot", "lab", "version: 1\nros: 1\nvelocity: {topic: /cmd_vel}\n")
    write_bundle(
        Bundle(BundledFile("scenario", "shared", HOSTILE.replace("ws://evil.example:9090", "lab")), (robot,)), path
    )
    content = path.read_bytes()
    path.unlink()
    return content


def _rezipped(content: bytes, change: Callable[[str, bytes], tuple[str, bytes]]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        for entry in old.infolist():
            new.writestr(*change(entry.filename, old.read(entry)))
    return out.getvalue()


@pytest.mark.parametrize(
    "name", ["../evil", "/etc/evil", "scenario/../../evil", "robot/evil.yaml/x", "scenario/\x1b.yaml"]
)
def test_no_name_in_a_bundle_leads_out_of_it(tmp_path: Path, name: str) -> None:
    path = tmp_path / "b.caris"
    path.write_bytes(_rezipped(_bundle(tmp_path), lambda old, data: (name if old.startswith("robot") else old, data)))
    with pytest.raises(BundleError):
        read_bundle(path)


def test_a_text_of_others_adds_no_line_to_the_log_and_does_not_control_the_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)
    monkeypatch.setattr(logging, "raiseExceptions", logging.raiseExceptions)
    monkeypatch.setenv("CARIS_LOG_FILE", "")
    handlers, level = logging.root.handlers[:], logging.root.level
    try:
        configure_logging(tmp_path / "console.log")
        try:
            raise ValueError("\x1b[2J\x9b31m in an error")  # noqa: TRY301 - as of a library
        except ValueError:
            logging.getLogger("t").warning("robot says: %s", "\x1b]0;x\x07\n2026-01-01 CRITICAL \udcff", exc_info=True)
    finally:
        for handler in logging.root.handlers:
            handler.close()
        logging.root.handlers[:] = handlers
        logging.root.setLevel(level)
    for text in (capfd.readouterr().err, (tmp_path / "console.log").read_text("utf-8")):
        assert text.replace("\n", "").isprintable()
        assert [line for line in text.splitlines() if line.startswith("2026-01-01")] == []
        assert "ValueError" in text


@pytest.mark.parametrize("about", ["[" * 100_000, '{"a":' * 50_000, "", "null", "9" * 5000, "\x00", '{"format": []}'])
def test_an_about_that_is_none_is_reported(tmp_path: Path, about: str) -> None:
    path = tmp_path / "b.caris"
    path.write_bytes(
        _rezipped(_bundle(tmp_path), lambda old, data: (old, about.encode() if old == "about.json" else data))
    )
    with pytest.raises(BundleError):
        read_bundle(path)


def test_no_mutation_of_a_bundle_writes_elsewhere(tmp_path: Path) -> None:
    whole, path = _bundle(tmp_path), tmp_path / "b.caris"
    home = tmp_path / "home"
    for seed in range(SEEDS):
        chance = random.Random(seed)  # noqa: S311 - a test, not cryptography
        content = bytearray(whole)
        for _ in range(chance.choice((1, 1, 3, 20))):
            content[chance.randrange(len(content))] = chance.randrange(256)
        path.write_bytes(bytes(content[: len(content) if seed % 5 else chance.randrange(len(content))]))
        try:
            unpack(
                read_bundle(path),
                {"scenario": home / "scenarios", "robot": home / "robots", "face": home / "faces"},
                lambda _kind, _name: None,
            )
        except BundleError:
            continue
        finally:
            for one in sorted(home.rglob("*.yaml")):
                assert one.parent.name in ("scenarios", "robots", "faces")
                one.unlink()
        assert {one.name for one in tmp_path.iterdir()} <= {"b.caris", "home"}


@pytest.mark.parametrize("size_bytes", [1 << 30, (1 << 28) + 1, 1 << 62])
@pytest.mark.parametrize("compression", [b"", b"zstd", b"lz4"])
def test_a_block_that_would_take_a_gigabyte_is_refused_before_it_does(size_bytes: int, compression: bytes) -> None:
    body = (
        CHUNK_BODY.pack(0, 0, size_bytes, 0, len(compression))
        + compression
        + struct.pack("<Q", 4)
        + b"\x28\xb5\x2f\xfd"
    )
    with pytest.raises(events_file.DamagedBlockError):
        events_file.decompress(record(CHUNK, body))


def test_json_without_end_is_wrong_and_not_the_end() -> None:
    for text in ("[" * 1_000_000, '{"a":' * 500_000, "[1, 2", ""):
        with pytest.raises(ValueError):
            parse_json(text)
    assert parse_json('{"a": [1]}') == {"a": [1]}


def test_a_terminal_obeys_nothing_that_a_file_says(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    title = "Lab\x1b]0;owned\x07\x1b[2J\x9b31m\u202egnp.exe\r"
    user_robots_dir().mkdir(parents=True, exist_ok=True)
    profile = f"version: 1\nros: 1\nvelocity: {{topic: /cmd_vel}}\ntitle: {json.dumps(title)}\n"
    (user_robots_dir() / "lab.yaml").write_text(profile, encoding="utf-8")
    assert command_table.run(["robots"]) == 0
    assert command_table.run(["robots", "--listen", "no\x1b[2Jsuch"]) == 1
    monkeypatch.setattr(console_command, "configure_logging", lambda *_args, **_more: None)
    scenario = tmp_path / "shared.yaml"
    scenario.write_text('version: 1\n"\\e[2J": 1\n', encoding="utf-8")
    assert command_table.run(["--scenario", str(scenario), "--study", str(tmp_path / "study")]) == 2
    for words in ((file := "a\x1b]0;owned\x07\u202e.mp4",), ("export", "a", "b", file), ("track", "--threads", file)):
        with suppress(SystemExit):
            assert command_table.run(words) == 2
    shown = "".join(capsys.readouterr())
    assert "Lab\\x1b]0;owned" in shown
    assert shown.replace("\n", "").isprintable()
    assert printable("Größe: 5 µm — “ok”") == "Größe: 5 µm — “ok”"
