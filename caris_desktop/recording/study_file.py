"""Study file ``study.yaml``: title, authors, licence and DOI of a study, for archives, methods sheet and citations."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from caris_desktop.domain.schema_fields import Problem, name_of, value_from
from caris_desktop.domain.schema_validation import problem_lines, problems, quoted
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value, setting
from caris_desktop.domain.yaml_files import YamlSourceError, parse_yaml, yaml_text
from caris_desktop.recording.session.session_header import SessionError, reading

FILE_NAME, CITATION_NAME = "study.yaml", "CITATION.cff"
_MAX_BYTES = 256 * 1024


class Author(Value):
    """One author of the study."""

    name: str = setting(shortest=1, longest=200, pattern=r"\S", allowed="text that is not blank.")
    """As in publications: given name first, or the family name, a comma and the given name."""
    orcid: str = setting(
        default="",
        quiet=True,
        pattern=r"^(https://orcid\.org/)?\d{4}-\d{4}-\d{4}-\d{3}[\dX]$",
        allowed="an ORCID iD such as 0000-0002-1825-0097.",
    )
    """ORCID iD. Its last character is a checksum, which is verified."""
    affiliation: str = setting(default="", quiet=True, longest=300)
    """University or institute."""

    @property
    def orcid_url(self) -> str:
        """Address of the ORCID iD; empty without one."""
        return f"https://orcid.org/{self.orcid[-19:]}" if self.orcid else ""

    @property
    def names(self) -> tuple[str, str]:
        """Family and given names; without a comma, the last word is the family name."""
        family, comma, given = self.name.partition(",")
        if not comma:
            given, _, family = self.name.strip().rpartition(" ")
        return family.strip(), given.strip()


class StudyFile(Value):
    """What a study is called, who made it, and how its data may be used."""

    title: str = setting(shortest=1, longest=300, pattern=r"\S", allowed="text that is not blank.")
    """Title of the data set."""
    format_version: Literal[1] = 1
    """The version of this format."""
    description: str = setting(default="", quiet=True, longest=5000)
    """Abstract: question, participants, procedure."""
    authors: tuple[Author, ...] = setting(default=(), quiet=True)
    """Authors, in the order of a citation. Exports name them, unlike wizards and coders."""
    licence: str = setting(default="", quiet=True, longest=200)
    """SPDX identifier of the licence, for example `CC-BY-4.0`. `--licence` precedes it."""
    keywords: tuple[str, ...] = setting(default=(), quiet=True)
    """Keywords for the search in an archive."""
    funding: tuple[str, ...] = setting(default=(), quiet=True)
    """Funders with the number of the grant."""
    doi: str = setting(
        default="", quiet=True, pattern=r"^10\.\d{4,9}/\S+$", allowed="a DOI such as 10.5281/zenodo.1234567."
    )
    """DOI of the data set, as reserved by the archive."""

    @property
    def doi_url(self) -> str:
        return f"https://doi.org/{self.doi}" if self.doi else ""

    def citation(self, year: int) -> str:
        """Citation of the data set in one sentence."""
        authors = [f"{family}, {given}" if given else family for family, given in (each.names for each in self.authors)]
        by = " & ".join(filter(None, ("; ".join(authors[:-1]), *authors[-1:])))
        text = f"{by} ({year}). {self.title} [Data set]." if by else f"{self.title} ({year}) [Data set]."
        return f"{text} {self.doi_url}".rstrip()


class StudyFileError(SessionError):
    """Study file with a mistake; the text names file, line and what is allowed."""


def study_file_of(session_folder: Path) -> Path | None:
    """Study file of a session: in its study, in the folder of sessions, or in its own folder."""
    folder = session_folder.absolute()
    places = [folder, folder.parent, *([folder.parent.parent] if folder.parent.name == "sessions" else [])]
    return next((path for place in places if (path := place / FILE_NAME).is_file()), None)


def study_of(session_folder: Path) -> StudyFile | None:
    """Study file of a session; None if there is none. Raises StudyFileError."""
    path = study_file_of(session_folder)
    return None if path is None else read_study_file(path)


def read_study_file(path: Path) -> StudyFile:
    """Read and check a study file. Raises StudyFileError."""
    with reading(path, StudyFileError), path.open("rb") as file:
        raw = file.read(_MAX_BYTES + 1)
    if len(raw) > _MAX_BYTES:
        raise StudyFileError(QT_TR_NOOP("{path} is too large for a study file."), path=path)
    try:
        source = parse_yaml(raw.decode("utf-8-sig"))
    except YamlSourceError as error:
        raise StudyFileError("{path}, line {line}: {error}", path=path, line=error.line, error=error) from error
    except UnicodeDecodeError as error:
        raise StudyFileError(QT_TR_NOOP("{path} is not UTF-8 text."), path=path) from error
    found = list(problems(StudyFile, source.data)) or list(_meaning_problems(source.data))
    if found:
        raise StudyFileError("{problems}", problems=problem_lines(str(path), source, found))
    study: StudyFile = value_from(StudyFile, source.data)
    return study


def _meaning_problems(data: dict[str, Any]) -> Iterator[Problem]:
    """Mistakes that a schema cannot express."""
    for number, author in enumerate(data.get("authors", ())):
        if (orcid := author.get("orcid")) and not _orcid_is_valid(orcid):
            place = ("authors", number, "orcid")
            text = tr("{key} is {value}, which is not an ORCID iD: its last character does not match.")
            yield place, text.format(key=name_of(place), value=quoted(orcid))
    if licence := data.get("licence"):
        from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression

        try:
            canonicalize_license_expression(licence)
        except InvalidLicenseExpression:
            text = tr("{key} is {value}. Allowed: an SPDX identifier (https://spdx.org/licenses).")
            yield ("licence",), text.format(key=name_of(("licence",)), value=quoted(licence))


def _orcid_is_valid(orcid: str) -> bool:
    """Checksum of ISO 7064, mod 11-2 (https://support.orcid.org/hc/en-us/articles/360006897674)."""
    digits = orcid[-19:].replace("-", "")
    total = 0
    for digit in digits[:-1]:
        total = (total + int(digit)) * 2
    return digits[-1] == "0123456789X"[(12 - total % 11) % 11]


def write_citation(folder: Path, study: StudyFile) -> Path:
    """Write ``CITATION.cff`` (https://citation-file-format.github.io, 1.2.0) into ``folder``. Raises OSError."""
    authors = []
    for author in study.authors:
        family, given = author.names
        names = {"family-names": family, "given-names": given} if given else {"name": family}
        authors.append(names | _given({"affiliation": author.affiliation, "orcid": author.orcid_url}))
    content = {
        "cff-version": "1.2.0",
        "message": "If you use these data, please cite them as below.",
        "type": "dataset",
        "title": study.title,
        **_given({"abstract": study.description}),
        "authors": authors or [{"name": "The authors of the study"}],
        **_given({"license": study.licence, "doi": study.doi, "keywords": list(study.keywords)}),
    }
    path = folder / CITATION_NAME
    path.write_text(yaml_text(content), encoding="utf-8")
    return path


def _given(fields: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if value}
