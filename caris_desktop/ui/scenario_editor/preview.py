"""Preview of the edited scenario: errors, consequences for the wizard, and changes, as HTML."""

from collections.abc import Iterator
from functools import cache
from html import escape
from itertools import zip_longest
from typing import Any, Literal

from caris_desktop.domain.intents import INTENTS, Intent
from caris_desktop.domain.schema_fields import keys_of, value_from
from caris_desktop.domain.schema_labels import title_of
from caris_desktop.domain.schema_paths import ABSENT, Difference, entry_name
from caris_desktop.domain.schema_validation import quoted
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.scenario.document import ScenarioDocument
from caris_desktop.scenario.phrases import phrase_groups
from caris_desktop.scenario.protocol_steps import step_named
from caris_desktop.scenario.scenario_migrations import migrate
from caris_desktop.scenario.scenario_model import ERROR_KEYS, Permissions, Scenario, manual_checks
from caris_desktop.ui.action_bindings import rows_of
from caris_desktop.ui.action_rows import ACTIONS, go_to_nth_place, perform_nth_gesture
from caris_desktop.ui.action_spec import ActionSpec
from caris_desktop.ui.mark_intents import mark_with_label
from caris_desktop.ui.panel_table import PANELS
from caris_desktop.ui.tokens import Colors

_MOST_OF_A_VALUE = 90
_BEFORE_DIFFERENCE = 20


def preview_page(document: ScenarioDocument, section: str, colors: Colors) -> str:
    """HTML with errors, consequences of the section, and changes since the last save."""
    return "".join((_mistakes(document, colors), _of_section(document, section, colors), _changes(document, colors)))


def _heading(text: str, colors: Colors, role: str = "text") -> str:
    return f'<p style="margin:14px 0 6px 0; font-weight:600; color:{getattr(colors, role)}">{escape(text)}</p>'


def _line(html: str, colors: Colors, role: str = "text") -> str:
    return f'<p style="margin:3px 0; color:{getattr(colors, role)}">{html}</p>'


def _cap(key: str, colors: Colors) -> str:
    if not key:
        return ""
    return (
        f'<span style="background:{colors.raised}; color:{colors.text}; font-size:12px; font-weight:600">'
        f"&nbsp;{escape(key)}&nbsp;</span>"
    )


def _mistakes(document: ScenarioDocument, colors: Colors) -> str:
    if not document.mistakes:
        return ""
    count = len(document.mistakes)
    parts = [_heading(tr("Errors to correct before saving: %n", "", count), colors, "red")]
    for number, mistake in enumerate(document.mistakes):
        message = tr("Line {line}: {message}").format(line=mistake.line, message=mistake.message)
        link = f'<a href="mistake:{number}" style="color:{colors.red}">{escape(message)}</a>'
        parts.append(_line(link, colors, "red"))
    return "".join(parts)


def _of_section(document: ScenarioDocument, section: str, colors: Colors) -> str:
    show = {
        "Phrases": _phrases, "Protocol": _protocol, "Places": _places, "What is allowed": _allowed,
        "Assistant": _assistant, "Recording": _recording,
    }.get(section)  # fmt: skip
    return "" if show is None else show(document, colors)


def _valued(document: ScenarioDocument, name: str) -> Any:
    """Parsed value of a key, regardless of errors elsewhere; if it has an error itself, the last valid value."""
    (key,) = (key for key in keys_of(Scenario) if key.name == name)
    if not any(mistake.path[:1] == (name,) for mistake in document.mistakes):
        value = document.value((name,))
        return key.default if value is ABSENT else value_from(key.form, value)
    return getattr(document.scenario, key.attribute) if document.scenario is not None else key.default


