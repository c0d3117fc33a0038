"""Scenario document for editing: text changed place by place, each change reported as a step that can be undone.

The text is authoritative, and the form derives from it; comments, order and columns are preserved. Mistakes are
tolerated: the text contains them, their messages give line and place, and only saving is blocked.
"""

from collections.abc import Callable, Mapping
from copy import deepcopy
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from caris_desktop.domain.schema_fields import KeyPath, form_of, keys_of, parts_of, value_from
from caris_desktop.domain.schema_paths import (
    ABSENT,
    Difference,
    called,
    default_of,
    differences,
    form_at,
    key_of,
    references,
    text_key,
    value_at,
    with_value_at,
    without_at,
)
from caris_desktop.domain.value_class import Value
from caris_desktop.domain.yaml_files import LocatedData, YamlSourceError, parse_yaml, yaml_text
from caris_desktop.scenario.scenario_file import migrate, mistakes
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.scenario.text_editing import edited, quick_data, with_entry_moved

_ID = "id"
"""By which an entry is known as well as by its name, and which may stay when that changes."""


class Mistake(Value):
    """Mistake at a place in the file, as a sentence; ``line`` counts from 1."""

    path: KeyPath
    line: int
    message: str


class _State:
    """``unreadable`` is the reason why ``data`` are from an earlier text.

    ``write`` is called when the text is first asked for, not on each key: it takes up to 60 ms.
    """

    def __init__(self, data: dict[str, Any], write: Callable[[], str], unreadable: Mistake | None = None) -> None:
        self.data = data
        self.unreadable = unreadable
        self.mistakes: tuple[Mistake, ...] | None = None if unreadable is None else (unreadable,)
        self._write = write

    @cached_property
    def text(self) -> str:
        return self._write()


class Step(Value):
    """Change of the document at ``path``, with its display name. ``continued``: typing at the place of the step before
    it, with the same ``before``.
    """

    before: _State
    after: _State
    path: KeyPath
    words: tuple[str, ...]
    continued: bool


