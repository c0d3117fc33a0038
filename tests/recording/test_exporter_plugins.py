"""Exporters of others: installed as packages, used, and switched off when they fail."""

import sys
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.app.plugin_contracts import check_exporter, record_sample
from caris_desktop.domain.plugins import BUILT_IN, find, load
from caris_desktop.recording import session_export
from caris_desktop.recording.pseudonyms import pseudonyms_of
from caris_desktop.recording.session_export import FORMATS, ExportContext, ExportRequest, all_formats, export_all
from tests.support.plugins import install


def source(body: str, version: int = 1, before: str = "") -> str:
    return f"""
import logging, os, time
from pathlib import Path
{before}

def Plugin(session, out, context):
    {body}

Plugin.caris_interface = {version}
"""


WRITES = "(out / 'a.txt').write_text(session.trial['wizard']); return [out / 'a.txt']"


@pytest.fixture
def session(tmp_path: Path) -> Path:
    folder = tmp_path / "one"
    record_sample(folder, talk=True)
    return folder


def test_the_built_in_formats_are_those_of_the_group() -> None:
    assert [fmt.name for fmt in FORMATS] == list(BUILT_IN["exporters"])
    assert list(all_formats()) == list(BUILT_IN["exporters"])


@pytest.mark.parametrize("name", [fmt.name for fmt in FORMATS])
def test_a_built_in_exporter_keeps_the_contract(name: str) -> None:
    written = load(find("exporters", name))

    def export(session: Any, out: Path, context: ExportContext) -> list[Path]:
        paths: list[Path] = written([session] if all_formats()[name].together else session, out, context)
        return paths

    export.caris_interface = 1  # type: ignore[attr-defined]
    check_exporter(export)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("return []", "did not return the files"),
        ("(out / 'a').touch(); return None", "did not return the files"),
        ("(out / 'a').touch(); return [out / 'b']", "did not return the files"),
        ("(out / 'a').touch(); print('hello'); return [out / 'a']", "prints"),
        ("(out / 'a').touch(); context.progress(7.0); return [out / 'a']", "between 0 and 1"),
        ("(out / 'a').touch(); (session.folder / 'a').touch(); return [out / 'a']", "nothing into the folder"),
    ],
)
def test_the_contract_refuses(body: str, message: str) -> None:
    made: dict[str, Any] = {}
    exec(source(body), made)  # noqa: S102 - of this test
    with pytest.raises(AssertionError, match=message):
        check_exporter(made["Plugin"])


def test_one_exports_with_the_pseudonyms_that_were_asked_for(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path / "packages", "exporters", "lab", source(f"context.warn('so so'); {WRITES}"), monkeypatch)
    finished = export_all(ExportRequest((session,), ("lab", "vtt"), tmp_path / "out"))
    assert finished.problems == ("one: lab: so so",)
    assert (tmp_path / "out" / "one" / "lab" / "a.txt").read_text() == pseudonyms_of([session]).wizard("Ada") == "W1"
    export_all(ExportRequest((session,), ("lab",), tmp_path / "named", with_names=True))
    assert (tmp_path / "named" / "one" / "a.txt").read_text() == "Ada"
    assert "lab_lab" not in sys.modules, "this process does not run it"


@pytest.mark.logs("the plug-in lab of lab-lab failed", "what the plug-in lab sent", "nearly")
@pytest.mark.long("*it printed*", "*ModuleNotFoundError*")
@pytest.mark.parametrize(
    ("module", "reason"),
    [
        (source("raise ValueError('no idea')"), "it raised ValueError: no idea"),
        (source(f"print('x' + chr(27)); {WRITES}"), "it printed “x\\x1b”"),
        (source("return [out / 'a']"), "it did not return the files that it wrote"),
        (source("os._exit(3)"), "it ended its process"),
        (source("logging.warning('nearly'); time.sleep(3600)"), "it did not return within 2 s"),
        (source(WRITES, version=9), "it is written for version 9 of the interface, and this program has version 1"),
        (source(WRITES, before="import nothing_of_this_name"), "it raised ModuleNotFoundError: No module named"),
        (source("context.warn(Plugin)"), "it returned something of an unexpected kind"),
    ],
)
def test_one_that_fails_is_named_and_costs_only_itself(
    module: str, reason: str, session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path / "packages", "exporters", "lab", module, monkeypatch)
    monkeypatch.setattr(session_export, "PLUGIN_WITHIN_S", 2.0)
    second = tmp_path / "two"
    record_sample(second, talk=False)
    finished = export_all(ExportRequest((session, second), ("lab", "vtt"), tmp_path / "out"))
    for problem, name in zip(finished.problems, ("one", "two"), strict=True):
        assert problem.startswith(f"{name}: lab: The plug-in lab (lab-lab 2.1) was switched off: {reason}")
    for folder in ("one", "two"):
        assert [path.name for path in (tmp_path / "out" / folder).iterdir()] == ["vtt"]


def test_a_disk_that_fails_is_not_the_fault_of_the_plug_in(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = f"""
    if session.folder.name == 'one':
        raise PermissionError(13, 'the archive is read-only')
    {WRITES}
"""
    install(tmp_path / "packages", "exporters", "lab", source(body.strip()), monkeypatch)
    second = tmp_path / "two"
    record_sample(second, talk=False)
    finished = export_all(ExportRequest((session, second), ("lab",), tmp_path / "out"))
    (problem,) = finished.problems
    assert "the archive is read-only" in problem and "switched off" not in problem
    assert finished.written == (tmp_path / "out" / "two",)
