"""SDL's virtual joystick: a gamepad without hardware, attached to the SDL library of pygame-ce."""

import ctypes
import importlib.util
from pathlib import Path

_GAME_CONTROLLER = 1
CONTROLLER_AXES, CONTROLLER_BUTTONS = 6, 15


def _sdl() -> ctypes.CDLL:
    spec = importlib.util.find_spec("pygame")
    if spec is None or spec.origin is None:
        raise RuntimeError("pygame-ce is not installed")
    folder = Path(spec.origin).parent
    found = [*(folder.parent / "pygame_ce.libs").glob("libSDL2-2*"), *folder.glob("**/SDL2.dll")]
    sdl = ctypes.CDLL(str(found[0]))
    sdl.SDL_JoystickOpen.restype = ctypes.c_void_p
    sdl.SDL_JoystickInstanceID.argtypes = [ctypes.c_void_p]
    sdl.SDL_JoystickClose.argtypes = [ctypes.c_void_p]
    sdl.SDL_JoystickSetVirtualAxis.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_int16]
    sdl.SDL_JoystickSetVirtualButton.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_uint8]
    sdl.SDL_JoystickGetButton.argtypes = [ctypes.c_void_p, ctypes.c_int]
    sdl.SDL_JoystickGetButton.restype = ctypes.c_uint8
    return sdl


class VirtualGamepad:
    """Gamepad that is attached from construction to ``unplug()``. SDL must be initialised in this process."""

    def __init__(
        self, *, kind: int = _GAME_CONTROLLER, axes: int = CONTROLLER_AXES, buttons: int = CONTROLLER_BUTTONS
    ) -> None:
        # SDL locks in each call. Holding its lock across calls would deadlock: the thread that reads gamepads waits for
        # it while holding the GIL.
        self._sdl = _sdl()
        index = self._sdl.SDL_JoystickAttachVirtual(kind, axes, buttons, 0)
        if index < 0:
            raise RuntimeError("SDL has no virtual joystick here")
        self._handle = self._sdl.SDL_JoystickOpen(index)
        self._instance = self._sdl.SDL_JoystickInstanceID(self._handle)

    def push(self, axis: int, value: float) -> None:
        """Move an axis to -1..1."""
        self._sdl.SDL_JoystickSetVirtualAxis(self._handle, axis, round(value * 32767))

    def press(self, button: int) -> None:
        self._sdl.SDL_JoystickSetVirtualButton(self._handle, button, 1)

    def release(self, button: int) -> None:
        self._sdl.SDL_JoystickSetVirtualButton(self._handle, button, 0)

    def has_been_read(self, button: int, *, held: bool) -> bool:
        """True if SDL has delivered this state; a change before that would be lost."""
        return bool(self._sdl.SDL_JoystickGetButton(self._handle, button)) == held

    def unplug(self) -> None:
        """Detach the gamepad, even while a button is pressed."""
        for index in range(self._sdl.SDL_NumJoysticks()):
            if self._sdl.SDL_JoystickGetDeviceInstanceID(index) == self._instance:
                self._sdl.SDL_JoystickDetachVirtual(index)
                break
