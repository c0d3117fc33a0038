"""Events of the conversation and of the language model."""

from typing import Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.value_class import dataclass

Speaker = Literal["robot", "participant", "wizard"]
UtteranceOrigin = Literal[
    "typed", "phrase", "filler", "assistant", "suggestion", "heard", "dictated", "own_voice"
]  # fmt: skip
UtteranceState = Literal["requested", "started", "finished", "interrupted", "failed"]
LlmOutcome = Literal["answered", "cancelled", "failed"]


@dataclass(frozen=True, slots=True)
class UtteranceChanged:
    """State of an utterance. The same ``utterance_id`` returns with each new state.

    ``actor`` requested the utterance or, if it is interrupted, silenced it. ``person_id`` is the person addressed, or
    the speaker; empty if unknown. ``{p-...}`` in ``text`` replaces the name of the person with that id. ``source`` is
    the microphone that picked it up. ``estimated``: the time is an estimate. ``confidence`` (0 to 1) and ``language``
    come from the speech recogniser. ``gesture`` accompanies the utterance.
    """

    stamp_ns: int
    utterance_id: str
    speaker: Speaker
    text: str
    origin: UtteranceOrigin
    state: UtteranceState
    voice: str = ""
    detail: str = ""
    actor: Actor = ""
    person_id: str = ""
    source: str = ""
    estimated: bool = False
    confidence: float | None = None
    language: str = ""
    gesture: str = ""


@dataclass(frozen=True, slots=True)
class UtteranceCorrected:
    """Correction of an utterance: its text, speaker, person, tags or times. None: not changed.

    ``speaker`` and ``person_id`` may be empty for "not sure". ``person_confidence`` is the likelihood of that person, 0
    to 1, if the console identified the speaker. ``start_ns`` and ``end_ns`` are the start and end of the voice in the
    samples of a microphone.
    """

    stamp_ns: int
    utterance_id: str
    text: str | None = None
    speaker: Literal["", "robot", "participant", "wizard"] | None = None
    person_id: str | None = None
    tags: tuple[str, ...] | None = None
    actor: Actor = ""
    person_confidence: float | None = None
    start_ns: int | None = None
    end_ns: int | None = None


ReplyMeans = Literal[
    "typed", "phrase", "suggestion", "edited_suggestion", "filler", "assistant", "own_voice", "dictated"
]


@dataclass(frozen=True, slots=True)
class ResponseTimed:
    """Times of the robot's response to a turn of the participant, on the session clock; None: did not occur.

    ``turn_id`` and ``reply_id`` are the utterances. ``voice_ended_ns``: acoustic end of the turn, later than the first
    sound if the robot spoke over it. ``text_ns``: final transcript. ``suggested_ns``: suggestions shown. ``asked_ns``:
    key pressed by the wizard. ``first_sound_ns``: first sound of the robot.
    """

    stamp_ns: int
    turn_id: str
    reply_id: str
    means: ReplyMeans
    voice_ended_ns: int
    text_ns: int | None = None
    suggested_ns: int | None = None
    asked_ns: int | None = None
    first_sound_ns: int | None = None
    person_id: str = ""


SuggestionState = Literal["displayed", "taken", "edited", "dismissed", "superseded", "expired"]


@dataclass(frozen=True, slots=True)
class SuggestionChanged:
    """A suggested reply was shown, or its outcome is known. The same ``suggestion_id`` returns once.

    ``turn_id`` and ``revision`` identify the turn. ``rank`` is its position and the number of its key (1 to 3).
    ``latency_ms`` is from the end of the participant's voice until it was shown. ``edit_distance`` counts the
    characters that the wizard changed. ``utterance_id`` is what was said of it.
    """

    stamp_ns: int
    suggestion_id: str
    state: SuggestionState
    turn_id: str
    revision: int
    rank: int
    text: str
    model: str
    latency_ms: float | None = None
    edit_distance: int | None = None
    utterance_id: str = ""
    actor: Actor = ""


ProposalState = Literal["displayed", "counting", "confirmed", "vetoed", "lapsed", "refused"]


@dataclass(frozen=True, slots=True)
class ProposalChanged:
    """State of an action that a language model proposed.

    ``intent`` is its type name in the table of intents, ``arguments`` its fields. ``refused``: by the gate, or because
    it was outside the list or the bounds; ``detail`` gives the reason.
    """

    stamp_ns: int
    proposal_id: str
    state: ProposalState
    turn_id: str
    revision: int
    intent: str
    arguments: dict[str, float | str | bool]
    model: str
    detail: str = ""
    actor: Actor = ""


AssistedFunction = Literal["replies", "fillers", "actions"]
AssistanceLevel = Literal["off", "suggest", "act"]


@dataclass(frozen=True, slots=True)
class LevelChanged:
    """Degree of automation of the language model."""

    stamp_ns: int
    function: AssistedFunction
    level: AssistanceLevel
    actor: Actor = ""


VoiceOutput = Literal["robot", "computer", "both"]


@dataclass(frozen=True, slots=True)
class VoiceChanged:
    """Speech output changed: who speaks, and this computer's voice, rate and volume as in the scenario file."""

    stamp_ns: int
    output: VoiceOutput
    name: str = ""
    language: str = ""
    rate: float = 1.0
    volume: float = 1.0
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class FaceChanged:
    """The robot's face changed, on ``screens`` windows and pages.

    ``image`` is the file name of an image, ``live`` whether the robot's camera image is shown.
    """

    stamp_ns: int
    expression: str
    text: str = ""
    image: str = ""
    live: bool = False
    screens: int = 0
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class ChatMessage:
    """One message of a prompt to a language model."""

    role: Literal["system", "user", "assistant"]
    content: str


@dataclass(frozen=True, slots=True)
class LlmExchange:
    """One finished exchange with a language model.

    ``server`` is its host and port, without credentials. ``seed`` is the random seed, None if none was sent. ``actor``
    asked the question. ``photo`` is the file name of the attached image, as in PhotoTaken, or ``camera NAME`` for its
    frame at that time. Several are separated by commas. ``purpose``: the wizard's question, suggested replies or
    proposed actions. ``turn_id`` and ``revision`` identify the turn that it refers to. ``cut``: the answer is
    incomplete because of its length limit or the server's filter; ``detail`` says so in words. ``parameters`` are those
    that the server accepted.
    """

    stamp_ns: int
    exchange_id: str
    provider: str
    model: str
    messages: tuple[ChatMessage, ...]
    answer: str
    outcome: LlmOutcome
    asked_ns: int
    first_token_ns: int | None
    parameters: dict[str, float | int | str]
    detail: str = ""
    model_version: str = ""
    server: str = ""
    seed: int | None = None
    actor: Actor = ""
    photo: str = ""
    purpose: Literal["question", "replies", "actions"] = "question"
    turn_id: str = ""
    revision: int = 0
    cut: Literal["", "length", "filter"] = ""


@dataclass(frozen=True, slots=True)
class AssistantChanged:
    """The assistant's settings changed: model, role, style, a prompt or the notes.

    ``name`` is the selection, or names the changed text; ``text`` is the new one. ``reset``: all is as in the scenario.
    """

    stamp_ns: int
    setting: Literal["model", "role", "style", "system_prompt", "notes", "reset"]
    name: str = ""
    text: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class AnswerUsed:
    """Use of a language model's answer. ``utterance_id`` is the robot's utterance made from it."""

    stamp_ns: int
    exchange_id: str
    use: Literal["said", "edited", "dismissed"]
    text: str
    utterance_id: str = ""
    actor: Actor = ""
