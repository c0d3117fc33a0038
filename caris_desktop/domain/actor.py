"""Actors: who requested an intent, the commands that follow from it, and the events that report it."""

from caris_desktop.domain.translation import QT_TR_NOOP

Actor = str
"""``wizard`` (this computer's), ``wizard:NAME`` (another one), ``console`` itself, ``model`` or ``script``.

Empty in events: another source, such as a button on the robot, or not recorded, as in older recordings.
"""

WIZARD: Actor = "wizard"
CONSOLE: Actor = "console"
MODEL: Actor = "model"
SCRIPT: Actor = "script"
OTHER_WIZARD = "wizard:"
"""Prefix of a wizard's name."""


def in_words(actor: Actor) -> str:
    """Actor within a sentence of the record, which contains no names."""
    if actor.startswith(OTHER_WIZARD):
        return QT_TR_NOOP("another wizard")
    named = {
        CONSOLE: QT_TR_NOOP("the console"), MODEL: QT_TR_NOOP("the language model"), SCRIPT: QT_TR_NOOP("a script"),
    }  # fmt: skip
    return named.get(actor, QT_TR_NOOP("the wizard"))


def cancelled_by(actor: Actor) -> str:
    """Reason why an action was cancelled, for the record."""
    if actor.startswith(OTHER_WIZARD):
        return QT_TR_NOOP("cancelled by another wizard")
    named = {
        CONSOLE: QT_TR_NOOP("cancelled by the console"),
        MODEL: QT_TR_NOOP("cancelled by the language model"),
        SCRIPT: QT_TR_NOOP("cancelled by a script"),
    }
    return named.get(actor, QT_TR_NOOP("cancelled by the wizard"))
