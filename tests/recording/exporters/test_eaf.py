"""ELAN projects: valid by ELAN's schema, readable by pympi, unchanged when read back, media at their times."""

import string
import wave
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import av
import numpy as np
import pympi
import pytest
import xmlschema
from hypothesis import given, settings
from hypothesis import strategies as st

from caris_desktop.domain.events import Marked
from caris_desktop.domain.sensing import AudioBlock
from caris_desktop.recording.annotation import annotation_editing
from caris_desktop.recording.annotation.annotation_editing import AnnotationError
from caris_desktop.recording.annotation.annotation_import import media_spans_ms_of, read_eaf
from caris_desktop.recording.annotation.annotation_model import (
    Annotation,
    AnnotationDocument,
    Tier,
    Vocabulary,
    VocabularyEntry,
)
from caris_desktop.recording.annotation.annotation_store import load_documents, save_coder
from caris_desktop.recording.annotation.session_tiers import session_tiers
from caris_desktop.recording.exporters.eaf import LinkedMedia, eaf_text
from caris_desktop.recording.session.session_header import header_of
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import ExportContext, export_session
from tests.recording.export_checks import check_what_elan_insists_on
from tests.recording.told_session import at, heard, said, tell, tour
from tests.support.examples import examples
from tests.support.recorded_session import make_session, number_in

SCHEMA = Path(__file__).parents[4] / "shared" / "data" / "EAFv3.0.xsd"
NASTY = (
    "a \"quoted\" <b> & 'x'",
    "two\nlines\tand a tab",
    " spaces ",
    "\U0001f916 é 李 \u202eolleh",
    "]]>",
    "%s{}\\",
    "0",
)


@pytest.fixture(scope="module")
def elan_schema() -> xmlschema.XMLSchema:
    if not SCHEMA.is_file():
        pytest.skip(f"ELAN's schema is not at {SCHEMA}")
    return xmlschema.XMLSchema(str(SCHEMA))


def coded(*coders: str) -> AnnotationDocument:
    """Several coders with tiers of the same names, and special characters in texts and vocabulary."""
    values = tuple(VocabularyEntry(" ".join(text.split()), text) for text in NASTY)
    document = AnnotationDocument(duration_ms=60_000)
    document = annotation_editing.add_vocabulary(document, Vocabulary("Gaze <&>", values, 'Where "people" look.'))
    document = annotation_editing.add_vocabulary(document, Vocabulary("free text", (VocabularyEntry("x"),)))
    for coder in coders:
        document = annotation_editing.add_tier(document, "Looks", coder, "Gaze <&>", participant="P07 <x>")
        document = annotation_editing.add_tier(document, "Notes & more", coder)
        document = annotation_editing.add_tier(document, "Empty", coder, "free text")
        looks, notes = document.tiers[-3].tier_id, document.tiers[-2].tier_id
        for number, text in enumerate(("", *NASTY)):
            document = annotation_editing.add_annotation(
                document, looks, number * 100, number * 100 + 100, " ".join(text.split())
            )
            document = annotation_editing.add_annotation(document, notes, number * 500, number * 500 + 1, text)
    return document


def write(folder: Path, document: AnnotationDocument) -> Path:
    path = folder / "x.eaf"
    path.write_text(eaf_text(document), encoding="utf-8", newline="\n")
    return path


def test_an_export_reads_back_identical(tmp_path: Path, elan_schema: xmlschema.XMLSchema) -> None:
    document = coded("anna", "ben", "zoë <m>")
    path = write(tmp_path, document)
    elan_schema.validate(str(path))
    # One of the vocabularies has no description.
    check_what_elan_insists_on(path)
    assert read_eaf(path) == document
    assert read_eaf(path, coder="somebody") == document


def test_pympi_reads_the_same(tmp_path: Path) -> None:
    document = coded("anna", "ben")
    eaf = pympi.Elan.Eaf(str(write(tmp_path, document)))
    names = {"c-anna-tier-1": "Looks@anna", "c-ben-tier-2": "Notes & more@ben"}
    for tier_id, name in names.items():
        ours = [(item.start_ms, item.end_ms, item.value) for item in document.of_tier(tier_id)]
        assert sorted(eaf.get_annotation_data_for_tier(name)) == ours
    parameters = eaf.get_parameters_for_tier("Looks@anna")
    assert (parameters["ANNOTATOR"], parameters["PARTICIPANT"]) == ("anna", "P07 <x>")
    (_, entries, _) = eaf.controlled_vocabularies["Gaze <&>"]
    assert [values[0][0] for values, _ in entries.values()] == [
        entry.value for entry in document.vocabularies[0].entries
    ]
    assert eaf.linguistic_types[parameters["LINGUISTIC_TYPE_REF"]]["CONTROLLED_VOCABULARY_REF"] == "Gaze <&>"


