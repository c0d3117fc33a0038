"""Guide page of each panel, popup and window."""

import re
from collections.abc import Mapping
from pathlib import Path

from PySide6.QtWidgets import QWidget

from caris_desktop.domain.shipped import resources_dir

FIRST_PAGE = "wizard.md"
PAGES: Mapping[str, str] = {
    "AgreementDialog": "sessions.md#annotation",
    "AlarmList": "alarms.md#alarms",
    "AssistantPanel": "assistant.md",
    "BranchesCard": "protocol.md#keys",
    "CommandPalette": "keys.md#find-anything",
    "ConfirmFileDialog": "scenarios.md#sharing",
    "ConnectionCard": "wizard.md#when-something-goes-wrong",
    "ConversationPanel": "conversation.md",
    "DiagnosticsPanel": "wizard.md#robot-and-other-panels",
    "DrivePanel": "wizard.md#driving",
    "ExportDialog": "sessions.md#export",
    "FaceEditor": "face.md#your-own-faces",
    "FacePanel": "face.md",
    "FaceWindow": "face.md#show-the-face",
    "GamepadDialog": "wizard.md#driving",
    "ImportConflictDialog": "scenarios.md#sharing",
    "ImportDialog": "sessions.md#annotation",
    "LabelCard": "sessions.md#annotation",
    "MapPanel": "wizard.md#map",
    "MarkCard": "wizard.md#recording",
    "MotionPanel": "wizard.md#robot-and-other-panels",
    "NotesPanel": "alarms.md#notes",
    "ObserverWindow": "wizard.md#observer-windows",
    "PeoplePanel": "people.md",
    "PhotosPanel": "wizard.md#photos",
    "PracticeStrip": "practice.md",
    "PreflightCard": "preflight.md",
    "ProtocolStrip": "protocol.md",
    "ResumeTrialCard": "practice.md#resume-a-trial-after-a-crash",
    "RobotDialog": "robot-profiles.md#quick-start",
    "RobotPanel": "robot-profiles.md#the-robot-panel",
    "ScenarioEditor": "editing-scenarios.md",
    "SessionPanel": "wizard.md#recording",
    "SessionsWindow": "sessions.md",
    "SetUpPage": "first-use.md",
    "ShortcutSheet": "keys.md#change-keys",
    "SpeakPanel": "wizard.md#speaking",
    "StartDialog": "wizard.md#recording",
    "StepsCard": "protocol.md#keys",
    "TierDialog": "sessions.md#annotation",
    "TitleDialog": "layouts.md#the-layout-menu",
    "VideoPanel": "wizard.md#several-cameras",
}
"""Guide page by class name of a panel, popup or window."""


def guide_dir() -> Path:
    return resources_dir() / "guide"


def page_of(widget: QWidget | None) -> str:
    """Page of the innermost panel, popup or window around ``widget``; the wizard's guide for all others."""
    while widget is not None:
        if page := PAGES.get(type(widget).__name__):
            return page
        widget = widget.parentWidget()
    return FIRST_PAGE


def anchor_of(heading: str) -> str:
    """Anchor of a heading, as the documentation site makes it."""
    return re.sub(r"[^\w\s-]", "", heading).strip().lower().replace(" ", "-")
