"""Sharing of a scenario: with the user's robot and face, without secrets, and into the user's folders."""

from dataclasses import replace
from pathlib import Path

import pytest

from caris_desktop.app import composition
from caris_desktop.app.composition import import_conflicts, import_scenario, share_scenario
from caris_desktop.conversation.face.face_file import load_face, save_face
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.intents import SameName
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.services.scenario_service import Imported
from caris_desktop.robot.profile import load_profile, save_profile, user_robots_dir
from caris_desktop.scenario.bundle import read_bundle, write_bundle
from caris_desktop.scenario.scenario_file import list_scenarios, load_scenario, save_scenario, user_scenarios_dir


@pytest.fixture(autouse=True)
def somebodys_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "sender"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "sender"))


def test_a_bundle_gives_the_same_scenario_robot_and_face(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    profile = replace(load_profile("simulated"), title="Ours", address="wss://robot.example:9090")
    save_profile(profile, user_robots_dir() / "ours.yaml")
    save_face(replace(load_face("calm"), name="round", title="Round"))
    tour = load_scenario(layouts_dir() / "tour-guide.yaml")
    sent = save_scenario(
        replace(tour, title="Visit", robot="ours", face=replace(tour.face, face="round"), path=None),
        user_scenarios_dir() / "visit.yaml",
    )
    share_scenario(sent, tmp_path / "visit.caris")
    inside = read_bundle(tmp_path / "visit.caris")
    assert [(part.kind, part.name) for part in inside.beside] == [("robot", "ours"), ("face", "round")]
    assert str(tmp_path) not in inside.scenario.text, "nothing tells where it lay on that computer"

    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "receiver"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "receiver"))
    assert import_conflicts(tmp_path / "visit.caris") == ()
    imported = import_scenario(tmp_path / "visit.caris")
    path = imported.path
    assert imported == Imported(path)
    got = load_scenario(path)
    assert (got.title, got.protocol, got.phrases) == ("Visit", sent.protocol, sent.phrases)
    assert load_profile(got.robot).title == "Ours" and load_face(got.face.face).title == "Round"
    assert path in [choice.path for choice in list_scenarios()]


def test_a_shipped_scenario_that_was_changed_does_not_hide_the_shipped_one(tmp_path: Path) -> None:
    tour = composition.find_scenario("tour-guide")
    share_scenario(tour, tmp_path / "same.caris")
    assert import_scenario(tmp_path / "same.caris") == Imported(tour.path or Path()), "it is here already"
    assert list_own() == []
    changed = save_scenario(replace(tour, title="My tour"), tmp_path / "tour-guide.yaml")
    share_scenario(changed, tmp_path / "tour.caris")
    [conflict] = import_conflicts(tmp_path / "tour.caris")
    assert (conflict.there, conflict.own, conflict.free) == (tour.path, False, "tour-guide-2")
    assert "My tour" in conflict.part.text and "My tour" not in conflict.text
    imported = import_scenario(tmp_path / "tour.caris")
    assert (imported.path.stem, imported.renamed) == ("tour-guide-2", "tour-guide → tour-guide-2")
    assert composition.find_scenario("tour-guide").title == "Tour guide"


def test_the_choice_for_each_name_is_applied_and_nothing_is_lost(tmp_path: Path) -> None:
    tour = composition.find_scenario("tour-guide")
    save_profile(replace(load_profile("simulated"), title="Theirs"), user_robots_dir() / "ours.yaml")
    theirs = save_scenario(replace(tour, title="Theirs", robot="ours"), tmp_path / "visit.yaml")
    share_scenario(theirs, tmp_path / "v.caris")
    mine = save_scenario(replace(tour, title="Mine"), user_scenarios_dir() / "visit.yaml")
    robot = user_robots_dir() / "ours.yaml"
    save_profile(replace(load_profile("simulated"), title="Mine"), robot)
    before = robot.read_text()
    conflicts = import_conflicts(tmp_path / "v.caris")
    assert [(one.part.kind, one.part.name, one.own, one.free) for one in conflicts] == [
        ("scenario", "visit", True, "visit-2"), ("robot", "ours", True, "ours-2"),
    ]  # fmt: skip
    decided = (SameName("scenario", "visit", "their-visit"), SameName("robot", "ours"))
    imported = import_scenario(tmp_path / "v.caris", decided)
    assert (imported.path.name, imported.renamed) == ("their-visit.yaml", "")
    assert load_scenario(imported.path).title == "Theirs" and load_profile("ours").title == "Theirs"
    assert load_scenario(mine.path or Path()).title == "Mine", "kept beside it"
    assert Path(imported.put_aside).read_text() == before, "what was replaced is put aside"
    assert imported.path in [choice.path for choice in list_scenarios()]
    assert "replaced" not in [choice.path.parent.name for choice in list_scenarios()]


def test_a_name_that_is_taken_or_cannot_be_is_refused_and_everything_stays(tmp_path: Path) -> None:
    tour = composition.find_scenario("tour-guide")
    share_scenario(save_scenario(replace(tour, title="Theirs"), tmp_path / "visit.yaml"), tmp_path / "v.caris")
    for name in ("visit", "other"):
        save_scenario(replace(tour, title=name), user_scenarios_dir() / f"{name}.yaml")
    before = {path: path.read_text() for path in list_own()}
    for name, why in (
        ("other", "named 'other' already exists"),
        ("../x", "is not a valid name"),
        ("tour-guide", "already"),
    ):
        with pytest.raises(UserFacingError) as told:
            import_scenario(tmp_path / "v.caris", [SameName("scenario", "visit", name)])
        assert why in told.value.meaning
    assert {path: path.read_text() for path in list_own()} == before


def list_own() -> list[Path]:
    return sorted(user_scenarios_dir().glob("*.yaml")) if user_scenarios_dir().is_dir() else []


def test_a_robot_in_it_that_cannot_be_is_reported_and_nothing_is_saved(tmp_path: Path) -> None:
    save_profile(load_profile("simulated"), user_robots_dir() / "ours.yaml")
    tour = replace(composition.find_scenario("tour-guide"), robot="ours")
    share_scenario(tour, tmp_path / "tour.caris")
    inside = read_bundle(tmp_path / "tour.caris")
    broken = replace(inside, beside=(replace(inside.beside[0], text="title: Ours\nros: 7\n"),))
    write_bundle(broken, tmp_path / "broken.caris")
    with pytest.raises(UserFacingError) as told:
        import_scenario(tmp_path / "broken.caris")
    assert "broken.caris, robot/ours.yaml, line " in told.value.meaning
    assert list_own() == []
