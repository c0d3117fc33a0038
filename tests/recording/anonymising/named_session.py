"""Study with a session that has a rare name in every place where a name can be."""

import json
from contextlib import closing
from hashlib import sha256
from pathlib import Path
from typing import Any

from caris_desktop.domain.events import (
    AssistantChanged,
    ChatMessage,
    ConsentNoted,
    FaceChanged,
    GoalChanged,
    LlmExchange,
    Marked,
    PhotoTagged,
    PhotoTaken,
    PlacesChanged,
    Problem,
    RobotChosen,
    ScenarioOpened,
    StopRequested,
    UtteranceChanged,
    UtteranceCorrected,
)
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.schema import to_jsonable
from caris_desktop.people.people_store import About, PeopleStore
from caris_desktop.recording.annotation.annotation_editing import add_annotation, add_tier
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument
from caris_desktop.recording.annotation.annotation_store import save_coder
from caris_desktop.recording.photo_file import TAGS, with_texts
from caris_desktop.recording.session.manifest import write_manifest
from caris_desktop.recording.session.session_header import read_header, recorded_files
from caris_desktop.recording.session.session_reader import open_session
from tests.support.recorded_session import SECOND_NS, make_session, rerecorded

MET, GUEST = "Zoë Quillfeather", "Thaddeus Wobblethorpe"
WIZARD, OTHER_WIZARD, CODER = "Wilhelmina Drosselmeyer", "Xaver Nepomuk", "Ottokar Brambilla"
FRIEND, USER = "Ulysses Farthingale", "qwertzulrich"
NAMES = (MET, GUEST, WIZARD, OTHER_WIZARD, CODER, FRIEND, USER)
ADDRESS = "lab-seven.example.org"
SCENARIO = f"""format_version: 1
title: Tour with Quillfeather
places:
  wobblethorpe: {{x_m: 1.0, y_m: 2.0, heading_deg: 0.0}}
phrases:
  Greetings: [Hello {MET}]
"""


