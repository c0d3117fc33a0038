"""A methods sheet as its reader finds it in the Markdown file."""

import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from caris_desktop.recording.exporters.methods import write_methods_of_study
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext


@dataclass(frozen=True)
class Item:
    """Answer to a question, without the escaping of Markdown."""

    answer: str = ""
    sources: tuple[str, ...] = ()
    by_hand: str = ""


@dataclass(frozen=True)
class Sheet:
    """The whole sheet: items by question."""

    items: dict[str, Item] = field(default_factory=dict)
    paragraph: str = ""
    prompts: tuple[str, ...] = ()

    @property
    def answers(self) -> dict[str, str]:
        return {question: item.answer for question, item in self.items.items()}


def sheet_of(sessions: Sequence[Session]) -> Sheet:
    with tempfile.TemporaryDirectory() as out:
        write_methods_of_study(sessions, Path(out), ExportContext())
        text = (Path(out) / "methods.md").read_text("utf-8")
    text, *appendices = text.split("\n## Appendix: ")
    questions, paragraph = text.split(
        "\n## Paragraph for a paper\n\nText in square brackets still has to be filled in.\n"
    )
    items = {}
    for part in re.split(r"\n(?=\*\*)", questions)[1:]:
        part = part.split("\n## ")[0]  # noqa: PLW2901
        question, *lines = filter(None, part.splitlines())
        by_hand = [line.removeprefix("- [ ] **To fill in by hand:** ") for line in lines if line.startswith("- [ ] ")]
        sources = [re.findall("`([^`]+)`", line) for line in lines if line.startswith("*From ")]
        answer = [line for line in lines if not line.startswith(("- [ ] ", "*From "))]
        items[question.strip("*")] = Item(_plain(*answer), tuple(*sources), _plain(*by_hand))
    prompts = tuple(text.partition("```\n")[2].rpartition("\n```")[0] for text in appendices)
    return Sheet(items, _plain(paragraph.strip()), prompts)


def _plain(text: str = "") -> str:
    return re.sub(r"\\(.)", r"\1", text)
