"""Parameters of a question that a server does not take: which one it names, and the question without it.

Servers that copy an API know some of its parameters, and models of one server differ: OpenAI's newer ones take no
``temperature`` and no ``max_tokens``, Gemini's older ones no ``thinkingConfig``.
"""

import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from caris_desktop.conversation.models.question import Request

LIMITS = ("max_tokens", "max_completion_tokens", "maxOutputTokens", "num_predict")
# How a server may write each; a question is whole without any of them.
_NAMED_AS = {
    "temperature": r"temperature",
    "max_tokens": r"max_tokens",
    "max_completion_tokens": r"max_(?:completion_)?tokens",
    "maxOutputTokens": r"max_?output_?tokens",
    "num_predict": r"num_predict",
    "seed": r"seed",
    "reasoning_effort": r"reasoning(?:_effort|\.effort)?",
    "thinkingConfig": r"thinking\w*",
    "think": r"think(?:ing)?",
    "response_format": r"response_format|json_schema|json_object",
    "responseSchema": r"response_?schema",
    "format": r"[\"'`]format[\"'`]",
    "cache_prompt": r"cache_prompt",
    "id_slot": r"id_slot",
}
_WITHIN = ("options", "generationConfig")


def parameters_sent(request: Request) -> tuple[str, ...]:
    """Those in the request that it can do without."""
    places = (request.body, *(request.body[key] for key in _WITHIN if key in request.body))
    return tuple(name for name in _NAMED_AS if any(name in place for place in places))


def named_parameter(request: Request, answer: dict[str, Any], reason: str) -> str:
    """Which of them a refusal names, in its ``param``, its ``loc`` or its words; empty for none."""
    sent = parameters_sent(request)
    for told in (*_named_apart(answer), reason):
        found = [(match.start(), name) for name in sent if (match := _pattern(name).search(told))]
        if found:
            return min(found)[1]
    return ""


def _pattern(name: str) -> re.Pattern[str]:
    return re.compile(rf"(?<!\w)(?:{_NAMED_AS[name]})(?!\w)", re.IGNORECASE)


def _named_apart(answer: dict[str, Any]) -> Iterable[str]:
    error = answer.get("error")
    for told in (error if isinstance(error, dict) else {}, answer):
        if isinstance(told.get("param"), str):
            yield told["param"]
    details = answer.get("detail")
    for detail in details if isinstance(details, list) else ():
        if isinstance(detail, dict) and isinstance(detail.get("loc"), list):
            yield " ".join(map(str, detail["loc"]))


def leave_out(request: Request, names: Iterable[str]) -> Request:
    """The request without these; without its limit nobody but the reader of the answer keeps to it."""
    names = frozenset(names)
    body = {key: value for key, value in request.body.items() if key not in names}
    for key in _WITHIN:
        if key in body:
            body[key] = {name: value for name, value in body[key].items() if name not in names}
    return replace(request, body=body, bounded=request.bounded and names.isdisjoint(LIMITS))
