"""Demo controls of the default robot model for the Robot panel: lights, volume, gesture, screen, eyes."""

import asyncio
import math
from typing import Any

from caris_desktop.ros import message_conversion
from caris_desktop.ros.message_fields import message_of, number, truth
from caris_desktop.simulator.ros_context import Wiring
from caris_desktop.simulator.server import Message

WAVE_S = 2.0
_MOST_SCREEN_CHARS = 500
_TEMPERATURE_STEPS = 50


class DemoControls:
    """Holds the present values, publishes them on latched topics, and lists them in :attr:`state`."""

    def __init__(self, wiring: Wiring) -> None:
        self._wiring = wiring
        self._steps = 0
        self._color = {"r": 0.0, "g": 0.0, "b": 0.0, "a": 0.0}
        self._volume = 60.0
        self._screen = ""
        self._eyes = True
        self._waves_begun = 0
        self._waving = False
        self._waving_task: asyncio.TimerHandle | None = None
        wiring.obeys("/leds/color", "std_msgs", "ColorRGBA", self._on_color)
        wiring.obeys("/volume", "std_msgs", "Float32", self._on_volume)
        wiring.obeys("/screen/text", "std_msgs", "String", self._on_screen)
        wiring.serves("/gestures/wave", "std_srvs", "Trigger", self._wave)
        wiring.serves("/eyes/set", "std_srvs", "SetBool", self._set_eyes)
        self._volume_state = wiring.publishes("/volume/state", "std_msgs", "Float32", latched=True)
        self._eyes_state = wiring.publishes("/eyes/state", "std_msgs", "Bool", latched=True)
        self._temperature = wiring.publishes("/diagnostics/temperature", "std_msgs", "Float32")
        wiring.publish(self._volume_state, {"data": self._volume})
        wiring.publish(self._eyes_state, message_conversion.encode_bool(self._eyes))

    @property
    def state(self) -> dict[str, Any]:
        return {
            "leds": dict(self._color),
            "volume": self._volume,
            "screen": self._screen,
            "eyes_open": self._eyes,
            "waving": self._waving,
            "waves_begun": self._waves_begun,
            "temperature_c": self.temperature_c,
        }

    @property
    def temperature_c(self) -> float:
        """Motor temperature: rises with speed, with a slow oscillation, so that a plot shows something."""
        truth_ = self._wiring.robot.truth
        effort = abs(truth_.forward_mps) + abs(truth_.left_mps) + 0.3 * abs(truth_.turn_radps)
        return 36.0 + 4.0 * effort + 0.5 * math.sin(self._wiring.robot.now_s / 7.0)

    def publish_due(self) -> None:
        """Publish due messages; called after every simulation step."""
        self._steps += 1
        if self._steps % _TEMPERATURE_STEPS == 0 and self._wiring.wanted(self._temperature):
            self._wiring.publish(self._temperature, {"data": self.temperature_c})

    def stop(self) -> None:
        """Cancel pending work."""
        if self._waving_task is not None:
            self._waving_task.cancel()

    def _on_color(self, message: Message) -> None:
        color = message_of(message, "ColorRGBA")
        # ROS fills omitted fields with zero
        self._color = {
            channel: min(max(number(color, channel, "ColorRGBA"), 0.0), 1.0) if channel in color else 0.0
            for channel in "rgba"
        }

    def _on_volume(self, message: Message) -> None:
        self._volume = min(max(number(message_of(message, "Float32"), "data", "Float32"), 0.0), 100.0)
        self._wiring.publish(self._volume_state, {"data": self._volume})

    def _on_screen(self, message: Message) -> None:
        self._screen = message_conversion.decode_string(message)[:_MOST_SCREEN_CHARS]

    def _wave(self, _: Message) -> Message:
        if self._waving:
            return {"success": False, "message": "the arm is already waving"}
        self._waving = True
        self._waves_begun += 1
        self._waving_task = asyncio.get_running_loop().call_later(WAVE_S, self._end_wave)
        return {"success": True, "message": f"waving for {WAVE_S:g} s"}

    def _end_wave(self) -> None:
        self._waving = False

    def _set_eyes(self, arguments: Message) -> Message:
        self._eyes = truth(arguments, "data", "args")
        self._wiring.publish(self._eyes_state, message_conversion.encode_bool(self._eyes))
        return {"success": True, "message": "open" if self._eyes else "closed"}
