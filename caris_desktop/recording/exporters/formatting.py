"""Formatting of values in texts: functions for reports, which templates use as filters."""

import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime

from markupsafe import Markup

from caris_desktop.domain.actor import in_words
from caris_desktop.domain.foreign_json import parse_json
from caris_desktop.recording.measures.distributions import SummaryStats, quantile
from caris_desktop.recording.measures.session_measures import THIS_COMPUTER, ModelUse
from caris_desktop.recording.session.session_header import clock_text
from caris_desktop.recording.studies.data_quality import stream_words

_NUMBERS = (
    "no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve",
)  # fmt: skip
_MARKDOWN = re.compile(r"([\\`*_\[\]<>#|~])")


def number(count: float) -> str:
    """``one``, ``twelve``, ``13``."""
    return _NUMBERS[int(count)] if count < len(_NUMBERS) else str(int(count))


def plural(count: float, one: str, many: str = "") -> str:
    """``no sessions``, ``one session``, ``twelve sessions``, ``13 sessions``."""
    return f"{number(count)} {one if count == 1 else many or one + 's'}"


def counted(count: float, one: str, many: str = "") -> str:
    """``no stops``, ``1 stop``, ``3 stops``."""
    return f"{int(count) or 'no'} {one if count == 1 else many or one + 's'}"


def times(count: float) -> str:
    """``never``, ``once``, ``twice``, ``three times``."""
    return {0: "never", 1: "once", 2: "twice"}.get(int(count), f"{number(count)} times")


def was(count: float) -> str:
    """``was``, ``were``."""
    return "was" if count == 1 else "were"


def join_words(parts: Iterable[str], last: str = "and") -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    parts = list(parts)
    return f" {last} ".join(part for part in (", ".join(parts[:-1]), *parts[-1:]) if part)


def counts(labelled: Mapping[str, float]) -> str:
    """``slip: 2, late: 1``."""
    return ", ".join(f"{label}: {count}" for label, count in labelled.items())


def most_common(labelled: Mapping[str, float]) -> dict[str, float]:
    """The same, the largest first."""
    return dict(sorted(labelled.items(), key=lambda entry: -entry[1]))


def capitalized(text: str) -> str:
    """Text with a capital first letter; the others stay as they are."""
    return text[:1].upper() + text[1:]


def percent(share: float) -> str:
    """``67%``."""
    return f"{share:.0%}"


def duration(seconds: float) -> str:
    """``4.2 s``, ``3 min 12 s``, ``1 h 05 min``."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    total_s = round(seconds)
    if total_s < 3600:
        return f"{total_s // 60} min {total_s % 60:02d} s"
    return f"{total_s // 3600} h {total_s % 3600 // 60:02d} min"


def distance(metres: float) -> str:
    """``0.4 m``, ``12 m``, ``1.3 km``."""
    if metres >= 1000:
        return f"{metres / 1000:.1f} km"
    return f"{metres:.1f} m" if metres < 10 else f"{metres:.0f} m"


def statistics(seconds: Sequence[float]) -> str:
    """``n = 3, mean 1.20 s, SD 0.30 s``."""
    spread = SummaryStats.of(seconds)
    if spread is None or spread.n == 1:
        return f"n = {len(seconds)}"
    return f"n = {spread.n}, mean {spread.mean:.2f} s, SD {spread.sd:.2f} s"


def spread(seconds: Sequence[float]) -> str:
    """``median 1.10 s (n = 3, mean 1.20 s, SD 0.30 s, 0.90 to 1.60 s)``; for at least one value."""
    if len(seconds) == 1:
        return f"{seconds[0]:.2f} s (n = 1)"
    median = quantile(seconds, 0.5)
    return f"median {median:.2f} s ({statistics(seconds)}, {min(seconds):.2f} to {max(seconds):.2f} s)"


def days(utc_ns: Iterable[int]) -> str:
    """``21 November 2026``, or the first and the last day; empty without any."""
    moments = sorted(utc_ns)
    if not moments:
        return ""
    first, last = (f"{day.day} {day:%B %Y}" for day in (_utc(moments[0]), _utc(moments[-1])))
    return first if first == last else f"{first} to {last}"


def moment(utc_ns: int) -> str:
    """``21 November 2026, 10:00 UTC``."""
    return f"{days([utc_ns])}, {_utc(utc_ns):%H:%M} UTC"


def _utc(utc_ns: int) -> datetime:
    return datetime.fromtimestamp(utc_ns // 1_000_000_000, UTC)


def settings(text: str) -> str:
    """Parameters of a language model, from JSON: ``temperature 0.3, max_tokens 48``."""
    return ", ".join(f"{name} {value}" for name, value in parse_json(text).items()) or "the model's defaults"


def model_name(model: ModelUse, remark: str = "") -> str:
    """``smollm2-135m, q8_0 (embedded, on this computer)``, ``gpt-4o (openai, at api.openai.com; a remark)``."""
    named = ", ".join(part for part in (model.model, model.version) if part) or "not specified"
    where = f"on {model.place}" if model.place == THIS_COMPUTER else f"at {model.place}"
    kind = ", ".join(part for part in (model.provider, where if model.place else "server not specified") if part)
    return f"{named} ({kind}{f'; {remark}' if remark else ''})"


def px(value: float) -> str:
    """``12.5``: at most two decimals."""
    return f"{value:.2f}".rstrip("0").rstrip(".")


def compact(markup: str) -> Markup:
    """Elements without the line breaks between them."""
    return Markup(re.sub(r">\s+<", "><", markup.strip()))  # noqa: S704 - escaped before


def squeeze(text: str) -> str:
    """Text on one line, with single spaces."""
    line = " ".join(text.split())
    return Markup(line) if isinstance(text, Markup) else line  # noqa: S704 - escaped before


def markdown_escaped(text: object) -> Markup:
    """Text whose characters have no meaning in Markdown."""
    if isinstance(text, Markup):
        return text
    return Markup(_MARKDOWN.sub(r"\\\1", str(text)))  # noqa: S704 - the escaping


def fence(text: str) -> str:
    """Fence of a Markdown block for any text: longer than each run of backticks inside."""
    return "`" * max(3, 1 + max((len(run) for run in re.findall("`+", text)), default=0))


FILTERS = {
    function.__name__: function
    for function in (
        number, plural, counted, times, was, join_words, counts, most_common, capitalized, percent, duration, distance,
        statistics, spread, quantile, days, moment, settings, model_name, stream_words, squeeze, fence,
        px, compact,
    )
} | {"actor": in_words, "clock": clock_text, "stats": SummaryStats.of}  # fmt: skip
