"""Text building blocks of the methods sheet: counts, lists and names in correct singular and plural."""

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime

from caris_desktop.domain.events import ReplyMeans
from caris_desktop.domain.foreign_json import parse_json
from caris_desktop.recording.measures.distributions import SummaryStats, quantile, share_at_once
from caris_desktop.recording.session.responses import AT_ONCE_S
from caris_desktop.recording.session.session_reader import Session

SEEN = (
    ("frame", "the video of the robot's camera"),
    ("people", "boxes around the people detected in it"),
    ("map", "a map"),
    ("pose", "the robot's position on it"),
    ("scan", "the LIDAR scan"),
    ("people_in_map", "people's positions on the map"),
    ("head", "the orientation of the robot's head"),
    ("battery", "the robot's battery charge"),
)
CAN = (
    ("driving", "drive the robot"),
    ("assistant", "ask a language model"),
    ("photos", "take photos"),
    ("naming_people", "name people"),
    ("robot_controls", "use further robot controls"),
    ("transcription", "read the transcript"),
    ("own_voice", "speak through the robot with their own voice"),
    ("face", "change the robot's face"),
)
ORIGIN_WORDS = {
    "typed": "typed by the wizard",
    "phrase": "prepared phrases",
    "suggestion": "suggested replies that the wizard chose",
    "assistant": "answers of the language model that the wizard approved",
    "filler": "fillers",
    "dictated": "dictated by the wizard",
    "own_voice": "in the wizard's own voice",
    "heard": "unprompted robot speech",
}
SOURCE_WORDS = {
    "keyboard": "the keyboard",
    "gamepad": "a gamepad",
    "onscreen": "on-screen buttons",
    "rehearsal": "a rehearsed script",
}
_NUMBERS = (
    "no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve",
)  # fmt: skip


def number_of(count: int, one: str, many: str = "") -> str:
    """``no sessions``, ``one session``, ``twelve sessions``, ``13 sessions``."""
    return f"{number_word(count)} {one if count == 1 else many or one + 's'}"


def number_word(count: int) -> str:
    """``one``, ``twelve``, ``13``."""
    return _NUMBERS[count] if count < len(_NUMBERS) else str(count)


def times_word(count: int) -> str:
    return {0: "never", 1: "once", 2: "twice"}.get(count, f"{number_word(count)} times")


def was_or_were(count: int) -> str:
    return "was" if count == 1 else "were"


def listing(parts: Sequence[str], last: str = "and") -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return f" {last} ".join(part for part in (", ".join(parts[:-1]), *parts[-1:]) if part)


def listing_counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{name}: {count}" for name, count in counts.items())


def share_words(origins: dict[str, int]) -> str:
    total = sum(origins.values())
    return listing([f"{count / total:.0%} {ORIGIN_WORDS.get(name, name)}" for name, count in origins.items()])


def distinct(values: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(value for value in values if value))


def statistics_words(spread: SummaryStats) -> str:
    sd = "" if spread.sd is None else f", SD {spread.sd:.2f} s"
    return f"n = {spread.n}" if spread.n == 1 else f"n = {spread.n}, mean {spread.mean:.2f} s{sd}"


def spread_words(spread: SummaryStats) -> str:
    if spread.n == 1:
        return f"{spread.median:.2f} s (n = 1)"
    return f"median {spread.median:.2f} s ({statistics_words(spread)}, {spread.smallest:.2f} to {spread.largest:.2f} s)"


MEANS_WORDS: dict[ReplyMeans, str] = {
    "typed": "typed", "phrase": "a phrase", "suggestion": "a suggestion", "edited_suggestion": "an edited suggestion",
    "filler": "a filler", "assistant": "an assistant answer", "own_voice": "the wizard's own voice",
    "dictated": "dictated",
}  # fmt: skip


def gaps_words(gaps_s: Sequence[float]) -> str:
    """Distribution of response gaps as text; empty if there are none."""
    if not gaps_s:
        return ""
    lower, middle, upper = (quantile(gaps_s, share) or 0.0 for share in (0.25, 0.5, 0.75))
    overlaps = sum(gap_s < 0.0 for gap_s in gaps_s)
    return (
        f"Gaps before the first sound of an answer: median {middle:.2f} s, quartiles {lower:.2f} and {upper:.2f} s,"
        f" {round(100 * (share_at_once(gaps_s) or 0.0))} % under {AT_ONCE_S:g} s,"
        f" {overlaps} of {len(gaps_s)} overlapping."
    )


def settings_words(text: str) -> str:
    """Sent parameters as text: ``temperature 0.3, max_tokens 48``."""
    return ", ".join(f"{name} {value}" for name, value in parse_json(text).items()) or "the model's defaults"


def days_words(sessions: Iterable[Session]) -> str:
    """``21 November 2026``, or the first and the last day."""
    days = sorted(session.clock.anchor.utc_ns_at(session.started_ns) // 1_000_000_000 for session in sessions)
    if not days:
        return ""
    first, last = (datetime.fromtimestamp(moment, UTC) for moment in (days[0], days[-1]))
    if first.date() == last.date():
        return f"{first.day} {first:%B %Y}"
    return f"{first.day} {first:%B %Y} to {last.day} {last:%B %Y}"