def _phrases(document: ScenarioDocument, colors: Colors) -> str:
    parts = [_heading(tr("On the wizard's keys"), colors)]
    keys = [spec.keys[0] for spec in ACTIONS if spec.id.startswith("phrase_")]
    groups = phrase_groups(_valued(document, "phrases"))
    taken = _taken(document)
    if not groups:
        parts.append(_line(escape(tr("No phrases yet. The first phrase you add is on F1.")), colors, "dim"))
    for group in groups:
        if group.title:
            parts.append(
                _line(escape(tr("Group “{group}”, selected with F10").format(group=group.title)), colors, "dim")
            )
        rows = []
        for key, phrase in zip(keys, group.phrases, strict=False):
            key_html = f" {_cap(phrase.key, colors)}" if phrase.key else ""
            remark = _reported_taken(phrase.key, taken, colors)
            rows.append(
                f'<tr><td style="padding:3px 8px 3px 0">{_cap(key, colors)}</td>'
                f'<td style="padding:3px 0">{escape(phrase.say)}{key_html}{remark}</td></tr>'
            )
        parts.append(f"<table>{''.join(rows)}</table>")
    filler = _valued(document, "filler")
    fillers = (filler, *_valued(document, "fillers")) if filler else ()
    if fillers:
        parts.append(_line(escape(tr("While the wizard thinks, in rotation:")), colors, "dim"))
        parts.append(_line(f"{_cap('F9', colors)} {escape(' · '.join(fillers))}", colors))
    gestures = _valued(document, "gestures")
    if gestures:
        parts.append(_line(escape(tr("Gestures, if the robot supports them:")), colors, "dim"))
        keys = [spec.keys[0] for spec in ACTIONS if spec.intent is perform_nth_gesture]
        for key, gesture in zip(keys, gestures, strict=False):
            remark = _reported_taken(gesture.key, taken, colors)
            parts.append(_line(f"{_cap(gesture.key or key, colors)} {escape(gesture.title)}{remark}", colors))
    return "".join(parts)


def _reported_taken(key: str, taken: dict[str, str], colors: Colors) -> str:
    if key not in taken:
        return ""
    remark = escape(tr("{key} already has another function: {what}").format(key=key, what=taken[key]))
    return f'<br><span style="color:{colors.amber}">{remark}</span>'


def _taken(document: ScenarioDocument) -> dict[str, str]:
    """Commands by key, except for phrases and gestures with their own key, which yield to them."""
    rows = ACTIONS if document.scenario is None else rows_of(document.scenario)
    return {key: spec.text for spec in rows if not spec.own_key for key in spec.keys}


def _protocol(document: ScenarioDocument, colors: Colors) -> str:
    steps = _valued(document, "protocol").steps
    if not steps:
        return _line(escape(tr("Without steps, the protocol strip is not shown.")), colors, "dim")
    parts = [_heading(tr("Protocol strip above the panels"), colors)]
    rows = []
    for number, step in enumerate(steps, start=1):
        more = [tr("{minutes} min").format(minutes=f"{step.minutes:g}")] if step.minutes else []
        more += [tr("go to {place}").format(place=step.go_to)] if step.go_to else []
        more += [tr("%n to tick off", "", len(step.tick))] if step.tick else []
        lines = [f"<b>{escape(step.title)}</b>"]
        if more:
            lines.append(f'<span style="color:{colors.dim}">{escape(" · ".join(more))}</span>')
        if step.say:
            lines.append(escape(f"“{step.say}”"))
        for digit, branch in enumerate(step.branches, start=1):
            to = step_named(steps, branch.to)
            words = tr("{what} → {step}").format(what=branch.title, step=branch.to if to is None else to.title)
            lines.append(f"{_cap(f'B {digit}', colors)} {escape(words)}")
        rows.append(
            f'<tr><td style="padding:4px 8px 4px 0; color:{colors.dim}">{number}</td>'
            f'<td style="padding:4px 0">{"<br>".join(lines)}</td></tr>'
        )
    parts.append(f"<table>{''.join(rows)}</table>")
    minutes = sum(step.minutes for step in steps)
    if minutes:
        words = tr("Expected duration: {minutes} minutes in total.")
        if any(step.branches or step.then for step in steps):
            words = tr("Expected duration if every step is done: {minutes} minutes.")
        parts.append(_line(escape(words.format(minutes=f"{minutes:g}")), colors))
    return "".join(parts)


def _places(document: ScenarioDocument, colors: Colors) -> str:
    steps = _valued(document, "protocol").steps
    keys = [spec.keys[0] for spec in ACTIONS if spec.intent is go_to_nth_place]
    parts = [_heading(tr("On the wizard's keys"), colors)]
    for place, key in zip_longest(_valued(document, "places"), keys):
        if place is None:
            break
        led = ", ".join(step.title for step in steps if step.go_to == place.name)
        remark = tr(" · used in step {steps}").format(steps=led) if led else ""
        dim = f'<span style="color:{colors.dim}">{escape(remark)}</span>'
        parts.append(_line(f"{_cap(key or '', colors)} {escape(place.name)}{dim}", colors))
    if len(parts) == 1:
        parts.append(_line(escape(tr("No places yet. The first place you add is on Alt+1.")), colors, "dim"))
    return "".join(parts)


