"""RO-Crate export: a session's files with metadata for archives, readable by people and programs.

https://www.researchobject.org/ro-crate/specification/1.1/. The ``rocrate`` package reads the result in tests. Its
writer is not used: it copies files unchanged, where these are checked and pseudonymised, and it would list each file
twice, for three more dependencies.
"""

import json
import re
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from fnmatch import fnmatch
from pathlib import Path
from typing import Any
from urllib.parse import quote

from caris_desktop import __version__
from caris_desktop.domain.foxglove import INFINITE, INVALID
from caris_desktop.domain.json_encoding import TRANSFORMS_TOPIC, schema_of
from caris_desktop.domain.schema import to_jsonable
from caris_desktop.domain.streams import BY_NAME, spec_of_topic
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.anonymising.pseudonymous_copy import CopiedFile, copy_session
from caris_desktop.recording.data_dictionary import DICTIONARY_TABLE, dictionary_columns
from caris_desktop.recording.exporters.templates import write_page
from caris_desktop.recording.session.events_file import read_index
from caris_desktop.recording.session.manifest import MANIFEST_NAME, digest_of
from caris_desktop.recording.session.session_header import SessionError
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.recording.study_file import CITATION_NAME, StudyFile, write_citation
from caris_desktop.recording.tables.catalog import tables_of

_PROFILE = "https://w3id.org/ro/crate/1.1"
_MCAP, _MCAP_URL = "application/x-mcap", "https://mcap.dev/spec"
_ENCODINGS: dict[str, str] = {
    ".json": "application/json", ".csv": "text/csv", ".txt": "text/plain", ".md": "text/markdown",
    ".mp4": "video/mp4", ".wav": "audio/wav", ".flac": "audio/flac", ".png": "image/png", ".mcap": _MCAP,
    ".yaml": "application/yaml", ".cff": "application/yaml", ".html": "text/html",
}  # fmt: skip
# The first matching pattern describes a file of the session.
_DESCRIPTIONS = (
    ("recovered/*", "File of a recording that was cut off, before its repair."),
    ("session.json", "Session header: time, people (pseudonyms), scenario, software, clock, files."),
    (
        "events.mcap",
        "Every event and every value of the robot's streams, with timestamps. FORMAT.md describes the format.",
    ),
    ("*.frames.csv", "Arrival time, capture time and position in the video of each frame of the video with this name."),
    ("video-*", "Video of one camera; the .frames.csv file next to it contains the true time of each frame."),
    ("audio-*", "Audio of one source. The audio stream of events.mcap contains the time of each sample."),
    ("movement.txt", "Readable log of how the robot was driven."),
    ("speech.txt", "Readable log of the conversation: speaker, text and time."),
    ("people.json", "Times at which each person (opaque ids) was seen."),
    ("photos/*", "A photo that the wizard took."),
    ("llm/*", "One exchange with a language model: prompt, parameters, answer."),
    ("annotations/*", "Annotations of one coder."),
    (MANIFEST_NAME, "SHA-256 checksums of all files when the session was closed, in sha256sum format."),
)
_SCRUBBED = (
    "In this copy, pseudonyms replace the names of the wizard and coders, and the robot profile replaces the "
    "robot's address."
)
_RENEWED = "Of files that are not as they were recorded it has the checksums of these copies."
_LICENCE_PAGES = {
    "CC0-1.0": "https://creativecommons.org/publicdomain/zero/1.0/",
    "CC-BY-4.0": "https://creativecommons.org/licenses/by/4.0/",
    "CC-BY-SA-4.0": "https://creativecommons.org/licenses/by-sa/4.0/",
    "CC-BY-NC-4.0": "https://creativecommons.org/licenses/by-nc/4.0/",
    "CC-BY-NC-SA-4.0": "https://creativecommons.org/licenses/by-nc-sa/4.0/",
    "CC-BY-ND-4.0": "https://creativecommons.org/licenses/by-nd/4.0/",
    "CC-BY-NC-ND-4.0": "https://creativecommons.org/licenses/by-nc-nd/4.0/",
}
# Answers of the start dialog that belong in an archive; the wizard's name does not.
_TOLD_OF_TRIAL = ("study", "condition", "trial", "recording", "purpose")
_UNNAMED = re.compile(r"Person \d+|")

