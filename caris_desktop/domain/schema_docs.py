"""Tables of the guide for a declared file: keys, allowed values and meanings."""

import re
from collections.abc import Iterator
from typing import Any

from caris_desktop.domain.schema_fields import Group, Key, ValueForm, data_of, form_of, is_group, keys_of, plain_number
from caris_desktop.domain.schema_json import description_of
from caris_desktop.domain.schema_validation import condition

_FEW_CHOICES = 4
_PLACE = re.compile(r"(<!-- keys of (\S+?)(?:: ([\w ]+?))? -->\n).*?(?=\n<!-- end of keys -->)", re.DOTALL)
_SCALAR_WORDS = {bool: "`true` or `false`", str: "text", int: "whole number", float: "number"}


def reference(declaration: Group) -> str:
    """Markdown: one table for the file itself, then a section for each group, recursively."""
    lines = _table(keys_of(declaration))
    for key in keys_of(declaration):
        lines += _section(key)
    return "\n".join(lines) + "\n"


def with_tables(page: str, files: dict[str, Group]) -> str:
    """``page`` with its tables regenerated.

    A table follows each ``<!-- keys of FILE: NAMES -->`` (all keys without names), up to ``<!-- end of keys -->``;
    ``FILE.KEY.KEY`` is a group within the file.
    """

    def table(found: re.Match[str]) -> str:
        file, *path = found[2].split(".")
        group = files[file]
        for name in path:
            (form,) = (key.form for key in keys_of(group) if key.name == name)
            group = (form.item or form).kind
        keys = {key.name: key for key in keys_of(group)}
        names = found[3].split() if found[3] else list(keys)
        return "\n".join((found[1], *_table(tuple(keys[name] for name in names)), ""))

    return _PLACE.sub(table, page)


def _section(key: Key, within: str = "") -> list[str]:
    form = key.form.item or key.form
    if form.elsewhere is not None:
        return []
    if is_group(form.kind):
        lines = ["", f"## `{within}{key.name}`", "", description_of(key.form), "", *_table(keys_of(form.kind))]
        for inner in keys_of(form.kind):
            if is_group((inner.form.item or inner.form).kind):
                lines += _section(inner, f"{within}{key.name}.")
        return lines
    groups = form.alternatives
    lines = ["", f"## `{within}{key.name}`", "", description_of(key.form)] if groups else []
    for group in groups:
        lines += ["", description_of(form_of(group)), "", *_table(keys_of(group))]
    return lines


def _table(keys: tuple[Key, ...]) -> list[str]:
    rows = [f"| `{key.name}` | {', '.join(_cells(key))} | {_meaning(key)} |" for key in keys]
    return ["| key | values, default | meaning |", "| --- | --- | --- |", *rows]


def _meaning(key: Key) -> str:
    description = description_of(key.form)
    elsewhere = (key.form.item or key.form).elsewhere
    if elsewhere is not None:
        description += f" [Format]({elsewhere.page})."
    choices = key.form.choices
    if key.required and len(choices) > _FEW_CHOICES:
        description += f" One of {_listed(choices)}."
    return description.replace("|", "\\|").strip()


def _cells(key: Key) -> Iterator[str]:
    rule = key.form.rule
    yield from _allowed(key.form)
    if rule.instead_of:
        yield "instead of " + " or ".join(f"`{other}`" for other in rule.instead_of)
    if rule.beside and rule.beside != rule.needed:
        yield f"only with `{condition(rule.beside)}`"
    if key.required:
        yield "required"
    elif rule.needed:
        yield f"required {'and only ' if rule.beside == rule.needed else ''}with `{condition(rule.needed)}`"
    elif not (is_group(key.form.kind) or rule.instead_of):
        yield _shown(None if key.default is None else data_of(key.form, key.default))


def _shown(default: Any) -> str:
    if isinstance(default, bool):
        return "`true`" if default else "`false`"
    return f"`{default}`" if default or isinstance(default, (int, float)) else "none"


def _allowed(form: ValueForm) -> Iterator[str]:
    kind, rule = form.kind, form.rule
    if (item := form.item) is not None:
        yield f"list{_size(form, 'entry', 'entries')}: {', '.join(_allowed(item))}"
    elif rule.noun and not 0 < len(form.choices) <= _FEW_CHOICES:
        yield f"a {rule.noun}"
    elif (text := form.text) is not None:
        yield f"{', '.join(_allowed(text))} or a group, see below"
    elif is_group(kind):
        yield "a group, see below"
    elif form.is_free:
        yield "names and values"
    elif choices := form.choices:
        yield _listed(choices)
    elif kind is str:
        yield rule.allowed.rstrip(".") or f"text{_size(form, 'character', 'characters')}"
    else:
        yield " or ".join(_SCALAR_WORDS[each] for each in form.scalars) + (f" in {rule.unit}" if rule.unit else "")
        bounds = (("at least", rule.at_least), ("more than", rule.more_than), ("at most", rule.at_most))
        yield from (f"{words} {plain_number(float(limit))}" for words, limit in bounds if limit is not None)


def _listed(choices: tuple[Any, ...]) -> str:
    *others, last = [f"`{choice}`" for choice in choices]
    return f"{', '.join(others)} or {last}" if others else last


def _size(form: ValueForm, one: str, many: str) -> str:
    least, most = form.size
    if least == most:
        return f" of {least} {many}"
    if most is not None:
        return f" of {least} to {most} {many}" if least else f" of up to {most} {many}"
    return f" of at least {least} {one if least == 1 else many}" if least else ""
