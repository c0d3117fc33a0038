"""Robot models of the simulated robot, from ``resources/simulator/robots.yaml``."""

from dataclasses import replace
from functools import lru_cache

from caris_desktop.simulator.robot_interface import RobotInterface
from caris_desktop.simulator.shipped_data import built, shipped_data
from caris_desktop.simulator.simulated_base import HOLONOMIC

DEFAULT = "generic"


class UnknownRobotModel(ValueError):  # noqa: N818 - the user asked for what is not there; nothing is broken
    """Unknown robot model, or not for this ROS; the text lists the available ones."""


@lru_cache
def _models() -> dict[str, dict[int, RobotInterface]]:
    """Models by name and ROS version."""
    models: dict[str, dict[int, RobotInterface]] = {}
    for data in shipped_data("robots.yaml"):
        models.setdefault(data["name"], {})[data["dialect"]] = built(RobotInterface, data)
    return models


def robot_model_named(
    name: str, ros: int | None = None, *, namespace: str | None = None, holonomic: bool = False
) -> RobotInterface:
    """Robot model by name, for ROS 1 or 2 if it exists for both.

    Parameters
    ----------
    namespace
        Put before the names that are relative; None takes what the robot usually has.
    holonomic
        Also for robots whose wheels do not allow it, to practise.

    Raises
    ------
    UnknownRobotModel
        Otherwise.
    """
    cut = _models().get(name)
    if cut is None:
        available = ", ".join(robot_model_names())
        raise UnknownRobotModel(f"Unknown robot model '{name}'. Available models: {available}.")
    if ros is not None and ros not in cut:
        (only,) = cut
        raise UnknownRobotModel(f"The robot model '{name}' requires ROS {only}: omit --ros, or choose another model.")
    model = cut[ros if ros is not None else min(cut)]
    if namespace is not None:
        model = replace(model, namespace=namespace.strip("/"))
    if holonomic and not model.body.base.left_mps:
        base = replace(model.body.base, left_mps=HOLONOMIC.left_mps)
        model = replace(model, body=replace(model.body, base=base))
    return model


def robot_model_names() -> tuple[str, ...]:
    """Names of all models."""
    return tuple(sorted(_models()))
