"""Anonymised copy of a session: complete and valid, without a name, a face without consent, or an unwanted voice."""

import csv
import json
import os
import shutil
import stat
import wave
from hashlib import sha256
from pathlib import Path

import av
import numpy as np
import pytest
import yaml

from caris_desktop.app import command_table
from caris_desktop.domain.events import ScenarioOpened, UtteranceChanged
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.recording.anonymising import session_copy
from caris_desktop.recording.anonymising.session_copy import KnownNames, write_sound
from caris_desktop.recording.forgetting.byte_search import ByteSearch
from caris_desktop.recording.forgetting.text_erasure import all_of
from caris_desktop.recording.photo_file import with_texts
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session.manifest import verify_manifest, write_manifest
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import FORMATS, ExportRequest, export_all
from caris_desktop.recording.studies.statistics import study_statistics
from tests.recording.anonymising.named_session import ADDRESS, FRIEND, MET, NAMES, WIZARD, make_study
from tests.support.recorded_session import make_session


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Session in a study, which no test changes."""
    return make_study(tmp_path_factory.mktemp("recorded") / "study")


@pytest.fixture(scope="module")
def copied(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its copy, with the review beside it."""
    out = tmp_path_factory.mktemp("copied") / "copy"
    before = os.umask(0o022)
    try:
        assert anonymise(recorded, out, "--also-called", FRIEND) == 0
    finally:
        os.umask(before)
    return out


def anonymise(recording: Path, out: Path, *words: str) -> int:
    return command_table.run(["anonymise", str(recording), "--out", str(out), "--workers", "1", *words])


def named_in(folder: Path) -> dict[str, list[str]]:
    """Files that contain a name or the robot's address in any encoding, also compressed, or in their own name."""
    search, found = ByteSearch(all_of(NAMES, ())), {}
    for path in sorted(folder.rglob("*")):
        words = [hit.words for hit in search.file(path).hits] if path.is_file() else []
        words += [hit.words for hit in search.data(path.name.encode()).hits]
        if path.is_file() and ADDRESS.encode() in path.read_bytes():
            words.append(ADDRESS)
        if words:
            found[str(path.relative_to(folder))] = words
    return found


def samples_of(path: Path) -> np.ndarray:
    with wave.open(str(path)) as file:
        return np.frombuffer(file.readframes(file.getnframes()), "<i2").astype(float)


def test_the_names_are_where_they_are_searched(recorded: Path) -> None:
    found = named_in(recorded)
    assert {"events.mcap", "session.json", "speech.txt", "notes.txt", "console.log", "llm/0009.json"} <= set(found)
    assert any(name.startswith("annotations/Ottokar") for name in found)
    assert any(name.startswith("photos/zoë") for name in found)


def test_no_byte_of_the_copy_names_anybody(recorded: Path, copied: Path) -> None:
    assert named_in(copied) == {}
    assert named_in(copied.parent) == {}, "the list for review has pseudonyms too"
    events = open_session(copied)
    told = json.dumps([str(value) for _, value in events.values()])
    for name in (*NAMES, ADDRESS, *(part for each in NAMES for part in each.split())):
        assert name.casefold() not in told.casefold()
    assert not (copied / "derived").exists()
    assert not list(copied.rglob("export-1"))
    assert not list(copied.rglob("*.sqlite*"))


def test_the_copy_is_a_complete_session(recorded: Path, copied: Path) -> None:
    assert verify_manifest(copied) == []
    before, now = open_session(recorded), open_session(copied)
    assert (now.losses, now.notices, now.closed_properly) == ((), (), True)
    assert (now.clock, now.ended_ns, now.reason) == (before.clock, before.ended_ns, before.reason)
    pairs = zip(before.arrivals(), now.arrivals(), strict=True)
    assert all((at_ns, spec) == (copied_ns, copied_spec) for (at_ns, spec, _), (copied_ns, copied_spec, _) in pairs)
    assert {sound.file_name for sound in now.header.audio} == {"audio-microphone.wav", "audio-robot-voice.wav"}
    with VideoReader(now) as videos:
        assert not videos.problems
        assert len(videos.frame_times_ns("front")) == before.header.videos[0].frames
    SessionTimeline(now).close()
    for file in now.header.files:
        assert (copied / file.name).stat().st_size == file.bytes


