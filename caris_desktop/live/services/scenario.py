"""The scenario in force: opening another one, its places, and how the panels are arranged."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from PySide6.QtCore import QObject

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import WIZARD, Actor
from caris_desktop.domain.events import Event, LayoutChanged, PlacesChanged, ScenarioOpened
from caris_desktop.live.bus import Bus
from caris_desktop.live.service import Handlers, Service
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.model import Place, Scenario


@dataclass(frozen=True, slots=True)
class ScenarioParts:
    """``load`` and ``save_places`` raise ToldFailure; ``text`` is what is recorded of a scenario."""

    load: Callable[[Path], Scenario]
    save_places: Callable[[Scenario], Scenario]
    text: Callable[[Scenario], str]


class ScenarioService(Service):
    """Keeps ``state.scenario`` and ``state.places``. ``apply`` lets every service follow another scenario."""

    def __init__(
        self,
        state: LiveState,
        bus: Bus,
        parts: ScenarioParts,
        scenario: Scenario,
        *,
        apply: Callable[[Scenario], None],
        parent: QObject,
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._bus = bus
        self._parts = parts
        self._apply = apply
        self._layout: LayoutChanged | None = None
        # Who starts the program with a scenario is its wizard.
        self._opened_by: Actor = WIZARD
        self.current = scenario
        state.scenario.set(scenario)

    def handlers(self) -> Handlers:
        return {
            intents.OpenScenario: self._open,
            intents.SavePlace: self._save_place,
            intents.RemovePlace: self._remove_place,
            intents.KeepLayout: self._keep_layout,
        }

    def use_scenario(self, scenario: Scenario) -> None:
        self._state.places.set(scenario.places)
        self._bus.publish(self._opened())

    def standing(self, now_ns: int) -> list[Event]:
        """What heads a recording of it."""
        return [self._opened(), *([] if self._layout is None else [replace(self._layout, stamp_ns=now_ns)])]

    def _open(self, asked: intents.OpenScenario) -> None:
        self.current = self._parts.load(asked.path)
        self._opened_by = asked.actor
        self._layout = None
        self._apply(self.current)
        self._state.scenario.set(self.current)

    def _opened(self) -> ScenarioOpened:
        scenario = self.current
        name = scenario.path.name if scenario.path else ""
        text = self._parts.text(scenario)
        return ScenarioOpened(clock.now_ns(), name, scenario.title, scenario.sha256, text, self._opened_by)

    def _save_place(self, asked: intents.SavePlace) -> None:
        name = " ".join(asked.place.split())
        places = list(self.current.places)
        at = next((index for index, place in enumerate(places) if place.name == name), len(places))
        places[at : at + 1] = [Place(name, asked.pose_in_map)]
        self._keep_places(tuple(places), PlacesChanged(clock.now_ns(), name, asked.pose_in_map, asked.actor))

    def _remove_place(self, asked: intents.RemovePlace) -> None:
        places = tuple(place for place in self.current.places if place.name != asked.place)
        if len(places) < len(self.current.places):
            self._keep_places(places, PlacesChanged(clock.now_ns(), asked.place, None, asked.actor))

    def _keep_places(self, places: tuple[Place, ...], event: PlacesChanged) -> None:
        self.current = self._parts.save_places(replace(self.current, places=places))
        self._opened_by = event.actor
        self._state.places.set(places)
        self._bus.publish(event)
        self._bus.publish(self._opened())
        self._state.scenario.set(self.current)

    def _keep_layout(self, asked: intents.KeepLayout) -> None:
        self._layout = LayoutChanged(clock.now_ns(), asked.layout, asked.actor)
        self._bus.publish(self._layout)
