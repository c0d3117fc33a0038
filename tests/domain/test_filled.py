"""Localized texts with values: English in the recording, translated in the window."""

import ast
import json
import pickle
from collections.abc import Iterator
from pathlib import Path

import pytest

from caris_desktop.domain.events import Problem
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.json_encoding import to_message
from caris_desktop.domain.schema import to_jsonable
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.domain.translation import (
    QT_TR_NOOP,
    LocalizedText,
    joined,
    localized,
    parse_localized,
    tr,
    use_translator,
)
from caris_desktop.domain.yaml_files import yaml_text
from caris_desktop.live.service import localize_problem
from caris_desktop.ui.window_appearance import in_trial_language

GERMAN = {
    "The disk is slow: it took {delay} s.": "{delay} s hat die Festplatte gebraucht.",
    "{camera} broke off: {why}.": "{camera} brach ab: {why}.",
    "no answer": "keine Antwort",
    "%n pictures of {camera} are lost.": "%n Bilder von {camera} fehlen.",
}


@pytest.fixture
def german() -> Iterator[None]:
    use_translator(lambda text, _meant, _number: GERMAN.get(text, text))
    yield
    use_translator(None)


def broke_off(camera: str) -> LocalizedText:
    return localized("{camera} broke off: {why}.", camera=camera, why=localized("no answer"))


@pytest.mark.usefixtures("german")
def test_a_text_of_another_process_is_english_and_can_be_translated() -> None:
    text = pickle.loads(pickle.dumps(localized("The disk is slow: it took {delay} s.", delay=2.5)))  # noqa: S301
    assert text == "The disk is slow: it took 2.5 s."
    assert tr(text) == "2.5 s hat die Festplatte gebraucht."
    assert type(tr(text)) is str
    assert tr(broke_off("no answer")) == "no answer brach ab: keine Antwort.", "a name that reads like a text stays"


@pytest.mark.usefixtures("german")
def test_a_value_is_never_taken_for_a_text() -> None:
    evil = "{why} {camera.__class__} {0} %n {delay!r}"
    assert broke_off(evil) == f"{evil} broke off: no answer."
    assert tr(broke_off(evil)) == f"{evil} brach ab: keine Antwort."


@pytest.mark.usefixtures("german")
def test_a_marked_text_is_one_wherever_it_goes() -> None:
    """A marked text is translated as a value, from a table or an error, and after pickling; an equal name is not."""
    reasons = {"silent": QT_TR_NOOP("no answer")}
    whys = (reasons["silent"], ValueError(QT_TR_NOOP("no answer")), pickle.loads(pickle.dumps(reasons))["silent"])  # noqa: S301
    told = [tr(localized("{camera} broke off: {why}.", camera="no answer", why=why)) for why in whys]
    assert told == ["no answer brach ab: keine Antwort."] * 3
    assert tr(joined([QT_TR_NOOP("no answer"), "no answer"])) == "keine Antwort no answer"
    assert json.dumps(reasons) == '{"silent": "no answer"}'
    assert type(to_jsonable(reasons)["silent"]) is str
    assert yaml_text(reasons) == "silent: no answer\n"
    assert tr(QT_TR_NOOP("")) == ""


@pytest.mark.usefixtures("german")
def test_an_error_reports_it_on() -> None:
    assert tr(str(OSError(broke_off("Front")))) == "Front brach ab: keine Antwort."
    assert tr(localized("{why}", why=ValueError(localized("no answer")))) == "keine Antwort"
    assert tr(UserFacingError(broke_off("Front"), "", "").what) == "Front brach ab: keine Antwort."


def test_more_values_come_later() -> None:
    counted = localized("{count} pictures of {camera}", camera="Front")
    assert localized(counted, count=3) == "3 pictures of Front"
    assert localized(counted, count=3).template == "{count} pictures of {camera}"


@pytest.mark.usefixtures("german")
def test_the_number_of_one_and_many_goes_with_it() -> None:
    def of_one_and_many(text: str, _meant: str, number: int) -> str:
        return "Ein Bild von {camera} fehlt." if number == 1 else GERMAN.get(text, text).replace("%n", str(number))

    three, one = (
        localized(QT_TR_NOOP("%n pictures of {camera} are lost.", "", count), camera="the %n hall") for count in (3, 1)
    )
    use_translator(of_one_and_many)
    assert three == "3 pictures of the %n hall are lost."
    assert tr(pickle.loads(pickle.dumps(three))) == "3 Bilder von the %n hall fehlen."  # noqa: S301
    assert tr(localized("{what}", what=one)) == "Ein Bild von the %n hall fehlt."


