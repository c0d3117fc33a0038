"""Study protocol of a scenario: steps, their content, and branches."""

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated, Literal

from caris_desktop.domain.key_path import Problem
from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.schema_validation import allowed_words
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value

MOST_BRANCHES = 9
"""One for each digit."""
END = "end"
"""Nothing comes after this step."""
_SECONDS = 60.0

_Title = Annotated[str, FieldSpec(shortest=1, longest=60)]


class Branch(Value):
    """A possible action of the participant, and the step that follows."""

    title: Annotated[_Title, FieldSpec("Action of the participant; the text of its button.")]
    to: Annotated[
        str,
        FieldSpec(
            "The step that follows, by title or id.",
            title="Next step",
            refers=("protocol", "steps", "title"),
            shortest=1,
            longest=60,
        ),
    ]


class ProtocolStep(Value):
    """One step of the protocol."""

    title: Annotated[_Title, FieldSpec("Title in the window, in the recording and in every table.")]
    id: Annotated[
        str,
        FieldSpec(
            "Short name that stays the same when the title changes; derived from the title if not given.",
            pattern="^([a-z0-9][a-z0-9_-]*)?$",
            allowed="lower-case letters, digits, - and _.",
            longest=40,
            quiet=True,
        ),
    ] = ""
    say: Annotated[
        str,
        FieldSpec(
            "Sentence that the robot says in this step, with one key. A sentence of `phrases` includes its "
            "gesture and face.",
            longest=500,
            quiet=True,
        ),
    ] = ""
    go_to: Annotated[
        str,
        FieldSpec(
            "The one of the `places` that belongs to the step.", refers=("places", "name"), longest=80, quiet=True
        ),
    ] = ""
    minutes: Annotated[
        float,
        FieldSpec(
            "Expected duration; 0.5 is half a minute, 0 means no expected duration.",
            unit="minutes",
            at_least=0,
            at_most=600,
            quiet=True,
        ),
    ] = 0.0
    tick: Annotated[
        tuple[Annotated[str, FieldSpec(shortest=1, longest=80)], ...],
        FieldSpec(
            "Items that the wizard ticks off in this step.", title="To tick off", longest=12, unique=True, quiet=True
        ),
    ] = ()
    branches: Annotated[
        tuple[Branch, ...],
        FieldSpec("Alternative next steps, depending on what the participant does.", longest=MOST_BRANCHES, quiet=True),
    ] = ()
    then: Annotated[
        str,
        FieldSpec(
            "The step that follows, by title or id, or `end`; if not given, the step below.",
            refers=("protocol", "steps", "title"),
            else_one_of=(END,),
            longest=60,
            quiet=True,
        ),
    ] = ""
    note: Annotated[str, FieldSpec("A reminder for the wizard, shown with the step.", longest=500, quiet=True)] = ""

    @property
    def step_id(self) -> str:
        return self.id or _id_from(self.title)

    @property
    def expected_s(self) -> float:
        """Expected duration; zero if none is given."""
        return self.minutes * _SECONDS


class ProtocolSettings(Value):
    """The steps of the study, in order. The wizard may go to any step at any time, and the steps taken are recorded."""

    steps: Annotated[tuple[ProtocolStep, ...], FieldSpec("The steps, in order.", longest=60)] = ()
    begins: Annotated[
        Literal["with_recording", "by_hand"],
        FieldSpec("The first step starts with the recording, or when the wizard goes to it.", quiet=True),
    ] = "with_recording"


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
