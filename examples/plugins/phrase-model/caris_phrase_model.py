"""Language model for CARIS Desktop that answers by rules: the same answers in each rehearsal."""

import json
import re

RULES = [
    (r"\b(hello|hi|good (morning|day|evening))\b", "Hello! How can I help you?"),
    (r"\bwhere\b.*\b(café|cafe|coffee)\b", "The café is on the ground floor, to the left of the entrance."),
    (r"\bthank", "You are welcome."),
]
OTHERWISE = "I do not know that. Please ask at the desk."


class PhraseModel:
    """The contract is ``caris_desktop.conversation.embedded_server.LanguageModel``."""

    caris_interface = 1

    def answer(self, messages, *, max_tokens, temperature, seed, schema):
        question = messages[-1]["content"].lower()
        text = next((answer for pattern, answer in RULES if re.search(pattern, question)), OTHERWISE)
        if schema is not None:
            yield json.dumps(filled(schema, text))
            return
        yield from re.findall(r"\S+\s*", text)


def filled(schema, text):
    """The smallest value of this schema, with the answer as its text."""
    if "enum" in schema:
        return schema["enum"][0]
    if "anyOf" in schema:
        return filled(schema["anyOf"][0], text)
    match schema.get("type"):
        case "object":
            return {name: filled(each, text) for name, each in schema.get("properties", {}).items()}
        case "array":
            return [filled(schema.get("items", {}), text)] * max(1, schema.get("minItems", 1))
        case "integer" | "number":
            return schema.get("minimum", 0)
        case "boolean":
            return False
    return text
