"""What the Conversation panel says of each turn, worked out from the turns without a window."""

from collections.abc import Iterable, Mapping, Sequence

from caris_desktop.conversation.transcript import Turn, is_heard
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.corrections import WhoSpoke
from caris_desktop.domain.sound import Hearing
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import dataclass
from caris_desktop.ui import words

NOT_SURE = QT_TR_NOOP("somebody")
ROBOT, WIZARD, PARTICIPANT = QT_TR_NOOP("robot"), QT_TR_NOOP("wizard"), QT_TR_NOOP("participant")


@dataclass(frozen=True, slots=True)
class TranscriptRow:
    """One turn as it stands there. ``tentative`` words may still change. ``changeable``: who said it may be wrong."""

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
        """All of the words, also those that may still change."""
        return " ".join(filter(None, (self.text, self.tentative)))

    @property
    def spoken(self) -> str:
        """The whole turn with what the look of it says, as a screen reader says it."""
        state = (
            tr("still being made out") if self.tentative else "",
            tr("cut short") if self.cut_short else "",
            tr("corrected") if self.heard_text is not None else "",
            ", ".join(self.tags),
        )
        said = tr("{time}, {who}: {words}").format(time=self.time, who=self.who, words=self.words)
        return " · ".join(part for part in (said, *state) if part)


@dataclass(frozen=True, slots=True)
class _Made:
    """A row with what it was made from."""

    turn: Turn
    hearing: Hearing | None
    named: object
    row: TranscriptRow


class RowMaker:
    """Makes rows of turns, each only once as long as nothing of it changes: an hour has two thousand of them."""

    def __init__(self, anchor: ClockAnchor, *, with_tags: bool = True) -> None:
        self._anchor = anchor
        self._with_tags = with_tags
        self._made: dict[str, _Made] = {}

    def rows(
        self, turns: Iterable[Turn], names: Mapping[str, str], heard: Mapping[str, Hearing]
    ) -> list[TranscriptRow]:
        """``turns`` in the order in which they began; ``heard`` is what is made out of one under way, by its id."""
        made: dict[str, _Made] = {}
        for turn in turns:
            hearing = heard.get(turn.utterance_id)
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
            words.clock_time(turn.begins_ns, self._anchor),
            who_spoke(turn.speaker, turn.person_id, names),
            turn.speaker,
            words.with_names(turn.text, name_of) if hearing is None else hearing.committed.strip(),
            "" if hearing is None else hearing.tentative.strip(),
            cut_short=turn.state == "interrupted",
            heard_text=turn.heard_text,
            tags=turn.tags if self._with_tags else (),
            changeable=is_heard(turn),
        )


def who_spoke(speaker: WhoSpoke, person_id: str, names: Mapping[str, str]) -> str:
    """The name or number of a participant where it is known who it was."""
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
    """The rows that have every word of the query, in what was said, who said it, or the tags."""
    asked = query.casefold().split()
    if not asked:
        return []
    return [
        number
        for number, row in enumerate(rows)
        if all(word in " ".join((row.words, row.who, *row.tags)).casefold() for word in asked)
    ]
