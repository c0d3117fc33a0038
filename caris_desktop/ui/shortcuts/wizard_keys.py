"""Key bindings of the current wizard: saved in their profile, applied to the action table, edited on the sheet."""

from collections.abc import Callable

from PySide6.QtCore import QObject, Signal

from caris_desktop.domain.translation import tr
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_spec import ActionSpec
from caris_desktop.ui.key_choices import Keys, as_text, from_text, name_of_row, owners, with_keys, without
from caris_desktop.ui.wizard_profiles import WizardProfiles

_KEY = "shortcuts"
_UNREAD_KEY = "shortcuts unread"


class WizardKeys(QObject):
    """Key bindings of the current wizard. ``tell`` receives what happened, its meaning and advice if saved keys cannot
    be used.
    """

    changed = Signal()

    def __init__(
        self, wizards: WizardProfiles, actions: Actions, tell: Callable[[str, str, str], None], parent: QObject
    ) -> None:
        super().__init__(parent)
        self._wizards = wizards
        self._actions = actions
        self._tell = tell
        self._choices: dict[str, Keys] = {}
        self._reported: frozenset[str] = frozenset()
        wizards.changed.connect(self.take_up)
        actions.rebuilt.connect(self._report_fallbacks)
        self.take_up()

    @property
    def wizard(self) -> str:
        return self._wizards.current

    def take_up(self) -> None:
        """Apply the current wizard's bindings."""
        stored = str(self._wizards.value(_KEY, "") or "")
        try:
            choices = from_text(stored) if stored else {}
        except ValueError:
            choices = {}
            self._wizards.set_value(_UNREAD_KEY, stored)
            self._wizards.set_value(_KEY, "")
            self._tell(
                tr("Your custom keys could not be read."),
                tr("All commands use their default keys. The unreadable data stays in the settings."),
                tr("Set your keys again in All shortcuts."),
            )
        if choices != self._choices:
            self._use(choices)

    def is_changed(self, spec: ActionSpec) -> bool:
        return name_of_row(spec) in self._choices

    @property
    def any_changed(self) -> bool:
        return bool(self._choices)

    def choose(self, spec: ActionSpec, keys: Keys) -> None:
        """Set the row's keys; other rows lose conflicting ones."""
        rows = {row.id: row for row in self._actions.all_specs}
        choices = dict(self._choices)
        for key, other in owners(rows.values(), spec, keys):
            left = without(rows[other.id], key)
            choices[name_of_row(other)] = left
            rows[other.id] = with_keys(rows[other.id], left)
        choices[name_of_row(spec)] = keys
        for row in (*rows.values(), spec):
            standard = self._actions.standard_row(row.id)
            if choices.get(name_of_row(row)) == Keys(standard.keys, standard.driving_keys):
                del choices[name_of_row(row)]
        self._persist(choices)

    def reset(self, spec: ActionSpec) -> None:
        """Restore the row's default keys."""
        standard = self._actions.standard_row(spec.id)
        self.choose(spec, Keys(standard.keys, standard.driving_keys))

    def reset_all(self) -> None:
        self._persist({})

    def _persist(self, choices: dict[str, Keys]) -> None:
        self._wizards.set_value(_KEY, as_text(choices))
        self._use(choices)

    def _use(self, choices: dict[str, Keys]) -> None:
        self._choices = choices
        self._actions.use_choices(choices)
        self._report_fallbacks()
        self.changed.emit()

    def _report_fallbacks(self) -> None:
        fallen_back = frozenset(self._actions.settled.fallen_back)
        news = fallen_back - self._reported
        self._reported = fallen_back
        if news:
            self._tell(
                tr("Some of your keys cannot be used here."),
                " ".join(sorted(news)),
                tr("These commands use their default keys. View and change them in All shortcuts."),
            )
