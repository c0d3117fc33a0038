"""Discrete events of a session. All are recorded, none may be lost.

``stamp_ns`` is the session clock. People appear as opaque ``person_id``; names are only in the study's database.
``actor`` requested what the event reports; events without a request, such as an arrival, have none.

One file per subject; the union of all is here.
"""

from caris_desktop.domain.events.conversation_events import (
    AnswerUsed,
    AssistanceLevel,
    AssistantChanged,
    AssistedFunction,
    ChatMessage,
    FaceChanged,
    LevelChanged,
    LlmExchange,
    LlmOutcome,
    ProposalChanged,
    ProposalState,
    ReplyMeans,
    ResponseTimed,
    Speaker,
    SuggestionChanged,
    SuggestionState,
    UtteranceChanged,
    UtteranceCorrected,
    UtteranceOrigin,
    UtteranceState,
    VoiceChanged,
    VoiceOutput,
)
from caris_desktop.domain.events.people_events import (
    ConsentKind,
    ConsentNoted,
    IdentifiedBy,
    PeopleDecision,
    PeopleMerged,
    PeopleUndone,
    PersonAppeared,
    PersonAttended,
    PersonDescribed,
    PersonDetail,
    PersonForgotten,
    PersonIdentified,
    PersonLeft,
    PersonRejected,
    PersonRenamed,
    PersonSplit,
    PersonSuggested,
)
from caris_desktop.domain.events.practice_events import PracticeEnded, PracticeStepEnded
from caris_desktop.domain.events.preflight_events import PreflightChecked, PreflightState
from caris_desktop.domain.events.protocol_events import (
    LATE_FROM_S,
    PlannedStep,
    ProtocolEnded,
    ProtocolOpened,
    StepEntered,
    StepHow,
    StepTicked,
)
from caris_desktop.domain.events.robot_events import (
    CommandSent,
    CommandSource,
    ControlUsed,
    DriveEnded,
    EmergencyStopChanged,
    GamepadChanged,
    GoalChanged,
    GoalState,
    GuardChanged,
    GuardState,
    HeadMoved,
    InitialPoseSet,
    LinkChanged,
    LinkQuality,
    LinkState,
    MapOperation,
    MappingChanged,
    MapRequestChanged,
    MovementChanged,
    MovementState,
    NavigationSpeedChanged,
    PlacesChanged,
    RequestState,
    StopRequested,
    TopicTraffic,
    TrafficMeasured,
)
from caris_desktop.domain.events.session_events import (
    ANSWER,
    LOST_ON_THE_WAY,
    OVERTAKEN,
    AlarmChanged,
    AlarmState,
    ConfirmedAsBefore,
    Gap,
    LayoutChanged,
    Marked,
    MarkKind,
    MarkState,
    PhotoDeleted,
    PhotoTagged,
    PhotoTaken,
    Problem,
    ProblemEnd,
    RecordingPaused,
    RobotChosen,
    ScenarioOpened,
    SessionEnded,
    SessionStarted,
    Severity,
    TrialResumed,
)

Event = (
    LinkChanged
    | LinkQuality
    | CommandSent
    | DriveEnded
    | StopRequested
    | EmergencyStopChanged
    | GoalChanged
    | NavigationSpeedChanged
    | GuardChanged
    | MovementChanged
    | InitialPoseSet
    | MapRequestChanged
    | MappingChanged
    | PlacesChanged
    | HeadMoved
    | ControlUsed
    | TrafficMeasured
    | GamepadChanged
    | UtteranceChanged
    | LlmExchange
    | AnswerUsed
    | UtteranceCorrected
    | ResponseTimed
    | SuggestionChanged
    | ProposalChanged
    | LevelChanged
    | VoiceChanged
    | AssistantChanged
    | FaceChanged
    | PersonAppeared
    | PersonLeft
    | PersonRenamed
    | PersonSuggested
    | PersonIdentified
    | PersonRejected
    | PersonDescribed
    | PeopleMerged
    | PersonSplit
    | ConsentNoted
    | PersonAttended
    | PeopleUndone
    | PersonForgotten
    | PhotoTaken
    | PhotoTagged
    | PhotoDeleted
    | Marked
    | ProtocolOpened
    | StepEntered
    | StepTicked
    | ProtocolEnded
    | RecordingPaused
    | PreflightChecked
    | ScenarioOpened
    | RobotChosen
    | LayoutChanged
    | Gap
    | Problem
    | AlarmChanged
    | SessionStarted
    | SessionEnded
    | TrialResumed
    | ConfirmedAsBefore
    | PracticeStepEnded
    | PracticeEnded
)
