"""Console that records onto a small disk while the disk fills; prints one JSON object with the displayed state."""

import json
import sys
from pathlib import Path

from mcap.reader import make_reader

from tests.support.console_process import ConsoleProcess
from tests.support.polling import wait_for


def main(disk: Path, address: str) -> None:
    console = ConsoleProcess(address, disk / "study")
    console.wait_until_shown(link="connected", drive_allowed=True, video="fresh")
    console.send_command("record")
    folder = Path(console.wait_until_shown(recording="recording")["session"])
    with (disk / "ballast").open("wb", buffering=0) as ballast:

        def filled() -> bool:
            try:
                ballast.write(b"\1" * 2_000_000)
            except OSError:
                return bool(console.shown["recording"] == "failed")
            return False

        wait_for(filled, "the recording has failed", timeout_s=60)
    failed = dict(console.shown)
    (disk / "ballast").unlink()
    with (folder / "events.mcap").open("rb") as stream:
        messages = list(make_reader(stream).iter_messages(topics=["/event/session_ended"]))
    console.send_command("export")
    exported = wait_for(lambda: console.shown["exports"], "the export is made")
    print(
        json.dumps(
            {
                "problems": failed["problems"],
                "link": console.shown["link"],
                "reason": json.loads(messages[-1][2].data)["reason"] if messages else "",
                "exported": sorted(path.name for path in Path(exported[0]).iterdir()),
                "closed_with": console.close(),
            }
        )
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
