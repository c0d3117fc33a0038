"""Service calls to the simulated robot itself: speech and faults."""

import asyncio
import json
import logging
from collections.abc import Mapping, Sequence

_log = logging.getLogger(__name__)
SAY, PREPARE, FAULT = "/simulator/say", "/simulator/prepare", "/simulator/fault"
# Speech is synthesised first, which takes long on a busy computer.
_TIMEOUT_S = 60.0


async def call(address: str, service: str, arguments: Sequence[Mapping[str, str]]) -> None:
    """Call ``service`` once for each of ``arguments``. A rosbridge drops unexecuted calls when its client disconnects,
    so each call awaits its answer. Failures are logged only; the caller notices the missing effect.
    """
    from websockets.asyncio.client import connect
    from websockets.exceptions import WebSocketException

    try:
        async with asyncio.timeout(_TIMEOUT_S), connect(address) as robot:
            for number, values in enumerate(arguments):
                operation = {"op": "call_service", "id": f"{number}", "service": service, "args": dict(values)}
                await robot.send(json.dumps(operation))
                while json.loads(await robot.recv()).get("id") != operation["id"]:
                    pass
    except (OSError, TimeoutError, ValueError, WebSocketException):
        _log.warning("the simulated robot could not be asked for %s", service, exc_info=True)