_TEXTS = st.text(st.characters(codec=None), max_size=30) | st.sampled_from(
    ["\x00", "\ud800", "\r\n", "\u2028", "\ufffe"]
)
_NAMES = st.text(st.sampled_from(string.printable + "äß李\x00\u202e"), min_size=1, max_size=12)


@settings(max_examples=examples(60), deadline=None)
@given(
    st.lists(st.tuples(_NAMES, st.sampled_from(["anna", "ben", "ts1", "Ö <>"]), st.booleans()), max_size=4),
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 5000), st.integers(1, 300), _TEXTS), max_size=12),
    st.lists(st.tuples(_TEXTS, _TEXTS), max_size=4),
)
def test_any_text_of_a_coder_reads_back_identical(
    tiers: list[tuple[str, str, bool]], spans: list[tuple[int, int, int, str]], entries: list[tuple[str, str]]
) -> None:
    """The edit functions replace control characters by U+FFFD and single line ends by line feeds."""
    document = AnnotationDocument(duration_ms=10_000)
    vocabulary = Vocabulary("V\n1", tuple(VocabularyEntry(*entry) for entry in entries), "d\x07")
    steps: list[Any] = [lambda doc: annotation_editing.add_vocabulary(doc, vocabulary)]
    for name, coder, limited in tiers:
        uses = "V 1" if limited else ""
        steps.append(lambda doc, name=name, coder=coder, uses=uses: annotation_editing.add_tier(doc, name, coder, uses))
    for tier, start_ms, length_ms, text in spans:
        steps.append(
            lambda doc, tier=tier, start_ms=start_ms, length_ms=length_ms, text=text: annotation_editing.add_annotation(
                doc, doc.tiers[tier % len(doc.tiers)].tier_id, start_ms, start_ms + length_ms, text
            )
        )
    for step in steps:
        try:
            document = step(document)
        except (AnnotationError, ZeroDivisionError):
            continue
    text = eaf_text(document)
    ElementTree.fromstring(text)  # noqa: S314 - written by this program
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        assert read_eaf(write(Path(folder), document)) == document


def test_ids_that_xml_has_not_are_retained_alongside(tmp_path: Path, elan_schema: xmlschema.XMLSchema) -> None:
    tier = Tier("tier 1", "T", "anna")
    ids = ("1", "ts3", "a b", "und", "a2", "no digit", "x1")
    annotations = tuple(Annotation(name, "tier 1", n * 10, n * 10 + 5, "v") for n, name in enumerate(ids))
    document = AnnotationDocument((tier,), (), annotations, 1000)
    path = write(tmp_path, document)
    elan_schema.validate(str(path))
    assert read_eaf(path) == document


