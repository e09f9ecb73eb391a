"""The named data sets: where each comes from, under which licence, and ``load``, which gives their motions.

A data set is looked for in the folder that the environment variable ``TUTORIAL_DATA`` names (any motion
files in its sub-folder count, whatever they are called), then in the user's cache, and is then downloaded
into the cache. ``TUTORIAL_OFFLINE=1`` forbids the last. The samples lie in the repository.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import json
import os
import pathlib
import re
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from ..errors import DataError
from ..motion import Motion, Skeleton
from ..motion.files import SUFFIXES, read_motion
from ..motion.rotations import quat_mul
from .download import DownloadError, RemoteFile, default_cache, download_files

DATA = "TUTORIAL_DATA"
PROJECT = pathlib.Path(__file__).resolve().parents[2]  # the checkout, when installed from one (editable)
SAMPLES = PROJECT / "data_samples"

_SAMPLE_TITLES = {
    "walking": "walking along curved paths",
    "running": "running along curved paths",
    "boxing": "shadow boxing in random combinations",
    "dancing": "dancing, phrases from a grammar of steps",
}


class NotAtHand(DataError):
    """A data set that is neither in a folder nor can be downloaded now; ``reason`` is the short form."""

    reason = ""


class EmptyFolder(DataError):
    """A folder for a data set that is there but holds no motion file."""

    def __init__(self, name: str, folder: pathlib.Path):
        expected = "expected .bvh, or .amc with its .asf"
        super().__init__(f"{name}: the folder {folder} holds no motion file, {expected}")
        self.folder = folder


class ClosedFolder(DataError):
    """A folder, of a data set or in one, that cannot be opened."""

    def __init__(self, folder: str | os.PathLike, reason: str):
        super().__init__(f"{folder}: cannot be opened ({reason}), expected a folder of motion files")
        self.folder = pathlib.Path(folder)


@dataclass(frozen=True)
class DataSet:
    """One named data set.

    folder: where its files lie below a data folder, with ``/``. files: what a download brings, empty for the
    samples, which lie in the repository. fps: of the published files, None for the samples.
    """

    name: str
    title: str
    licence: str
    folder: str
    files: tuple[RemoteFile, ...] = ()
    fps: float | None = None

    @property
    def clips(self) -> int:
        """How many motion files are published (0 for the samples)."""
        return sum(pathlib.PurePosixPath(f.name).suffix in SUFFIXES for f in self.files)

    @property
    def size(self) -> int | None:
        """Bytes to download, None where it is not published."""
        sizes = [f.size for f in self.files]
        return None if not sizes or None in sizes else sum(sizes)

    @property
    def minutes(self) -> float | None:
        """Of motion, None where it is not published."""
        frames = [f.frames for f in self.files]
        return None if not frames or None in frames else sum(frames) / self.fps / 60

    def with_base(self, base: str) -> DataSet:
        """The same files from another server, a mirror in a classroom say: ``base``/folder/file."""
        files = tuple(dataclasses.replace(f, url=f"{base.rstrip('/')}/{f.name}") for f in self.files)
        return dataclasses.replace(self, files=files)


@dataclass(frozen=True)
class Listed:
    """A row of ``listing``: minutes and megabytes are None where they are not known.

    at_hand: ``"TUTORIAL_DATA"``, ``"cache"``, ``"data_samples"``, ``"to download"``, ``"missing"`` (samples
    without a checkout), ``"empty folder"`` or ``"closed folder"``.
    path: the folder the data set is read from, or would be downloaded into, or the one that is closed.
    """

    name: str
    title: str
    clips: int
    minutes: float | None
    megabytes: float | None
    licence: str
    at_hand: str
    path: pathlib.Path


# -- names ---------------------------------------------------------------------------------------------------


@functools.cache
def _catalogue() -> dict[str, DataSet]:
    described = json.loads(pathlib.Path(__file__).with_name("sources.json").read_text(encoding="utf-8"))
    sets = {}
    for name, d in described.items():
        folder = d.get("folder", name)
        files = tuple(
            RemoteFile(
                f"{folder}/{f['name']}", d["base"] + f.get("path", f["name"]),
                f.get("sha256"), f.get("bytes"), f.get("frames"),
            )
            for f in d["files"]
        )  # fmt: skip
        sets[name] = DataSet(name, d["title"], d["licence"], folder, files, d["fps"])
    for style, title in _SAMPLE_TITLES.items():
        name = f"samples/{style}"
        sets[name] = DataSet(name, f"{title}; made by formula, not captured", "MIT, as the code", name)
    return sets


def names() -> tuple[str, ...]:
    """The names that ``load`` knows."""
    return tuple(_catalogue())


def entry(name: str | DataSet) -> DataSet:
    """The data set called ``name``; a ``DataError`` gives close matches and all names."""
    if isinstance(name, DataSet):
        return name
    try:
        return _catalogue()[name]
    except (KeyError, TypeError):
        pass
    # a part before or after the slash counts too: "walkin" is close to cmu/walking and samples/walking
    wrong = str(name).lower()
    near = [n for n in names() if difflib.get_close_matches(wrong, [n, *n.split("/")], n=1, cutoff=0.75)]
    close = near if len(near) <= 4 else []
    guess = f"; did you mean {' or '.join(close)}?" if close else ";"
    raise DataError(f"unknown data set {str(name)!r}{guess} known: {', '.join(names())}")


# -- folders -------------------------------------------------------------------------------------------------


def data_folder() -> pathlib.Path | None:
    """The folder that TUTORIAL_DATA names, None if it is not set; a ``DataError`` if there is no such folder.

    A relative one is taken from the current folder, and if it is not there from the project's, so that the
    same setting serves the command line and the notebooks.
    """
    setting = os.environ.get(DATA, "").strip()
    if not setting:
        return None
    folder = pathlib.Path(setting).expanduser()
    tried = [folder] if folder.is_absolute() else [pathlib.Path.cwd() / folder, PROJECT / folder]
    for candidate in dict.fromkeys(tried):
        if candidate.is_dir():
            return candidate.resolve()
    for candidate in tried:
        if candidate.exists():
            raise DataError(f"{DATA}={setting}: {candidate} is a file, expected a folder")
    places = " or ".join(str(c) for c in dict.fromkeys(tried))
    raise DataError(f"{DATA}={setting}: no such folder; expected {places}")


def motion_files(folder: pathlib.Path) -> list[pathlib.Path]:
    """The motion files (``.bvh``, ``.amc``) in ``folder`` and below, sorted by path, without hidden ones.

    Links to folders are followed. Raises ``ClosedFolder`` for one that cannot be opened.
    """
    found = [p for p in files_below(folder) if p.suffix.lower() in SUFFIXES]
    return sorted(found, key=lambda p: p.relative_to(folder).as_posix())


def files_below(folder: pathlib.Path) -> Iterator[pathlib.Path]:
    """The files in ``folder`` and below, without hidden ones; each folder once, whatever links lead to it.

    Raises ``ClosedFolder`` for a folder that cannot be opened.
    """
    todo, seen = deque([folder]), set()  # links wait at the end: what lies here keeps its own name
    while todo:
        place, files = todo.popleft(), []
        try:
            status = place.stat()
            if (status.st_dev, status.st_ino) in seen:
                continue
            seen.add((status.st_dev, status.st_ino))
            with os.scandir(place) as entries:
                visible = sorted((e for e in entries if not e.name.startswith(".")), key=lambda e: e.name)
            for entry in visible:
                path = place / entry.name
                if entry.is_dir():
                    (todo.append if entry.is_symlink() else todo.appendleft)(path)
                elif entry.is_file():
                    files.append(path)
        except OSError as error:
            raise ClosedFolder(place, error.strerror or str(error)) from None
        yield from files


def _find(data_set: DataSet, cache: pathlib.Path) -> tuple[str, pathlib.Path, list[pathlib.Path]] | None:
    """Where ``data_set`` is at hand: place, folder and motion files; None if it is not.

    A folder of the user's own, or of the checkout, that is there but holds no motion raises ``EmptyFolder``, one
    that cannot be opened ``ClosedFolder``.
    """
    own = data_folder()
    places = [] if own is None else [(DATA, own / data_set.folder)]
    if not data_set.files:
        places.append(("data_samples", SAMPLES / data_set.folder.removeprefix("samples/")))
    for place, folder in places:
        if folder.is_dir():
            paths = motion_files(folder)
            if not paths:
                raise EmptyFolder(data_set.name, folder)
            return place, folder, paths
    if data_set.files and all((cache / f.name).is_file() for f in data_set.files):
        return "cache", cache / data_set.folder, _cached_motions(data_set, cache)
    return None


def _cached_motions(data_set: DataSet, cache: pathlib.Path) -> list[pathlib.Path]:
    return [cache / n for n in sorted(f.name for f in data_set.files) if n.endswith(SUFFIXES)]


def paths_of(name: str | DataSet, *, cache: str | os.PathLike | None = None) -> list[pathlib.Path]:
    """The motion files that ``load`` reads for ``name``, sorted; none if it is not at hand.

    Raises ``DataError`` for an unknown name, and for a folder that is empty or cannot be opened.
    """
    found = _find(entry(name), _cache(cache))
    return found[2] if found else []


def where(name: str | DataSet, *, cache: str | os.PathLike | None = None) -> pathlib.Path:
    """The folder that ``name`` is read from, or, if it is not at hand, the one that ``fetch`` would fill."""
    data_set, cache = entry(name), _cache(cache)
    found = _find(data_set, cache)
    return found[1] if found else _destination(data_set, cache)


def _destination(data_set: DataSet, cache: pathlib.Path) -> pathlib.Path:
    return cache / data_set.folder if data_set.files else SAMPLES / data_set.folder.removeprefix("samples/")


def _cache(cache: str | os.PathLike | None) -> pathlib.Path:
    return default_cache() if cache is None else pathlib.Path(cache)


# -- downloads -----------------------------------------------------------------------------------------------


def fetch(name: str | DataSet, *, cache: str | os.PathLike | None = None) -> pathlib.Path:
    """Download ``name`` into the cache (default: the user's) and return its folder.

    What is there and right is not fetched again; what was cut off goes on from there. Raises ``NotAtHand``
    without a network, for an answer that is not the file, or a checksum that does not match.
    """
    data_set, cache = entry(name), _cache(cache)
    if not data_set.files:
        found = _find(data_set, cache)
        if found is None:
            raise _not_at_hand(data_set, cache, f"it lies in the repository, and {SAMPLES} has none of it")
        return found[1]
    complete = all((cache / f.name).is_file() for f in data_set.files)
    try:
        download_files(data_set.files, cache)
    except DownloadError as error:
        raise _not_at_hand(data_set, cache, str(error)) from None
    if not complete:
        print(f"{data_set.name}: {len(data_set.files)} files downloaded. Licence: {data_set.licence}.")
    return cache / data_set.folder


def _not_at_hand(data_set: DataSet, cache: pathlib.Path, reason: str) -> NotAtHand:
    own = data_folder()
    if own is not None and not (own / data_set.folder).is_dir():
        reason = f"no folder {data_set.folder} in {DATA}, and {reason}"
    if not data_set.files:
        advice = f"install from a clone (pip install -e .) or put .bvh files into {own or 'TUTORIAL_DATA'}/"
        advice += data_set.folder
    else:
        last = data_set.files[-1].name.removeprefix(f"{data_set.folder}/")
        files = f"its {len(data_set.files)} files (the last is {last})" if own is None else "motion files"
        command = f"python -m tutorial_lib data fetch {data_set.name}"
        advice = f"run `{command}` later, or put {files} into {(own or cache) / data_set.folder}"
    error = NotAtHand(f"{data_set.name} is not at hand: {reason}; {advice}")
    error.reason = reason
    return error


# -- motions -------------------------------------------------------------------------------------------------


def load(
    name: str | DataSet,
    *,
    limit: int | None = None,
    fps: float | None = None,
    cache: str | os.PathLike | None = None,
) -> list[Motion]:
    """The motions of the data set ``name``, sorted by file name; metres, y up, named ``set/file``.

    Looked for in the folder TUTORIAL_DATA, then in the cache (default: the user's), then downloaded.
    limit: the first so many clips only. fps: resampled to so many frames a second.

    Raises ``DataError`` for an unknown name, a TUTORIAL_DATA that does not exist, a folder without motion
    in it or one that cannot be opened; ``NotAtHand`` if it cannot be had; ``MotionFileError`` for a file that
    cannot be read.
    """
    return _load(name, limit, fps, cache)[0]


def _load(name, limit, fps, cache) -> tuple[list[Motion], str]:
    data_set, cache = entry(name), _cache(cache)
    if limit is not None and (not isinstance(limit, (int, np.integer)) or limit < 1):
        raise DataError(f"limit={limit!r}: expected a number of clips, at least 1")
    found = _find(data_set, cache)
    if found is None:
        folder = fetch(data_set, cache=cache)
        found = "the download", folder, _cached_motions(data_set, cache)
    place, folder, paths = found
    motions = []
    for path in tqdm(paths[:limit], desc=f"reading {data_set.name}", unit="clip", delay=2, leave=False):
        clip = path.relative_to(folder).with_suffix("").as_posix()
        motion = read_clip(path).with_name(f"{data_set.folder}/{clip}")
        motions.append(motion if fps is None else motion.resample(fps))
    return motions, place


def load_first(
    *wanted: str | DataSet,
    limit: int | None = None,
    fps: float | None = None,
    cache: str | os.PathLike | None = None,
    at_least: int = 1,
) -> list[Motion]:
    """The first of several data sets that can be had, real ones first: ``load_first(real, sample)``.

    Prints in one line which it is and why not an earlier one. Options as for ``load``. Passed over is what is
    not at hand, and what has fewer clips than ``at_least`` (two where clips are to be kept for testing): an
    unknown name or a file that cannot be read is an error all the same.
    """
    if not wanted:
        raise DataError("load_first: expected at least one name")
    sets = [entry(name) for name in wanted]
    passed_over = []
    for data_set in sets:
        try:
            motions, place = _load(data_set, limit, fps, cache)
        except NotAtHand as error:
            if len(sets) == 1:
                raise
            passed_over.append(f"{data_set.name}: {error.reason}")
            continue
        if len(motions) < at_least:
            passed_over.append(f"{data_set.name}: {len(motions)} clips in {place}, expected at least {at_least}")
            continue
        why = f" (not {'; not '.join(passed_over)})" if passed_over else ""
        seconds = sum(m.duration for m in motions)
        print(f"Data: {data_set.name}, {len(motions)} clips, {seconds:.0f} s, from {place}{why}.")
        return motions
    raise NotAtHand(f"none is at hand: {'; '.join(passed_over)}")


def read_clip(path: str | os.PathLike) -> Motion:
    """One motion file as ``load`` gives it: without a root that never moves and without empty end sites.

    So a file has the same skeleton whether it is read by a data set's name or by its path.
    Raises ``MotionFileError`` if it cannot be read.
    """
    return drop_empty_end_sites(drop_static_root(read_motion(path)))


def drop_static_root(motion: Motion) -> Motion:
    """Without a root that never moves above a joint that travels, which then is the root.

    Bandai Namco's files have such a ``joint_Root`` above ``Hips``. Positions stay as they are; the new root's
    offset, in those files its place in the first frame, becomes zero, so that all clips share a skeleton.
    Any other motion is returned as it is.
    """
    old, rotations = motion.skeleton, motion.rotations
    if rotations is None or len(old.children[0]) != 1:
        return motion
    # a joint's path and turns, and how far its child travels from it: a bone's length stays as it is
    path, turns = motion.positions[:, 0], rotations[:, 0]
    length = np.linalg.norm(motion.positions[:, 1] - path, axis=-1)
    if max(np.ptp(path, axis=0).max(), np.ptp(turns, axis=0).max()) > 1e-9 or np.ptp(length) < 1e-6:
        return motion
    offsets = old.offsets[1:].copy()
    offsets[0] = 0
    skeleton = Skeleton(
        old.names[1:],
        tuple(p - 1 for p in old.parents[1:]),
        offsets,
        old.orders[1:],
        frozenset(j - 1 for j in old.end_sites),
    )
    local = rotations[:, 1:].copy()
    local[:, 0] = quat_mul(rotations[:, 0], rotations[:, 1])
    return dataclasses.replace(motion, skeleton=skeleton, positions=motion.positions[:, 1:], rotations=local)


def drop_empty_end_sites(motion: Motion) -> Motion:
    """Without end sites if all of them lie in their joints, as in files that have them only for the format.

    The acRNN's mark the tips of the fingers and the toes; those stay (57 nodes).
    """
    ends = sorted(motion.skeleton.end_sites)
    return motion if np.abs(motion.skeleton.offsets[ends]).max(initial=0.0) > 1e-6 else motion.without_end_sites()


def listing(*, cache: str | os.PathLike | None = None) -> list[Listed]:
    """All data sets, with their licences and where each is at hand now (``data list``).

    Clips, minutes and megabytes are those of the files at hand, or else of the published ones.
    """
    return [listed(data_set, cache=cache) for data_set in _catalogue().values()]


def listed(name: str | DataSet, *, cache: str | os.PathLike | None = None) -> Listed:
    """The row of one data set in :func:`listing`; a ``DataError`` for an unknown name or a wrong TUTORIAL_DATA."""
    data_set, cache = entry(name), _cache(cache)
    try:
        found = _find(data_set, cache)
    except EmptyFolder as error:
        found = "empty folder", error.folder, []
    except ClosedFolder as error:
        found = "closed folder", error.folder, []
    place, folder, paths = found or ("to download" if data_set.files else "missing", None, [])
    published = not found or place == "cache"
    minutes = data_set.minutes if published else _minutes(paths)
    size = data_set.size if published else None
    if found and size is None:
        size = sum(p.stat().st_size for p in paths)
    return Listed(
        data_set.name,
        data_set.title,
        len(paths) if found else data_set.clips,
        minutes,
        None if size is None else size / 1e6,
        data_set.licence,
        place,
        folder or _destination(data_set, cache),
    )


def _minutes(paths: list[pathlib.Path]) -> float | None:
    """Of motion in BVH files, as their headers say; None if one does not tell (AMC files do not) or cannot be read."""
    seconds = 0.0
    for path in paths:
        try:
            with open(path, "rb") as file:
                head = file.read(1 << 17) if path.suffix.lower() == ".bvh" else b""
            told = re.search(rb"Frames:\s*(\d+)\s+Frame Time:\s*([\d.]+(?:[eE][-+]?\d+)?)", head)
            if not told:
                return None
            seconds += float(told[1]) * float(told[2])
        except (OSError, ValueError):  # 1.2.3 is no number; `load` says what is wrong with a file
            return None
    return seconds / 60 if paths else None
