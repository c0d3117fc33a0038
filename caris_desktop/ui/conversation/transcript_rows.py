"""Rows of the transcript, computed from turns without a window."""

from collections.abc import Iterable, Mapping, Sequence

from caris_desktop.conversation.conversation_transcript import Turn, is_heard
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.corrections import WhoSpoke
from caris_desktop.domain.sound_values import Hearing
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.ui import text_formatting

NOT_SURE = QT_TR_NOOP("somebody")
ROBOT, WIZARD, PARTICIPANT = QT_TR_NOOP("robot"), QT_TR_NOOP("wizard"), QT_TR_NOOP("participant")


class TranscriptRow(Value):
    """Row of a turn. ``tentative`` words may still change. ``changeable``: the speaker can be corrected."""

    utterance_id: str
    begins_ns: int
    time: str
    who: str
    speaker: WhoSpoke
    text: str
    tentative: str = ""
    cut_short: bool = False
    heard_text: str | None = None
    tags: tuple[str, ...] = ()
    changeable: bool = False

    @property
    def words(self) -> str:
        """Whole text, including partial results."""
        return " ".join(filter(None, (self.text, self.tentative)))

    @property
    def spoken(self) -> str:
        """The turn and its state as text for a screen reader."""
        state = (
            tr("still being transcribed") if self.tentative else "",
            tr("cut short") if self.cut_short else "",
            tr("corrected") if self.heard_text is not None else "",
            ", ".join(self.tags),
        )
        sentence = tr("{time}, {who}: {words}").format(time=self.time, who=self.who, words=self.words)
        return " · ".join(part for part in (sentence, *state) if part)


class _Made(Value):
    """A row with its inputs."""

    turn: Turn
    hearing: Hearing | None
    named: object
    row: TranscriptRow


class RowMaker:
    """Makes rows from turns; unchanged rows are reused, as an hour has two thousand turns."""

    def __init__(self, anchor: ClockAnchor, *, with_tags: bool = True) -> None:
        self._anchor = anchor
        self._with_tags = with_tags
        self._made: dict[str, _Made] = {}

    def rows(
        self, turns: Iterable[Turn], names: Mapping[str, str], hearings: Mapping[str, Hearing]
    ) -> list[TranscriptRow]:
        """Rows of ``turns``, sorted by start; ``hearings``: partial results by utterance id."""
        made: dict[str, _Made] = {}
        for turn in turns:
            hearing = hearings.get(turn.utterance_id)
            if not turn.text and (hearing is None or not (hearing.committed or hearing.tentative)):
                continue
            named = names if "{" in turn.text else names.get(turn.person_id)
            before = self._made.get(turn.utterance_id)
            if before is None or before.turn is not turn or before.hearing is not hearing or before.named != named:
                before = _Made(turn, hearing, named, self._row(turn, names, hearing))
            made[turn.utterance_id] = before
        self._made = made
        return [each.row for each in made.values()]

    def _row(self, turn: Turn, names: Mapping[str, str], hearing: Hearing | None) -> TranscriptRow:
        def name_of(person_id: str) -> str:
            return names.get(person_id, tr(NOT_SURE))

        return TranscriptRow(
            turn.utterance_id,
            turn.begins_ns,
            text_formatting.clock_time(turn.begins_ns, self._anchor),
            who_spoke(turn.speaker, turn.person_id, names),
            turn.speaker,
            text_formatting.with_names(turn.text, name_of) if hearing is None else hearing.committed.strip(),
            "" if hearing is None else hearing.tentative.strip(),
            cut_short=turn.state == "interrupted",
            heard_text=turn.heard_text,
            tags=turn.tags if self._with_tags else (),
            changeable=is_heard(turn),
        )


def who_spoke(speaker: WhoSpoke, person_id: str, names: Mapping[str, str]) -> str:
    """Speaker as text: a participant's name or number if known."""
    match speaker:
        case "robot":
            return tr(ROBOT)
        case "wizard":
            return tr(WIZARD)
        case "participant":
            return names.get(person_id, tr(PARTICIPANT))
        case _:
            return tr(NOT_SURE)


def found_in(rows: Sequence[TranscriptRow], query: str) -> list[int]:
    """Rows that contain all words of the query in text, speaker or tags."""
    query_words = query.casefold().split()
    if not query_words:
        return []
    return [
        number
        for number, row in enumerate(rows)
        if all(word in " ".join((row.words, row.who, *row.tags)).casefold() for word in query_words)
    ]
