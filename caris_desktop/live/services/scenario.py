"""The scenario in force: opening another one, its places, and how the panels are arranged."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from PySide6.QtCore import QObject

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import WIZARD, Actor
from caris_desktop.domain.events import Event, LayoutChanged, PlacesChanged, ScenarioOpened
from caris_desktop.domain.failure import ToldFailure
from caris_desktop.live.bus import Bus
from caris_desktop.live.service import Handlers, Service
from caris_desktop.live.slow_work import SlowWork
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.model import Place, Scenario


@dataclass(frozen=True, slots=True)
class ScenarioParts:
    """``load`` and ``save_places`` raise ToldFailure; ``text`` is what is recorded of a scenario. All of them wait on
    files, and are called in a thread of their own.
    """

    load: Callable[[Path], Scenario]
    save_places: Callable[[Scenario], Scenario]
    text: Callable[[Scenario], str]


Places = tuple[Place, ...]
Filed = tuple[Scenario, str]
"""A scenario as it is in its file now, and the text of it."""


class ScenarioService(Service):
    """Keeps ``state.scenario`` and ``state.places``. ``apply`` lets every service follow another scenario.

    Files are read and written one after the other in the order of the requests, so that the last one counts.
    """

    def __init__(
        self,
        state: LiveState,
        bus: Bus,
        parts: ScenarioParts,
        scenario: Scenario,
        slow_work: SlowWork,
        *,
        apply: Callable[[Scenario], None],
        parent: QObject,
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._bus = bus
        self._parts = parts
        self._slow_work = slow_work
        self._apply = apply
        self._layout: LayoutChanged | None = None
        # Who starts the program with a scenario is its wizard.
        self._opened_by: Actor = WIZARD
        self._closed = False
        self.current = scenario
        self._text = parts.text(scenario)
        # ``current`` as it is once all that was asked for is done: only for the thread that does it.
        self._filed = scenario
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

    def rewrite(self, write: Callable[[Scenario], Path], written: Callable[[Path], None]) -> None:
        """Have ``write`` put the scenario into a file, which ``written`` hears of, and open that.

        ``write`` is called in a thread of its own, and raises ToldFailure.
        """

        def work() -> tuple[Path, Filed]:
            path = write(self._filed)
            return path, self._load(path)

        def done(outcome: tuple[Path, Filed]) -> None:
            path, filed = outcome
            written(path)
            self._use(filed, WIZARD)

        self._slow_work.do(work, done, self._tell)

    def stop(self) -> None:
        self._closed = True

    def _open(self, asked: intents.OpenScenario) -> None:
        self._slow_work.do(lambda: self._load(asked.path), lambda filed: self._use(filed, asked.actor), self._tell)

    def _load(self, path: Path) -> Filed:  # the thread of slow work
        self._filed = self._parts.load(path)
        return self._filed, self._parts.text(self._filed)

    def _use(self, filed: Filed, actor: Actor) -> None:
        self.current, self._text = filed
        self._opened_by = actor
        if self._closed:
            return
        self._layout = None
        self._apply(self.current)
        # Opened anew it has the arrangement of its file again.
        self._state.scenario.set_anew(self.current)

    def _opened(self) -> ScenarioOpened:
        scenario = self.current
        name = scenario.path.name if scenario.path else ""
        return ScenarioOpened(clock.now_ns(), name, scenario.title, scenario.sha256, self._text, self._opened_by)

    def _save_place(self, asked: intents.SavePlace) -> None:
        place = Place(" ".join(asked.place.split()), asked.pose_in_map)

        def with_it(places: Places) -> Places:
            at = next((index for index, one in enumerate(places) if one.name == place.name), len(places))
            return (*places[:at], place, *places[at + 1 :])

        self._change_places(with_it, PlacesChanged(clock.now_ns(), place.name, asked.pose_in_map, asked.actor))

    def _remove_place(self, asked: intents.RemovePlace) -> None:
        def without_it(places: Places) -> Places | None:
            left = tuple(place for place in places if place.name != asked.place)
            return left if len(left) < len(places) else None

        self._change_places(without_it, PlacesChanged(clock.now_ns(), asked.place, None, asked.actor))

    def _change_places(self, change: Callable[[Places], Places | None], event: PlacesChanged) -> None:
        """``change`` gives None where there is nothing to do."""

        def work() -> Filed | None:
            places = change(self._filed.places)
            if places is None:
                return None
            self._filed = self._parts.save_places(replace(self._filed, places=places))
            return self._filed, self._parts.text(self._filed)

        def done(filed: Filed | None) -> None:
            if filed is None:
                return
            self.current, self._text = filed
            self._opened_by = event.actor
            self._state.places.set(self.current.places)
            self._bus.publish(event)
            self._bus.publish(self._opened())
            self._state.scenario.set(self.current)

        self._slow_work.do(work, done, self._tell)

    def _tell(self, failure: ToldFailure) -> None:
        self._bus.problem(failure.severity, failure.what, failure.meaning, failure.advice)

    def _keep_layout(self, asked: intents.KeepLayout) -> None:
        self._layout = LayoutChanged(clock.now_ns(), asked.layout, asked.actor)
        self._bus.publish(self._layout)
