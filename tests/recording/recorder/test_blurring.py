"""Blurring of recorded people: walkers with ground truth, and detections that are late, incomplete or missing."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from numpy.typing import NDArray

from caris_desktop.domain import clock
from caris_desktop.domain.actor import WIZARD
from caris_desktop.domain.events import PhotoTaken
from caris_desktop.domain.sensing import FrameRef, People, PersonBox
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.perception import blur
from caris_desktop.recording.recorder.blurring import Blurring
from caris_desktop.recording.recorder.disk_watch import DiskLimits
from caris_desktop.recording.recorder.recorder_messages import (
    BlurDemand,
    BlurWhat,
    StartRecording,
    TakePhoto,
    UseConsents,
)
from caris_desktop.recording.recorder.session_recorder import SessionRecorder
from tests.recording.driving import RecorderUnderTest, header

WIDTH_PX, HEIGHT_PX, RATE_HZ, LOOK_HZ = 640, 360, 30, 8
FRAMES = 500
SECOND_NS = 1_000_000_000
LATE_NS = 180_000_000
"""Delay between a frame and its detections."""
SURELY_THE_SAME = 0.05
"""Share of pixels that a covered part may have in common with the original, by chance."""


@dataclass(frozen=True)
class Walker:
    """Person who walks back and forth from ``from_s`` to ``until_s``."""

    track: int
    width_px: float
    speed_px_per_s: float
    top_px: float
    from_s: float
    until_s: float

    def box(self, at_s: float) -> tuple[float, float, float, float] | None:
        """Left, top, width, height; None while outside the image."""
        if not self.from_s <= at_s < self.until_s:
            return None
        way_px = WIDTH_PX + self.width_px
        gone_px = (at_s - self.from_s) * self.speed_px_per_s % (2 * way_px)
        left_px = (gone_px if gone_px < way_px else 2 * way_px - gone_px) - self.width_px
        near = 1.0 + 0.2 * np.sin(at_s * 1.7 + self.track)
        top_px = self.top_px + 6.0 * np.sin(at_s * 9.0 + self.track)
        return left_px, top_px, self.width_px * near, 2.6 * self.width_px * near


WALKERS = (
    Walker(1, 60.0, 90.0, 90.0, 0.0, 99.0),
    Walker(2, 36.0, 150.0, 120.0, 1.3, 99.0),
    Walker(3, 22.0, 60.0, 150.0, 0.0, 12.0),
    Walker(4, 80.0, 200.0, 60.0, 4.1, 9.0),
    Walker(5, 45.0, 40.0, 140.0, 7.7, 99.0),
)


FOLLOWED_AFTER_S = 0.6
"""Delay of a tracker that waits for a good view of a possibly known person."""


def seen(at_s: float, random: np.random.Generator, *, known_from_s: dict[int, float]) -> People:
    """Simulated detector and tracker: inaccurate boxes, occasional misses, and no identity at first."""
    boxes: list[PersonBox] = []
    unfollowed: list[PersonBox] = []
    for walker in WALKERS:
        box = walker.box(at_s)
        visible = box is not None and min(box[0] + box[2], WIDTH_PX) - max(box[0], 0.0) > 0.2 * box[2]
        if box is None or not visible or random.random() < 0.08:
            continue
        left, top, width, height = np.array(box) + random.normal(0.0, 0.02 * box[2], 4)
        if at_s - known_from_s.setdefault(walker.track, at_s) < FOLLOWED_AFTER_S:
            unfollowed.append(PersonBox(0, "", left, top, width, height, 0.3))
        else:
            boxes.append(PersonBox(walker.track, f"p-{walker.track}", left, top, width, height, 0.8))
    stamp_ns = SECOND_NS + round(at_s * RATE_HZ) * SECOND_NS // RATE_HZ
    return People(stamp_ns, "front", 0, WIDTH_PX, HEIGHT_PX, tuple(boxes), 60.0, unfollowed=tuple(unfollowed))


def truth_of(what: BlurWhat, box: tuple[float, float, float, float]) -> tuple[int, int, int, int] | None:
    """Pixels of the person or the face: left, top, right, bottom within the image."""
    left, top, width, height = box
    if what == "faces":
        left, width, height = left + 0.25 * width, 0.5 * width, height / 6
    x0, x1 = max(0, round(left)), min(WIDTH_PX, round(left + width))
    y0, y1 = max(0, round(top)), min(HEIGHT_PX, round(top + height))
    return (x0, y0, x1, y1) if x1 - x0 > 1 and y1 - y0 > 1 else None


@dataclass
class Outcome:
    """``bare`` are the (frame, track) of visible people; shares are of all frames together."""

    frames: list[int]
    bare: list[tuple[int, int]]
    background_kept: float
    longest_wait_ns: int


def play(what: BlurWhat, *, without: frozenset[int], frames: int = FRAMES) -> Outcome:
    """Run frames through the recorder's queue; ``without`` are the indices of missing detections."""
    random = np.random.default_rng(7)
    noise = random.integers(0, 256, (HEIGHT_PX + 40, WIDTH_PX, 3), np.uint8)
    blurring = Blurring(blur)
    blurring.use_demand(BlurDemand("everybody", what))
    outcome = Outcome([], [], 0.0, 0)
    kept = background = 0
    now_ns = 0
    came_ns: dict[int, int] = {}

    def judge(number: int, original: NDArray[np.uint8], image: NDArray[np.uint8]) -> None:
        nonlocal kept, background
        outcome.frames.append(number)
        outcome.longest_wait_ns = max(outcome.longest_wait_ns, now_ns - came_ns[number])
        same = image[..., 0] == original[..., 0]
        nobody = np.ones(same.shape, bool)
        for walker in WALKERS:
            box = walker.box(number / RATE_HZ)
            part = None if box is None else truth_of(what, box)
            if box is None or part is None:
                continue
            x0, y0, x1, y1 = part
            nobody[y0:y1, x0:x1] = False
            wide = min(box[0] + box[2], WIDTH_PX) - max(box[0], 0.0) > 20.0
            if wide and same[y0:y1, x0:x1].mean() > SURELY_THE_SAME:
                outcome.bare.append((number, walker.track))
        kept += int((same & nobody).sum())
        background += int(nobody.sum())

    waiting_looks: list[tuple[int, People]] = []
    known_from_s: dict[int, float] = {}
    looks = 0
    for number in range(frames + RATE_HZ):
        now_ns = SECOND_NS + number * SECOND_NS // RATE_HZ
        while waiting_looks and waiting_looks[0][0] <= now_ns:
            blurring.add_detections(waiting_looks.pop(0)[1], now_ns)
        blurring.go_on(now_ns)
        stamp_ns, came_ns[number] = now_ns, now_ns
        if number * LOOK_HZ // RATE_HZ > (number - 1) * LOOK_HZ // RATE_HZ:
            looks += 1
            people = seen(number / RATE_HZ, random, known_from_s=known_from_s)
            if looks not in without:
                waiting_looks.append((stamp_ns + LATE_NS, people))
        if number < frames:
            at = int(random.integers(0, 40))
            image = noise[at : at + HEIGHT_PX]
            ref = FrameRef(stamp_ns, None, "front", "", 0, number, WIDTH_PX, HEIGHT_PX)
            blurring.add(
                ref, image.copy(), now_ns, lambda done, number=number, original=image: judge(number, original, done)
            )
    outcome.background_kept = kept / background
    return outcome


