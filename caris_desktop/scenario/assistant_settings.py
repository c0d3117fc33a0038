"""Assistant section of a scenario: the language model and its prompts."""

from typing import Annotated, Literal

from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.value_class import dataclass

PROMPT_CHARACTERS, TEXT_CHARACTERS = 8000, 4000
"""The longest system prompt, and the longest of the other texts: in the file and as the wizard changes them."""
MODEL_PATTERN = "^(embedded|ollama:.+|openai:.+|gemini:.+)$"
MODEL_ALLOWED = "embedded, ollama:NAME, openai:NAME or gemini:NAME."


@dataclass(frozen=True, slots=True)
class NamedText:
    """A text that is chosen by its name."""

    name: Annotated[str, FieldSpec("How the wizard finds it.", shortest=1, longest=40)]
    text: Annotated[str, FieldSpec("What it says.", prose=True, longest=TEXT_CHARACTERS)]


AssistantPeople = Literal["numbers", "names", "history"]


@dataclass(frozen=True, slots=True)
class AssistantSettings:
    """How the language model is asked."""

    model: Annotated[
        str,
        FieldSpec(
            "The model of this program, or one of Ollama, of an OpenAI-compatible server or of Gemini.",
            pattern=MODEL_PATTERN,
            allowed=MODEL_ALLOWED,
            external="language_model",
        ),
    ] = "embedded"
    system_prompt: Annotated[
        str, FieldSpec("What the model is told before the conversation.", prose=True, longest=PROMPT_CHARACTERS)
    ] = ""
    max_tokens: Annotated[
        int, FieldSpec("The longest answer, in tokens.", title="Longest answer", at_least=1, at_most=8192)
    ] = 96
    temperature: Annotated[
        float, FieldSpec("0: always the likeliest word; more: more varied.", at_least=0, at_most=2)
    ] = 0.4
    people: Annotated[
        AssistantPeople,
        FieldSpec(
            "What the model is told of who is here: `person 3`; their names; or with their names also group, tags, "
            "note and what there was before. Names go to the model's computer, and never into the recording.",
            title="What it is told of people",
            quiet=True,
        ),
    ] = "numbers"
    pictures: Annotated[
        bool,
        FieldSpec("Pictures may be given to the model with a question. `embedded` sees none.", quiet=True),
    ] = False
    models: Annotated[
        tuple[Annotated[str, FieldSpec(pattern=MODEL_PATTERN, allowed=MODEL_ALLOWED, external="language_model")], ...],
        FieldSpec(
            "Further models that the wizard may choose, beside that of this program and those that Ollama and an "
            "OpenAI-compatible server on this computer list.",
            title="Further models",
            longest=20,
            unique=True,
            quiet=True,
        ),
    ] = ()
    roles: Annotated[
        tuple[NamedText, ...],
        FieldSpec(
            "What the model may be for the wizard, one at a time: told after `system_prompt`.", longest=20, quiet=True
        ),
    ] = ()
    styles: Annotated[
        tuple[NamedText, ...],
        FieldSpec("How it may answer, one at a time: told after the role.", longest=20, quiet=True),
    ] = ()
    templates: Annotated[
        tuple[NamedText, ...],
        FieldSpec(
            "Prepared questions for the field; `{said}` in one is what the participant said last.",
            longest=20,
            quiet=True,
        ),
    ] = ()
    notes: Annotated[
        str,
        FieldSpec(
            "What the model is told as notes, which the wizard can change.", prose=True, longest=4000, quiet=True
        ),
    ] = ""
