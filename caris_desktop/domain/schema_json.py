"""JSON Schema of a declared file, with which editors complete, check and explain it, and tables for the guide."""

import ast
import functools
import inspect
import itertools
import json
import re
import sys
from collections.abc import Iterator
from typing import Any

from caris_desktop.domain.schema_fields import (
    FieldSpec,
    Group,
    Key,
    ValueForm,
    data_of,
    form_of,
    is_group,
    keys_of,
    plain_number,
)
from caris_desktop.domain.schema_validation import condition

_TYPES = {str: "string", float: "number", int: "integer", bool: "boolean"}


def file_schema(declaration: Group, *, title: str, schema_id: str = "") -> dict[str, Any]:
    """Schema of a whole file."""
    definitions: dict[str, Any] = {}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **({"$id": schema_id} if schema_id else {}),
        "title": title,
        **_bare(form_of(declaration), definitions),
        "description": description_of(form_of(declaration)),
        "$defs": definitions,
    }


def schema_text(declaration: Group, *, title: str, schema_id: str = "") -> str:
    """Content of the schema file."""
    return json.dumps(file_schema(declaration, title=title, schema_id=schema_id), indent=2, ensure_ascii=False) + "\n"


def description_of(form: ValueForm) -> str:
    """Description for people: the docstring of the attribute, else the rule's text, else the declaration's docstring.

    Raises OSError if the source of the declaration is missing.
    """
    group, name = form.place or (None, "")
    description = "" if group is None else _docstrings(group.__module__).get((group.__name__, name), "")
    description = description or form.rule.text or (form.kind.__doc__ if is_group(form.kind) else "") or ""
    return " ".join(description.replace("``", "`").split())


@functools.cache
def _docstrings(module: str) -> dict[tuple[str, str], str]:
    """Docstrings of the attributes of all classes in a module, by both names: they are in its source only."""
    found = {}
    for group in ast.parse(inspect.getsource(sys.modules[module])).body:
        if isinstance(group, ast.ClassDef):
            for pair in itertools.pairwise(group.body):
                match pair:
                    case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                        found[group.name, name] = text
    return found


def _schema(form: ValueForm, definitions: dict[str, Any]) -> dict[str, Any]:
    if form.elsewhere is not None:
        schema: dict[str, Any] = {"$ref": form.elsewhere.schema}
    else:
        schema = _defined(form, definitions) if form.rule.noun else _bare(form, definitions)
    allowed = f"Allowed: {form.rule.allowed}" if form.rule.allowed and not form.choices else ""
    description = f"{description_of(form)} {allowed}".strip()
    return {**schema, "description": description} if description else schema


def _defined(form: ValueForm, definitions: dict[str, Any]) -> dict[str, Any]:
    """Reference to a shared definition: what has a noun is described once, and may be recursive."""
    name = form.rule.noun.replace(" ", "_")
    if name not in definitions:
        definitions[name] = {}
        definitions[name] |= {"title": form.rule.noun, **_bare(form, definitions)}
    return {"$ref": f"#/$defs/{name}"}


def _bare(form: ValueForm, definitions: dict[str, Any]) -> dict[str, Any]:
    kind, rule = form.kind, form.rule
    least, most = form.size
    if is_group(kind):
        return _group(kind, definitions, rule)
    if groups := form.alternatives:
        schema = {"type": "object", **_one_of(groups, definitions)}
        text = form.text
        return schema if text is None else {"if": {"type": "string"}, "then": _bare(text, definitions), "else": schema}
    if form.is_free:
        return {"type": "object"}
    if choices := form.choices:
        words = {"enum": list(choices)} if len(choices) > 1 else {"const": choices[0]}
        return {"anyOf": [words, {"type": "string", "pattern": rule.pattern}]} if rule.pattern else words
    if (item := form.item) is not None:
        return _given(
            {"type": "array", "minItems": least or None, "maxItems": most, "uniqueItems": rule.unique},
            items=_schema(item, definitions),
        )
    types = [_TYPES[each] for each in form.scalars]
    return _given(
        {
            "type": types if len(types) > 1 else types[0],
            "minLength": least or None,
            "maxLength": most,
            "pattern": rule.pattern or None,
            "minimum": rule.at_least,
            "exclusiveMinimum": rule.more_than,
            "maximum": rule.at_most,
        }
    )


def _group(group: Group, definitions: dict[str, Any], rule: FieldSpec) -> dict[str, Any]:
    keys = keys_of(group)
    properties = {}
    for key in keys:
        properties[key.name] = _schema(key.form, definitions)
        if isinstance(key.default, (bool, int, float, str)) and key.default != "" and not key.required:
            properties[key.name]["default"] = key.default
    neighbours = {key.name: found for key in keys if (found := _neighbours(key))}
    return _given(
        {
            "type": "object",
            "required": [key.name for key in keys if key.required] or None,
            "anyOf": [{"required": [name]} for name in rule.some_of] or None,
            "dependentSchemas": neighbours or None,
            "allOf": [_needed(key, keys) for key in keys if key.form.rule.needed] or None,
        },
        additionalProperties=False,
        properties=properties,
    )


def _neighbours(key: Key) -> dict[str, Any]:
    """Constraints on the group's other keys while this one is present."""
    rule = key.form.rule
    schema = _key_with_words(rule.beside) if rule.beside else {}
    if rule.instead_of:
        schema["not"] = {"anyOf": [{"required": [other]} for other in rule.instead_of]}
    return schema


def _needed(key: Key, keys: tuple[Key, ...]) -> dict[str, Any]:
    instead = [other.name for other in keys if key.name in other.form.rule.instead_of]
    any_of = [{"required": [name]} for name in (key.name, *instead)]
    return {"if": _key_with_words(key.form.rule.needed), "then": {"anyOf": any_of} if instead else any_of[0]}


def _key_with_words(condition_words: tuple[str, ...]) -> dict[str, Any]:
    """Schema that requires the key, with one of the words after it."""
    other, *words = condition_words
    return {"required": [other]} | ({"properties": {other: {"enum": words}}} if words else {})


def _one_of(groups: tuple[Group, ...], definitions: dict[str, Any]) -> dict[str, Any]:
    """Alternatives selected by each group's first required key, so that an editor reports problems
    of the group meant.
    """
    first, *others = groups
    schema = _group(first, definitions, FieldSpec())
    if not others:
        return schema
    decisive = next(key.name for key in keys_of(first) if key.required)
    return {"if": {"required": [decisive]}, "then": schema, "else": _one_of(tuple(others), definitions)}


def _given(schema: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {name: value for name, value in schema.items() if value is not None and value is not False} | more


# Tables of the guide for a declared file: keys, allowed values and meanings.

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
