"""Check of an export against its format, with third-party programs."""

import csv
import json
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

from caris_desktop.recording.session_export import FORMATS

_SCHEMA = Path(__file__).parents[3] / "shared" / "data" / "EAFv3.0.xsd"


def formats_there() -> list[str]:
    """Formats with an available exporter."""
    return [fmt.name for fmt in FORMATS]


def check_export(fmt: str, out: Path) -> None:
    """Fail if the files in ``out`` do not conform to ``fmt``."""
    assert any(path.is_file() and path.stat().st_size for path in out.rglob("*")), f"{fmt} holds nothing"
    _CHECKS[fmt](out)


def _csv(out: Path) -> None:
    tables = sorted(out.glob("*.csv"))
    assert {"session.csv", "data_dictionary.csv"} <= {path.name for path in tables}
    _check_rows(tables)


def _check_rows(tables: list[Path]) -> None:
    for path in tables:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
        assert rows, path
        assert {len(row) for row in rows} == {len(rows[0])}, path


def _parquet(out: Path) -> None:
    import pyarrow.parquet as pq

    for path in out.rglob("*.parquet"):
        pq.read_table(path).validate(full=True)


def _tables(out: Path) -> None:
    tables = sorted(out.rglob("*.csv"))
    assert tables
    _check_rows(tables)
    _parquet(out)


def _lerobot(out: Path) -> None:
    for info in out.rglob("meta/info.json"):  # none of a session shorter than a frame
        assert json.loads(info.read_text(encoding="utf-8"))["codebase_version"].startswith("v3")
    _parquet(out)
    _frames(out)


def _eaf(out: Path) -> None:
    import xmlschema
    from pympi.Elan import Eaf

    (path,) = out.glob("*.eaf")
    # Without speech and marks there are no tiers.
    assert Eaf(str(path)).get_linked_files() or not list(out.glob("*.mp4"))
    if _SCHEMA.exists():
        xmlschema.validate(str(path), str(_SCHEMA))
    check_what_elan_insists_on(path)


def check_what_elan_insists_on(path: Path) -> None:
    """Requirements of ELAN's parser beyond the schema: the languages of a vocabulary are those of its descriptions, and
    referenced values, types and slots exist.
    """
    root = ElementTree.parse(path).getroot()  # noqa: S314 - written by this program
    assert {"AUTHOR", "DATE", "FORMAT", "VERSION"} <= set(root.keys())
    languages = {language.get("LANG_ID") for language in root.iter("LANGUAGE")}
    for language in root.iter("LANGUAGE"):
        assert language.get("LANG_ID")
        assert language.get("LANG_DEF")
        assert language.get("LANG_LABEL")
    entries: dict[str, dict[str, str]] = {}
    for vocabulary in root.iter("CONTROLLED_VOCABULARY"):
        name = vocabulary.attrib["CV_ID"]
        assert name not in entries
        of_description = [description.get("LANG_REF") for description in vocabulary.findall("DESCRIPTION")]
        assert of_description, f"the vocabulary '{name}' has no DESCRIPTION: a NullPointerException in addEntry"
        assert len(set(of_description)) == len(of_description)
        assert set(of_description) <= languages
        assert [child.tag for child in vocabulary][: len(of_description)] == ["DESCRIPTION"] * len(of_description)
        entries[name] = {}
        for entry in vocabulary.findall("CV_ENTRY_ML"):
            assert [value.get("LANG_REF") for value in entry.findall("CVE_VALUE")] == of_description
            assert entry.attrib["CVE_ID"] not in {known for of_one in entries.values() for known in of_one}
            entries[name][entry.attrib["CVE_ID"]] = entry.findtext("CVE_VALUE") or ""
    types: dict[str, str | None] = {}
    for kind in root.iter("LINGUISTIC_TYPE"):
        assert kind.get("TIME_ALIGNABLE") == "true"
        assert kind.get("CONSTRAINTS") is None
        assert kind.get("GRAPHIC_REFERENCES") == "false"
        types[kind.attrib["LINGUISTIC_TYPE_ID"]] = kind.get("CONTROLLED_VOCABULARY_REF")
    assert {name for name in types.values() if name is not None} <= set(entries)
    slots = {slot.attrib["TIME_SLOT_ID"]: int(slot.attrib["TIME_VALUE"]) for slot in root.iter("TIME_SLOT")}
    for tier in root.iter("TIER"):
        assert tier.get("PARENT_REF") is None
        vocabulary_name = types[tier.attrib["LINGUISTIC_TYPE_REF"]]
        for annotation in tier.iter("ALIGNABLE_ANNOTATION"):
            assert re.search(r"\d", annotation.attrib["ANNOTATION_ID"])
            assert slots[annotation.attrib["TIME_SLOT_REF1"]] < slots[annotation.attrib["TIME_SLOT_REF2"]]
            if (chosen := annotation.get("CVE_REF")) is not None:
                assert vocabulary_name is not None
                assert entries[vocabulary_name][chosen] == (annotation.findtext("ANNOTATION_VALUE") or "")
    for media in root.iter("MEDIA_DESCRIPTOR"):
        assert media.get("MEDIA_URL")
        assert media.get("MIME_TYPE")
    stereotypes = {constraint.get("STEREOTYPE") for constraint in root.iter("CONSTRAINT")}
    assert stereotypes == {"Time_Subdivision", "Symbolic_Subdivision", "Symbolic_Association", "Included_In"}


def _textgrid(out: Path) -> None:
    import parselmouth

    for path in out.glob("*.TextGrid"):
        assert parselmouth.read(str(path)).class_name == "TextGrid"


def _vtt(out: Path) -> None:
    import webvtt

    for path in out.glob("*.vtt"):
        webvtt.read(str(path))


def _rosbag2(out: Path) -> None:
    from mcap.reader import make_reader
    from rosbags.highlevel import AnyReader

    for path in out.rglob("*.mcap"):
        with path.open("rb") as file:
            assert sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())
    for path in (out / "session.bag", out / "ros2"):
        with AnyReader([path]) as reader:
            for connection, _, raw in reader.messages():
                reader.deserialize(raw, connection.msgtype)


def _frames(out: Path) -> None:
    for path in out.rglob("*.jsonl"):
        for line in path.read_text(encoding="utf-8").splitlines():
            json.loads(line)


def _rocrate(out: Path) -> None:
    from rocrate.rocrate import ROCrate

    metadata = sorted(out.rglob("ro-crate-metadata.json"))
    assert metadata
    crate = ROCrate(str(metadata[0].parent))
    assert crate.root_dataset["name"]


def _page(out: Path) -> None:
    for path in [*out.rglob("*.html"), *out.rglob("*.md")]:
        text = path.read_text(encoding="utf-8")
        assert len(text) > 200, path
        HTMLParser().feed(text)


_CHECKS: dict[str, Callable[[Path], None]] = {
    "csv": _csv,
    "parquet": _parquet,
    "tables": _tables,
    "lerobot": _lerobot,
    "eaf": _eaf,
    "textgrid": _textgrid,
    "vtt": _vtt,
    "rosbag2": _rosbag2,
    "frames": _frames,
    "rocrate": _rocrate,
    "html": _page,
    "methods": _page,
}
