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
    """Something is said. The same ``utterance_id`` returns with each new state.

    ``actor`` had the robot say it, and where it is interrupted, silenced it. ``person_id`` is to whom it is said, or
    who says it; empty where that is not known. ``{p-...}`` in ``text`` stands for the name of the person with that id.
    ``source`` is the microphone that heard it. ``estimated``: nobody told when exactly this was, so it is reckoned.
    ``confidence`` is the recogniser's, 0 to 1, and ``language`` what it took it for. ``gesture`` goes along with it.
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
    """What was made out of an utterance, or who is said to have said it, is different: None is left as it is.

    ``speaker`` and ``person_id`` may be empty for "not sure". ``person_confidence`` is how likely it is that person,
    0 to 1, where the console took them for the speaker. ``start_ns`` and ``end_ns`` are when its voice began and ended
    in the samples of a microphone.
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
    """How the robot came to answer a turn of the participant. Moments on the session clock, None where there was none.

    ``turn_id`` and ``reply_id`` are the utterances; ``voice_ended_ns`` the acoustic end of the turn (later than the
    first sound where the robot spoke over it), ``text_ns`` when its text was final, ``suggested_ns`` when suggestions
    were shown, ``asked_ns`` when the wizard pressed the key, ``first_sound_ns`` when the robot was heard.
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
    """A suggested reply was shown, or met its one fate. The same ``suggestion_id`` returns once.

    ``turn_id`` and ``revision`` say to what it is a reply, ``rank`` is its place and the number of its key (1 to 3).
    ``latency_ms`` is from the end of the participant's voice until it was shown. ``edit_distance`` counts the
    characters that the wizard changed, ``utterance_id`` is what was said of it.
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
    """A language model proposed that something be done, and what became of that.

    ``intent`` is the name of its type in the table of intents, ``arguments`` its fields. ``refused``: by the gate or as
    it was outside the list or the bounds; ``detail`` says why.
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
    """How much the language model may do by itself."""

    stamp_ns: int
    function: AssistedFunction
    level: AssistanceLevel
    actor: Actor = ""


VoiceOutput = Literal["robot", "computer", "both"]


@dataclass(frozen=True, slots=True)
class VoiceChanged:
    """Who speaks from now on, and how this computer does: as in the scenario file, by its voice, rate and volume."""

    stamp_ns: int
    output: VoiceOutput
    name: str = ""
    language: str = ""
    rate: float = 1.0
    volume: float = 1.0
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class FaceChanged:
    """What the robot's face shows from now on, on ``screens`` windows and pages.

    ``image`` is the file name of a picture, ``live`` whether the robot's own picture is shown.
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

    ``server`` is the host that was asked, with its port and without credentials; ``seed`` what its choice of words
    began with, None where the server was not told one. ``actor`` asked the question. ``photo`` is the file name of the
    picture that went with it, as in PhotoTaken, or ``camera NAME`` for what one showed then; of several, with commas.
    ``purpose`` is what for: the wizard's question, suggested replies or proposed actions; ``turn_id`` and ``revision``
    say to what of the conversation. ``cut``: the answer ends before its end, at its limit of length or by the server's
    filter; ``detail`` says so in words. ``parameters`` are those that the server took.
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
    """The wizard asks differently from now on: another model, role or style, or other words of a prompt or the notes.

    ``name`` is what was chosen, or which text was changed; ``text`` the new one. ``reset``: all is as in the scenario.
    """

    stamp_ns: int
    setting: Literal["model", "role", "style", "system_prompt", "notes", "reset"]
    name: str = ""
    text: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class AnswerUsed:
    """What was done with a language model's answer. ``utterance_id`` is as what the robot was to say it."""

    stamp_ns: int
    exchange_id: str
    use: Literal["said", "edited", "dismissed"]
    text: str
    utterance_id: str = ""
    actor: Actor = ""