@pytest.mark.usefixtures("german")
def test_the_record_has_it_in_english_and_as_plain_text() -> None:
    problem, plain = (Problem(1, "warning", what, "", "") for what in (broke_off("F"), "F broke off: no answer."))
    recorded = json.dumps(to_message(BY_TYPE[Problem], problem, at_utc_ns=1))
    assert recorded == json.dumps(to_message(BY_TYPE[Problem], plain, at_utc_ns=1))
    assert "{camera}" not in recorded


@pytest.mark.usefixtures("german")
def test_the_console_reports_it_in_the_wizards_language() -> None:
    sent = Problem(1, "warning", broke_off("Front"), "no answer", joined((broke_off("A"), "as it is")))
    here = localize_problem(pickle.loads(pickle.dumps(sent)))  # noqa: S301
    assert (here.what, here.meaning, here.advice) == (
        "Front brach ab: keine Antwort.", "keine Antwort", "A brach ab: keine Antwort. as it is",
    )  # fmt: skip
    use_translator(in_trial_language)
    assert localize_problem(sent).what.startswith("[Front bŕöķé".replace("ķ", "k")), localize_problem(sent).what


@pytest.mark.usefixtures("german")
def test_a_text_stored_as_plain_text_is_found_again() -> None:
    texts = (*GERMAN, "{camera}: {why}.")
    kept = (
        broke_off("the {hall}: left"), localized("%n pictures of {camera} are lost.", camera="A\nB"),
        localized(QT_TR_NOOP("%n pictures of {camera} are lost.", "", 3), camera="A\nB"),
    )  # fmt: skip
    told = [tr(parse_localized(str.__str__(json.loads(json.dumps(one))), texts)) for one in kept]
    assert told == ["the {hall}: left brach ab: keine Antwort.", kept[1], "3 Bilder von A\nB fehlen."]
    twice = parse_localized("A is A, not B.", ("{name} is {name}, not {other}.",))
    assert isinstance(twice, LocalizedText)
    assert (twice, twice.values) == ("A is A, not B.", {"name": "A", "other": "B"})
    for other in ("", "A is C, not B.", "of something else"):
        assert type(parse_localized(other, ("{name} is {name}, not {other}.",))) is str


ROOMS = ("robot", "recording", "perception", "conversation/listening", "conversation/voices", "app")
TOLD = {
    "AnnotationError", "CameraError", "DetectorAwayError", "EmbeddingModelError", "EngineUnavailableError",
    "ExportError", "ErasureStoppedError", "Gap", "NoAnswer", "NoEngineError", "NoSuchVoiceError",
    "OutletUnavailableError", "Problem", "RepairReport", "SecurityError", "SessionError", "UserFacingError",
    "UnknownFormError", "UnreadableMediaError", "WeightsError", "_away", "_miss", "_no",
    "_report_problem", "abort", "give_up", "problem", "unreachable",
}  # fmt: skip
"""Calls whose arguments the wizard reads."""
COLLECTED = ("self._sentences.append", "self._losses.append", "problems.append", "context.warn")
"""Calls that collect texts for the wizard."""
OF_THE_TERMINAL = ("recording/studies/", "recording/session/manifest.py", "recording/replay/video_reader.py")
"""Files that collect texts for the terminal, which is English."""


def glued(source: str, *, collects: bool = True) -> list[str]:
    """Concatenated texts that cannot be translated; ``collects``: collected texts are displayed."""
    found = []
    for call in (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)):
        told = [*call.args, *(one.value for one in call.keywords if one.arg != "searched")]
        called = ast.unparse(call.func)
        if called.rpartition(".")[2] in TOLD or (collects and called.endswith(COLLECTED)):
            parts = [part for one in told for part in ([one.body, one.orelse] if isinstance(one, ast.IfExp) else [one])]
            found += [ast.unparse(part) for part in parts if _is_glued(part)]
    return found


def _is_glued(part: ast.expr) -> bool:
    """True for a concatenation; a path uses a slash."""
    return isinstance(part, ast.JoinedStr) or (isinstance(part, ast.BinOp) and not isinstance(part.op, ast.Div))


def test_no_child_process_glues_what_it_reports() -> None:
    package = Path(__file__).parents[2] / "caris_desktop"
    files = [file for room in ROOMS for file in (package / room).rglob("*.py")]
    files += [package / "conversation" / f"{name}.py" for name in ("synthesis", "sound_devices", "embedded_server")]
    named = {file.relative_to(package).as_posix(): file.read_text("utf-8") for file in files}
    found = {name: glued(text, collects=not name.startswith(OF_THE_TERMINAL)) for name, text in named.items()}
    assert {name: texts for name, texts in found.items() if texts} == {}
    assert glued('raise CameraError(f"The camera {name} is away.", "Look.")') == ["f'The camera {name} is away.'"]
