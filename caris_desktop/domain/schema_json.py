"""JSON Schema of a declared file, with which editors complete, check and explain it."""

import ast
import functools
import inspect
import itertools
import json
import sys
from typing import Any

from caris_desktop.domain.schema_fields import FieldSpec, Group, Key, ValueForm, form_of, is_group, keys_of

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
