"""The JSON Schema of a declared file, by which editors complete, check and explain what is typed."""

from typing import Any

from caris_desktop.domain.declared import Form, Group, choices_of, form_of, groups_of, is_group, item_of, keys_of

_TYPES = {str: "string", float: "number", int: "integer", bool: "boolean"}


def file_schema(declaration: Group, *, schema_id: str, title: str) -> dict[str, Any]:
    """The schema of a whole file."""
    definitions: dict[str, Any] = {}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": schema_id,
        "title": title,
        **_bare(form_of(declaration), definitions),
        "description": description_of(form_of(declaration)),
        "$defs": definitions,
    }


def description_of(form: Form) -> str:
    """What people are told of a place: its rule's text, or else what its declaration says of itself."""
    own = is_group(form.kind) and form.foreign is None
    said = form.rule.text or (form.kind.__doc__ if own else "") or ""
    return " ".join(said.replace("``", "`").split())


def _schema(form: Form, definitions: dict[str, Any]) -> dict[str, Any]:
    schema = _defined(form, definitions) if form.rule.noun else _bare(form, definitions)
    allowed = f"Allowed: {form.rule.allowed}" if form.rule.allowed else ""
    description = f"{description_of(form)} {allowed}".strip()
    return {**schema, "description": description} if description else schema


def _defined(form: Form, definitions: dict[str, Any]) -> dict[str, Any]:
    """What has a noun is described once, and may hold itself."""
    name = form.rule.noun.replace(" ", "_")
    if name not in definitions:
        definitions[name] = {}
        definitions[name] |= {"title": form.rule.noun, **_bare(form, definitions)}
    return {"$ref": f"#/$defs/{name}"}


def _bare(form: Form, definitions: dict[str, Any]) -> dict[str, Any]:
    kind, rule = form.kind, form.rule
    if form.foreign is not None:
        return {"$ref": form.foreign.schema}
    if is_group(kind):
        return _group(kind, definitions)
    if groups := groups_of(kind):
        return {"type": "object", **_one_of(groups, definitions)}
    if choices := choices_of(kind):
        return {"enum": list(choices)} if len(choices) > 1 else {"const": choices[0]}
    if (item := item_of(kind)) is not None:
        return _given(
            {"type": "array", "minItems": rule.shortest or None, "maxItems": rule.longest, "uniqueItems": rule.unique},
            items=_schema(item, definitions),
        )
    return _given(
        {
            "type": _TYPES[kind],
            "minLength": rule.shortest or None,
            "maxLength": rule.longest,
            "pattern": rule.pattern or None,
            "minimum": rule.at_least,
            "exclusiveMinimum": rule.more_than,
            "maximum": rule.at_most,
        }
    )


def _group(group: Group, definitions: dict[str, Any]) -> dict[str, Any]:
    properties = {}
    required = []
    for key in keys_of(group):
        properties[key.name] = _schema(key.form, definitions)
        if isinstance(key.default, (bool, int, float, str)) and key.default != "" and not key.form.rule.wanted:
            properties[key.name]["default"] = key.default
        if key.required or key.form.rule.wanted:
            required.append(key.name)
    wanted = {"required": required} if required else {}
    return {"type": "object", **wanted, "additionalProperties": False, "properties": properties}


def _one_of(groups: tuple[Group, ...], definitions: dict[str, Any]) -> dict[str, Any]:
    """Decided by the first key that a group must have, so that an editor tells what is wrong in the one meant."""
    first, *others = groups
    schema = _group(first, definitions)
    if not others:
        return schema
    decisive = next(key.name for key in keys_of(first) if key.required)
    return {"if": {"required": [decisive]}, "then": schema, "else": _one_of(tuple(others), definitions)}


def _given(schema: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {name: value for name, value in schema.items() if value is not None and value is not False} | more
