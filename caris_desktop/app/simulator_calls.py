"""What the program asks of the simulated robot itself, beside what any robot can be asked for."""

import asyncio
import json
import logging
from collections.abc import Mapping, Sequence

_log = logging.getLogger(__name__)
SAY, PREPARE, FAULT = "/simulator/say", "/simulator/prepare", "/simulator/fault"
# What is to be said is made first, which on a busy computer takes its time.
_TOLD_WITHIN_S = 60.0


async def call(address: str, service: str, arguments: Sequence[Mapping[str, str]]) -> None:
    """One call of ``service`` for each. A rosbridge forgets what it has not obeyed yet when its client leaves, so each
    call waits for its answer. What fails is for whoever waits for the outcome to notice, and in the log.
    """
    from websockets.asyncio.client import connect
    from websockets.exceptions import WebSocketException

    try:
        async with asyncio.timeout(_TOLD_WITHIN_S), connect(address) as robot:
            for number, told in enumerate(arguments):
                asked = {"op": "call_service", "id": f"{number}", "service": service, "args": dict(told)}
                await robot.send(json.dumps(asked))
                while json.loads(await robot.recv()).get("id") != asked["id"]:
                    pass
    except (OSError, TimeoutError, ValueError, WebSocketException):
        _log.warning("the simulated robot could not be asked for %s", service, exc_info=True)
