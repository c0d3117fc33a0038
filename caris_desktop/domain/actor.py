"""Who asks for what is done: in intents, in the commands that follow from them, and in the events that tell of it."""

Actor = str
"""``wizard`` (this computer's), ``wizard:NAME`` (another one), ``console`` by itself, ``model`` or ``script``.

Empty in events: somebody or something else, as a button on the robot, or nobody wrote it down, as in older recordings.
"""

WIZARD: Actor = "wizard"
CONSOLE: Actor = "console"
MODEL: Actor = "model"
SCRIPT: Actor = "script"
OTHER_WIZARD = "wizard:"
"""What their names stand behind."""


def in_words(actor: Actor) -> str:
    """Who that is, inside a sentence of the record, which holds no names."""
    if actor.startswith(OTHER_WIZARD):
        return "another wizard"
    return {CONSOLE: "the console", MODEL: "the language model", SCRIPT: "a script"}.get(actor, "the wizard")