@pytest.mark.parametrize("what", ["persons", "faces"])
def test_everybody_is_covered_in_every_frame_and_most_else_is_not(what: BlurWhat) -> None:
    outcome = play(what, without=frozenset(range(5, 140, 11)))
    assert outcome.frames == list(range(FRAMES)), "each once, in their order"
    assert outcome.bare == []
    assert outcome.background_kept >= 0.6
    assert outcome.longest_wait_ns <= 0.75 * SECOND_NS


def test_while_perception_says_nothing_the_whole_picture_is_covered() -> None:
    outcome = play("persons", without=frozenset(range(10, 20)), frames=120)
    assert outcome.frames == list(range(120))
    assert outcome.bare == []


def frame(number: int = 0, *, at_ms: int = 0) -> tuple[FrameRef, NDArray[np.uint8]]:
    image = np.random.default_rng(number).integers(0, 256, (HEIGHT_PX, WIDTH_PX, 3), np.uint8)
    return FrameRef(SECOND_NS + at_ms * 1_000_000, None, "front", "", 0, number, WIDTH_PX, HEIGHT_PX), image


def look(at_ms: int, *boxes: PersonBox) -> People:
    return People(SECOND_NS + at_ms * 1_000_000, "front", at_ms, WIDTH_PX, HEIGHT_PX, boxes, 50.0)


ADA, BEN = PersonBox(1, "p-ada", 50, 50, 80, 200, 0.9), PersonBox(2, "p-ben", 400, 50, 80, 200, 0.9)


def share_the_same(one: NDArray[np.uint8], other: NDArray[np.uint8], box: PersonBox) -> float:
    part = np.s_[int(box.top_px) : int(box.top_px + box.height_px), int(box.left_px) : int(box.left_px + box.width_px)]
    return float((one[part] == other[part]).all(axis=2).mean())


