"""HTML and Markdown texts from templates, the program's and researchers' own; values are escaped."""

import sys
import traceback
from pathlib import Path
from types import FrameType
from typing import Any

from caris_desktop.domain.shipped import resources_dir
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.recording.session_export import ExportError

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

    from caris_desktop.recording.exporters.formatting import FILTERS, markdown_escaped

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
