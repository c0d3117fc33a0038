"""Methods sheet export: reporting items of a Wizard-of-Oz study, as Markdown and as a page."""

import re
from collections.abc import Sequence
from pathlib import Path

from caris_desktop.recording.exporters.methods_sheet import MethodsSheet, methods_sheet
from caris_desktop.recording.exporters.templates import write_page
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.recording.studies.data_quality import counted


def write_methods(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Write the sheet of one session as ``methods.md`` and ``methods.html``. Raises OSError, SessionError."""
    return write_methods_of_study([session], out, context)


def write_methods_of_study(sessions: Sequence[Session], out: Path, context: ExportContext) -> list[Path]:
    """Write one sheet for all ``sessions`` (at least one) into ``out``: ``methods.md`` and ``methods.html``.

    Practice sessions among them or in the same folders count as the wizards' training; all other values exclude them.
    Raises OSError, SessionError.
    """
    sheet = methods_sheet(sessions, context.progress)
    markdown = out / "methods.md"
    markdown.write_bytes(as_markdown(sheet).encode("utf-8", "replace"))
    page = write_page(out / "methods.html", "methods.html.j2", sheet=sheet)
    context.progress(1.0)
    return [markdown, page]


def as_markdown(sheet: MethodsSheet) -> str:
    """Sheet as Markdown; text from the recording is escaped."""
    lines = [f"# {_plain(sheet.title)}", "", sheet.about, "", f"To be filled in by hand: {_open(sheet)}.", ""]
    for section in sheet.sections:
        lines += [f"## {section.title}", ""]
        for item in section.items:
            lines.append(f"**{item.question}**")
            if item.answer:
                lines += ["", _plain(item.answer)]
            if item.answer and item.sources:
                lines += ["", f"*From {', '.join(f'`{source}`' for source in item.sources)}*"]
            if item.by_hand:
                lines += ["", f"- [ ] **To fill in by hand:** {item.by_hand}"]
            lines.append("")
    lines += [
        "## Paragraph for a paper", "", "Text in square brackets still has to be filled in.", "",
        _plain(sheet.paragraph), "",
    ]  # fmt: skip
    for appendix in sheet.appendices:
        fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", appendix.text)), default=0))
        lines += [f"## Appendix: {appendix.title}", "", appendix.about, "", fence, appendix.text, fence, ""]
    return "\n".join(lines)


def _open(sheet: MethodsSheet) -> str:
    return counted(sheet.open_items, "item")


def _plain(text: str) -> str:
    return re.sub(r"([\\`*_\[\]<>#|~])", r"\\\1", " ".join(text.split()))
