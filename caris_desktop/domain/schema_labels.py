"""Translated titles, descriptions and entry names of a declared file."""

import inspect
import re
from collections.abc import Iterator
from typing import Any

from caris_desktop.domain.schema_fields import Group, Key, ValueForm, form_of, keys_of
from caris_desktop.domain.schema_json import description_of
from caris_desktop.domain.translation import tr

_UNIT = re.compile(r"_(s|ms|m|mps|radps|px|deg|rad)$")


def title_of(key: Key) -> str:
    """Title of the key in a form."""
    title = _title(key)
    return tr(title)


def said_of(form: ValueForm) -> str:
    """Description; empty without one."""
    description = description_of(form)
    return tr(description)


def allowed_by(form: ValueForm) -> str:
    """Allowed values in words; empty without them."""
    return tr(form.rule.allowed)


def unit_of(form: ValueForm) -> str:
    return tr(form.rule.unit)


def section_of(key: Key) -> str:
    return tr(key.form.rule.section)


def noun_of(group: Group) -> str:
    """Noun for such a group."""
    noun = _noun(group)
    return tr(noun)


def words_of(group: Group) -> str:
    """Short description of such a group."""
    words = _first_words(group)
    return tr(words)


def word_of(choice: Any) -> str:
    """Selectable word for people."""
    word = _word(choice)
    return tr(word)


def texts_of(declaration: Group) -> list[str]:
    """All texts above of a declaration, untranslated."""
    return list(dict.fromkeys(text for text in _texts(form_of(declaration), set()) if text))


def _texts(form: ValueForm, seen: set[Any]) -> Iterator[str]:
    yield from (description_of(form), form.rule.allowed, form.rule.unit, form.rule.needs, form.rule.noun)
    yield from (_word(choice) for choice in (*form.choices, *form.rule.else_one_of))
    if (item := form.item) is not None:
        yield from _texts(item, seen)
    for group in form.groups:
        if group not in seen:
            seen.add(group)
            yield from (_noun(group), _first_words(group))
            for key in keys_of(group):
                yield from (_title(key), key.form.rule.section)
                yield from _texts(key.form, seen)


def _title(key: Key) -> str:
    words = _UNIT.sub("", key.name).replace("_", " ")
    return key.form.rule.title or words[:1].upper() + words[1:]


def _noun(group: Group) -> str:
    name = re.sub(r"(Settings|Keys|Node|Leaf|Entry)$", "", group.__name__).strip("_")
    return re.sub(r"(?<!^)(?=[A-Z])", " ", name).lower()


def _first_words(group: Group) -> str:
    docstring = " ".join((inspect.getdoc(group) or "").split())
    return re.split(r"[.,;:]", docstring)[0]


def _word(choice: Any) -> str:
    words = str(choice).replace("_", " ")
    return words[:1].upper() + words[1:]