class ScenarioDocument:
    """``velocity_topic_of`` as for ``load_scenario``.

    Raises YamlSourceError or ValueError if ``text`` cannot be shown in a form.
    """

    def __init__(
        self, text: str, path: Path, velocity_topic_of: Callable[[str], str | None] = lambda _robot: None
    ) -> None:
        self.path = path
        self._velocity_topic_of = velocity_topic_of
        state = _read(text)
        if state.unreadable is not None:
            raise YamlSourceError(state.unreadable.message, state.unreadable.line)
        self._saved = state
        self._state = state
        self._typing: tuple[KeyPath, _State] | None = None
        """Place where typing continues the last step, and the state before that."""
        self._without_mistakes: _State | None = None

    # ---- what it says

    @property
    def text(self) -> str:
        return self._state.text

    @property
    def data(self) -> dict[str, Any]:
        """Data of the form; never change it in place."""
        return self._state.data

    @property
    def saved_text(self) -> str:
        return self._saved.text

    @property
    def saved_data(self) -> dict[str, Any]:
        return self._saved.data

    @property
    def unreadable(self) -> Mistake | None:
        """Reason why the text cannot be shown as a form."""
        return self._state.unreadable

    @property
    def changed(self) -> bool:
        return self.data != self.saved_data or self._state.text != self._saved.text

    def value(self, path: KeyPath) -> Any:
        """Value at a place or its default; ABSENT if there is none."""
        value = self.written_value(path)
        if value is not ABSENT or not path:
            return value
        above, last = self.value(path[:-1]), path[-1]
        if isinstance(last, int) or value_at(above, (last,)) is not ABSENT:
            return value_at(above, (last,))
        try:
            return default_of(key_of(form_at(Scenario, self.data, path[:-1]), above, last))
        except KeyError:
            return ABSENT

    def written_value(self, path: KeyPath) -> Any:
        """Value at a place in the file itself."""
        found = value_at(self.data, path)
        if found is ABSENT and path and isinstance(path[-1], str):
            # A text in place of a group is the value of its first key.
            above = value_at(self.data, path[:-1])
            if isinstance(above, str):
                group = form_at(Scenario, self.data, path[:-1]).group_at(above)
                return above if group is not None and text_key(group) == path[-1] else ABSENT
        return found

    @property
    def mistakes(self) -> tuple[Mistake, ...]:
        """All mistakes that block saving, by line."""
        state = self._state
        if state.mistakes is None:
            found = [(self.line_of(path), path, text) for path, text in mistakes(self.data, self._velocity_topic_of)]
            found.sort(key=lambda mistake: mistake[0])
            state.mistakes = tuple(Mistake(path, line, message) for line, path, message in found)
        if not state.mistakes:
            self._without_mistakes = state
        return state.mistakes

    @property
    def scenario(self) -> Scenario | None:
        """Last version without a mistake; None if there is none."""
        meant = self._state if not self.mistakes else self._without_mistakes
        return None if meant is None else _scenario_of(meant)

    def line_of(self, path: KeyPath) -> int:
        """First line of that place, or of the part that contains it."""
        return _located(self.text).line_of(path)

    def differences(self) -> tuple[Difference, ...]:
        """Changes since the last save."""
        return tuple(differences(Scenario, self.saved_data, self.data))

    def words(self, path: KeyPath) -> tuple[str, ...]:
        """Display name of the place, from the outside in."""
        return tuple(called(Scenario, self.data, path))

    # ---- what is done

    def set(self, path: KeyPath, value: Any) -> None:
        """Set a value; ABSENT removes it. Successive changes at one place are one undo step. Renaming an entry updates
        its references.
        """
        if value is ABSENT:
            self.clear(path)
            return
        if self.written_value(path) == value and type(self.written_value(path)) is type(value):
            return
        before = self._before_step(path)
        if isinstance(value, str) and (along := self._referring(before.data, path)):
            self._rename(before, path, value, along)
            return
        place, placed = self._placed(path, value)
        if place != path:
            self._persist(path, self._with(place, placed), goes_on=True)
        elif value == self._left_out(path) and (value == "" or value_at(self.saved_data, path) is ABSENT):
            self.clear(path)
        else:
            self._persist(path, self._with(path, value), goes_on=True)

    def clear(self, path: KeyPath) -> None:
        """Remove a value, so that the default applies."""
        if value_at(self.data, path) is ABSENT or isinstance(path[-1], int):
            return
        if (shorter := self._as_text(path)) is not None:
            self._persist(path, with_value_at(self.data, path[:-1], shorter), goes_on=True)
            return
        removed = path
        data = without_at(self.data, path)
        # Remove a group that existed only for this.
        while (
            len(removed) > 1
            and value_at(data, removed[:-1]) == {}
            and value_at(self.saved_data, removed[:-1]) is ABSENT
        ):
            removed = removed[:-1]
            data = without_at(data, removed)
        self._persist(path, data, goes_on=False)

    def add(self, path: KeyPath, entry: Any) -> None:
        """Insert an entry into a list, at the index at the end of ``path``."""
        above, place = path[:-1], path[-1]
        entries = self.value(above)
        entries = list(entries) if isinstance(entries, list) else []
        entries.insert(int(place), deepcopy(entry))
        self._persist(path, self._with(above, entries), goes_on=False)

    def remove(self, path: KeyPath) -> None:
        """Remove an entry from its list."""
        above = path[:-1]
        if value_at(self.data, above) is ABSENT:
            self.set(above, without_at(self.value(above), path[-1:]))
            self.pause()
            return
        data = without_at(self.data, path)
        if value_at(data, above) == [] and value_at(self.saved_data, above) in (ABSENT, []):
            self.clear(above)
            return
        self._persist(path, data, goes_on=False)

    def move(self, path: KeyPath, place: int) -> None:
        """Move an entry within its list."""
        above, index = path[:-1], int(path[-1])
        entries = list(self.value(above))
        if not 0 <= place < len(entries) or place == index:
            return
        entries.insert(place, entries.pop(index))
        data = with_value_at(self.data, above, entries)
        self._persist(path, data, goes_on=False, text=with_entry_moved(self.text, path, place))

    def set_text(self, text: str) -> None:
        """Replace the whole text. If a form cannot show it, the form's data stay."""
        if text == self.text:
            return
        state = _read(text, self._state.data)
        self._push((), state, goes_on=True)

    def replace(self, path: KeyPath, value: Any) -> None:
        """Set a value as an undo step of its own; ABSENT removes it."""
        self.pause()
        self.set(path, value)
        self.pause()

    def pause(self) -> None:
        """Begin a new undo step."""
        self._typing = None

    def restore(self, state: _State) -> None:
        """Go back or forth to a state of a step."""
        if state is not self._state:
            self._state = state
            self.pause()

    def _on_step(self, step: Step) -> None:
        """Record a step; the document itself has no history."""

    def revert(self) -> None:
        """Revert to the saved version; can be undone."""
        if self.changed:
            self._push((), self._saved, goes_on=False)

    # ---- the file

    def note_saved(self, sent: str, text: str, path: Path) -> None:
        """Note that the file at ``path`` now has ``text``, written from ``sent``; later changes remain unsaved."""
        self.pause()
        self.path = path
        if self.text == sent:
            self._state = self._saved = _read(text, self.data)
        elif sent == text:
            self._saved = _read(text, self.data)
        else:
            self._saved = _read(sent, self.data)
            self.rebase(text)

    def rebase(self, text: str) -> tuple[Difference, ...]:
        """Apply the local changes to ``text``, which another program wrote; return them.

        Raises YamlSourceError or ValueError if a form cannot show the text; then nothing has changed.
        """
        other = _read(text)
        if other.unreadable is not None:
            raise YamlSourceError(other.unreadable.message, other.unreadable.line)
        mine = self.differences()
        data = self.data
        if self.changed:
            self._push((), other, goes_on=False)
        else:
            self._state = other
        self._saved = other
        for difference in mine:
            self.replace(difference.path, value_at(data, difference.path))
        return mine

    # ---- within

    def _before_step(self, path: KeyPath) -> _State:
        """State before the present undo step, if it continues at that place."""
        return self._typing[1] if self._typing is not None and self._typing[0] == path else self._state

    def _referring(self, data: dict[str, Any], path: KeyPath) -> list[KeyPath]:
        """Places that refer to an entry by the name or id at ``path``."""
        name = value_at(data, path)
        if len(path) < 3 or not isinstance(path[-2], int) or not isinstance(name, str) or not name:
            return []
        entries, key = value_at(data, path[:-2]), path[-1]
        ids = {entry.get(_ID) for entry in entries if isinstance(entry, Mapping)}
        return [
            place
            for place, rule, value in references(Scenario, data)
            if rule.refers[:-1] == path[:-2]
            and value not in rule.else_one_of
            # An id takes precedence over an equal title.
            and (value == name if key == _ID else key == rule.refers[-1] and _same(value, name) and value not in ids)
        ]

    def _rename(self, before: _State, path: KeyPath, name: str, along: list[KeyPath]) -> None:
        """Rename from the state before the step, so that partially typed names, or temporary duplicates, break no
        references.
        """
        others = value_at(before.data, path[:-2])
        taken = any(
            isinstance(value := value_at(entry, path[-1:]), str) and _same(value, name)
            for number, entry in enumerate(others)
            if number != path[-2]
        )
        places = [path] if taken or not name else [path, *along]
        data = before.data
        for place in places:
            data = with_value_at(data, place, name)
        self._persist(path, data, goes_on=True)

    def _persist(self, path: KeyPath, data: dict[str, Any], *, goes_on: bool, text: str = "") -> None:
        """Go on with ``data``; ``text`` is used if it says that."""
        if self.unreadable is not None:
            return
        before = self._before_step(path) if goes_on else self._state

        def write() -> str:
            changed = text if _says(text, data) else edited(before.text, before.data, data)
            # Unusual layout: the content matters more than the formatting.
            return changed if _says(changed, data) else yaml_text(data)

        self._push(path, _State(data, write), goes_on=goes_on)

    def _push(self, path: KeyPath, state: _State, *, goes_on: bool) -> None:
        before = self._before_step(path) if goes_on else self._state
        continued = before is not self._state
        if not continued:
            before.text  # noqa: B018 - written once, so that no chain of unwritten texts grows
        step = Step(before, state, path, self.words(path), continued)
        self._state = state
        self._typing = (path, before) if goes_on else None
        self._on_step(step)

    def _with(self, path: KeyPath, value: Any) -> dict[str, Any]:
        """Data with ``value`` at ``path``; a new key comes after those that precede it in the schema."""
        data: dict[str, Any] = with_value_at(self.data, path, value)
        for number, part in enumerate(path):
            above = path[:number]
            present = value_at(self.data, above)
            if isinstance(part, str) and isinstance(present, dict) and part not in present:
                group = form_at(Scenario, self.data, above).group_at(present)
                names = [key.name for key in keys_of(group)] if group is not None else []
                before = names[: names.index(part)] if part in names else names
                entries = list(present.items())
                place = max((at for at, (name, _value) in enumerate(entries, 1) if name in before), default=0)
                entries.insert(place, (part, value_at(data, (*above, part))))
                data = with_value_at(data, above, dict(entries))
                break
        return data

    def _left_out(self, path: KeyPath) -> Any:
        """Default value of a place."""
        try:
            parent = form_at(Scenario, self.data, path[:-1])
            key = key_of(parent, value_at(self.data, path[:-1]), str(path[-1]))
        except KeyError:
            return ABSENT
        if key.required:
            return ABSENT
        default = default_of(key)
        return "" if default is ABSENT and key.form.kind is str else default

    def _placed(self, path: KeyPath, value: Any) -> tuple[KeyPath, Any]:
        """Place and value to set for ``value`` at ``path``: the whole group if a text abbreviates it and another key is
        set, the whole list if it existed only as a default; else as given.
        """
        for number in range(1, len(path)):
            above = path[:number]
            text = value_at(self.data, above)
            if text is ABSENT and isinstance(path[number], int):
                return above, with_value_at(self.value(above), path[number:], value)
            if isinstance(text, str) and isinstance(path[number], str):
                form = form_at(Scenario, self.data, above)
                group = form.group_at(text)
                if group is None:
                    return path, value
                first = text_key(group)
                if path[number:] == (first,):
                    return above, value
                return above, with_value_at({first: text}, path[number:], value)
        return path, value

    def _as_text(self, path: KeyPath) -> str | None:
        """Abbreviation as text of a group without that key, if possible and used before."""
        above = path[:-1]
        group_data = value_at(self.data, above)
        if not above or not isinstance(group_data, Mapping) or isinstance(value_at(self.saved_data, above), Mapping):
            return None
        form = form_at(Scenario, self.data, above)
        group = form.group_at(group_data)
        left = {name: value for name, value in group_data.items() if name != path[-1]}
        if form.text is None or group is None or list(left) != [text_key(group)]:
            return None
        text = left[text_key(group)]
        return text if isinstance(text, str) else None


