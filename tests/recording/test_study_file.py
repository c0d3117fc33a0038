"""Study file: checked with its lines, and used by archive, methods sheet and citation."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml
from rocrate.rocrate import ROCrate

from caris_desktop.app import command_table
from caris_desktop.recording.session.manifest import verify_manifest
from caris_desktop.recording.session_export import ExportContext, ExportRequest, export_all, export_session
from caris_desktop.recording.study_file import FILE_NAME, StudyFileError, read_study_file
from tests.recording.told_session import heard, tell

STUDY = """\
title: Politeness of a tour guide robot
description: Visitors met a robot.
authors:
  - name: Josiah Carberry
    orcid: https://orcid.org/0000-0002-1825-0097
    affiliation: Brown University
  - {name: "van der Berg, Anna", affiliation: Brown University}
licence: CC-BY-4.0
keywords: [robots, "politeness: a study"]
funding: [Example Foundation 12345]
doi: 10.5281/zenodo.1234567
"""
CITATION = (
    "Carberry, Josiah & van der Berg, Anna (2026). Politeness of a tour guide robot [Data set]. "
    "https://doi.org/10.5281/zenodo.1234567"
)


@pytest.fixture
def session(tmp_path: Path) -> Path:
    folder = tell(tmp_path / "study" / "sessions" / "one", heard(1, 2.0, 3.0, "Hi"), lasts_s=9.0)
    (tmp_path / "study" / FILE_NAME).write_text(STUDY)
    return folder


@pytest.mark.parametrize(
    "mistake",
    [
        (1, "titel: Politeness", "line 1: unknown key 'titel'"),
        (
            5,
            "    orcid: 0000-0002-1825-0098",
            "line 5: 'authors[1].orcid' is '0000-0002-1825-0098', which is not an ORCID iD",
        ),
        (
            5,
            "    orcid: 0000-0002-1825",
            "line 5: 'authors[1].orcid' is '0000-0002-1825'. Allowed: an ORCID iD such as",
        ),
        (8, "licence: CC-BY-9", "line 8: 'licence' is 'CC-BY-9'. Allowed: an SPDX identifier"),
        (11, "doi: https://doi.org/10.1", "line 11: 'doi' is 'https://doi.org/10.1'. Allowed: a DOI such as"),
        (9, "keywords: robots", "line 9: 'keywords' must be a list"),
        (9, "keywords: [robots", "line 1"),
        (4, "  - nam: Josiah Carberry", "line 4: "),
    ],
)
def test_a_mistake_is_refused_with_file_and_line(
    session: Path, tmp_path: Path, mistake: tuple[int, str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    line, now, told = mistake
    path = session.parents[1] / FILE_NAME
    lines = STUDY.splitlines()
    lines[line - 1] = now
    path.write_text("\n".join(lines))
    with pytest.raises(StudyFileError) as error:
        read_study_file(path)
    assert f"{path}, line" in str(error.value)
    assert told in str(error.value)
    assert command_table.run(["export", str(session), "--to", "rocrate", str(tmp_path / "out")]) == 1
    assert command_table.run(["anonymise", str(session), "--out", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err.count(f"{path}, line") >= 2
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("orcid", ["0000-0002-1825-0097", "0000-0001-5109-3700", "0000-0002-1694-233X"])
def test_checksums_of_orcid(tmp_path: Path, orcid: str) -> None:
    (tmp_path / FILE_NAME).write_text(f"title: T\nauthors: [{{name: A B, orcid: {orcid}}}]\n")
    assert read_study_file(tmp_path / FILE_NAME).authors[0].orcid_url == f"https://orcid.org/{orcid}"


def test_the_archive_has_authors_licence_and_doi(session: Path, tmp_path: Path) -> None:
    export_session(session, "rocrate", tmp_path / "out")
    crate = ROCrate(tmp_path / "out")
    root = crate.root_dataset
    assert [(author.id, author["name"], author["affiliation"]["name"]) for author in root["author"]] == [
        ("https://orcid.org/0000-0002-1825-0097", "Josiah Carberry", "Brown University"),
        ("#author-2", "van der Berg, Anna", "Brown University"),
    ]
    assert root["license"].id == "https://creativecommons.org/licenses/by/4.0/"
    assert root["identifier"] == "https://doi.org/10.5281/zenodo.1234567"
    assert root["creditText"] == CITATION
    assert root["keywords"] == "robots, politeness: a study"
    assert root["funding"][0]["name"] == "Example Foundation 12345"
    assert root["description"].startswith("Visitors met a robot.")
    assert {entity["name"] for entity in crate.get_by_type("File")} >= {"CITATION.cff"}
    graph = json.loads((tmp_path / "out" / "ro-crate-metadata.json").read_text())["@graph"]
    ids = [entity["@id"] for entity in graph]
    assert len(ids) == len(set(ids))
    assert all(reference in ids or reference.startswith("http") for reference in references(graph))


def references(value: Any) -> list[str]:
    if isinstance(value, dict) and set(value) == {"@id"}:
        return [value["@id"]]
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return [one for part in parts for one in references(part)]


def test_a_chosen_licence_precedes(session: Path, tmp_path: Path) -> None:
    export_session(session, "rocrate", tmp_path / "out", ExportContext(licence="CC0-1.0"))
    assert ROCrate(tmp_path / "out").root_dataset["license"]["identifier"] == "CC0-1.0"


def test_a_citation_file_lies_beside_the_export(session: Path, tmp_path: Path) -> None:
    for fmt in ("rocrate", "methods"):
        export_session(session, fmt, tmp_path / fmt)
        citation = yaml.safe_load((tmp_path / fmt / "CITATION.cff").read_text())
        assert citation["authors"] == [
            {
                "family-names": "Carberry", "given-names": "Josiah", "affiliation": "Brown University",
                "orcid": "https://orcid.org/0000-0002-1825-0097",
            },
            {"family-names": "van der Berg", "given-names": "Anna", "affiliation": "Brown University"},
        ]  # fmt: skip
        assert (citation["cff-version"], citation["type"]) == ("1.2.0", "dataset")
        assert (citation["license"], citation["doi"]) == ("CC-BY-4.0", "10.5281/zenodo.1234567")


def test_the_methods_sheet_describes_the_study(session: Path, tmp_path: Path) -> None:
    shutil.copytree(session, session.with_name("two"))
    request = ExportRequest((session, session.with_name("two")), ("methods",), tmp_path / "out")
    assert export_all(request).problems == ()
    sheet = (tmp_path / "out" / "methods" / "methods.md").read_text()
    told = sheet.replace("\\", "")
    assert "## Study" in sheet
    assert "Politeness of a tour guide robot [Data set]." in told
    assert "Visitors met a robot." in told
    assert "Funding: Example Foundation 12345." in told
    assert "orcid.org/0000-0002-1825-0097" in told


def test_an_anonymised_session_brings_the_study_file(session: Path, tmp_path: Path) -> None:
    assert command_table.run(["anonymise", str(session), "--out", str(tmp_path / "one")]) == 0
    assert verify_manifest(tmp_path / "one") == []
    assert command_table.run(["anonymise", str(session.parents[1]), "--out", str(tmp_path / "all")]) == 0
    for number, folder in enumerate((tmp_path / "one", tmp_path / "all" / "one")):
        export_session(folder, "rocrate", tmp_path / f"out-{number}")
        root = ROCrate(tmp_path / f"out-{number}").root_dataset
        assert root["creditText"] == CITATION


def test_without_a_study_file_nothing_is_added(session: Path, tmp_path: Path) -> None:
    (session.parents[1] / FILE_NAME).unlink()
    for fmt in ("rocrate", "methods"):
        export_session(session, fmt, tmp_path / fmt)
        assert not list((tmp_path / fmt).rglob("CITATION*"))
    assert "author" not in ROCrate(tmp_path / "rocrate").root_dataset.properties()
