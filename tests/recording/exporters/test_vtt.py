"""Captions, read with webvtt-py."""

import html
import json
from pathlib import Path
from typing import Any

import webvtt

from caris_desktop.recording.session_export import export_session
from tests.recording.minute import S, everything, make_session, said, utterance


def captions(path: Path) -> list[tuple[float, float, str | None, str]]:
    def seconds(time: Any) -> float:
        return time.hours * 3600 + time.minutes * 60 + time.seconds + time.milliseconds / 1000

    # webvtt-py does not unescape cue text.
    return [
        (seconds(one.start_time), seconds(one.end_time), one.voice, html.unescape(one.text))
        for one in webvtt.read(str(path))
    ]


def exported(session: Path, out: Path) -> Path:
    export_session(session, "vtt", out)
    return out


def test_utterances_are_captioned_with_their_speaker(tmp_path: Path) -> None:
    make_session(tmp_path / "s", everything)
    out = exported(tmp_path / "s", tmp_path / "out")
    assert captions(out / "captions.vtt") == [
        (5.0, 7.5, "Robot", "Welcome to the lab."),
        (12.0, 13.0, "Participant", "Ünïcode \U0001f916 \ufffd & <b>"),
    ], "without what was never said"
    assert captions(out / "captions-robot.vtt") == [(5.0, 7.5, "Robot", "Welcome to the lab.")]
    assert len(captions(out / "captions-participant.vtt")) == 1
    assert {path.name for path in out.iterdir()} == {"captions.vtt", "captions-robot.vtt", "captions-participant.vtt"}
    assert "Times are relative to the start of the session s" in (out / "captions.vtt").read_text(encoding="utf-8")


def test_each_video_has_captions_by_its_own_time(tmp_path: Path) -> None:
    def values(begin_ns: int) -> list[Any]:
        return [
            *said(begin_ns, at_s=1.0, for_s=1.0, text="before"),
            *said(begin_ns, at_s=3.0, for_s=2.0, text="across"),
            *said(begin_ns, at_s=10.0, for_s=2.5, text="within"),
            *said(begin_ns, at_s=30.0, for_s=1.0, text="after"),
        ]

    begin_ns = make_session(tmp_path / "s", values)
    header = json.loads((tmp_path / "s" / "session.json").read_text())
    first = {"camera": "front", "first_stamp_ns": begin_ns + 4 * S, "last_stamp_ns": begin_ns + 20 * S}
    second = {"camera": "up", "first_stamp_ns": begin_ns + 9 * S + 500_000_000, "last_stamp_ns": begin_ns + 60 * S}
    header["videos"] = [
        {"file_name": "video-front.mp4", **first},
        {"file_name": "../captions.mp4", **second},
        {"file_name": 7},
        "damaged",
    ]
    (tmp_path / "s" / "session.json").write_text(json.dumps(header))
    out = exported(tmp_path / "s", tmp_path / "out")
    assert captions(out / "video-front.vtt") == [(0.0, 1.0, "Robot", "across"), (6.0, 8.5, "Robot", "within")]
    assert captions(out / "video-captions.vtt") == [(0.5, 3.0, "Robot", "within"), (20.5, 21.5, "Robot", "after")]
    assert "at second 4.000 of s" in (out / "video-front.vtt").read_text(encoding="utf-8")


def test_no_text_breaks_out_of_its_cue(tmp_path: Path) -> None:
    nasty = "a\n\nb --> 00:00:01.000 </v><i>x</i> &amp;\r\n\tNOTE c\u2028d"
    told: dict[str, Any] = {"utterance_id": "id with\n\nline --> and spaces", "text": nasty}
    make_session(
        tmp_path / "s",
        lambda begin_ns: [
            utterance(begin_ns + S, "started", **told),
            utterance(begin_ns + 2 * S, "interrupted", **told),
            utterance(begin_ns + 5 * S, "finished", utterance_id="heard", text="Yes.", speaker="participant"),
        ],
    )
    out = exported(tmp_path / "s", tmp_path / "out")
    first, second = captions(out / "captions.vtt")
    assert first == (1.0, 2.0, "Robot", "a b -> 00:00:01.000 </v><i>x</i> &amp; NOTE c d")
    assert second == (5.0, 7.0, "Participant", "Yes."), "of which only one moment is known"
    assert "<v.interrupted Robot>" in (out / "captions.vtt").read_text(encoding="utf-8")


def test_a_silent_session_has_a_file_without_captions(tmp_path: Path) -> None:
    make_session(tmp_path / "s", lambda _: [])
    out = exported(tmp_path / "s", tmp_path / "out")
    assert captions(out / "captions.vtt") == []
