"""Palette items for the protocol: steps, and branches of the current step."""

from functools import partial

from caris_desktop.domain import intents
from caris_desktop.domain.translation import tr
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui.palette.palette_item import PaletteItem
from caris_desktop.ui.step_intents import present_step, target_of


def step_entries(console: WizardConsole) -> list[PaletteItem]:
    scenario = console.scenario
    step = present_step(scenario, console.state)
    branches = [
        PaletteItem(
            tr("{what}: continue to {step}").format(what=branch.title, step=target_of(scenario, branch).title),
            tr("Branch"), "git-branch", "", partial(console.do, intents.TakeBranch(branch.title)),
            also=tr("branch protocol"), acts=True,
            named=f"{branch.title} {target_of(scenario, branch).title}",
            id=f"Branch: {branch.title}: on to {target_of(scenario, branch).title}",
        )
        for branch in (() if step is None else step.branches)
    ]  # fmt: skip
    steps = [
        PaletteItem(
            tr("Step {number}: {title}").format(number=number, title=one.title), tr("Step"), "list-numbers", "",
            partial(console.do, intents.GoToStep(one.step_id)), also=tr("protocol jump begin"), acts=True,
            named=f"{number} {one.title}",
            id=f"Step: Step {number}: {one.title}",
        )
        for number, one in enumerate(scenario.protocol.steps, start=1)
    ]  # fmt: skip
    return [*branches, *steps]