def _recording(document: ScenarioDocument, colors: Colors) -> str:
    settings = _valued(document, "recording")
    labels = [spec.keys[0] for spec in ACTIONS if spec.intent is mark_with_label]
    error = next(spec.keys[0] for spec in ACTIONS if spec.id == "wizard_error")
    parts = [_heading(tr("On the wizard's keys"), colors)]
    parts += [
        _line(f"{_cap(key, colors)} {escape(label)}", colors)
        for key, label in zip(labels, settings.labels, strict=False)
    ]
    then = escape(tr("Wizard error, then its kind:"))
    parts.append(_line(f"{_cap(error, colors)} {then}", colors, "dim"))
    for key, kind in zip(ERROR_KEYS, settings.error_kinds, strict=False):
        meaning = f'<br><span style="color:{colors.dim}">{escape(tr(kind.meaning))}</span>' if kind.meaning else ""
        parts.append(_line(f"{_cap(key, colors)} {escape(tr(kind.kind))}{meaning}", colors))
    checks = manual_checks(_valued(document, "preflight"))
    if checks:
        parts.append(_heading(tr("Manual checks before a recording"), colors))
        parts += [_line(f"☐ {escape(check.check)}", colors) for check in checks]
    return "".join(parts)


def _assistant(document: ScenarioDocument, colors: Colors) -> str:
    permissions = _valued(document, "permissions")
    if not permissions.assistant:
        template = tr("This scenario does not allow the assistant, so none of this is used.")
        return _heading(template, colors, "amber")
    settings, levels = _valued(document, "assistant"), _valued(document, "assistance")
    parts = [_heading(tr("Instructions to the model before a question"), colors)]
    texts = [("", settings.system_prompt)]
    texts += [(tr("as {role}").format(role=role.name), role.text) for role in settings.roles]
    texts += [(tr("in the style {style}").format(style=style.name), style.text) for style in settings.styles]
    texts += [(tr("notes"), settings.notes)]
    for when, text in texts:
        if text:
            head = f'<span style="color:{colors.dim}">{escape(when)}: </span>' if when else ""
            parts.append(_line(f"{head}“{escape(text)}”", colors))
    if settings.templates:
        parts.append(_heading(tr("Prepared questions"), colors))
        last = escape(tr("the participant's last utterance"))
        example = f'<span style="color:{colors.green}">{last}</span>'
        parts += [
            _line(f"{escape(each.name)}: “{escape(each.text).replace('{said}', example)}”", colors)
            for each in settings.templates
        ]
    parts.append(_heading(tr("Automation"), colors))
    for words in _LEVELS:
        countdown_s, late_s = f"{levels.countdown_s:g}", f"{levels.filler_after_s:g}"
        template = tr(_LEVELS[words][getattr(levels, words)])
        parts.append(_line(escape(template.format(countdown_s=countdown_s, late_s=late_s)), colors))
    return "".join(parts)


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


def _allowed(document: ScenarioDocument, colors: Colors) -> str:
    before, now = _permissions_of(document.saved_data), _valued(document, "permissions")
    titles = {key.attribute: title_of(key) for key in keys_of(Permissions)}
    parts = []
    for name, on in changed_permissions(before, now):
        words = tr("{permission} is now on. This appears:") if on else tr("{permission} is now off. This disappears:")
        parts.append(_heading(words.format(permission=titles[name]), colors, "green" if on else "amber"))
        parts += _consequences(consequences(name), colors, sign="+" if on else "−")
    parts.append(_heading(tr("Not available in this scenario"), colors))
    off = [name for name in titles if not getattr(now, name)]
    if not off:
        parts.append(_line(escape(tr("Everything is allowed.")), colors, "dim"))
    for name in off:
        effects = [each.words for each in consequences(name) if each.sort != "act"]
        words = tr("{permission}: {what}").format(
            permission=titles[name], what=", ".join(effects) or tr("no key or panel")
        )
        parts.append(_line(escape(words), colors, "dim"))
    return "".join(parts)


Sort = Literal["panel", "key", "act"]


class Consequence(Value):
    """Consequences of a permission, derived from the tables of intents, actions and panels.

    Feature that requires a permission.
    """

    sort: Sort
    words: str
    key: str = ""


@cache
def consequences(permission: str) -> tuple[Consequence, ...]:
    """Features that this permission alone removes: panels, commands with keys, other intents."""
    return tuple(dict.fromkeys(_found(permission)))


