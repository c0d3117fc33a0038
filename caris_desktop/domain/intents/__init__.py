"""Intents: all requests to the console, as data, and one table of what each may do.

Keys, buttons, the palette, gamepads, proposals of a language model, a second wizard and the record use these types
only. A new function is one dataclass and one table line in the file of its subject, and one handler in its service.
"""

from caris_desktop.domain.intents.assistant_intents import (
    ASSISTANT,
    CAMERA_PICTURE,
    Ask,
    AskAboutPhoto,
    CancelAnswer,
    ChooseModel,
    ChoosePrompt,
    DismissAnswer,
    EditPrompt,
    PromptPart,
    ResetPrompts,
    SayAnswer,
)
from caris_desktop.domain.intents.base_intents import (
    AsBefore,
    Bounds,
    Intent,
    IntentSpec,
    IntentTable,
    Moves,
    Permission,
)
from caris_desktop.domain.intents.conversation_intents import CONVERSATION, CorrectUtterance
from caris_desktop.domain.intents.driving_intents import (
    DRIVING,
    Drive,
    EmergencyStop,
    LookAt,
    Nod,
    ReleaseDrive,
    ReleaseEmergencyStop,
    SetGuard,
    SetSpeed,
    Stop,
    TurnHead,
)
from caris_desktop.domain.intents.face_intents import (
    FACE,
    KeepFace,
    ServeFace,
    ShowExpression,
    ShowFaceWindow,
    ShowOnFace,
    UseFace,
)
from caris_desktop.domain.intents.marks_intents import (
    MARKS,
    AddNote,
    BeginMark,
    ChangeMark,
    ChangeNote,
    EndMark,
    Mark,
    RemoveNote,
    RestoreNote,
    StretchMark,
    WithdrawMark,
    new_mark_id,
)
from caris_desktop.domain.intents.people_intents import (
    PEOPLE,
    AttendPerson,
    ConfirmPerson,
    ForgetPerson,
    LookUpPerson,
    MergePeople,
    NamePerson,
    NoteConsent,
    NotePerson,
    RejectPerson,
    SetPersonGroup,
    SplitPerson,
    TagPerson,
    UndoPeople,
)
from caris_desktop.domain.intents.places_intents import (
    PLACES,
    CancelGoal,
    GoToPlace,
    GoToPoint,
    LoadMap,
    RemovePlace,
    SaveMap,
    SavePlace,
    SetInitialPose,
    SetMapping,
)
from caris_desktop.domain.intents.practice_intents import PRACTICE, BeginPractice, EndPractice, SkipPracticeStep
from caris_desktop.domain.intents.preflight_intents import PREFLIGHT, TickCheck, TryMicrophone
from caris_desktop.domain.intents.protocol_intents import (
    PROTOCOL,
    GoToStep,
    NextStep,
    PreviousStep,
    SkipStep,
    TakeBranch,
    TickItem,
)
from caris_desktop.domain.intents.robot_intents import ROBOT, UseControl, UseRobot, UseSimulatedRobot
from caris_desktop.domain.intents.session_intents import (
    SESSION,
    ConfirmAsBefore,
    ConfirmFile,
    DeletePhoto,
    DismissAlarm,
    GoOnWithTrial,
    ImportScenario,
    KeepLayout,
    LeaveTrial,
    OpenScenario,
    PauseRecording,
    ResetLayout,
    RestorePhoto,
    SameName,
    SaveLayout,
    SaveScenario,
    ShareScenario,
    SizeClass,
    StartRecording,
    StopRecording,
    TagPhoto,
    TakePhoto,
)
from caris_desktop.domain.intents.sound_intents import SOUND, HearRobot, PushToTalk, UseMicrophone
from caris_desktop.domain.intents.speaking_intents import (
    SPEAKING,
    CancelQueued,
    DraftSpeech,
    EditQueued,
    FillGap,
    MoveQueued,
    Say,
    SetVoice,
    Silence,
)
from caris_desktop.domain.intents.suggestions_intents import (
    SUGGESTIONS,
    ConfirmProposal,
    DismissSuggestions,
    SayEditedSuggestion,
    SaySuggestion,
    SetLevel,
    VetoProposal,
)

INTENTS: IntentTable = {
    **DRIVING,
    **PLACES,
    **ROBOT,
    **SPEAKING,
    **SOUND,
    **CONVERSATION,
    **ASSISTANT,
    **FACE,
    **SUGGESTIONS,
    **PEOPLE,
    **SESSION,
    **PREFLIGHT,
    **MARKS,
    **PROTOCOL,
    **PRACTICE,
}
"""Table of all intents, from one part per subject."""
