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
    """A text that is selected by its name."""

    name: Annotated[str, FieldSpec("Name shown to the wizard.", shortest=1, longest=40)]
    text: Annotated[str, FieldSpec("The text itself.", prose=True, longest=TEXT_CHARACTERS)]


AssistantPeople = Literal["numbers", "names", "history"]


@dataclass(frozen=True, slots=True)
class AssistantSettings:
    """Settings of the language model."""

    model: Annotated[
        str,
        FieldSpec(
            "The built-in model, or one of Ollama, of an OpenAI-compatible server or of Gemini.",
            pattern=MODEL_PATTERN,
            allowed=MODEL_ALLOWED,
            external="language_model",
        ),
    ] = "embedded"
    system_prompt: Annotated[
        str, FieldSpec("Instructions to the model before the conversation.", prose=True, longest=PROMPT_CHARACTERS)
    ] = ""
    max_tokens: Annotated[
        int, FieldSpec("Maximum length of an answer, in tokens.", title="Longest answer", at_least=1, at_most=8192)
    ] = 96
    temperature: Annotated[
        float, FieldSpec("0: always the most likely word; higher: more varied.", at_least=0, at_most=2)
    ] = 0.4
    people: Annotated[
        AssistantPeople,
        FieldSpec(
            "Information for the model about the people present: `person 3`; their names; or their names "
            "with group, tags, note and history. Names are sent to the model's computer, and never saved in "
            "the recording.",
            title="Information about people",
            quiet=True,
        ),
    ] = "numbers"
    pictures: Annotated[
        bool,
        FieldSpec(
            "Pictures may be sent to the model with a question. `embedded` does not accept pictures.", quiet=True
        ),
    ] = False
    models: Annotated[
        tuple[Annotated[str, FieldSpec(pattern=MODEL_PATTERN, allowed=MODEL_ALLOWED, external="language_model")], ...],
        FieldSpec(
            "Further models that the wizard may choose, in addition to the built-in one and those listed by "
            "Ollama and an OpenAI-compatible server on this computer.",
            title="Further models",
            longest=20,
            unique=True,
            quiet=True,
        ),
    ] = ()
    roles: Annotated[
        tuple[NamedText, ...],
        FieldSpec(
            "Roles of the model that the wizard can choose, one at a time; sent after `system_prompt`.",
            longest=20,
            quiet=True,
        ),
    ] = ()
    styles: Annotated[
        tuple[NamedText, ...],
        FieldSpec(
            "Styles of the answers that the wizard can choose, one at a time; sent after the role.",
            longest=20,
            quiet=True,
        ),
    ] = ()
    templates: Annotated[
        tuple[NamedText, ...],
        FieldSpec(
            "Prepared questions for the field; `{said}` stands for the participant's last utterance.",
            longest=20,
            quiet=True,
        ),
    ] = ()
    notes: Annotated[
        str, FieldSpec("Notes for the model, which the wizard can change.", prose=True, longest=4000, quiet=True)
    ] = ""
