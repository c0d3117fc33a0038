"""Methods sheet export: reporting items of a Wizard-of-Oz study, as Markdown and as a page.

The questions of its template are those of the reporting guidelines of Riek, "Wizard of Oz Studies in HRI: A Systematic
Review and New Reporting Guidelines", Journal of Human-Robot Interaction 1(1), 2012, and what journals require on
language models. Nothing is invented: what the recording lacks is marked for the researcher.
"""

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from caris_desktop.recording.exporters.methods_facts import methods_facts
from caris_desktop.recording.exporters.templates import write_own_page, write_page
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.recording.study_file import write_citation


def write_methods_of_study(sessions: Sequence[Session], out: Path, context: ExportContext) -> list[Path]:
    """Write one sheet for all ``sessions`` (at least one) into ``out``: ``methods.md`` and ``methods.html``, or the one
    that the researcher's template makes.

    Practice sessions among them or in the same folders count as the wizards' training; all other values exclude them.
    Raises OSError, SessionError, ExportError.
    """
    facts = methods_facts(sessions, lambda share: context.progress(0.95 * share))
    years = [datetime.fromisoformat(session.clock.utc(session.started_ns)).year for session in sessions]
    facts |= {"study": context.study, "citation": context.study.citation(max(years)) if context.study else ""}
    if context.template is not None:
        paths = [write_own_page(out, "methods", context.template, **facts)]
    else:
        layouts = (f"methods{suffix}" for suffix in (".md", ".html"))
        paths = [write_page(out / layout, "methods.j2", layout=f"{layout}.j2", **facts) for layout in layouts]
    if context.study is not None:
        paths.append(write_citation(out, context.study))
    context.progress(1.0)
    return paths
