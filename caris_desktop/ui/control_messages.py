"""Values of robot controls as text, and the confirmation question of a control."""

from caris_desktop.domain.control_definitions import ControlValue, RobotControl


def value_words(control: RobotControl, value: ControlValue) -> str:
    """The value as shown to the wizard: on, 62 %, Welcome."""
    for choice in control.choices:
        if choice.value == value and isinstance(choice.value, bool) == isinstance(value, bool):
            return choice.title
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, str):
        return value or "empty"
    number = f"{value:.{_decimals(control, value)}f}"
    return f"{number} {control.unit}" if control.unit else number


def question_for(control: RobotControl, value: ControlValue) -> str:
    if control.kind == "button":
        return f"{control.title}?"
    if control.kind == "toggle":
        return f"{control.title} {'on' if value else 'off'}?"
    return f"{control.title}: {value_words(control, value)}?"


def _decimals(control: RobotControl, value: float) -> int:
    if control.step > 0:
        return len(f"{control.step:.3f}".rstrip("0").partition(".")[2])
    if control.kind != "slider" and float(value).is_integer():
        return 0
    size = control.highest - control.lowest if control.kind == "slider" else abs(value)
    return 0 if size >= 100 else 1 if size >= 10 else 2
