"""HTML and Markdown texts from templates, the program's and researchers' own, with functions that format values.

Values are escaped.
"""

import re
import sys
import traceback
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from statistics import fmean, median, stdev
from types import FrameType
from typing import Any

import numpy as np
from markupsafe import Markup

from caris_desktop.domain.actor import in_words
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.shipped import resources_dir
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.measures.session_measures import THIS_COMPUTER, ModelUse
from caris_desktop.recording.session.session_header import clock_text
from caris_desktop.recording.session_export import ExportError
from caris_desktop.recording.studies.data_quality import stream_words


class SummaryStats(Value):
    """Distribution of values. ``sd`` is the sample standard deviation, None for a single value."""

    n: int
    mean: float
    sd: float | None
    median: float
    smallest: float
    largest: float

    @classmethod
    def of(cls, values: Sequence[float]) -> "SummaryStats | None":
        """None for no values."""
        if not values:
            return None
        return cls(
            n=len(values),
            mean=fmean(values),
            sd=stdev(values) if len(values) > 1 else None,
            median=median(values),
            smallest=min(values),
            largest=max(values),
        )


def quantile(values: Sequence[float], share: float) -> float | None:
    """Quantile; None for no values."""
    return float(np.quantile(values, share)) if values else None


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


OF_FORMAT = {"methods": "methods.j2", "html": "report.html.j2"}
"""Template of each format that takes a researcher's own."""
# Characters that XML and HTML forbid; a recogniser or a robot may send anything.
_CONTROLS = {code: "\ufffd" for code in (*range(0x20), 0x7F) if chr(code) not in "\t\n\r"}
# A template from elsewhere must not occupy the computer for long. The report of an hour needs 1.6 million steps.
_MOST_STEPS = 20_000_000
_MOST_BYTES = 1_000_000


def write_page(path: Path, template: str, **values: Any) -> Path:
    """Fill ``resources/templates/TEMPLATE`` and write it as UTF-8: Markdown if ``path`` ends with .md, else HTML.

    Raises OSError.
    """
    return _write(path, _environment(path.suffix, []).get_template(template).render(**values))


def write_own_page(out: Path, name: str, template: Path, /, **values: Any) -> Path:
    """Fill a researcher's ``template`` with the data ``values`` and write it into ``out`` as NAME.md or NAME.html.

    It is run in a sandbox and includes files of its own folder and shipped ones. Raises OSError, ExportError.
    """
    path = out / f"{name}{suffix_of(template)}"
    steps = 0

    def count(_frame: FrameType, _event: str, _arg: Any) -> Any:
        nonlocal steps
        steps += 1
        if steps > _MOST_STEPS:
            raise OverflowError("the template does not come to an end")
        return count

    before = sys.gettrace()
    try:
        found = _own(template)
        sys.settrace(count)
        text = found.render(**values, layout=f"{name}{path.suffix}.j2")
    except Exception as error:
        raise _mistake(template, error) from error
    finally:
        sys.settrace(before)
    return _write(path, text)


def check_template(template: Path) -> None:
    """Raise ExportError if a researcher's template cannot be read or has wrong syntax."""
    suffix_of(template)
    try:
        _own(template)
    except Exception as error:
        raise _mistake(template, error) from error


def suffix_of(template: Path) -> str:
    """``.md`` or ``.html``, from the name of a researcher's template. Raises ExportError for another name."""
    for suffix in (".md", ".html"):
        if template.name.endswith(f"{suffix}.j2"):
            return suffix
    named = QT_TR_NOOP(
        "{template}: the name of a template ends with .md.j2 or .html.j2, which says what it makes. Nothing was "
        "written; rename it."
    )
    raise ExportError(named, template=template)


def _own(template: Path) -> Any:
    import jinja2

    folder = template.resolve().parent

    def load(name: str) -> str | tuple[str, str, None] | None:
        path = (folder / name).resolve()
        if not path.is_relative_to(folder) or not path.is_file():
            return None
        if path.stat().st_size > _MOST_BYTES:
            raise ValueError(f"{path.name} is larger than {_MOST_BYTES} bytes")
        return path.read_text("utf-8"), str(path), None

    loader = jinja2.FunctionLoader(load)
    if not template.is_file():
        raise FileNotFoundError("there is no such file")
    return _environment(suffix_of(template), [loader]).get_template(template.resolve().name)


def _environment(suffix: str, loaders: list[Any]) -> Any:
    import jinja2
    from jinja2.sandbox import ImmutableSandboxedEnvironment

    class Environment(ImmutableSandboxedEnvironment):
        intercepted_binops = frozenset(("*", "**"))

        def call_binop(self, context: Any, operator: str, left: Any, right: Any) -> Any:
            if operator == "**" or not (isinstance(left, int | float) and isinstance(right, int | float)):
                raise OverflowError(f"{operator} is for numbers that stay small")
            return super().call_binop(context, operator, left, right)

    environment = Environment(
        loader=jinja2.ChoiceLoader([*loaders, jinja2.FileSystemLoader(resources_dir() / "templates")]),
        autoescape=True,
        # Values that are escaped for Markdown are not escaped again.
        finalize=markdown_escaped if suffix == ".md" else None,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= FILTERS
    return environment


def _write(path: Path, text: str) -> Path:
    # Lone surrogates from input methods cannot be encoded.
    path.write_bytes(text.translate(_CONTROLS).encode("utf-8", "replace"))
    return path


def _mistake(template: Path, error: Exception) -> ExportError:
    """What is wrong in which line, in the template itself or in a file that it includes."""
    import jinja2

    if isinstance(error, ExportError):
        return error
    places = [(frame.filename, frame.lineno) for frame in traceback.extract_tb(error.__traceback__)]
    place: tuple[str, int | None] = next((each for each in reversed(places) if each[0].endswith(".j2")), ("", None))
    if isinstance(error, jinja2.TemplateSyntaxError):
        place = error.filename or "", error.lineno
    why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    if isinstance(error, jinja2.TemplateNotFound):
        why = f"there is no file {error.name} in the folder of the template"
    where = localized(QT_TR_NOOP("{file}, line {line}"), file=place[0] or template, line=place[1] or 1)
    wrong = QT_TR_NOOP("{where}: {why}. Nothing was written; correct the template and export again.")
    return ExportError(wrong, where=where, why=why.rstrip("."))