_OWN_NAMES = (
    "schemas", "FORMAT.md", "data_dictionary.csv", "ro-crate-metadata.json", "ro-crate-preview.html", CITATION_NAME,
)  # fmt: skip

Entity = dict[str, Any]


class _Packed(Value):
    """One file of the crate, by its path in it; ``unlike_manifest``: changed since the session closed."""

    name: str
    size_bytes: int
    sha256: str
    description: str
    unlike_manifest: bool = False


def write_rocrate(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Fill the folder ``out`` with copies and metadata, pseudonymised if the session is.

    Raises OSError; SessionError if the session holds names of people.
    """
    _refuse_names(session)
    _warn_of_paths(session, context.warn)
    folder = out / _folder_name(session)
    folder.mkdir()
    copied = [
        _Packed(f"{folder.name}/{file.name}", file.size_bytes, file.sha256, _description(file), file.unlike_manifest)
        for file in copy_session(session, folder, context.warn, context.progress)
    ]
    packed = [*copied, *_packed_descriptions(session, out, context)]
    graph = _graph(session, packed, licence_of(context.licence), context.study)
    metadata = out / "ro-crate-metadata.json"
    document = {"@context": [f"{_PROFILE}/context", {"sha256": "http://schema.org/sha256"}], "@graph": graph}
    metadata.write_text(json.dumps(document, indent=2, ensure_ascii=False) + "\n", encoding="utf-8", errors="replace")
    preview = write_page(out / "ro-crate-preview.html", "rocrate.html.j2", crate=_preview(graph, packed))
    context.progress(1.0)
    return [metadata, preview, *(out / file.name for file in packed)]


def _folder_name(session: Session) -> str:
    name = session.folder.absolute().name or "session"
    return f"session-{name}" if name in _OWN_NAMES else name


def licence_of(chosen: str) -> Entity:
    """Contextual entity of a licence: an SPDX identifier, an address, free text, or none."""
    chosen = chosen.strip()
    if not chosen:
        return {
            "@id": "#no-licence",
            "@type": "CreativeWork",
            "name": "No licence was chosen",
            "description": (
                "These data may be used only as the law permits without a licence. Ask their authors for permission."
            ),
        }
    if re.match(r"https?://\S+$", chosen):
        return {"@id": chosen, "@type": "CreativeWork", "name": chosen, "url": chosen}
    if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9.+-]*", chosen):
        address = _LICENCE_PAGES.get(chosen, f"https://spdx.org/licenses/{chosen}")
        return {"@id": address, "@type": "CreativeWork", "name": chosen, "identifier": chosen, "url": address}
    return {"@id": "#licence", "@type": "CreativeWork", "name": chosen, "description": chosen}


def _refuse_names(session: Session) -> None:
    """Raise SessionError if the recording holds names of people, which belong in the study's database only."""
    for _, status in session.values("status"):
        rows = status.content if status.name == "persons" and isinstance(status.content, list) else []
        for row in rows:
            if isinstance(row, dict) and not _UNNAMED.fullmatch(str(row.get("name") or "")):
                raise SessionError(
                    QT_TR_NOOP(
                        "{name} contains names of people (in the stream 'status'), which must not leave "
                        "the study. Nothing was written."
                    ),
                    name=session.folder.name,
                )


_PATHS = re.compile(r"/(?:home|Users|root)/|[A-Za-z]:\\Users\\")


def _warn_of_paths(session: Session, warn: Callable[[str], None]) -> None:
    """Warn about paths of this computer; the recording itself is not rewritten."""
    private_paths = (str(Path.home()), str(session.folder.absolute().parent))
    count = 0
    for _, value in session.values("event/problem", "status"):
        text = "\n".join(_texts(to_jsonable(value)))
        count += bool(_PATHS.search(text)) or any(path in text for path in private_paths)
    if count:
        warn(
            QT_TR_NOOP(
                "%n message(s) in events.mcap contain folder names of the recording computer, which may "
                "reveal who used it. They are in the archive as recorded.",
                "",
                count,
            )
        )


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, (list, dict)):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _texts(item)


