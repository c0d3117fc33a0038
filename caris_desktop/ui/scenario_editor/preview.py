"""Preview of the edited scenario: errors, consequences for the wizard, and changes, as HTML."""

from collections.abc import Iterable
from functools import cache
from html import escape
from itertools import chain, repeat
from typing import Any, Literal

from caris_desktop.domain.intents import INTENTS, Intent
from caris_desktop.domain.schema_fields import keys_of, value_from
from caris_desktop.domain.schema_paths import ABSENT, Difference, entry_name, title_of
from caris_desktop.domain.schema_validation import quoted
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.scenario.document import ScenarioDocument
from caris_desktop.scenario.phrases import phrase_groups
from caris_desktop.scenario.protocol_steps import step_named
from caris_desktop.scenario.scenario_file import migrate
from caris_desktop.scenario.scenario_model import ERROR_KEYS, Permissions, Scenario, manual_checks
from caris_desktop.ui.action_bindings import rows_of
from caris_desktop.ui.action_rows import ACTIONS, go_to_nth_place, mark_with_label, perform_nth_gesture
from caris_desktop.ui.panel_table import PANELS
from caris_desktop.ui.tokens import Colors

_MOST_OF_A_VALUE = 90
_BEFORE_DIFFERENCE = 20


def preview_page(document: ScenarioDocument, section: str, colors: Colors) -> str:
    """HTML with errors, consequences of the section, and changes since the last save."""
    return _Preview(document, colors).html(section)


_LEVELS = {
    "replies": {
        "off": QT_TR_NOOP("No reply is suggested."),
        "suggest": QT_TR_NOOP("Replies are suggested; the wizard says one with a key."),
        "act": QT_TR_NOOP("The first reply is said after {countdown_s} s, unless the wizard stops it."),
    },
    "fillers": {
        "off": QT_TR_NOOP("Silences are not filled automatically."),
        "suggest": QT_TR_NOOP("After {late_s} s without a reply, the filler key is highlighted."),
        "act": QT_TR_NOOP("After {late_s} s without a reply, a filler is said, unless the wizard stops it."),
    },
    "actions": {
        "off": QT_TR_NOOP("No action is proposed."),
        "suggest": QT_TR_NOOP("Actions are proposed; the wizard carries one out with a key."),
        "act": QT_TR_NOOP(
            "Actions without motion are carried out after {countdown_s} s, unless the wizard stops them; "
            "actions with motion wait for a key."
        ),
    },
}


