"""The guide's tables of a declared file: each key, what may stand there, and what it means."""

from collections.abc import Iterator
from typing import Any

from caris_desktop.domain.declared import (
    Form,
    Group,
    Key,
    choices_of,
    data_of,
    form_of,
    groups_of,
    is_group,
    item_of,
    keys_of,
    plain_number,
)
from caris_desktop.domain.declared_schema import description_of

_FEW_CHOICES = 4


def reference(declaration: Group) -> str:
    """Markdown: one table for the file itself, then one section for each group in it."""
    lines = _table(declaration)
    for key in keys_of(declaration):
        lines += _section(key)
    return "\n".join(lines) + "\n"


def _section(key: Key) -> list[str]:
    form = item_of(key.form.kind) or key.form
    if form.foreign is not None:
        return []
    if is_group(form.kind):
        return ["", f"## `{key.name}`", "", description_of(key.form), "", *_table(form.kind)]
    groups = groups_of(form.kind)
    lines = ["", f"## `{key.name}`", "", description_of(key.form)] if groups else []
    for group in groups:
        lines += ["", description_of(form_of(group)), "", *_table(group)]
    return lines


def _table(group: Group) -> list[str]:
    rows = [f"| `{key.name}` | {', '.join(_cells(key))} | {_meaning(key)} |" for key in keys_of(group)]
    return ["| key | what may stand there, default | meaning |", "| --- | --- | --- |", *rows]


def _meaning(key: Key) -> str:
    said = description_of(key.form)
    foreign = (item_of(key.form.kind) or key.form).foreign
    if foreign is not None:
        said += f" [How they are written]({foreign.page})."
    choices = choices_of(key.form.kind)
    if key.required and len(choices) > _FEW_CHOICES:
        said += f" There are {_listed(choices)}."
    return said.replace("|", "\\|").strip()


def _cells(key: Key) -> Iterator[str]:
    yield from _allowed(key.form)
    if key.required or key.form.rule.wanted:
        yield "required"
    elif not is_group(key.form.kind):
        yield _shown(None if key.default is None else data_of(key.form.kind, key.default))


def _shown(default: Any) -> str:
    if isinstance(default, bool):
        return "`true`" if default else "`false`"
    return f"`{default}`" if default or isinstance(default, (int, float)) else "none"


def _allowed(form: Form) -> Iterator[str]:
    kind, rule = form.kind, form.rule
    if (item := item_of(kind)) is not None:
        yield f"list{_size(form, 'entry', 'entries')}: {', '.join(_allowed(item))}"
    elif form.foreign is not None or (rule.noun and not _few(kind)):
        yield f"a {rule.noun}"
    elif is_group(kind):
        yield "a group, see below"
    elif choices := choices_of(kind):
        yield _listed(choices)
    elif kind is bool:
        yield "`true` or `false`"
    elif kind is str:
        yield rule.allowed.rstrip(".") or f"text{_size(form, 'character', 'characters')}"
    else:
        yield " ".join(["whole number" if kind is int else "number", f"in {rule.unit}" if rule.unit else ""]).strip()
        bounds = (("at least", rule.at_least), ("more than", rule.more_than), ("at most", rule.at_most))
        yield from (f"{words} {plain_number(float(limit))}" for words, limit in bounds if limit is not None)


def _few(kind: Any) -> bool:
    return 0 < len(choices_of(kind)) <= _FEW_CHOICES


def _listed(choices: tuple[Any, ...]) -> str:
    *others, last = [f"`{choice}`" for choice in choices]
    return f"{', '.join(others)} or {last}" if others else last


def _size(form: Form, one: str, many: str) -> str:
    least, most = form.rule.shortest, form.rule.longest
    if most is not None:
        return f" of {least} to {most} {many}" if least else f" of up to {most} {many}"
    return f" of at least {least} {one if least == 1 else many}" if least else ""
