"""Network and robot faults: both link processes, the simulated robot, and a proxy between them.

An independent client with a direct connection observes the robot's velocity topic.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import CommandSent, DriveEnded, LinkQuality
from caris_desktop.domain.link_commands import Release, RenewLease
from caris_desktop.domain.sensing import FrameRef, LaserScan, Odometry
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.live.state import LiveState
from caris_desktop.robot.unread import MOST_UNREAD
from tests.robot.link_bench import LinkProcess
from tests.robot.test_media_link import run_with_ring
from tests.support.polling import wait_for
from tests.support.simulated_robot import SimulatedRobot
from tests.support.tcp_proxy import TcpProxy
from tests.support.twist_listener import TwistListener

REPOSITORY = Path(__file__).parents[2]
SHOWN_WITHIN_S = 2.0
RESTORED_WITHIN_S = 8.0


class Bench:
    """Robot, proxy, links and independent listener."""

    def __init__(self) -> None:
        self.robot = SimulatedRobot()
        self.proxy = TcpProxy(self.robot.port)
        self.link = LinkProcess(self.proxy.address)
        self.link.wait_for_state("connected")
        self.listener = TwistListener(self.robot.address)
        wait_for(lambda: self.link.of(LaserScan), "scans")

    def close(self) -> None:
        self.link.close()
        self.listener.close()
        self.proxy.__exit__()
        self.robot.kill()

    def drive(self, *, turn_radps: float = 0.3) -> None:
        """Hold a key until the robot moves."""
        before = len(self.moving())
        self.link.drive(0.0, turn_radps)
        self.link.hold(lambda: len(self.moving()) > before + 4, "velocity commands reach the robot")

    def moving(self, *, since_s: float = 0.0) -> list[float]:
        """Arrival times of moving velocity commands at the robot, on the monotonic clock."""
        return [seen.at_ns / 1e9 for seen in list(self.listener.seen) if seen.moving and seen.at_ns / 1e9 >= since_s]

    def state_is_shown(self, *states: str, since_s: float, after: int) -> None:
        """Assert that one of ``states`` is reported within two seconds of ``since_s``, while the key stays held."""
        self.link.hold(
            lambda: any(state in states for state in self.link.states()[after:]),
            f"{states}, have {self.link.states()[after:]}",
        )
        assert time.monotonic() - since_s < SHOWN_WITHIN_S

    def hold_until(self, at_s: float) -> None:
        self.link.hold(lambda: time.monotonic() >= at_s, "that moment")

    def is_restored(self, *, after: int) -> float:
        """Assert that link and streams are back, the held key moves nothing and a new press does; returns its time."""
        restored_from_s = time.monotonic()
        self.link.hold(lambda: self.link.states()[after:][-1:] == ["connected"], "connected again")
        scans, poses = len(self.link.of(LaserScan)), len(self.link.of(Odometry))
        self.link.hold(
            lambda: len(self.link.of(LaserScan)) > scans + 3 and len(self.link.of(Odometry)) > poses + 3,
            "streams again",
        )
        assert time.monotonic() - restored_from_s < RESTORED_WITHIN_S
        if self.listener_is_deaf:
            self.listen_again()
        since_s = time.monotonic()
        self.hold_until(since_s + 0.3)
        assert self.moving(since_s=since_s) == []
        pressed_s = time.monotonic()
        self.drive()
        self.link.send(Release(now_ns()))
        wait_for(lambda: not self.listener.seen[-1].moving, "zero")
        return pressed_s

    @property
    def listener_is_deaf(self) -> bool:
        return self.listener.closed

    def listen_again(self) -> None:
        self.listener.close()
        self.listener = TwistListener(self.robot.address)


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.close()


@pytest.mark.long
def test_a_robot_that_stands_still_for_five_seconds(bench: Bench) -> None:
    bench.drive()
    after = len(bench.link.states())
    os.kill(bench.robot.pid, signal.SIGSTOP)
    stopped_s = time.monotonic()
    bench.state_is_shown("trouble", "lost", since_s=stopped_s, after=after)
    bench.link.hold(lambda: "lost" in bench.link.states()[after:], "lost")
    assert len(bench.link.of(DriveEnded)) == 1
    # The wizard presses the key again meanwhile.
    bench.link.drive(0.0, -0.3)
    bench.hold_until(stopped_s + 5.0)
    sent = len(bench.link.of(CommandSent))
    os.kill(bench.robot.pid, signal.SIGCONT)
    continued_s = time.monotonic()
    pressed_s = bench.is_restored(after=after)
    # Only commands sent before the stop may still be executed.
    late = [seen for seen in bench.listener.seen if seen.moving and seen.turn_radps < 0]
    assert late == []
    assert len([at_s for at_s in bench.moving(since_s=continued_s) if at_s < pressed_s]) <= 2 * MOST_UNREAD
    assert len(bench.link.of(CommandSent)) > sent


def test_a_robot_that_is_killed_and_started_again(bench: Bench) -> None:
    bench.drive()
    after = len(bench.link.states())
    bench.robot.kill()
    killed_s = time.monotonic()
    bench.state_is_shown("lost", since_s=killed_s, after=after)
    bench.link.drive(0.0, -0.3)
    bench.robot = SimulatedRobot(port=bench.robot.port)
    bench.listen_again()
    bench.is_restored(after=after)
    assert not [seen for seen in bench.listener.seen if seen.turn_radps < 0]


@pytest.mark.parametrize("direction", ["both", "to_server"])
@pytest.mark.long("both")
def test_a_connection_that_is_only_half_there(bench: Bench, direction: str) -> None:
    bench.drive()
    after = len(bench.link.states())
    bench.proxy.discard(direction)  # type: ignore[arg-type]
    discarded_s = time.monotonic()
    bench.state_is_shown("trouble", "lost", since_s=discarded_s, after=after)
    bench.link.hold(lambda: "lost" in bench.link.states()[after:], "lost")
    assert time.monotonic() - discarded_s < SHOWN_WITHIN_S + 0.5
    bench.link.drive(0.0, -0.3)
    bench.hold_until(discarded_s + 2.2)
    bench.proxy.discard("")
    opened_s = time.monotonic()
    bench.is_restored(after=after)
    assert not [seen for seen in bench.listener.seen if seen.turn_radps < 0]
    assert bench.moving(since_s=discarded_s + 0.3)[0] > opened_s


@pytest.mark.long
def test_a_network_that_takes_three_hundred_milliseconds(bench: Bench) -> None:
    after = len(bench.link.states())
    bench.proxy.delay(0.3)
    # The change to a slow network causes a pause, which ends the drive: press the key again.
    before = len(bench.moving())
    bench.link.drive_until(
        lambda: len(bench.moving()) > before + 4, "velocity commands reach the robot", turn_radps=0.3
    )
    slow_s = time.monotonic()
    bench.hold_until(slow_s + 1.5)
    quality = bench.link.of(LinkQuality)[-1]
    assert 500.0 < quality.round_trip_ms < 1000.0
    assert quality.clock_uncertainty_ms is not None
    released_s = time.monotonic()
    bench.link.send(Release(now_ns()))
    wait_for(lambda: bench.listener.seen[-1].at_ns / 1e9 > released_s and not bench.listener.seen[-1].moving, "zero")
    assert bench.moving()[-1] - released_s < 0.3 + 0.25
    # The network fails with commands on their way.
    bench.drive()
    after = len(bench.link.states())
    bench.proxy.cut()
    cut_s = time.monotonic()
    bench.state_is_shown("lost", since_s=cut_s, after=after)
    bench.is_restored(after=after)
    assert not [at_s for at_s in bench.moving(since_s=cut_s + 0.1) if at_s < cut_s + 0.6]


@pytest.mark.long
def test_a_network_of_one_megabit_shows_no_old_picture_as_fresh(bench: Bench, qapp: object) -> None:
    ring = FrameRing.create()
    media = LinkProcess(bench.proxy.address, body=run_with_ring, extra=(ring.name,))
    state = LiveState()
    try:
        wait_for(lambda: media.of(FrameRef) and bench.link.of(LinkQuality), "pictures and the clock")
        # All processes share one machine, so the robot's clock is known exactly.
        wall_minus_session_ns = time.time_ns() - time.monotonic_ns()
        bench.proxy.limit(1e6 / 8)
        bench.drive()
        slow_ns = now_ns()
        bench.hold_until(slow_ns / 1e9 + 4.0)
        frames = [frame for frame in media.of(FrameRef) if frame.stamp_ns > slow_ns]
        assert len(frames) > 3
        qualities = bench.link.of(LinkQuality)
        for frame in frames:
            known = [quality for quality in qualities if quality.stamp_ns <= frame.stamp_ns]
            state.add(known[-1])
            assert frame.robot_stamp_ns is not None
            age_s = (frame.stamp_ns + wall_minus_session_ns - frame.robot_stamp_ns) / 1e9
            state.frame.update_value(frame)
            told_s = state.frame.age_s(at_ns=frame.stamp_ns)
            assert told_s is not None
            stated_s = (known[-1].clock_uncertainty_ms or 0.0) / 1e3
            assert told_s >= age_s - 2.0 * stated_s - 0.01
        # The last received command is zero in every case.
        bench.link.send(Release(now_ns()))
        wait_for(lambda: not bench.listener.seen[-1].moving, "zero")
        bench.proxy.limit(None)
        bench.is_restored(after=0)
    finally:
        state.close()
        media.close()
        ring.close()


@pytest.mark.long
@pytest.mark.timeout(600)
def test_faults_of_every_kind_one_after_the_other(bench: Bench) -> None:
    chance = random.Random(7)  # noqa: S311 (an order, not secrets)
    for _ in range(20):
        bench.drive()
        after = len(bench.link.states())
        fault = chance.choice(("stop", "cut", "both", "to_server", "delay"))
        begun_s = time.monotonic()
        ends_s = begun_s + chance.uniform(1.5, 5.0)
        if fault == "stop":
            os.kill(bench.robot.pid, signal.SIGSTOP)
        elif fault == "cut":
            bench.proxy.cut(refuse=True)
        elif fault == "delay":
            bench.proxy.delay(chance.uniform(0.1, 0.35))
            bench.proxy.cut()
        else:
            bench.proxy.discard(fault)  # type: ignore[arg-type]
        bench.state_is_shown("trouble", "lost", since_s=begun_s, after=after)
        bench.link.drive(0.0, -0.3)
        bench.hold_until(ends_s)
        bench.proxy.restore()
        os.kill(bench.robot.pid, signal.SIGCONT)
        bench.is_restored(after=after)
        assert not [seen for seen in bench.listener.seen if seen.turn_radps < 0], fault


@pytest.mark.long
def test_packets_that_are_lost() -> None:
    """A separate network namespace that drops one packet in ten of the connection in each direction."""
    if shutil.which("unshare") is None or shutil.which("iptables") is None or os.geteuid() != 0:
        pytest.skip("dropping packets takes root, unshare and iptables")
    probe = ["unshare", "-n", "sh", "-c", "ip link set lo up && iptables -m statistic -h"]
    if subprocess.run(probe, capture_output=True, check=False).returncode:
        pytest.skip("this system does not allow a network of one's own")
    inside = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"{__file__}::{lossy_network.__name__}"]
    command = ["unshare", "-n", "sh", "-c", 'ip link set lo up && exec "$@"', "sh", *inside]
    done = subprocess.run(
        [*command, "-o", "python_functions=lossy_network"],
        capture_output=True,
        text=True,
        cwd=REPOSITORY,
        check=False,
        timeout=100,
    )
    assert done.returncode == 0, done.stdout[-4000:]


def lossy_network(bench: Bench) -> None:
    """Body of the test above; run outside the namespace it would disturb the whole machine."""
    for direction in ("--dport", "--sport"):
        rule = ["iptables", "-A", "INPUT", "-i", "lo", "-p", "tcp", direction, str(bench.proxy.port)]
        subprocess.run([*rule, "-m", "statistic", "--mode", "random", "--probability", "0.1", "-j", "DROP"], check=True)
    driven_until_s = time.monotonic() + 3.0
    sent_before = len(bench.link.of(CommandSent))
    while time.monotonic() < driven_until_s:
        bench.link.drive(0.0, 0.3)
        hold_for(bench.link, 0.8)
        bench.link.send(Release(now_ns()))
        hold_for(bench.link, 0.2)
    assert len(bench.link.of(CommandSent)) > sent_before + 10
    released_s = time.monotonic()
    wait_for(lambda: time.monotonic() > released_s + 2.5, "whatever is still under way")
    # TCP repeats a lost command as long as the connection lives, and no longer.
    assert not bench.moving(since_s=released_s + 1.7)
    assert not bench.listener.seen[-1].moving
    subprocess.run(["iptables", "-F", "INPUT"], check=True)
    wait_for(lambda: bench.link.states()[-1] == "connected", "connected")
    bench.drive()


def hold_for(link: LinkProcess, seconds: float) -> None:
    until_s = time.monotonic() + seconds
    renewed_s = 0.0

    def over() -> bool:
        nonlocal renewed_s
        if time.monotonic() - renewed_s > 0.05:
            renewed_s = time.monotonic()
            link.send(RenewLease(now_ns()))
        return time.monotonic() >= until_s

    wait_for(over, "the time")
