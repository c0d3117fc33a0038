"""State labels on derived tiers: English in files, translatable for display."""

from caris_desktop.domain.events import EmergencyStopChanged, LinkChanged, LlmExchange
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.recording.session.session_protocol import StepVisit
from caris_desktop.recording.session.session_robot import NavigationGoal

WIZARD_ERRORS = (QT_TR_NOOP("slip"), QT_TR_NOOP("late"), QT_TR_NOOP("wrong branch"))

STATES_IN_WORDS = (
    QT_TR_NOOP("standing"), QT_TR_NOOP("forward"), QT_TR_NOOP("backward"), QT_TR_NOOP("sideways"),
    QT_TR_NOOP("turning"), QT_TR_NOOP("keyboard"), QT_TR_NOOP("gamepad"), QT_TR_NOOP("onscreen"),
    QT_TR_NOOP("rehearsal"), QT_TR_NOOP("stop"), QT_TR_NOOP("lease"), QT_TR_NOOP("none"), QT_TR_NOOP("typed"),
    QT_TR_NOOP("phrase"), QT_TR_NOOP("filler"), QT_TR_NOOP("assistant"), QT_TR_NOOP("suggestion"),
    QT_TR_NOOP("heard"), QT_TR_NOOP("dictated"), QT_TR_NOOP("own_voice"), QT_TR_NOOP("said"), QT_TR_NOOP("edited"),
    QT_TR_NOOP("dismissed"), QT_TR_NOOP("unheard"), QT_TR_NOOP("requested"), QT_TR_NOOP("active"),
    QT_TR_NOOP("reached"), QT_TR_NOOP("cancelled"), QT_TR_NOOP("failed"), QT_TR_NOOP("answered"),
    QT_TR_NOOP("control"), QT_TR_NOOP("media"), QT_TR_NOOP("connecting"), QT_TR_NOOP("trouble"), QT_TR_NOOP("lost"),
    QT_TR_NOOP("slowing"), QT_TR_NOOP("blocked"), QT_TR_NOOP("blind"), QT_TR_NOOP("overridden"), QT_TR_NOOP("wizard"),
    QT_TR_NOOP("robot"), QT_TR_NOOP("console"), QT_TR_NOOP("model"), QT_TR_NOOP("script"),
    QT_TR_NOOP("present"), QT_TR_NOOP("paused"), QT_TR_NOOP("unspecified"),
)  # fmt: skip
"""All words for states on a tier, for translators of the timeline."""


def state(word: str) -> str:
    """State for the file and for ``tr``; an unknown word, such as another wizard's name, stays as it is."""
    return localized(word) if word in STATES_IN_WORDS else word


def error_words(label: str) -> str:
    """Wizard error label; a wizard's own wording is not translated."""
    return localized(label) if label in WIZARD_ERRORS else label


def step_words(visit: StepVisit) -> str:
    skipped = visit.left == "skipped"
    return localized(QT_TR_NOOP("{step} (skipped)"), step=visit.title) if skipped else visit.title or visit.step_id


def goal_words(goal: NavigationGoal) -> str:
    target = goal.place or f"({goal.target_in_map.x_m:.2f}, {goal.target_in_map.y_m:.2f})"
    return localized(QT_TR_NOOP("{place}: {state}"), place=target, state=state(goal.state))


def answer_words(exchange: LlmExchange) -> str:
    """Answer of the language model, or the reason why there is none."""
    reason = localized(
        QT_TR_NOOP("({outcome}: {detail})"), outcome=state(exchange.outcome), detail=localized(exchange.detail)
    )
    answer = localized(QT_TR_NOOP("{answer} (cut off)"), answer=exchange.answer) if exchange.cut else exchange.answer
    return answer if exchange.answer else reason


def link_words(change: LinkChanged) -> str:
    message = QT_TR_NOOP("{link}: {state} ({detail})") if change.detail else QT_TR_NOOP("{link}: {state}")
    return localized(message, link=state(change.link), state=state(change.state), detail=localized(change.detail))


def emergency_words(change: EmergencyStopChanged) -> str:
    return localized(QT_TR_NOOP("set by {whom}"), whom=state(change.actor or change.by))
