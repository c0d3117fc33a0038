"""Reaction of the recorder to free space, growth and delays."""

from caris_desktop.recording.recorder.disk_watch import DiskLimits, DiskState, DiskWatch

SECOND = 1_000_000_000
GB, MB = 1_000_000_000, 1_000_000


def run(
    watch: DiskWatch, seconds: range, *, free_at: tuple[int, int], grows: int = 0, delay_s: float = 0.0
) -> DiskState:
    """One observation per second: initial free space with its change, and the growth of the session."""
    free_bytes, change = free_at
    for at, second in enumerate(seconds):
        watch.observe(
            second * SECOND, free_bytes=free_bytes + at * change, written_bytes=second * grows, delays_s=[delay_s]
        )
    return watch.state


def test_plenty_of_room_at_an_ordinary_rate_is_no_matter() -> None:
    state = run(DiskWatch(DiskLimits()), range(120), free_at=(60 * GB, -MB), grows=MB)
    assert state.stage == "ample"
    assert state.bytes_per_s == MB
    assert state.room_s is not None
    assert 0.9 * 60_000 < state.room_s < 60_000


def test_the_forecast_warns_long_before_the_bytes_do() -> None:
    # 5 GB are left, more than the limit, but at 10 MB/s they last only eight minutes.
    watch = DiskWatch(DiskLimits())
    assert run(watch, range(10), free_at=(5 * GB, -10 * MB), grows=10 * MB).stage == "ample"
    assert run(watch, range(10, 20), free_at=(5 * GB - 100 * MB, -10 * MB), grows=10 * MB).stage == "scarce"


def test_writes_of_others_count_for_the_forecast_and_not_for_the_rate() -> None:
    state = run(DiskWatch(DiskLimits()), range(30), free_at=(5 * GB, -20 * MB), grows=MB)
    assert (state.stage, state.bytes_per_s) == ("scarce", MB)
    assert state.room_s is not None
    assert state.room_s < 300


def test_stages_follow_the_bytes_and_come_back_only_with_room_to_spare() -> None:
    watch = DiskWatch(DiskLimits())
    stages = []
    for second, free_bytes in enumerate([2000 * MB, 1000 * MB, 250 * MB, 60 * MB, 90 * MB, 110 * MB, 700 * MB, 3 * GB]):
        # Far apart, so that the window contains only the newest one.
        now_ns = second * 200 * SECOND
        stages.append(watch.observe(now_ns, free_bytes=free_bytes, written_bytes=0, delays_s=[]).stage)
    assert stages == ["ample", "scarce", "low", "out", "out", "low", "scarce", "ample"]


def test_one_hiccup_is_no_slow_disk_but_a_long_one_or_a_second_one_is() -> None:
    def slow(*delays_s: float, watch: DiskWatch | None = None) -> bool:
        return (watch or DiskWatch(DiskLimits())).observe(0, free_bytes=GB, written_bytes=0, delays_s=delays_s).slow

    assert not slow()
    assert not slow(1.5, 0.1)
    assert slow(1.5, 0.1, 1.2)
    assert slow(2.5)
    watch = DiskWatch(DiskLimits())
    assert slow(2.5, watch=watch)
    assert slow(0.8, watch=watch)
    assert not slow(0.2, watch=watch)
    assert not slow(0.8, watch=watch)