# Files


def _description(file: CopiedFile) -> str:
    description = next((text for pattern, text in _DESCRIPTIONS if fnmatch(file.name, pattern)), "Part of the session.")
    return f"{description} {_RENEWED if file.name == MANIFEST_NAME else _SCRUBBED}" if file.changed else description


def _packed_descriptions(session: Session, out: Path, context: ExportContext) -> list[_Packed]:
    """Instructions for reading the recording without this program."""
    channels = list(read_index(session.folder / "events.mcap").channels.values())
    recorded = {spec.name: channel for channel in channels if (spec := spec_of_topic(channel.topic)) is not None}
    specs = [spec for spec in BY_NAME.values() if spec.name in recorded]
    schemas = {spec.name: recorded[spec.name].json_schema or schema_of(spec)[1] for spec in specs}
    schemas |= {its.topic[1:]: its.json_schema or {} for its in channels if its.topic == TRANSFORMS_TOPIC}
    (out / "schemas").mkdir()
    written = {"FORMAT.md": "Description of the format of events.mcap and the other files."}
    write_page(
        out / "FORMAT.md", "rocrate_format.md.j2", session=session, name=_folder_name(session), topics=specs,
        meanings={spec.name: " ".join((spec.value_type.__doc__ or "").replace("``", "`").split()) for spec in specs},
        mcap_url=_MCAP_URL, manifest=MANIFEST_NAME, infinite=INFINITE, invalid=INVALID,
    )  # fmt: skip
    with (out / "data_dictionary.csv").open("w", encoding=context.csv.encoding, newline="") as file:
        rows = context.csv.writer(file)
        rows.writerow([column.name for column in DICTIONARY_TABLE.columns])
        tables = [table for spec in specs for table in tables_of(spec)]
        rows.writerows(zip(*dictionary_columns(tables), strict=True))
    written["data_dictionary.csv"] = "Meaning, unit and values of every field of events.mcap and column of tables."
    for stream, schema in schemas.items():
        name = f"schemas/{stream.replace('/', '.')}.schema.json"
        (out / name).write_text(json.dumps(schema, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
        written[name] = f"JSON Schema of the messages on the topic /{stream} in events.mcap."
    if context.study is not None:
        written[write_citation(out, context.study).name] = "How to cite these data, in the Citation File Format."
    return [
        _Packed(name, (out / name).stat().st_size, digest_of(out / name), description)
        for name, description in written.items()
    ]


# Metadata


def _graph(session: Session, packed: list[_Packed], licence: Entity, study: StudyFile | None) -> list[Entity]:
    clock, trial = session.clock, session.trial
    started, ended = clock.utc(session.started_ns), clock.utc(session.ended_ns)
    now = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"
    recorded_by = session.header.program_version or "unknown"
    software = {
        version: {
            "@id": f"#caris-desktop-{quote(version)}",
            "@type": "SoftwareApplication",
            "name": "CARIS Desktop",
            "version": version,
            "softwareVersion": version,
            "description": "Operator console for Wizard-of-Oz studies with mobile robots.",
        }
        for version in dict.fromkeys((recorded_by, __version__))
    }
    folder = _folder_name(session)
    folder_id = f"{quote(folder)}/"
    of_session = [file for file in packed if file.name.startswith(f"{folder}/")]
    others = [file for file in packed if file not in of_session]
    properties = [
        {"@id": f"#trial-{name}", "@type": "PropertyValue", "name": name, "value": trial[name]}
        for name in _TOLD_OF_TRIAL
        if trial.get(name)
    ]
    participant = trial.get("participant", "")
    root: Entity = {
        "@id": "./",
        "@type": "Dataset",
        "name": f"Session {folder}" + (f" of the study {trial['study']}" if trial.get("study") else ""),
        "description": _about(session, of_session),
        "datePublished": now,
        "dateCreated": started,
        "temporalCoverage": f"{started}/{ended}",
        "license": {"@id": licence["@id"]},
        "keywords": "human-robot interaction, Wizard of Oz",
        "hasPart": [{"@id": folder_id}, *({"@id": quote(file.name)} for file in others)],
        "mentions": [{"@id": "#recording"}, {"@id": "#packing"}],
    }
    entities: list[Entity] = []
    if study is not None:
        crate_properties, entities = _study_entities(study, int(started[:4]))
        root |= crate_properties
        root["description"] = f"{study.description} {root['description']}".strip()
    if properties:
        root["additionalProperty"] = [{"@id": entity["@id"]} for entity in properties]
        entities += properties
    if participant:
        root["about"] = {"@id": "#participant"}
        entities.append(
            {
                "@id": "#participant",
                "@type": "Person",
                "name": f"Participant {participant}",
                "identifier": participant,
                "description": "A pseudonym. The name is only in the database of the study.",
            }
        )
    recording: Entity = {
        "@id": "#recording",
        "@type": "CreateAction",
        "name": "Recording of the session",
        "startTime": started,
        "endTime": ended,
        "instrument": {"@id": software[recorded_by]["@id"]},
        "result": {"@id": folder_id},
        "actionStatus": {"@id": "http://schema.org/CompletedActionStatus"},
        "description": _ENDINGS.get(session.reason, _CUT_OFF) if session.closed_properly else _CUT_OFF,
    }
    packing: Entity = {
        "@id": "#packing",
        "@type": "CreateAction",
        "name": "Packing of this crate",
        "endTime": now,
        "instrument": {"@id": software[__version__]["@id"]},
        "object": {"@id": folder_id},
        "result": {"@id": "./"},
    }
    return [
        {
            "@id": "ro-crate-metadata.json",
            "@type": "CreativeWork",
            "conformsTo": {"@id": _PROFILE},
            "about": {"@id": "./"},
        },
        root,
        {
            "@id": "ro-crate-preview.html",
            "@type": "CreativeWork",
            "name": "Readable overview of this crate",
            "about": {"@id": "./"},
            "encodingFormat": "text/html",
        },
        {
            "@id": folder_id,
            "@type": "Dataset",
            "name": f"Session {folder}",
            "description": "The session as recorded; FORMAT.md describes the format.",
            "hasPart": [{"@id": quote(file.name)} for file in of_session],
        },
        *(_file(file) for file in packed),
        licence,
        *entities,
        recording,
        packing,
        *software.values(),
        {"@id": _MCAP_URL, "@type": "WebPage", "name": "MCAP format specification", "url": _MCAP_URL},
    ]


def _study_entities(study: StudyFile, year: int) -> tuple[Entity, list[Entity]]:
    """Properties of the crate from the study file, and the entities that they refer to."""
    names = dict.fromkeys(author.affiliation for author in study.authors if author.affiliation)
    institutes = {name: f"#affiliation-{number}" for number, name in enumerate(names, start=1)}
    authors = [
        {
            "@id": author.orcid_url or f"#author-{number}",
            "@type": "Person",
            "name": author.name,
            **({"affiliation": {"@id": institutes[author.affiliation]}} if author.affiliation else {}),
        }
        for number, author in enumerate(study.authors, start=1)
    ]
    grants = [
        {"@id": f"#funding-{number}", "@type": "Grant", "name": text}
        for number, text in enumerate(study.funding, start=1)
    ]
    organisations = [{"@id": place, "@type": "Organization", "name": name} for name, place in institutes.items()]
    properties = {
        "author": [{"@id": author["@id"]} for author in authors],
        "funding": [{"@id": grant["@id"]} for grant in grants],
        "keywords": ", ".join(study.keywords),
        "identifier": study.doi_url,
        "creditText": study.citation(year),
    }
    return {name: value for name, value in properties.items() if value}, [*authors, *organisations, *grants]


def _file(file: _Packed) -> Entity:
    encoding = _ENCODINGS.get(Path(file.name).suffix.lower(), "application/octet-stream")
    description = file.description
    if file.unlike_manifest:
        description += f" It was changed after the session was closed: its checksum differs from {MANIFEST_NAME}."
    return {
        "@id": quote(file.name),
        "@type": "File",
        "name": file.name,
        "description": description,
        "encodingFormat": [_MCAP, {"@id": _MCAP_URL}] if encoding == _MCAP else encoding,
        "contentSize": str(file.size_bytes),
        "sha256": file.sha256,
    }


def _about(session: Session, files: list[_Packed]) -> str:
    title = session.header.scenario.title
    parts = [
        (
            "A recorded session of a Wizard-of-Oz study with a mobile robot: sensor data, driving, speech, and "
            "the behaviour of people in front of the robot."
        ),
        f"Scenario: {title}." if title else "",
        f"It lasted {session.duration_s:.0f} s.",
        "It was imported from another program's bag." if session.header.source else "",
        "The recording was cut off; this copy contains the data that was saved." if not session.closed_properly else "",
        "Files that changed after the session was closed are marked as changed."
        if any(file.unlike_manifest for file in files)
        else "",
        _about_people(session),
        *session.header.repairs,
        *session.losses,
    ]
    return " ".join(part for part in parts if part)


def _about_people(session: Session) -> str:
    if made := session.header.anonymised:
        return (
            f"It is an anonymised copy, made by CARIS Desktop {made.program_version}. Names: {made.names}. Faces: "
            f"{made.faces}. Voices: {made.voices}."
        )
    if session.pseudonymised:
        return (
            "Pseudonyms replace the names of the wizard and coders, and the robot profile replaces the robot's "
            "address. Everything else is as recorded."
        )
    return ""


_ENDINGS = {
    "wizard": "The wizard ended it.",
    "console_closed": "It ended when the program was closed.",
    "disk_full": "It ended because the disk was full.",
    "imported": "It was imported from another program's bag.",
}
_CUT_OFF = "It was cut off."


def _preview(graph: list[Entity], packed: list[_Packed]) -> dict[str, Any]:
    """Content of the preview page."""
    entities = {entity["@id"]: entity for entity in graph}
    root, recording = entities["./"], entities["#recording"]
    licence = entities[root["license"]["@id"]]
    facts = [
        ("Started", recording["startTime"]),
        ("Ended", recording["endTime"]),
        ("Participant (pseudonym)", entities.get("#participant", {}).get("identifier", "not specified")),
        *(
            (name.capitalize(), entities[f"#trial-{name}"]["value"])
            for name in _TOLD_OF_TRIAL
            if f"#trial-{name}" in entities
        ),
        ("Recorded with", f"CARIS Desktop {entities[recording['instrument']['@id']]['version']}"),
        ("Packed", root["datePublished"]),
        *([("Cite as", root["creditText"])] if "creditText" in root else []),
    ]
    files = [
        {
            "name": file.name,
            "link": quote(file.name),
            "size": _size(file.size_bytes),
            "description": entities[quote(file.name)]["description"],
            "sha256": file.sha256,
        }
        for file in packed
    ]
    linked = str(licence.get("url", "")).startswith(("https://", "http://"))
    return {
        "name": root["name"], "description": root["description"], "facts": facts, "licence": licence,
        "licence_is_link": linked, "files": files,
    }  # fmt: skip


def _size(count: int) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count} bytes"