def test_a_consenting_person_is_shown_and_others_are_not() -> None:
    blurring = Blurring(blur)
    blurring.use_demand(BlurDemand("without_consent"))
    blurring.use_consents(UseConsents(video=frozenset({"p-ada"})))
    ref, image = frame(at_ms=50)
    done: list[NDArray[np.uint8]] = []
    blurring.add_detections(look(0, ADA, BEN), ref.stamp_ns)
    blurring.add(ref, image.copy(), ref.stamp_ns, done.append)
    blurring.add_detections(look(100, ADA, BEN), ref.stamp_ns)
    blurring.add_detections(look(350, ADA, BEN), ref.stamp_ns)
    assert share_the_same(done[0], image, ADA) == 1.0
    assert share_the_same(done[0], image, BEN) < SURELY_THE_SAME


def test_a_person_unknown_in_one_detection_is_blurred() -> None:
    """The track of a person with consent may have switched to another person."""
    blurring = Blurring(blur)
    blurring.use_demand(BlurDemand("without_consent"))
    blurring.use_consents(UseConsents(video=frozenset({"p-ada"})))
    ref, image = frame(at_ms=50)
    done: list[NDArray[np.uint8]] = []
    blurring.add_detections(look(0, PersonBox(1, "p-new", 50, 50, 80, 200, 0.9)), ref.stamp_ns)
    blurring.add(ref, image.copy(), ref.stamp_ns, done.append)
    for at_ms in (100, 350):
        blurring.add_detections(look(at_ms, ADA), ref.stamp_ns)
    assert share_the_same(done[0], image, ADA) < SURELY_THE_SAME


def test_untracked_people_are_blurred_but_not_consenting_ones_found_twice() -> None:
    blurring = Blurring(blur)
    blurring.use_demand(BlurDemand("without_consent"))
    blurring.use_consents(UseConsents(video=frozenset({"p-ada"})))
    ref, image = frame(at_ms=50)
    done: list[NDArray[np.uint8]] = []
    twice = replace(ADA, track=0, person_id="", left_px=55, width_px=60, confidence=0.2)
    brief = replace(BEN, track=0, person_id="")
    blurring.add_detections(look(0, ADA), ref.stamp_ns)
    blurring.add(ref, image.copy(), ref.stamp_ns, done.append)
    for at_ms in (100, 350):
        blurring.add_detections(replace(look(at_ms, ADA), unfollowed=(twice, brief)), ref.stamp_ns)
    assert share_the_same(done[0], image, ADA) == 1.0
    assert share_the_same(done[0], image, BEN) < SURELY_THE_SAME


@pytest.mark.long
def test_the_queue_is_bounded_and_frames_are_then_blurred_fully() -> None:
    blurring = Blurring(blur)
    blurring.use_demand(BlurDemand("everybody"))
    blurring.add_detections(look(0, ADA), SECOND_NS)
    done: list[NDArray[np.uint8]] = []
    frames = [frame(number, at_ms=number) for number in range(1, 100)]
    for ref, image in frames:
        blurring.add(ref, image.copy(), ref.stamp_ns, done.append)
    assert 99 - len(done) <= 45
    blurring.flush()
    assert len(done) == 99 and not blurring.waits
    pairs = zip(done, (image for _, image in frames), strict=True)
    assert all((one == image).all(axis=2).mean() < SURELY_THE_SAME for one, image in pairs)


@dataclass
class Session:
    folder: Path
    told: list[Any]