def make_study(study: Path, *, name: str = "2026-11-21_10-00-00_Thaddeus-Wobblethorpe") -> Path:
    """Session of a study with a people database; ``MET`` did not consent, the other person did."""
    made = make_session(
        study / "sessions" / name, seconds=9.0, cameras=("front",), fps=10.0, size_px=(320, 180), people=2,
        people_hz=5.0, person_every_s=0.0, scans_hz=1.0, beams=12, odometry_hz=2.0, map_cells=(10, 16),
        photo_every_s=3.0, utterance_every_s=1.5, llm_every_s=3.0, keep=True,
        trial={
            "study": f"Study of {MET}", "participant": GUEST, "condition": "with Wobblethorpe", "trial": "3",
            "wizard": WIZARD, "recording": "1", "purpose": "",
        },
    )  # fmt: skip
    folder = made.folder
    at_ns = made.plan.started_ns + 4 * SECOND_NS
    photo = f"photos/{MET.lower().replace(' ', '-')}.png"
    exchange = LlmExchange(
        at_ns, "x-9", "ollama", "llama", (ChatMessage("system", f"Be kind to {MET}."),), f"Hello {FRIEND}.", "answered",
        at_ns, None, {}, f"asked {GUEST}",
    )  # fmt: skip
    more: list[Any] = [
        *(
            UtteranceChanged(at_ns + n, "u-9", "robot", f"Hello {MET}, hello {{p-1}}.", "typed", state)
            for n, state in enumerate(("requested", "started", "finished"))
        ),
        UtteranceChanged(at_ns, "h-9", "participant", "I am zoe quillfeather", "heard", "started"),
        UtteranceChanged(at_ns + SECOND_NS, "h-9", "participant", "I am zoe quillfeather", "heard", "finished"),
        UtteranceCorrected(at_ns, "h-9", text=f"I am {MET}", tags=("Quillfeather",)),
        Marked(at_ns, f"{MET} laughs", note=f"asks for {FRIEND}", mark_id="m-9"),
        exchange,
        PhotoTaken(at_ns, "front", 40, photo, person_id="p-1"),
        PhotoTagged(at_ns, photo, (MET, "laughing")),
        PlacesChanged(at_ns, f"desk of {GUEST}", Pose2D(0.0, 0.0, 0.0)),
        GoalChanged(at_ns, "g-9", "active", Pose2D(0.0, 0.0, 0.0), f"desk of {GUEST}"),
        AssistantChanged(at_ns, "notes", text=f"{MET} likes art."),
        FaceChanged(at_ns, "happy", f"Hi {MET}"),
        Problem(at_ns, "info", "Saved.", f"It is in /home/{USER}/layout.yaml.", f"Ask {WIZARD}."),
        StopRequested(at_ns, f"wizard:{OTHER_WIZARD}"),
        RobotChosen(at_ns, "temi", "Temi", f"ws://{ADDRESS}:9090", f"name: temi\naddress: ws://{ADDRESS}:9090\n"),
        ScenarioOpened(at_ns, "tour.yaml", f"{MET}'s tour", sha256(SCENARIO.encode()).hexdigest(), SCENARIO),
        ConsentNoted(at_ns, "p-2", "video", True),
        ConsentNoted(at_ns, "p-2", "photo", True),
    ]
    rerecorded(made, sorted([*made.values, *((value.stamp_ns, value) for value in more)], key=lambda pair: pair[0]))
    texts = {TAGS: f"{MET}, laughing", "Description": FRIEND}
    (folder / photo).write_bytes(with_texts((folder / "photos" / "0001.png").read_bytes(), texts))
    (folder / "llm" / "0009.json").write_text(json.dumps(to_jsonable(exchange)))
    with (folder / "speech.txt").open("a") as file:
        file.write(f"10:00:00 4.0 robot: Hello {MET}\n")
    (folder / "notes.txt").write_text(f"{MET} came late.\n{WIZARD} was ill; {GUEST.upper()} went.\n")
    (folder / "console.log").write_text(f"INFO {OTHER_WIZARD} connected from {ADDRESS}\n")
    (folder / "interview").mkdir()
    (folder / "interview" / f"{GUEST}.m4a").write_bytes(b"\0\1" + GUEST.encode())
    (folder / "recovered").mkdir()
    (folder / "recovered" / "session.json.original").write_text(json.dumps({"trial": {"wizard": WIZARD}}))
    (folder / "derived" / "tables").mkdir(parents=True)
    (folder / "derived" / "tables" / "names.csv").write_text(MET)
    (folder / "export-1").mkdir()
    (folder / "export-1" / "names.csv").write_text(MET)
    document = add_tier(AnnotationDocument(), f"Gaze of {MET}", CODER)
    save_coder(folder, add_annotation(document, document.tiers[0].tier_id, 500, 1500, f"looks at {GUEST}"), CODER)
    header = read_header(folder)
    header = type(header)(**{**{name: getattr(header, name) for name in header.__dataclass_fields__}, "as_read": {}})
    raw = {
        **header.to_json(),
        "settings": {"voice": f"{MET}'s"},
        "robot": {"profile": "temi", "address": f"ws://{ADDRESS}:9090"},
    }
    raw["counts"] = {}
    raw["files"] = to_jsonable(recorded_files(folder))
    (folder / "session.json").write_text(json.dumps(raw, ensure_ascii=False))
    write_manifest(folder)
    assert open_session(folder).losses == ()
    with closing(PeopleStore(study / "people.sqlite")) as store:
        for person_id, about in (("p-1", About(name=MET, note="likes art")), ("p-2", About(group="b"))):
            new = store.add().person_id
            # As the recording has them.
            for table in ("people", "keys"):
                change = f"UPDATE {table} SET person_id = ? WHERE person_id = ?"  # noqa: S608 - our own names
                store._database.execute(change, (person_id, new))
            store._database.commit()
            store.describe(person_id, about)
        store.note_consent("p-2", "video", given=True)
        store.note_consent("p-2", "photo", given=True)
    return folder