@lru_cache(maxsize=1)
def _scenario_of(state: _State) -> Scenario:
    scenario: Scenario = value_from(Scenario, migrate(state.data))
    return scenario


@lru_cache(maxsize=1)
def _located(text: str) -> LocatedData:
    try:
        return quick_data(text)
    except YamlSourceError:
        return LocatedData({})


def _says(text: str, data: dict[str, Any]) -> bool:
    try:
        return bool(quick_data(text).data == data)
    except YamlSourceError:
        return False


def _same(one: str, other: str) -> bool:
    return one.casefold() == other.casefold()


def _read(text: str, last: dict[str, Any] | None = None) -> _State:
    """State from any text; ``last`` is used if it is unusable."""
    try:
        source = parse_yaml(text)
        path: KeyPath = ()
        line, message = 1, "a scenario must be a list of 'key: value' lines, found something else."
        if isinstance(source.data, dict):
            path = ("version",)
            line = source.line_of(path)
            migrate(source.data)
            found = _out_of_shape(Scenario, source.data, ())
            if found is None:
                return _State(source.data, lambda: text)
            path, message = found
            line = source.line_of(path)
    except YamlSourceError as error:
        line, path, message = error.line, (), f"{error}"
    except ValueError as error:
        message = f"{error}"
    return _State(last or {}, lambda: text, Mistake(path, line, message))


def _out_of_shape(hint: Any, data: Any, path: KeyPath) -> tuple[KeyPath, str] | None:
    """First place of ``data`` whose structure deviates from the schema, so that no form can show it; scalars may be
    anything.
    """
    form = form_of(hint)
    if form.text is not None and isinstance(data, str):
        return None
    if form.groups and not isinstance(data, dict):
        return path, "a group of 'key: value' lines is expected here."
    if form.item is not None and not isinstance(data, list):
        return path, "a list is expected here."
    found = (_out_of_shape(part, value, (*path, step)) for step, part, value in parts_of(form, data))
    return next((each for each in found if each is not None), None)
