"""Mutated foreign recordings: each is read or refused with a message, without side effects.

Some of each kind here, 200 with --long. A failure states the seed of the mutation.
"""

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from caris_desktop.domain.media_checks import PictureError, decode_compressed, decoded
from caris_desktop.recording.annotation.annotation_editing import AnnotationError
from caris_desktop.recording.foreign.bag_files import BagError, is_probably_bag
from caris_desktop.recording.foreign.bag_import import import_bag
from caris_desktop.recording.photo_file import PhotoFileError, previews
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session.session_header import SessionError
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import ExportError, export_session
from caris_desktop.simulator.simulated_mapping import MapFileError, MapFiles
from caris_desktop.ui.widgets.pictures import image_of
from tests.recording.foreign.test_bag_import import BAGS
from tests.support.mutations import MEMORY_LIMIT_BYTES, mutated, peak_memory_bytes, recorded_side_effects
from tests.support.recorded_session import make_session

pytestmark = [pytest.mark.logs(""), pytest.mark.timeout(900)]
SECRET = "words of somebody else's file"
FORMATS = ("csv", "html", "elan", "rosbag2", "rocrate", "captions")


def trials(request: pytest.FixtureRequest, few: int) -> range:
    return range(200 if request.config.getoption("--long") else few)


def tried(folder: Path, seed: int, read: Callable[[], None], refusals: tuple[type[Exception], ...]) -> bool:
    """True if it was read, False if it was refused. Fails for any other result."""
    before, secret = peak_memory_bytes(), folder.parent / "secret.txt"
    with recorded_side_effects(folder, secret) as seen:
        try:
            read()
            done = True
        except refusals as error:
            assert str(error).strip(), f"seed {seed}: {error!r} says nothing"
            done = False
        except Exception as error:
            raise AssertionError(f"seed {seed}: {error!r}") from error
        assert not seen, (seed, seen)
    assert peak_memory_bytes() - before < MEMORY_LIMIT_BYTES, seed
    return done


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "session"
    made = make_session(folder, seconds=2.0, utterance_every_s=0.5, mark_every_s=0.5, photo_every_s=1.0, people=1)
    return made.folder


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder next to an unreadable file; also used for temporary files of the program."""
    (tmp_path / "secret.txt").write_text(SECRET)
    place = tmp_path / "place"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    return place


def test_no_mutation_of_a_session_does_harm(request: pytest.FixtureRequest, session: Path, place: Path) -> None:
    secret = place.parent / "secret.txt"
    names = sorted(path.relative_to(session) for path in session.rglob("*") if path.is_file())
    read_whole = 0
    for seed in trials(request, 24):
        copy, out = place / "session", place / "out"
        shutil.copytree(session, copy)
        name = names[seed % len(names)]
        content = mutated((session / name).read_bytes(), seed, paths=(str(secret), "../../secret.txt", "../secret.txt"))
        (copy / name).write_bytes(content)

        def read(copy: Path = copy, out: Path = out, seed: int = seed) -> None:
            opened = open_session(copy)
            for _ in opened.values():
                pass
            SessionTimeline(opened).between(opened.started_ns, opened.started_ns + 1_000_000_000)
            with VideoReader(opened) as videos:
                for camera in ("front", "rear"):
                    for at in (0, 3):
                        videos.frame(camera, at)
            export_session(copy, FORMATS[seed % len(FORMATS)], out)

        read_whole += tried(place, seed, read, (SessionError, ExportError, AnnotationError))
        told = [path for path in place.rglob("*") if path.is_file() and SECRET.encode() in path.read_bytes()]
        assert not told, (seed, told)
        assert secret.read_text() == SECRET
        for each in place.iterdir():
            shutil.rmtree(each) if each.is_dir() else each.unlink()
    assert read_whole, "else this shows nothing"


@pytest.mark.parametrize("kind", BAGS)
@pytest.mark.long("folded", "ros1")
def test_no_mutation_of_a_bag_does_harm(
    request: pytest.FixtureRequest, kind: str, place: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    whole = BAGS[kind](tmp_path_factory.mktemp("bags"))
    names = [whole] if whole.is_file() else sorted(path for path in whole.iterdir() if path.is_file())
    imported = 0
    for seed in trials(request, 12):
        path = place / whole.name
        (shutil.copyfile if whole.is_file() else shutil.copytree)(whole, path)
        changed = names[seed % len(names)]
        (path if whole.is_file() else path / changed.name).write_bytes(mutated(changed.read_bytes(), seed))

        def read(path: Path = path) -> None:
            is_probably_bag(path)
            report = import_bag(path, place / "session")
            for _ in open_session(report.folder).values():
                pass

        imported += tried(place, seed, read, (BagError, SessionError))
        assert {each.name for each in place.iterdir()} <= {path.name, "session"}, seed
        for each in place.iterdir():
            shutil.rmtree(each) if each.is_dir() else each.unlink()
    assert imported, "else this shows nothing"


@pytest.mark.parametrize("ending", [".jpg", ".png", ".webp", ".bmp", ".gif"])
def test_no_mutation_of_a_picture_does_harm(request: pytest.FixtureRequest, ending: str, place: Path) -> None:
    picture = np.random.default_rng(1).integers(0, 256, (48, 64, 3), np.uint8)
    done, coded = cv2.imencode(ending, picture)
    assert done
    for seed in trials(request, 40):
        content = mutated(coded.tobytes(), seed)
        path = place / "photo.jpg"
        path.write_bytes(content)
        for read in (
            lambda content=content: decoded(content), lambda content=content: decode_compressed(content),
            lambda content=content: image_of(content), lambda path=path: previews(path, 100),
        ):  # fmt: skip
            tried(place, seed, read, (PictureError, PhotoFileError))


def test_no_mutation_of_a_map_does_harm(request: pytest.FixtureRequest, place: Path) -> None:
    maps = MapFiles(place)
    maps.save_picture("hall", np.zeros((30, 40), np.int8))
    maps.save_graph("hall", np.zeros((30, 40), np.int16), np.ones((30, 40), np.bool_))
    whole = {path: path.read_bytes() for path in place.iterdir()}
    loaded = 0
    for seed in trials(request, 40):
        path = sorted(whole)[seed % len(whole)]
        path.write_bytes(mutated(whole[path], seed))

        def read(path: Path = path) -> None:
            if path.suffix == ".posegraph":
                maps.load_graph("hall")
            else:
                maps.load_picture("hall")

        loaded += tried(place, seed, read, (MapFileError,))
        path.write_bytes(whole[path])
    assert loaded