CHECKS = np.repeat(
    (np.indices((HEIGHT_PX, WIDTH_PX)).sum(axis=0) // 2 % 2 * 255)[..., None].astype(np.uint8), 3, axis=2
)


class Checks:
    """Constant frames with squares of two pixels, which mosaic blocks destroy."""

    def read(self, ref: FrameRef) -> NDArray[np.uint8]:
        return CHECKS.copy()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Three seconds of video with two detections, and a photo; Ben has consented to video, Ada to photos."""
    folder = tmp_path_factory.mktemp("study") / "s"
    told: list[Any] = []
    blurring = Blurring(blur)
    begin = StartRecording(folder, header(), blur=BlurDemand("without_consent"))
    session = SessionRecorder(begin, frames=Checks(), report=told.append, limits=DiskLimits(), blurring=blurring)
    blurring.use_consents(UseConsents(frozenset({"p-ben"}), frozenset({"p-ada"})))
    began_ns = clock.now_ns()
    for number in range(90):
        stamp_ns = began_ns + number * SECOND_NS // RATE_HZ
        ref = FrameRef(stamp_ns, None, "front", "", 0, number, WIDTH_PX, HEIGHT_PX)
        if number % 4 == 0 and number < 60:
            people = People(stamp_ns, "front", number, WIDTH_PX, HEIGHT_PX, (ADA, BEN), 50.0)
            blurring.add_detections(people, clock.now_ns())
            session.write(people)
        session.write(ref)
        if number == 20:
            session.take_photo(TakePhoto(ref, folder / "elsewhere.png"))
    session.close("wizard", WIZARD)
    return Session(folder, told)


def contrast(image: NDArray[np.uint8], box: PersonBox) -> float:
    """Mean difference of neighbouring pixels: high for the pattern, low for mosaic blocks."""
    part = image[
        int(box.top_px) : int(box.top_px + box.height_px), int(box.left_px) : int(box.left_px + box.width_px)
    ].astype(float)
    return float(np.abs(np.diff(part, axis=1)).mean())


def test_nobody_is_seen_in_the_video(recorded: Session) -> None:
    frames = []
    # A machine too slow for the encoder continues in another file.
    for video in sorted(recorded.folder.glob("*.mp4"), key=lambda path: (len(path.name), path.name)):
        with av.open(str(video)) as container:
            frames += [each.to_ndarray(format="bgr24") for each in container.decode(video=0)]
    assert len(frames) == 90
    plain = contrast(CHECKS, ADA)
    assert max(contrast(each, ADA) for each in frames) < 0.3 * plain
    assert contrast(frames[20], BEN) > 0.6 * plain, "who agreed is as in life"
    assert contrast(frames[-1], BEN) < 0.3 * plain, "of what nobody looked at nothing is to be seen"


def test_a_picture_that_waited_is_in_the_record_when_it_came(recorded: Session) -> None:
    """Otherwise a replay would show a frame half a second after the boxes of its people."""
    with (recorded.folder / "events.mcap").open("rb") as file:
        told = list(make_reader(file).iter_messages(log_time_order=False))
    arrivals = [message.log_time for _, _, message in told]
    assert arrivals == sorted(arrivals)
    order = [channel.topic for _, channel, _ in told if channel.topic in ("/frame", "/people")]
    assert order[:6] == ["/people", "/frame", "/frame", "/frame", "/frame", "/people"]
    assert order.count("/frame") == 90


def test_only_who_agreed_to_photos_is_seen_in_one(recorded: Session) -> None:
    (taken,) = [each for each in recorded.told if isinstance(each, PhotoTaken)]
    photo = cv2.imread(str(recorded.folder / taken.file_name))
    assert contrast(photo, ADA) == contrast(CHECKS, ADA)
    assert contrast(photo, BEN) < 0.2 * contrast(CHECKS, BEN), "to be filmed is another thing"


@pytest.mark.logs(r"video_writer: ")
def test_the_report_says_of_which_cameras_nothing_is_to_be_seen_as_long_as_it_is_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_ns = clock.now_ns()
    monkeypatch.setattr(clock, "now_ns", lambda: now_ns)
    blurring = Blurring(blur)
    session = SessionRecorder(
        StartRecording(tmp_path / "s", header(), blur=BlurDemand("everybody")),
        frames=Checks(), report=lambda _event: None, limits=DiskLimits(), blurring=blurring,
    )  # fmt: skip

    def after_s(seconds: int, *, pictures: bool = True) -> tuple[str, ...]:
        nonlocal now_ns
        for _second in range(seconds):
            if pictures:
                session.write(FrameRef(now_ns, None, "front", "", 0, now_ns % 1000, WIDTH_PX, HEIGHT_PX))
            session.tick()
            now_ns += SECOND_NS
        return session.status().covered_whole

    assert after_s(3) == ()
    assert after_s(6) == ("front",)
    assert after_s(5, pictures=False) == (), "a camera that sends nothing is another trouble"
    assert after_s(2) == ("front",)
    blurring.use_demand(BlurDemand())
    assert after_s(2) == (), "nobody has to be covered"
    session.close("wizard", WIZARD)


def test_without_a_session_a_photo_waits_for_who_is_in_it(tmp_path: Path) -> None:
    ring = FrameRing.create(WIDTH_PX * HEIGHT_PX * 3)
    recorder = RecorderUnderTest(ring, in_thread=True)
    now_ns = clock.now_ns()
    ref = ring.write(CHECKS, stamp_ns=now_ns, robot_stamp_ns=None, camera="front")
    photo_asked = TakePhoto(ref, tmp_path / "photo.png", blur=BlurDemand("everybody"))
    before, after, later = (
        People(now_ns + late_ms * 1_000_000, "front", 1, WIDTH_PX, HEIGHT_PX, (ADA,), 50.0)
        for late_ms in (-50, 60, 300)
    )
    recorder.send(before, photo_asked, after, later)
    recorder.wait_for(PhotoTaken)
    recorder.close()
    ring.close()
    photo = cv2.imread(str(tmp_path / "photo.png"))
    assert contrast(photo, ADA) < 0.2 * contrast(CHECKS, ADA)
    assert contrast(photo, BEN) == contrast(CHECKS, BEN)