class _Preview:
    """HTML of the preview in these colours, paragraph by paragraph. Texts are escaped when they are added."""

    def __init__(self, document: ScenarioDocument, colors: Colors) -> None:
        self._document = document
        self._colors = colors
        self._parts: list[str] = []

    def html(self, section: str) -> str:
        mistakes = self._document.mistakes
        if mistakes:
            self._heading(tr("Errors to correct before saving: %n", "", len(mistakes)), "red")
        for number, mistake in enumerate(mistakes):
            message = tr("Line {line}: {message}").format(line=mistake.line, message=mistake.message)
            self._line("", "red", after=self._link(f"mistake:{number}", message, "red"))
        show = {
            "Phrases": self._show_phrases, "Protocol": self._show_protocol, "Places": self._show_places,
            "What is allowed": self._show_permissions, "Assistant": self._show_assistant,
            "Recording": self._show_recording,
        }.get(section)  # fmt: skip
        if show is not None:
            show()
        self._show_changes()
        return "".join(self._parts)

    # ---- pieces of HTML

    def _heading(self, text: str, role: str = "text") -> None:
        style = f"margin:14px 0 6px 0; font-weight:600; color:{getattr(self._colors, role)}"
        self._parts.append(f'<p style="{style}">{escape(text)}</p>')

    def _line(self, text: str, role: str = "text", *, before: str = "", after: str = "") -> None:
        """Paragraph with HTML ``before`` and ``after`` the text."""
        style = f"margin:3px 0; color:{getattr(self._colors, role)}"
        self._parts.append(f'<p style="{style}">{before}{escape(text)}{after}</p>')

    def _ink(self, text: str, role: str) -> str:
        return f'<span style="color:{getattr(self._colors, role)}">{escape(text)}</span>'

    def _link(self, target: str, text: str, role: str) -> str:
        return f'<a href="{target}" style="color:{getattr(self._colors, role)}">{escape(text)}</a>'

    def _cap(self, key: str) -> str:
        style = f"background:{self._colors.raised}; color:{self._colors.text}; font-size:12px; font-weight:600"
        return f'<span style="{style}">&nbsp;{escape(key)}&nbsp;</span>' if key else ""

    def _table(self, rows: Iterable[tuple[str, str]], cell: str) -> None:
        cells = (
            f'<tr><td style="{cell}; padding-right:8px">{first}</td><td style="{cell}">{second}</td></tr>'
            for first, second in rows
        )
        self._parts.append(f"<table>{''.join(cells)}</table>")

    # ---- document

    def _value(self, name: str) -> Any:
        """Parsed value of a key, regardless of errors elsewhere; if it has an error itself, the last valid value."""
        document = self._document
        (key,) = (key for key in keys_of(Scenario) if key.name == name)
        if not any(mistake.path[:1] == (name,) for mistake in document.mistakes):
            value = document.value((name,))
            return key.default if value is ABSENT else value_from(key.form, value)
        return getattr(document.scenario, key.attribute) if document.scenario is not None else key.default

    def _show_changes(self) -> None:
        changes = self._document.differences()
        if not changes:
            words = tr("No changes since the last save.")
            if self._document.changed:
                words = tr("Only comments or formatting have changed since the last save.")
            self._heading(tr("Changes"))
            self._line(words, "dim")
            return
        self._heading(tr("Changes since the last save: %n", "", len(changes)))
        for number, change in enumerate(changes):
            link = self._link(f"change:{number}", " › ".join(self._document.words(change.path)), "blue")
            self._line(difference_words(change), before=f"{link}<br>")

    # ---- sections

    def _show_phrases(self) -> None:
        self._heading(tr("On the wizard's keys"))
        keys = [spec.keys[0] for spec in ACTIONS if spec.id.startswith("phrase_")]
        groups = phrase_groups(self._value("phrases"))
        if not groups:
            self._line(tr("No phrases yet. The first phrase you add is on F1."), "dim")
        for group in groups:
            if group.title:
                self._line(tr("Group “{group}”, selected with F10").format(group=group.title), "dim")
            rows = (
                (self._cap(key), f"{escape(each.say)} {self._cap(each.key)}{self._other_use(each.key)}")
                for key, each in zip(keys, group.phrases, strict=False)
            )
            self._table(rows, "padding:3px 0")
        filler = self._value("filler")
        if filler:
            self._line(tr("While the wizard thinks, in rotation:"), "dim")
            self._line(" · ".join((filler, *self._value("fillers"))), before=f"{self._cap('F9')} ")
        gestures = self._value("gestures")
        if gestures:
            self._line(tr("Gestures, if the robot supports them:"), "dim")
            keys = [spec.keys[0] for spec in ACTIONS if spec.intent is perform_nth_gesture]
            for key, gesture in zip(keys, gestures, strict=False):
                cap = self._cap(gesture.key or key)
                self._line(gesture.title, before=f"{cap} ", after=self._other_use(gesture.key))

    def _other_use(self, key: str) -> str:
        """Remark that a key is taken, except by phrases and gestures with their own key, which yield to it."""
        rows = ACTIONS if self._document.scenario is None else rows_of(self._document.scenario)
        taken = next((spec.text for spec in reversed(rows) if not spec.own_key and key in spec.keys), "")
        remark = tr("{key} already has another function: {what}").format(key=key, what=taken)
        return f"<br>{self._ink(remark, 'amber')}" if taken else ""

    def _show_protocol(self) -> None:
        steps = self._value("protocol").steps
        if not steps:
            self._line(tr("Without steps, the protocol strip is not shown."), "dim")
            return
        self._heading(tr("Protocol strip above the panels"))
        rows = []
        for number, step in enumerate(steps, start=1):
            more = [tr("{minutes} min").format(minutes=f"{step.minutes:g}")] if step.minutes else []
            more += [tr("go to {place}").format(place=step.go_to)] if step.go_to else []
            more += [tr("%n to tick off", "", len(step.tick))] if step.tick else []
            lines = [f"<b>{escape(step.title)}</b>"]
            lines += [self._ink(" · ".join(more), "dim")] if more else []
            lines += [escape(f"“{step.say}”")] if step.say else []
            for digit, branch in enumerate(step.branches, start=1):
                to = step_named(steps, branch.to)
                words = tr("{what} → {step}").format(what=branch.title, step=branch.to if to is None else to.title)
                lines.append(f"{self._cap(f'B {digit}')} {escape(words)}")
            rows.append((self._ink(str(number), "dim"), "<br>".join(lines)))
        self._table(rows, "padding:4px 0")
        minutes = sum(step.minutes for step in steps)
        if minutes:
            words = tr("Expected duration: {minutes} minutes in total.")
            if any(step.branches or step.then for step in steps):
                words = tr("Expected duration if every step is done: {minutes} minutes.")
            self._line(words.format(minutes=f"{minutes:g}"))

    def _show_places(self) -> None:
        steps, places = self._value("protocol").steps, self._value("places")
        keys = [spec.keys[0] for spec in ACTIONS if spec.intent is go_to_nth_place]
        self._heading(tr("On the wizard's keys"))
        for place, key in zip(places, chain(keys, repeat("")), strict=False):
            led = ", ".join(step.title for step in steps if step.go_to == place.name)
            remark = tr(" · used in step {steps}").format(steps=led) if led else ""
            self._line(place.name, before=f"{self._cap(key)} ", after=self._ink(remark, "dim"))
        if not places:
            self._line(tr("No places yet. The first place you add is on Alt+1."), "dim")

    def _show_recording(self) -> None:
        settings = self._value("recording")
        labels = [spec.keys[0] for spec in ACTIONS if spec.intent is mark_with_label]
        error = next(spec.keys[0] for spec in ACTIONS if spec.id == "wizard_error")
        self._heading(tr("On the wizard's keys"))
        for key, label in zip(labels, settings.labels, strict=False):
            self._line(label, before=f"{self._cap(key)} ")
        self._line(tr("Wizard error, then its kind:"), "dim", before=f"{self._cap(error)} ")
        for key, kind in zip(ERROR_KEYS, settings.error_kinds, strict=False):
            meaning = f"<br>{self._ink(tr(kind.meaning), 'dim')}" if kind.meaning else ""
            self._line(tr(kind.kind), before=f"{self._cap(key)} ", after=meaning)
        checks = manual_checks(self._value("preflight"))
        if checks:
            self._heading(tr("Manual checks before a recording"))
        for check in checks:
            self._line(f"☐ {check.check}")

    def _show_assistant(self) -> None:
        if not self._value("permissions").assistant:
            self._heading(tr("This scenario does not allow the assistant, so none of this is used."), "amber")
            return
        settings, levels = self._value("assistant"), self._value("assistance")
        self._heading(tr("Instructions to the model before a question"))
        texts = [("", settings.system_prompt)]
        texts += [(tr("as {role}").format(role=role.name), role.text) for role in settings.roles]
        texts += [(tr("in the style {style}").format(style=style.name), style.text) for style in settings.styles]
        texts += [(tr("notes"), settings.notes)]
        for when, text in texts:
            if text:
                self._line(f"“{text}”", before=self._ink(f"{when}: ", "dim") if when else "")
        if settings.templates:
            self._heading(tr("Prepared questions"))
        example = self._ink(tr("the participant's last utterance"), "green")
        for each in settings.templates:
            self._line(f"{each.name}: “", after=f"{escape(each.text).replace('{said}', example)}”")
        self._heading(tr("Automation"))
        for name, words in _LEVELS.items():
            template = tr(words[getattr(levels, name)])
            self._line(template.format(countdown_s=f"{levels.countdown_s:g}", late_s=f"{levels.filler_after_s:g}"))

    def _show_permissions(self) -> None:
        now, titles = self._value("permissions"), {key.attribute: title_of(key) for key in keys_of(Permissions)}
        try:
            before = value_from(Permissions, migrate(self._document.saved_data).get("permissions", {}))
        except (TypeError, ValueError):
            before = Permissions()
        for name, title in titles.items():
            on = getattr(now, name)
            if on != getattr(before, name):
                words = (
                    tr("{permission} is now on. This appears:")
                    if on
                    else tr("{permission} is now off. This disappears:")
                )
                self._heading(words.format(permission=title), "green" if on else "amber")
                found = consequences(name)
                for each in found:
                    words = tr("panel {panel}").format(panel=each.words) if each.sort == "panel" else each.words
                    self._line(f"{('+' if on else '−')} {words} ", after=self._cap(each.key))
                if not found:
                    self._line(tr("No button and no key; background functions start or stop."), "dim")
        self._heading(tr("Not available in this scenario"))
        off = [name for name in titles if not getattr(now, name)]
        if not off:
            self._line(tr("Everything is allowed."), "dim")
        for name in off:
            effects = [each.words for each in consequences(name) if each.sort != "act"]
            what = ", ".join(effects) or tr("no key or panel")
            self._line(tr("{permission}: {what}").format(permission=titles[name], what=what), "dim")


