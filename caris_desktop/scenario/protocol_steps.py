"""Study protocol of a scenario: steps, their content, and branches."""

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated, Literal

from caris_desktop.domain.schema_fields import FieldSpec, Problem
from caris_desktop.domain.schema_validation import allowed_words
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value, setting

MOST_BRANCHES = 9
"""One for each digit."""
END = "end"
"""Nothing comes after this step."""
_SECONDS = 60.0

_Title = Annotated[str, FieldSpec(shortest=1, longest=60)]


class Branch(Value):
    """A possible action of the participant, and the step that follows."""

    title: _Title
    """Action of the participant; the text of its button."""
    to: str = setting(title="Next step", refers=("protocol", "steps", "title"), shortest=1, longest=60)
    """The step that follows, by title or id."""


class ProtocolStep(Value):
    """One step of the protocol."""

    title: _Title
    """Title in the window, in the recording and in every table."""
    id: str = setting(
        default="",
        pattern="^([a-z0-9][a-z0-9_-]*)?$",
        allowed="lower-case letters, digits, - and _.",
        longest=40,
        quiet=True,
    )
    """Short name that stays the same when the title changes; derived from the title if not given."""
    say: str = setting(default="", longest=500, quiet=True)
    """Sentence that the robot says in this step, with one key. A sentence of `phrases` includes its gesture and
    face."""
    go_to: str = setting(default="", refers=("places", "name"), longest=80, quiet=True)
    """The one of the `places` that belongs to the step."""
    minutes: float = setting(default=0.0, unit="minutes", at_least=0, at_most=600, quiet=True)
    """Expected duration; 0.5 is half a minute, 0 means no expected duration."""
    tick: tuple[Annotated[str, FieldSpec(shortest=1, longest=80)], ...] = setting(
        default=(), title="To tick off", longest=12, unique=True, quiet=True
    )
    """Items that the wizard ticks off in this step."""
    branches: tuple[Branch, ...] = setting(default=(), longest=MOST_BRANCHES, quiet=True)
    """Alternative next steps, depending on what the participant does."""
    then: str = setting(default="", refers=("protocol", "steps", "title"), else_one_of=(END,), longest=60, quiet=True)
    """The step that follows, by title or id, or `end`; if not given, the step below."""
    note: str = setting(default="", longest=500, quiet=True)
    """A reminder for the wizard, shown with the step."""

    @property
    def step_id(self) -> str:
        return self.id or _id_from(self.title)

    @property
    def expected_s(self) -> float:
        """Expected duration; zero if none is given."""
        return self.minutes * _SECONDS


class ProtocolSettings(Value):
    """The steps of the study, in order. The wizard may go to any step at any time, and the steps taken are recorded."""

    steps: tuple[ProtocolStep, ...] = setting(default=(), longest=60)
    """The steps, in order."""
    begins: Literal["with_recording", "by_hand"] = setting(default="with_recording", quiet=True)
    """The first step starts with the recording, or when the wizard goes to it."""


def step_named(steps: Iterable[ProtocolStep], name: str) -> ProtocolStep | None:
    """Step by id, else by title."""
    steps = tuple(steps)
    by_id = (step for step in steps if step.step_id == name)
    by_title = (step for step in steps if step.title.casefold() == name.casefold())
    return next(by_id, None) or next(by_title, None)


def step_after(steps: Sequence[ProtocolStep], step: ProtocolStep) -> ProtocolStep | None:
    """Next step without a branch; None after the last one."""
    if step.then:
        return step_named(steps, step.then)
    following = steps.index(step) + 1
    return steps[following] if following < len(steps) else None


def protocol_problems(settings: ProtocolSettings, places: Sequence[str]) -> Iterator[Problem]:
    """Problems between steps, and with ``places``; paths start at the protocol."""
    steps = settings.steps
    seen: set[str] = set()
    for index, step in enumerate(steps):
        if step.step_id in seen:
            key = "id" if step.id else "title"
            yield (
                ("steps", index, key),
                tr("duplicate step id '{step}': give one of them a different id.").format(step=step.step_id),
            )
        seen.add(step.step_id)
        if step.go_to and step.go_to not in places:
            unknown = tr("unknown place '{place}'.").format(place=step.go_to)
            known = allowed_words(step.go_to, list(places)) if places else tr("This scenario has no places.")
            yield ("steps", index, "go_to"), f"{unknown} {known}"
        if step.then and step.then != END and step_named(steps, step.then) is None:
            yield ("steps", index, "then"), _unknown_step(step.then, steps, END)
        titles: set[str] = set()
        for number, branch in enumerate(step.branches):
            path = ("steps", index, "branches", number)
            if branch.title.casefold() in titles:
                twice = tr("duplicate branch '{title}' in one step.")
                yield (*path, "title"), twice.format(title=branch.title)
            titles.add(branch.title.casefold())
            if step_named(steps, branch.to) is None:
                yield (*path, "to"), _unknown_step(branch.to, steps)


def _unknown_step(name: str, steps: Iterable[ProtocolStep], *others: str) -> str:
    unknown = tr("unknown step '{step}'.").format(step=name)
    return f"{unknown} {allowed_words(name, [*(step.title for step in steps), *others])}"


def _id_from(title: str) -> str:
    return re.sub(r"\W+", "-", title.casefold()).strip("-") or title
