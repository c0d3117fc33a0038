"""``caris-desktop robots``: list of known robots, interfaces of an unknown one, and a check of its streams."""

import argparse
import asyncio
import sys

from caris_desktop.app import composition
from caris_desktop.app.arguments import add_accept_named
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.live.confirmed_files import accept_written_profile
from caris_desktop.recording.terminal import reporting
from caris_desktop.robot.discovery import Exploration, StreamCheck, check_streams, explore_robot, load_profile_blocking
from caris_desktop.robot.profile import list_profiles, own_profile_file, save_profile, user_robots_dir
from caris_desktop.robot.profile_model import ProfileError, check_address
from caris_desktop.robot.profile_proposal import profile_of

_MARKS = {"good": "ok  ", "quiet": "..  ", "slow": "SLOW", "nothing": "NONE", "wrong": "FIX "}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--explore", metavar="ws://HOST:PORT|ros2:", help="explore the robot's interfaces, and propose a profile for it"
    )
    parser.add_argument(
        "--save", metavar="TITLE", help="save the proposed profile under this title with your own profiles"
    )
    parser.add_argument(
        "--listen",
        metavar="PROFILE|ws://HOST:PORT|ros2:",
        help="listen to every stream of a profile, and report its state",
    )
    add_accept_named(parser)
    parser.add_argument("--seconds", type=float, default=3.0, help="listening time in seconds (default: 3)")


@reporting(UserFacingError, ProfileError, composition.StartError)
def run(arguments: argparse.Namespace) -> int:
    """Exit status 0 if all is well; lists the known robots without arguments."""
    if arguments.explore:
        return _explore(check_address(arguments.explore), arguments.save)
    if arguments.listen:
        composition.confirm_robot(arguments.listen, accept_named=arguments.accept_named)
        return _listen(arguments.listen, arguments.seconds)
    if arguments.save:
        print("--save requires --explore.", file=sys.stderr)
        return 2
    return _list()


def _list() -> int:
    for profile in list_profiles():
        whose = "shipped" if profile.shipped else "own"
        print(f"{profile.name:<20} {whose:<8} {profile.error or f'{profile.title}, {profile.address}'}")
    print(f"Folder for your own profiles: {user_robots_dir()}.")
    return 0


def _explore(address: str, title: str | None) -> int:
    found = asyncio.run(explore_robot(address, on_progress=lambda words: print(f"{words} ...", flush=True)))
    _notify(found)
    if title is None:
        return 0
    path = own_profile_file(title)
    if path.exists():
        print(f"{path} already exists. Choose another title, or remove it first.", file=sys.stderr)
        return 1
    profile = profile_of(found.offer, found.proposal.chosen, name=path.stem, title=title, address=address)
    save_profile(profile, path)
    accept_written_profile(profile, path)
    print(f"Saved as {path}. Use it with --robot {path.stem}.")
    return 0


def _notify(found: Exploration) -> None:
    offer = found.offer
    ros = f"ROS {offer.dialect.value}" if offer.dialect else "Unknown ROS version"
    print(
        f"{ros} {offer.distribution}: {len(offer.topics)} topics, {len(offer.services)} services, "
        f"{len(offer.actions)} actions."
    )
    for resemblance in found.resembles:
        print(f"It resembles {resemblance.title}: --robot {resemblance.name} ({resemblance.share:.0%} of its names).")
    for proposal in found.proposal.fields:
        print(f"{proposal.label:<22} {proposal.value or '-':<40} {proposal.why}")
        others = [candidate.value for candidate in proposal.candidates if candidate.value != proposal.value]
        if others:
            print(f"{'':<22} or {', '.join(others[:5])}")
    for note in found.proposal.notes:
        print(note)


def _listen(name: str, seconds: float) -> int:
    profile = load_profile_blocking(name)
    print(f"Listening to {profile.title} at {profile.address} ...", flush=True)
    checks = asyncio.run(check_streams(profile, seconds=seconds))
    for check in checks:
        print(f"{_MARKS[check.state]} {check.label:<24} {check.topic:<36} {_rate(check)}{check.detail}")
    return 1 if any(check.state in ("nothing", "wrong") for check in checks) else 0


def _rate(check: StreamCheck) -> str:
    return "" if check.rate_hz is None else f"{check.rate_hz:.1f} Hz. "