def test_each_name_has_one_pseudonym_everywhere(copied: Path) -> None:
    session = open_session(copied)
    assert session.trial == {
        "study": "Study of {p-1}", "participant": "P2", "condition": "with P2", "trial": "3", "wizard": "W1",
        "recording": "1", "purpose": "",
    }  # fmt: skip
    assert session.header.robot.address == "temi"
    texts = {event.text for _, event in session.values("event/utterance_changed")}
    assert {"Hello {p-1}, hello {p-1}.", "I am {p-1}"} <= texts
    assert [event.actor for _, event in session.values("event/stop_requested")] == ["wizard:another"]
    assert (copied / "notes.txt").read_text() == "{p-1} came late.\nW1 was ill; P2 went.\n"
    assert (copied / "photos" / "{p-1}.png").is_file()
    assert {event.file_name for _, event in session.values("event/photo_taken")} >= {"photos/{p-1}.png"}
    assert "~/layout" in "".join(event.meaning for _, event in session.values("event/problem"))
    coding = json.loads((copied / "annotations" / "C1.json").read_text())
    assert (coding["coder"], coding["tiers"][0]["name"]) == ("C1", "Gaze of {p-1}")


def test_a_scenario_with_pseudonyms_is_a_scenario(copied: Path) -> None:
    scenario = [event for _, event in open_session(copied).values(BY_TYPE[ScenarioOpened].name)][-1]
    assert scenario.sha256 == sha256(scenario.content.encode()).hexdigest()
    content = yaml.safe_load(scenario.content)
    assert content["title"] == "Tour with (p-1)"
    assert content["phrases"] == {"Greetings": ["Hello (p-1)"]}


def test_the_header_says_how_the_copy_was_made(copied: Path) -> None:
    told = open_session(copied).header.anonymised
    assert told is not None
    assert told.utc.startswith("20")
    assert told.program_version
    assert (told.faces, told.voices) == ("faces covered of people without consent", "unchanged")
    assert told.left_out == (
        "interview/P2.m4a is left out: it cannot be searched for names.",
        "recovered/session.json.original is left out: a repair saved it, and it may name people.",
    )


def test_only_people_without_consent_are_covered(recorded: Path, copied: Path) -> None:
    before, now = open_session(recorded), open_session(copied)
    detections = [value for _, value in before.values("people")]
    differences: dict[str, list[float]] = {"p-1": [], "p-2": []}
    with VideoReader(before) as one, VideoReader(now) as other:
        for number in range(60, 84, 3):
            first, second = one.frame("front", number), other.frame("front", number)
            assert first is not None
            assert second is not None
            near = min(detections, key=lambda people: abs(people.stamp_ns - first.info.stamp_ns))
            changed = np.abs(first.image_bgr.astype(int) - second.image_bgr).mean(axis=2)
            for box in near.boxes:
                x, y = int(box.left_px + box.width_px / 2), int(box.top_px)
                differences[box.person_id].append(changed[y : y + 30, x - 6 : x + 6].mean())
    assert min(differences["p-1"]) > 2 * max(differences["p-2"])