def _found(permission: str) -> Iterator[Consequence]:
    for panel in PANELS.values():
        if panel.permission == permission:
            yield Consequence("panel", panel.title)
    keyed_intents = set()
    for spec in ACTIONS:
        intent = _intent_of(spec)
        needed = INTENTS[intent].permissions if intent is not None else ()
        if spec.permission == permission or permission in needed:
            keyed_intents.add(intent)
            yield Consequence("key", spec.text, spec.keys[0] if spec.keys else "")
    for intent, line in INTENTS.items():
        if permission in line.permissions and intent not in keyed_intents:
            yield Consequence("act", line.words)


def _intent_of(spec: ActionSpec) -> type[Intent] | None:
    return type(spec.intent) if isinstance(spec.intent, Intent) else None


def changed_permissions(before: Permissions, after: Permissions) -> list[tuple[str, bool]]:
    """Changed permissions with their new values."""
    names: Any = Permissions.__dataclass_fields__
    return [(name, getattr(after, name)) for name in names if getattr(before, name) != getattr(after, name)]


def _consequences(found: tuple[Consequence, ...], colors: Colors, sign: str) -> Iterator[str]:
    for each in found:
        words = tr("panel {panel}").format(panel=each.words) if each.sort == "panel" else each.words
        yield _line(f"{sign} {escape(words)} {_cap(each.key, colors)}", colors)
    if not found:
        yield _line(escape(tr("No button and no key; background functions start or stop.")), colors, "dim")


def _permissions_of(data: dict[str, Any]) -> Permissions:
    try:
        found: Permissions = value_from(Permissions, migrate(data).get("permissions", {}))
    except (TypeError, ValueError):
        found = Permissions()
    return found


def _changes(document: ScenarioDocument, colors: Colors) -> str:
    changes = document.differences()
    if not changes:
        words = tr("No changes since the last save.")
        if document.changed:
            words = tr("Only comments or formatting have changed since the last save.")
        return _heading(tr("Changes"), colors) + _line(escape(words), colors, "dim")
    parts = [_heading(tr("Changes since the last save: %n", "", len(changes)), colors)]
    for number, change in enumerate(changes):
        where = " › ".join(document.words(change.path))
        link = f'<a href="change:{number}" style="color:{colors.blue}">{escape(where)}</a>'
        parts.append(_line(f"{link}<br>{escape(difference_words(change))}", colors))
    return "".join(parts)


def difference_words(change: Difference) -> str:
    """Old and new value, short enough to scan."""
    if isinstance(change.before, str) and isinstance(change.after, str):
        before, after = _where_they_differ(change.before, change.after)
        return tr("{before} → {after}").format(before=_shown(before), after=_shown(after))
    if isinstance(change.before, list) or isinstance(change.after, list):
        return _list_words(change)
    if isinstance(change.before, dict) or isinstance(change.after, dict):
        return (
            tr("new") if change.before is ABSENT else tr("removed") if change.after is ABSENT else tr("options changed")
        )
    return tr("{before} → {after}").format(before=_shown(change.before), after=_shown(change.after))


def _where_they_differ(before: str, after: str) -> tuple[str, str]:
    """Two long texts, from shortly before their first difference."""
    pairs = enumerate(zip(before, after, strict=False))
    same = next((number for number, (old, new) in pairs if old != new), min(len(before), len(after)))
    start = before.rfind(" ", 0, max(0, same - _BEFORE_DIFFERENCE)) + 1
    if max(len(before), len(after)) <= _MOST_OF_A_VALUE or not start:
        return before, after
    return f"…{before[start:]}", f"…{after[start:]}"


def _list_words(change: Difference) -> str:
    before, after = (each if isinstance(each, list) else [] for each in (change.before, change.after))
    came = [entry_name(each) or "…" for each in after if each not in before]
    went = [entry_name(each) or "…" for each in before if each not in after]
    parts = [tr("new: {names}").format(names=_short(", ".join(came)))] if came else []
    parts += [tr("removed: {names}").format(names=_short(", ".join(went)))] if went else []
    return " · ".join(parts) or tr("reordered")


def _shown(value: Any) -> str:
    if value is ABSENT:
        return tr("not set")
    if isinstance(value, bool):
        return tr("on") if value else tr("off")
    return _short(value) if isinstance(value, str) and value else tr("empty") if value == "" else quoted(value)


def _short(text: str) -> str:
    words = " ".join(text.split())
    return f"“{words}”" if len(words) <= _MOST_OF_A_VALUE else f"“{words[: _MOST_OF_A_VALUE - 1]}…”"
