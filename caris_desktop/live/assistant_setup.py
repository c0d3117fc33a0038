"""Assistant setup: model and prompts, from the scenario with the wizard's changes."""

from typing import Literal

from caris_desktop.conversation.prompts import system_text
from caris_desktop.live.status import AssistantSetup
from caris_desktop.scenario.assistant_settings import PROMPT_CHARACTERS, TEXT_CHARACTERS, AssistantSettings, NamedText

Kind = Literal["system_prompt", "notes", "role", "style"]


def most_characters(kind: Kind) -> int:
    """Maximum length of an edited text, as in the scenario file."""
    return PROMPT_CHARACTERS if kind == "system_prompt" else TEXT_CHARACTERS


class AssistantSetupState:
    """Choices and edits of this session; the scenario file is not changed."""

    def __init__(self, settings: AssistantSettings) -> None:
        self._settings = settings
        self.model = self.role = self.style = ""
        self._edited: dict[tuple[Kind, str], str] = {}
        self.reset()

    def reset(self) -> None:
        """Reset to the scenario."""
        self.model = self._settings.model
        self.role = self.style = ""
        self._edited.clear()

    def has(self, kind: Literal["role", "style"], name: str) -> bool:
        return not name or any(each.name == name for each in self._named(kind))

    def choose(self, kind: Literal["role", "style"], name: str) -> None:
        if kind == "role":
            self.role = name
        else:
            self.style = name

    def edit(self, kind: Kind, name: str, text: str) -> None:
        """Replace a text of the scenario; the original text removes the edit."""
        key = (kind, name)
        if text == self._of_scenario(kind, name):
            self._edited.pop(key, None)
        else:
            self._edited[key] = text

    def text_of(self, kind: Kind, name: str = "") -> str:
        """Current text; empty for an unknown role or style."""
        return self._edited.get((kind, name), self._of_scenario(kind, name))

    @property
    def prompt(self) -> str:
        """Current complete system prompt."""
        return system_text(
            self.text_of("system_prompt"), self.text_of("role", self.role), self.text_of("style", self.style)
        )

    def shown(self) -> AssistantSetup:
        settings = self._settings
        return AssistantSetup(
            model=self.model,
            role=self.role,
            style=self.style,
            system_prompt=self.text_of("system_prompt"),
            roles=self._now("role"),
            styles=self._now("style"),
            templates=settings.templates,
            notes=self.text_of("notes"),
            edited=bool(self._edited) or self.model != settings.model or bool(self.role or self.style),
        )

    def _named(self, kind: Literal["role", "style"]) -> tuple[NamedText, ...]:
        return self._settings.roles if kind == "role" else self._settings.styles

    def _now(self, kind: Literal["role", "style"]) -> tuple[NamedText, ...]:
        return tuple(NamedText(each.name, self.text_of(kind, each.name)) for each in self._named(kind))

    def _of_scenario(self, kind: Kind, name: str) -> str:
        match kind:
            case "system_prompt":
                return self._settings.system_prompt
            case "notes":
                return self._settings.notes
            case _:
                return next((each.text for each in self._named(kind) if each.name == name), "")