Sort = Literal["panel", "key", "act"]


class Consequence(Value):
    """Feature that requires a permission, from the tables of intents, actions and panels."""

    sort: Sort
    words: str
    key: str = ""


@cache
def consequences(permission: str) -> tuple[Consequence, ...]:
    """Features that this permission alone removes: panels, commands with keys, other intents."""
    found = [Consequence("panel", panel.title) for panel in PANELS.values() if panel.permission == permission]
    keyed_intents = set()
    for spec in ACTIONS:
        intent = type(spec.intent) if isinstance(spec.intent, Intent) else None
        if spec.permission == permission or (intent is not None and permission in INTENTS[intent].permissions):
            keyed_intents.add(intent)
            found.append(Consequence("key", spec.text, spec.keys[0] if spec.keys else ""))
    for intent, line in INTENTS.items():
        if permission in line.permissions and intent not in keyed_intents:
            found.append(Consequence("act", line.words))
    return tuple(dict.fromkeys(found))


def difference_words(change: Difference) -> str:
    """Old and new value, short enough to scan."""
    if isinstance(change.before, str) and isinstance(change.after, str):
        return _arrow(*_where_they_differ(change.before, change.after))
    if isinstance(change.before, list) or isinstance(change.after, list):
        before, after = (each if isinstance(each, list) else [] for each in (change.before, change.after))
        came = [entry_name(each) or "…" for each in after if each not in before]
        went = [entry_name(each) or "…" for each in before if each not in after]
        parts = [tr("new: {names}").format(names=_short(", ".join(came)))] if came else []
        parts += [tr("removed: {names}").format(names=_short(", ".join(went)))] if went else []
        return " · ".join(parts) or tr("reordered")
    if isinstance(change.before, dict) or isinstance(change.after, dict):
        return (
            tr("new") if change.before is ABSENT else tr("removed") if change.after is ABSENT else tr("options changed")
        )
    return _arrow(change.before, change.after)


def _arrow(before: Any, after: Any) -> str:
    return tr("{before} → {after}").format(before=_shown(before), after=_shown(after))


def _where_they_differ(before: str, after: str) -> tuple[str, str]:
    """Two long texts, from shortly before their first difference."""
    pairs = enumerate(zip(before, after, strict=False))
    same = next((number for number, (old, new) in pairs if old != new), min(len(before), len(after)))
    start = before.rfind(" ", 0, max(0, same - _BEFORE_DIFFERENCE)) + 1
    if max(len(before), len(after)) <= _MOST_OF_A_VALUE or not start:
        return before, after
    return f"…{before[start:]}", f"…{after[start:]}"


def _shown(value: Any) -> str:
    if value is ABSENT:
        return tr("not set")
    if isinstance(value, bool):
        return tr("on") if value else tr("off")
    return _short(value) if isinstance(value, str) and value else tr("empty") if value == "" else quoted(value)


def _short(text: str) -> str:
    words = " ".join(text.split())
    return f"“{words}”" if len(words) <= _MOST_OF_A_VALUE else f"“{words[: _MOST_OF_A_VALUE - 1]}…”"