def test_the_review_lists_all_free_text_with_its_place(copied: Path) -> None:
    with copied.with_name("copy-review.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert stat.S_IMODE(copied.with_name("copy-review.csv").stat().st_mode) == 0o600
    found = {(row["file"], row["kind"], row["text"]) for row in rows}
    assert {
        ("events.mcap", "utterance_changed", "Hello {p-1}, hello {p-1}."),
        ("events.mcap", "marked", "asks for P1"),
        ("events.mcap", "llm_exchange", "Be kind to {p-1}."),
        ("events.mcap", "llm_exchange", "Hello P1."),
        ("events.mcap", "assistant_changed", "{p-1} likes art."),
        ("photos/{p-1}.png", "photo", "{p-1}, laughing"),
        ("annotations/C1.json", "annotation", "looks at P2"),
        ("notes.txt", "file", "W1 was ill; P2 went."),
        ("session.json", "trial", "with P2"),
    } <= found
    assert {row["session"] for row in rows} == {"copy"}
    assert next(row["place"] for row in rows if row["text"] == "asks for P1") == "0:04"


def test_the_copy_is_private(copied: Path) -> None:
    modes = {path.is_dir(): stat.S_IMODE(path.stat().st_mode) for path in (copied, *copied.rglob("*"))}
    assert modes == {True: 0o700, False: 0o600}


def test_names_are_silent_in_every_sound(recorded: Path, copied: Path) -> None:
    session = open_session(recorded)
    for sound in session.header.audio:
        now = samples_of(copied / sound.file_name)
        assert len(now) == sound.samples
        (end_ns,) = {
            event.stamp_ns for _, event in session.values("event/utterance_changed")
            if isinstance(event, UtteranceChanged) and event.utterance_id == "h-9" and event.state == "finished"
        }  # fmt: skip
        at = (end_ns - sound.first_stamp_ns) * sound.sample_rate_hz // 10**9
        assert not now[at - sound.sample_rate_hz // 2 : at].any()
        assert now.any()


@pytest.mark.parametrize("voice", ["remove", "change"])
def test_voices_are_removed_or_changed(recorded: Path, tmp_path: Path, voice: str) -> None:
    folder = shutil.copytree(recorded, tmp_path / "s" / "sessions" / "one")
    (folder / "audio").mkdir()
    shutil.copy(folder / "audio-microphone.wav", folder / "audio" / "clip.wav")
    assert anonymise(folder, tmp_path / "out", "--voice", voice) == 0
    session = open_session(tmp_path / "out")
    assert session.losses == ()
    robot = samples_of(tmp_path / "out" / "audio-robot-voice.wav")
    assert robot.any()
    if voice == "remove":
        assert [sound.file_name for sound in session.header.audio] == ["audio-robot-voice.wav"]
        assert not (tmp_path / "out" / "audio").exists()
        return
    for name in ("audio-microphone.wav", "audio/clip.wav"):
        before, now = samples_of(folder / name), samples_of(tmp_path / "out" / name)
        assert len(now) == len(before)
        part = slice(int(0.8 * 16000), int(1.6 * 16000))  # the robot speaks
        ratio = pitch_of(now[part]) / pitch_of(before[part])
        assert 1.15 < max(ratio, 1 / ratio) < 1.35


def pitch_of(samples: np.ndarray) -> float:
    return float(np.argmax(np.abs(np.fft.rfft(samples * np.hanning(len(samples))))))


@pytest.mark.parametrize("channels", [1, 2])
def test_a_changed_pitch_keeps_the_times(tmp_path: Path, channels: int) -> None:
    rate, seconds = 16000, 12
    samples = np.zeros(rate * seconds)
    for second in range(1, seconds - 1):
        samples[second * rate : second * rate + rate // 4] = 15000 * np.sin(
            np.arange(rate // 4) * 2 * np.pi * 200 / rate
        )
    with wave.open(str(tmp_path / "a.wav"), "wb") as file:
        file.setnchannels(channels)
        file.setsampwidth(2)
        file.setframerate(rate)
        file.writeframes(np.repeat(samples.astype("<i2")[:, None], channels, 1).tobytes())
    write_sound(tmp_path / "a.wav", tmp_path / "b.wav", 1.25)
    now = samples_of(tmp_path / "b.wav").reshape(-1, channels)[:, -1]
    assert len(now) == len(samples)
    for second in range(1, seconds - 1):
        begins = np.flatnonzero(np.abs(now[(second * rate - rate // 4) :]) > 3000)[0] - rate // 4
        assert abs(begins) < 0.06 * rate


@pytest.mark.logs(".*")
def test_media_that_cannot_be_anonymised_are_left_out_and_said(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_session(
        tmp_path / "study" / "sessions" / "one", seconds=6.0, cameras=("front", "rear"), fps=5.0, people=1,
        people_hz=4.0, photo_every_s=3.0,
    ).folder  # fmt: skip
    (folder / "video-front.mp4").write_bytes(b"no video" * 100)
    (folder / "photos" / "0001.png").write_bytes(b"no photo")
    (folder / "audio-microphone.wav").write_bytes(b"no sound")
    (folder / "annotations").mkdir()
    (folder / "annotations" / "Anna.json").write_text("{")
    write_manifest(folder)
    assert anonymise(folder, tmp_path / "out") == 0
    told = capsys.readouterr().err
    assert "video-rear.mp4 is left out: it is not known where people are" in told
    assert "video-front.mp4 is left out: video-front.mp4 cannot be read as a video" in told
    assert "photos/0001.png is left out" in told
    assert "audio-microphone.wav is left out: audio-microphone.wav contains no audio" in told
    assert "Anna" not in told
    session = open_session(tmp_path / "out")
    assert session.header.videos == ()
    assert {path.name for path in (tmp_path / "out").rglob("*") if path.is_file()} & {
        "video-rear.frames.csv", "video-front.frames.csv", "video-front.mp4", "video-rear.mp4", "0001.png", "Anna.json",
    } == set()  # fmt: skip
    assert verify_manifest(tmp_path / "out") == []


@pytest.mark.parametrize("blur", ["everybody", "nobody"])
def test_names_that_other_programs_wrote_into_media_stay_behind(recorded: Path, tmp_path: Path, blur: str) -> None:
    folder = shutil.copytree(recorded, tmp_path / "s" / "sessions" / "one")
    path, again = folder / "video-front.mp4", tmp_path / "again.mp4"
    with av.open(str(path)) as old, av.open(str(again), "w") as new:
        new.metadata.update(title=MET, comment=FRIEND)
        stream = new.add_stream_from_template(old.streams.video[0])
        for packet in old.demux(video=0):
            packet.stream = stream
            new.mux([packet] if packet.size else [])
    again.replace(path)
    with (folder / "video-front.frames.csv").open("a") as index:
        index.write(f"# until {MET} leaves\n")
    photo = folder / "photos" / "0001.png"
    photo.write_bytes(with_texts(photo.read_bytes(), {"Quillfeather": "in the kitchen"}))
    assert {"video-front.mp4", "video-front.frames.csv", "photos/0001.png"} <= set(named_in(folder))
    arguments = ("--blur", blur, "--also-called", MET, "--also-called", FRIEND)
    assert anonymise(folder, tmp_path / "out", *arguments) == 0
    assert named_in(tmp_path / "out") == {}
    session = open_session(tmp_path / "out")
    assert session.header.anonymised is not None
    assert "video-front.mp4 is copied without its sound, subtitles" in " ".join(session.header.anonymised.left_out)
    with VideoReader(session) as videos:
        assert len(videos.frame_times_ns("front")) == open_session(recorded).header.videos[0].frames


@pytest.mark.logs(".*")
def test_odd_videos_are_covered_or_left_out_and_end_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = make_session(
        tmp_path / "study" / "sessions" / "one", seconds=6.0, cameras=("front", "rear"), fps=5.0, people=1,
        people_hz=4.0,
    ).folder  # fmt: skip
    people = open_session(folder).values("people")
    assert {value.camera for _, value in people} == {"front"}
    for form, pixels in (("h264", "yuv420p"), ("mp4", "yuv444p")):
        with av.open(str(folder / "video-front.mp4"), "w", format=form) as video:
            stream = video.add_stream("libx264", rate=5)
            stream.width, stream.height, stream.pix_fmt = 321, 181, pixels
            if form == "h264":  # frames without times
                stream.width, stream.height = 320, 180
            for _ in range(10):
                image_bgr = np.zeros((stream.height, stream.width, 3), np.uint8)
                video.mux(stream.encode(av.VideoFrame.from_ndarray(image_bgr, "bgr24")))
            video.mux(stream.encode(None))
        assert anonymise(folder, tmp_path / form) == 0
        told = "video-front.mp4 is left out: video-front.mp4 cannot be read as a video: its frames have no times"
        assert (told in capsys.readouterr().err) == (form == "h264")
        assert (tmp_path / form / "video-front.mp4").exists() == (form == "mp4")


def test_without_blurring_the_videos_are_as_recorded(recorded: Path, tmp_path: Path) -> None:
    assert anonymise(recorded, tmp_path / "out", "--blur", "nobody", "--keep-wizards") == 0
    assert (tmp_path / "out" / "video-front.mp4").read_bytes() == (recorded / "video-front.mp4").read_bytes()
    session = open_session(tmp_path / "out")
    assert session.trial["wizard"] == WIZARD
    assert MET not in str([value for _, value in session.values()])


def test_every_command_takes_the_copy_as_it_is(copied: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(copied, tmp_path / "study" / "one")
    formats = tuple(fmt.name for fmt in FORMATS)
    finished = export_all(ExportRequest((folder,), formats, tmp_path / "out", with_names=True))
    assert finished.problems == ()
    assert {path.name for path in (tmp_path / "out" / "one").iterdir()} == set(formats)
    assert named_in(tmp_path / "out") == {}
    metadata = (tmp_path / "out" / "one" / "rocrate" / "ro-crate-metadata.json").read_text()
    assert "It is an anonymised copy" in metadata
    assert "Everything else is as recorded" not in metadata
    assert study_statistics(tmp_path / "study", tmp_path / "statistics").measures[0]["wizard"] == "W1"
    for words in (["sessions", str(tmp_path / "study")], ["export", str(folder), "--verify", str(tmp_path / "csv")]):
        assert command_table.run(words) == 0
    assert anonymise(folder, tmp_path / "again") == 0
    assert open_session(tmp_path / "again").trial == open_session(folder).trial


@pytest.mark.logs(".*")
def test_of_a_study_a_damaged_session_is_reported_and_the_rest_go_on(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = tmp_path / "study"
    shutil.copytree(recorded.parents[1], study)
    (study / "sessions" / "broken").mkdir()
    (study / "sessions" / "broken" / "session.json").write_text("{}")
    assert anonymise(study, tmp_path / "out", "--also-called", FRIEND) == 1
    told = capsys.readouterr()
    assert "broken: " in told.err
    assert "Anonymised 1 of 2 sessions" in told.out
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["2026-11-21_10-00-00_P2"]
    with (tmp_path / "out-review.csv").open(newline="") as file:
        assert {row["session"] for row in csv.DictReader(file)} == {"2026-11-21_10-00-00_P2"}


def test_the_places_of_copies(recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = recorded.parents[1]
    before = {path: path.stat().st_mtime_ns for path in study.rglob("*")}
    for out in (study / "copies", recorded / "export-2", study):
        assert anonymise(recorded, out) == 1
        assert "inside the study" in capsys.readouterr().err
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").touch()
    assert anonymise(recorded, tmp_path / "full") == 1
    assert "not empty" in capsys.readouterr().err
    assert {path: path.stat().st_mtime_ns for path in study.rglob("*")} == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["full"]


def test_a_cancelled_copy_leaves_nothing(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write, calls = session_copy.media.covered_video, []

    def interrupted(*values: object, **named: object) -> None:
        calls.append(write)
        raise KeyboardInterrupt

    monkeypatch.setattr(session_copy.media, "covered_video", interrupted)
    assert anonymise(recorded, tmp_path / "out") == 130
    assert calls
    assert "Nothing was written" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.logs(".*")
def test_without_the_names_of_people_nothing_is_copied(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = tmp_path / "study"
    shutil.copytree(recorded.parents[1], study)
    (study / "people.sqlite").write_bytes(b"damaged" * 100)
    assert anonymise(study, tmp_path / "out") == 1
    assert "names of people would stay" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_names_that_are_words_of_the_program_do_not_damage_it() -> None:
    names = KnownNames({"Max Mark": "P1", "Anna Schmidt": "P2", "Anna Meier": "P3"})
    assert names.replace("max: 3\nsay: Hello Max!\n", yaml=True) == "max: 3\nsay: Hello P1!\n"
    assert names.replace("- {max: 3, say: Hello max: hi}", yaml=True) == "- {max: 3, say: Hello P1: hi}"
    assert [names.replace_key(key) for key in ("max_tokens", "mark", "mark_id")] == ["max_tokens", "mark", "mark_id"]
    assert names.replace_key("Max's desk") == "P1's desk"
    assert names.replace("Anna and ANNA SCHMIDT, anna-meier's") == "[name] and P2, P3's"
    german = KnownNames({"anna gross-müller": "W1"}, folders=("/srv/study",))
    assert german.replace("Anna Groß, Mueller, GROSS; in /srv/study/one") == "W1 W1, W1, W1; in ~/one"
    assert names.replace("Annabel climbs Maximum") == "Annabel climbs Maximum"


def test_initials_of_a_wizard_are_no_words(tmp_path: Path) -> None:
    trial = {"wizard": "AB", "participant": "P07", "condition": "AB"}
    folder = make_session(tmp_path / "s", seconds=1.0, cameras=(), audio=(), people=0, trial=trial).folder
    assert anonymise(folder, tmp_path / "out") == 0
    assert open_session(tmp_path / "out").trial == trial | {"wizard": "W1"}


def test_a_person_called_max_damages_no_value(tmp_path: Path) -> None:
    folder = make_session(tmp_path / "s", seconds=8.0, cameras=(), audio=(), people=0, llm_every_s=2.0).folder
    words = [word for name in ("Max", "Mark", "Mia Done", "Tour Guide") for word in ("--also-called", name)]
    assert anonymise(folder, tmp_path / "out", *words) == 0
    before, now = open_session(folder), open_session(tmp_path / "out")
    pairs = zip(before.arrivals(), now.arrivals(), strict=True)
    assert all((at_ns, spec) == (copied_ns, copied_spec) for (at_ns, spec, _), (copied_ns, copied_spec, _) in pairs)
    (exchange,) = [event for _, event in now.values("event/llm_exchange")][:1]
    assert exchange.parameters == {"temperature": 0.4, "max_tokens": 120}
    kinds = [{event.kind for _, event in session.values("event/marked")} for session in (before, now)]
    assert kinds[0] == kinds[1]
    opened = [event for _, event in now.values("event/scenario_opened")][-1]
    assert yaml.safe_load(opened.content).keys() == yaml.safe_load(
        [event for _, event in before.values("event/scenario_opened")][-1].content
    ).keys()  # fmt: skip
