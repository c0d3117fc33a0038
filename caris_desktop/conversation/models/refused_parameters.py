"""Request parameters that a server refuses: detection by its error, and the request without them.

API-compatible servers support subsets, and models differ: OpenAI's newer ones refuse ``temperature`` and
``max_tokens``, Gemini's older ones ``thinkingConfig``.
"""

import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from caris_desktop.conversation.models.question import Request

LIMITS = ("max_tokens", "max_completion_tokens", "maxOutputTokens", "num_predict")
# Spellings in servers' errors; a question is complete without any of these.
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
    """Optional parameters in the request."""
    places = (request.body, *(request.body[key] for key in _WITHIN if key in request.body))
    return tuple(name for name in _NAMED_AS if any(name in place for place in places))


def named_parameter(request: Request, answer: dict[str, Any], reason: str) -> str:
    """Parameter that a refusal names in ``param``, ``loc`` or its text; empty for none."""
    sent = parameters_sent(request)
    for text in (*_named_apart(answer), reason):
        found = [(match.start(), name) for name in sent if (match := _pattern(name).search(text))]
        if found:
            return min(found)[1]
    return ""


def _pattern(name: str) -> re.Pattern[str]:
    return re.compile(rf"(?<!\w)(?:{_NAMED_AS[name]})(?!\w)", re.IGNORECASE)


def _named_apart(answer: dict[str, Any]) -> Iterable[str]:
    error = answer.get("error")
    for fields in (error if isinstance(error, dict) else {}, answer):
        if isinstance(fields.get("param"), str):
            yield fields["param"]
    details = answer.get("detail")
    for detail in details if isinstance(details, list) else ():
        if isinstance(detail, dict) and isinstance(detail.get("loc"), list):
            yield " ".join(map(str, detail["loc"]))


def leave_out(request: Request, names: Iterable[str]) -> Request:
    """Request without these parameters; without the limit, only the reader enforces it."""
    names = frozenset(names)
    body = {key: value for key, value in request.body.items() if key not in names}
    for key in _WITHIN:
        if key in body:
            body[key] = {name: value for name, value in body[key].items() if name not in names}
    return replace(request, body=body, bounded=request.bounded and names.isdisjoint(LIMITS))