# Complete export of a session


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A recorded session with real media and two coders, and its project."""
    folder = tmp_path_factory.mktemp("eaf") / "P07 run 1"
    make_session(folder, seconds=6.0, size_px=(160, 90), mark_every_s=2.0, utterance_every_s=2.0)
    for coder in ("anna", "ben"):
        document = annotation_editing.add_vocabulary(
            AnnotationDocument(duration_ms=6000),
            Vocabulary("Gaze", (VocabularyEntry("robot"), VocabularyEntry("floor"))),
        )
        document = annotation_editing.add_tier(document, "Looks", coder, "Gaze")
        save_coder(
            folder, annotation_editing.add_annotation(document, document.tiers[0].tier_id, 500, 1500, "robot"), coder
        )
    out = folder.parent / "out"
    export_session(folder, "eaf", out, ExportContext(with_names=True))
    return folder, out


def test_a_session_becomes_a_project(exported: tuple[Path, Path], elan_schema: xmlschema.XMLSchema) -> None:
    folder, out = exported
    path = out / "P07 run 1.eaf"
    elan_schema.validate(str(path))
    check_what_elan_insists_on(path)
    session = open_session(folder)
    document = annotation_editing.merge_documents(session_tiers(session), load_documents(folder))
    assert read_eaf(path) == document
    names = set(pympi.Elan.Eaf(str(path)).tiers)
    assert {"Driving source", "Wizard marks", "Motion", "Looks@anna", "Looks@ben"} <= names
    descriptors = ElementTree.parse(path).getroot().findall("HEADER/MEDIA_DESCRIPTOR")  # noqa: S314 - written by this program
    linked = [descriptor.get("RELATIVE_MEDIA_URL", "") for descriptor in descriptors]
    assert len(linked) == 4
    for url in linked:
        assert (path.parent / url).is_file()
    # The export contains no path of this computer.
    assert str(folder.parent) not in path.read_text(encoding="utf-8")


def test_videos_show_each_picture_at_its_time_of_the_session(exported: tuple[Path, Path]) -> None:
    folder, out = exported
    session = open_session(folder)
    for row in session.header.to_json()["videos"]:
        with av.open(str(folder / row["file_name"])) as video:
            recorded = [(float(frame.time), frame.to_ndarray(format="bgr24")) for frame in video.decode(video=0)]
        late_s = (row["first_stamp_ns"] - session.started_ns) / 1e9
        assert late_s > 0.05
        with av.open(str(out / row["file_name"])) as video:
            shown = [(float(frame.time), frame.to_ndarray(format="bgr24")) for frame in video.decode(video=0)]
        # The first frame is shown from the beginning.
        assert [shown[0][0], number_in(shown[0][1])] == [0.0, number_in(recorded[0][1])]
        assert [number_in(image) for _, image in shown[1:]] == [number_in(image) for _, image in recorded]
        assert np.allclose([time_s for time_s, _ in shown[1:]], [time_s + late_s for time_s, _ in recorded], atol=0.001)


def loud_s(path: Path) -> list[float]:
    """Start of each loud interval, in seconds of the file."""
    with wave.open(str(path)) as file:
        samples = np.frombuffer(file.readframes(file.getnframes()), "<i2").reshape(-1, file.getnchannels())
        loud = np.flatnonzero(np.abs(samples[:, 0]) > 1000)
        return [float(at) / file.getframerate() for at in loud[np.diff(loud, prepend=-10_000) > 100]]


def test_sound_is_filled_up_with_silence(tmp_path: Path) -> None:
    """Late start and a pause in the middle; the samples themselves stay unchanged."""
    blocks = [
        AudioBlock(at(2.0), "microphone", "audio-m.wav", 0, 16_000, 16_000),
        AudioBlock(at(7.0), "microphone", "audio-m.wav", 16_000, 16_000, 16_000),
        # The clock of the sound card differs slightly: this is still one piece.
        AudioBlock(at(8.0) + 4_000_000, "microphone", "audio-m.wav", 32_000, 8000, 16_000),
    ]
    folder = tell(tmp_path / "s", [*blocks, *heard(1, 2.0, 3.0, "Hi")], lasts_s=20.0)
    samples = np.zeros((40_000, 2), "<i2")
    for at_sample in (8000, 20_000, 36_000):
        samples[at_sample : at_sample + 50] = 20_000
    with wave.open(str(folder / "audio-m.wav"), "wb") as file:
        file.setparams((2, 2, 16_000, 0, "NONE", ""))
        file.writeframes(samples.tobytes())
    export_session(folder, "eaf", tmp_path / "out")
    assert loud_s(tmp_path / "out" / "audio-m.wav") == pytest.approx([2.5, 7.25, 8.25], abs=0.001)
    with wave.open(str(tmp_path / "out" / "audio-m.wav")) as file:
        assert (file.getnchannels(), file.getframerate(), file.getnframes()) == (2, 16_000, 8 * 16_000 + 8000)
    assert "Silence replaces gaps" in (tmp_path / "out" / "media.txt").read_text()


def test_sound_that_keeps_time_itself_is_moved_as_a_whole(tmp_path: Path) -> None:
    """Recorded file in which gaps are already silence; jitter of the stamps is ignored."""
    blocks = [
        AudioBlock(at(2.0 + number / 5) + (number % 3 - 1) * 4_000_000, "m", "audio-m.wav", number * 3200, 3200, 16_000)
        for number in range(50)
        if not 10 <= number < 30
    ]
    folder = tell(tmp_path / "s", blocks, lasts_s=20.0)
    samples = np.arange(160_000, dtype="<i2")
    with wave.open(str(folder / "audio-m.wav"), "wb") as file:
        file.setparams((1, 2, 16_000, 0, "NONE", ""))
        file.writeframes(samples.tobytes())
    export_session(folder, "eaf", tmp_path / "out")
    with wave.open(str(tmp_path / "out" / "audio-m.wav")) as file:
        written = np.frombuffer(file.readframes(file.getnframes()), "<i2")
    late = len(written) - len(samples)
    assert late == pytest.approx(2.0 * 16_000, abs=0.005 * 16_000)
    assert not written[:late].any()
    assert np.array_equal(written[late:], samples)


@pytest.mark.logs(r"exporters\.eaf: ")
def test_media_that_began_before_the_session_have_an_origin(tmp_path: Path) -> None:
    """ELAN plays a file at document time plus TIME_ORIGIN, which skips the part before the session."""
    folder = tell(
        tmp_path / "s",
        [AudioBlock(at(-0.25), "microphone", "audio-m.wav", 0, 16_000, 16_000)],
        lasts_s=20.0,
        videos=[
            {"camera": "front", "file_name": "video-front.mp4", "first_stamp_ns": at(3.0)},
            {"camera": "rear", "file_name": "../../video.mp4", "first_stamp_ns": at(3.0)},
        ],
    )
    with wave.open(str(folder / "audio-m.wav"), "wb") as file:
        file.setparams((1, 2, 16_000, 0, "NONE", ""))
        file.writeframes(bytes(32_000))
    (folder / "video-front.mp4").write_bytes(b"what a power cut left")
    (tmp_path.parent / "video.mp4").write_bytes(b"somebody else's")
    export_session(folder, "eaf", tmp_path / "out")
    root = ElementTree.parse(tmp_path / "out" / "s.eaf").getroot()  # noqa: S314 - written by this program
    origins = {item.get("MEDIA_URL"): item.get("TIME_ORIGIN") for item in root.findall("HEADER/MEDIA_DESCRIPTOR")}
    # The video cannot start with the session, so its offset is at least stated.
    assert origins == {"./audio-m.wav": "250", "./video-front.mp4": "-3000"}
    assert (tmp_path / "out" / "audio-m.wav").read_bytes() == (folder / "audio-m.wav").read_bytes()
    assert (tmp_path / "out" / "video-front.mp4").read_bytes() == b"what a power cut left"


@pytest.mark.long
def test_a_long_tour_keeps_elans_rules(tmp_path: Path, elan_schema: xmlschema.XMLSchema) -> None:
    values = [*tour(5, minutes=5.0), *said(900, 1.0, 1.0, 2.0, NASTY[0]), Marked(at(3.0), NASTY[1], mark_id="z")]
    folder = tell(tmp_path / "s", values, lasts_s=300.0)
    export_session(folder, "eaf", tmp_path / "out", ExportContext(with_names=True))
    elan_schema.validate(str(tmp_path / "out" / "s.eaf"))
    assert read_eaf(tmp_path / "out" / "s.eaf") == session_tiers(open_session(folder))


# Files of other programs


FOREIGN = """<?xml version="1.0" encoding="UTF-8"?>
<ANNOTATION_DOCUMENT AUTHOR="" DATE="2010-01-01T00:00:00+00:00" FORMAT="2.7" VERSION="2.7">
  <HEADER MEDIA_FILE="" TIME_UNITS="milliseconds"/>
  <TIME_ORDER>
    <TIME_SLOT TIME_SLOT_ID="ts1" TIME_VALUE="1000"/>
    <TIME_SLOT TIME_SLOT_ID="ts2"/>
    <TIME_SLOT TIME_SLOT_ID="ts3"/>
    <TIME_SLOT TIME_SLOT_ID="ts4" TIME_VALUE="4000"/>
  </TIME_ORDER>
  <TIER LINGUISTIC_TYPE_REF="default-lt" TIER_ID="Words" PARTICIPANT="P1">
    <ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a1" TIME_SLOT_REF1="ts1" TIME_SLOT_REF2="ts2">
      <ANNOTATION_VALUE>one</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>
    <ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a2" TIME_SLOT_REF1="ts2" TIME_SLOT_REF2="ts3">
      <ANNOTATION_VALUE>two</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>
    <ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a3" TIME_SLOT_REF1="ts3" TIME_SLOT_REF2="ts4">
      <ANNOTATION_VALUE>three</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>
  </TIER>
  <TIER LINGUISTIC_TYPE_REF="sub" TIER_ID="Parts" PARENT_REF="Words" ANNOTATOR="Mia">
    <ANNOTATION><REF_ANNOTATION ANNOTATION_ID="a6" ANNOTATION_REF="a1" PREVIOUS_ANNOTATION="a5">
      <ANNOTATION_VALUE>e</ANNOTATION_VALUE></REF_ANNOTATION></ANNOTATION>
    <ANNOTATION><REF_ANNOTATION ANNOTATION_ID="a5" ANNOTATION_REF="a1">
      <ANNOTATION_VALUE>on</ANNOTATION_VALUE></REF_ANNOTATION></ANNOTATION>
  </TIER>
  <TIER LINGUISTIC_TYPE_REF="cv" TIER_ID="Gloss" PARENT_REF="Parts">
    <ANNOTATION><REF_ANNOTATION ANNOTATION_ID="a7" ANNOTATION_REF="a6">
      <ANNOTATION_VALUE>old value</ANNOTATION_VALUE></REF_ANNOTATION></ANNOTATION>
  </TIER>
  <LINGUISTIC_TYPE LINGUISTIC_TYPE_ID="default-lt" TIME_ALIGNABLE="true"/>
  <LINGUISTIC_TYPE LINGUISTIC_TYPE_ID="sub" CONSTRAINTS="Symbolic_Subdivision" TIME_ALIGNABLE="false"/>
  <LINGUISTIC_TYPE LINGUISTIC_TYPE_ID="cv" CONTROLLED_VOCABULARY_REF="Old" TIME_ALIGNABLE="false"/>
  <CONTROLLED_VOCABULARY CV_ID="Old" DESCRIPTION="Before 2.8">
    <CV_ENTRY DESCRIPTION="a yes">yes</CV_ENTRY><CV_ENTRY>no</CV_ENTRY>
  </CONTROLLED_VOCABULARY>
</ANNOTATION_DOCUMENT>
"""


def test_open_times_and_references_are_worked_out(tmp_path: Path) -> None:
    path = tmp_path / "foreign.eaf"
    path.write_text(FOREIGN)
    document = read_eaf(path, coder="anna")
    found = {
        tier.name: (tier.coder, [(item.start_ms, item.end_ms, item.value) for item in document.of_tier(tier.tier_id)])
        for tier in document.tiers
    }
    assert found == {
        "Words": ("anna", [(1000, 2000, "one"), (2000, 3000, "two"), (3000, 4000, "three")]),
        "Parts": ("Mia", [(1000, 1500, "on"), (1500, 2000, "e")]),
        "Gloss": ("anna", [(1500, 2000, "old value")]),
    }
    (old,) = document.vocabularies
    assert (old.description, [entry.value for entry in old.entries]) == ("Before 2.8", ["yes", "no", "old value"])
    assert old.entries[0].description == "a yes"
    taken = annotation_editing.merge_imported(AnnotationDocument(duration_ms=5000), document)
    assert len(taken.annotations) == 6


def test_coding_of_a_video_itself_is_moved_to_the_session(tmp_path: Path) -> None:
    """A video of the session that was opened in ELAN and cut by its first 300 ms there."""
    header = {
        "clock": {"monotonic_ns": 0, "utc_ns": 0},
        "started_ns": at(0.0),
        "videos": [
            {"file_name": "video-front.mp4", "camera": "front", "first_stamp_ns": at(2.5)},
            {"file_name": "broken"},
            7,
        ],
        "audio": [{"file_name": "audio-m.wav", "first_stamp_ns": at(1.0)}],
    }
    spans_ms = media_spans_ms_of(header_of(header, tmp_path / "session.json"))
    assert {name: span_ms[0] for name, span_ms in spans_ms.items()} == {"video-front.mp4": 2500, "audio-m.wav": 1000}
    media = '<MEDIA_DESCRIPTOR MEDIA_URL="file:///C:/x%20y/video-front.mp4" MIME_TYPE="video/mp4" TIME_ORIGIN="300"/>'
    path = tmp_path / "x.eaf"
    path.write_text(FOREIGN.replace('"milliseconds"/>', f'"milliseconds">{media}</HEADER>'))
    moved = read_eaf(path, coder="anna", media_spans_ms=spans_ms)
    assert [item.start_ms for item in moved.of_tier("eaf-1")] == [3800, 4800, 5800]
    assert read_eaf(path, media_spans_ms={}).annotations[0].start_ms == 1000
    # Exports of this program use session time, although they link the same files.
    ours = eaf_text(coded("anna"), media=[LinkedMedia("video-front.mp4", "video/mp4", 0, "")])
    path.write_text(ours, encoding="utf-8")
    assert read_eaf(path, media_spans_ms=spans_ms) == coded("anna")


def test_a_file_that_elan_changed_keeps_what_is_ours(tmp_path: Path) -> None:
    """ELAN renames a tier, adds an annotation with its own id, and rewrites its notes."""
    document = coded("anna")
    text = eaf_text(document).replace('TIER_ID="Empty"', 'TIER_ID="Renamed"')
    slots = text.count("<TIME_SLOT ")
    text = text.replace(
        "</TIME_ORDER>",
        f'<TIME_SLOT TIME_SLOT_ID="ts{slots + 1}" TIME_VALUE="70000"/>'
        f'<TIME_SLOT TIME_SLOT_ID="ts{slots + 2}" TIME_VALUE="71000"/></TIME_ORDER>',
    ).replace(
        "<LINGUISTIC_TYPE",
        '<TIER TIER_ID="New" LINGUISTIC_TYPE_REF="free text"><ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a1" '
        f'TIME_SLOT_REF1="ts{slots + 1}" TIME_SLOT_REF2="ts{slots + 2}"><ANNOTATION_VALUE>late</ANNOTATION_VALUE>'
        "</ALIGNABLE_ANNOTATION></ANNOTATION></TIER><LINGUISTIC_TYPE",
        1,
    )
    path = tmp_path / "x.eaf"
    path.write_text(text, encoding="utf-8")
    read = read_eaf(path, coder="ben")
    assert [(tier.name, tier.coder) for tier in read.tiers] == [
        ("Looks", "anna"),
        ("Notes & more", "anna"),
        ("Renamed", "anna"),
        ("New", "ben"),
    ]
    assert read.of_tier("c-anna-tier-1") == document.of_tier("c-anna-tier-1")
    # An annotation beyond the stated end makes the end unknown.
    assert (read.annotations[-1].value, read.duration_ms) == ("late", 0)


_BOMB = '<!DOCTYPE a [<!ENTITY b "bbbb"><!ENTITY c "&b;&b;">]><ANNOTATION_DOCUMENT>&c;</ANNOTATION_DOCUMENT>'


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (FOREIGN[:-400], "not valid XML, or is truncated"),
        ("tier,start,end", "not valid XML"),
        ("<html/>", "is not an ELAN file: it starts with “html”"),
        (_BOMB, "contains XML that is not allowed in an ELAN file"),
        (FOREIGN.replace('"ts4" TIME_VALUE="4000"', '"ts4" TIME_VALUE="-4"'), "The time slot “ts4” has no valid time"),
        (FOREIGN.replace('"ts4" TIME_VALUE="4000"', '"ts4" TIME_VALUE="500"'), "ends before it starts"),
        (FOREIGN.replace('TIME_SLOT_REF2="ts4"', 'TIME_SLOT_REF2="ts9"'), "has no time"),
        (FOREIGN.replace('ANNOTATION_REF="a6"', 'ANNOTATION_REF="a7"'), "form a loop"),
        (FOREIGN.replace('ANNOTATION_ID="a3"', 'ANNOTATION_ID="a2"'), "missing or duplicate id"),
        (FOREIGN.replace('TIER_ID="Gloss"', 'TIER_ID="Parts"'), "Duplicate tier name “Parts”"),
        (FOREIGN.replace('"ts2" TIME_SLOT_REF2="ts3"', '"ts3" TIME_SLOT_REF2="ts2"'), "x.eaf cannot be imported"),
        (FOREIGN.replace(">one<", f">{'x' * 20_000}<"), "has 20000 characters"),
    ],
)
def test_an_unreadable_file_is_reported(tmp_path: Path, content: str, told: str) -> None:
    path = tmp_path / "x.eaf"
    path.write_text(content)
    with pytest.raises(AnnotationError, match=told):
        read_eaf(path)


def test_ends_of_files_are_reported_not_thrown(tmp_path: Path) -> None:
    """Files truncated at any place or with changed bytes: a document or an error message."""
    whole = eaf_text(coded("anna")).encode()
    rng = np.random.default_rng(5)
    path = tmp_path / "x.eaf"
    for _ in range(60):
        damaged = bytearray(whole)
        at_byte = int(rng.integers(0, len(whole)))
        damaged[at_byte : at_byte + 4] = rng.bytes(4) if rng.random() < 0.5 else b'"'
        path.write_bytes(damaged[: int(rng.integers(len(whole) // 2, len(whole) + 1))])
        try:
            annotation_editing.check_document(read_eaf(path))
        except AnnotationError as refusal:
            assert str(refusal).startswith("x.eaf cannot be imported.")
    with pytest.raises(AnnotationError, match="cannot be read"):
        read_eaf(tmp_path / "none.eaf")
