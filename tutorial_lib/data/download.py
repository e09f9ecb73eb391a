"""Downloads that go on after a cut, keep nothing that is wrong, and never show half a file under its name."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import pathlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from urllib.parse import urlsplit

import pooch
import requests
from tqdm import tqdm  # not tqdm.auto: a saved notebook would keep its widget as "Loading widget..."

from ..atomic import atomic_write
from ..errors import DataError

OFFLINE = "TUTORIAL_OFFLINE"
CACHE = "TUTORIAL_CACHE"

# Seconds to connect and to wait for more bytes. A host has several addresses and each is tried, so the
# first is short: behind a wall that swallows packets the wait is a few times as long.
TIMEOUT = (3.05, 30.0)
ATTEMPTS = 5
CHUNK = 1 << 13  # bytes; a chunk that was cut off is lost, so small ones


@dataclass(frozen=True)
class RemoteFile:
    """One file of a data set: its place in the cache and its address.

    name: path relative to the cache, with ``/``; sha256: hexadecimal, None where none is published;
    size: bytes, None where unknown; frames: of motion, None where unknown.
    """

    name: str
    url: str
    sha256: str | None = None
    size: int | None = None
    frames: int | None = None


class DownloadError(DataError):
    """A file that cannot be had now: no network, refused by the server, or not what was expected."""


def default_cache() -> pathlib.Path:
    """The folder that TUTORIAL_CACHE names, else the user's cache folder for this package, as pooch chooses it.

    It is not made by asking.
    """
    return pathlib.Path(os.environ.get(CACHE) or pooch.os_cache("tutorial_lib")).expanduser()


def download_files(files: Sequence[RemoteFile], cache: str | os.PathLike) -> None:
    """Bring every one of ``files`` into the folder ``cache``; what is there and right stays as it is.

    A cut-off download leaves ``NAME.part`` and goes on from there next time, if there is a checksum to hold it to. A
    file appears under its name only when whole and right. Where no checksum is published, that of the first download is
    recorded in ``checksums.json`` in ``cache`` and held to from then on. A folder in which all is there and right
    is only read, so it may be one that cannot be written.

    Raises ``DownloadError`` for the first file that cannot be had (the files before it stay) and for a
    folder that cannot be written; ``DataError`` for a damaged ``checksums.json``.
    """
    cache = pathlib.Path(cache)
    try:
        expected = _expected(files, _read_record(cache))
        missing = [f for f in files if not _is_right(cache / f.name, expected[f.name])]
        if not missing and None not in expected.values():
            return
        cache.mkdir(parents=True, exist_ok=True)
        with _one_process_at_a_time(cache), _quiet(pooch.get_logger()):
            _download_files(files, missing, cache)
    except OSError as error:
        raise DownloadError(f"cannot write to {error.filename or cache}: {error.strerror or error}") from None


def _expected(files: Sequence[RemoteFile], recorded: dict[str, str]) -> dict[str, str | None]:
    return {f.name: f.sha256 or recorded.get(f.name) for f in files}


def _download_files(files: Sequence[RemoteFile], missing: Sequence[RemoteFile], cache: pathlib.Path) -> None:
    """missing: those of ``files`` that were not right before this process had its turn, and may be by now."""
    recorded = _read_record(cache)
    expected = _expected(files, recorded)
    store = pooch.create(cache, base_url="", registry=expected, urls={f.name: f.url for f in files}, retry_if_failed=0)
    missing = [f for f in missing if not _is_right(cache / f.name, expected[f.name])]
    if missing and offline():
        raise DownloadError(f"{OFFLINE} is set")
    sizes = [f.size for f in missing]
    with (
        requests.Session() as session,
        tqdm(
            total=None if None in sizes else sum(sizes), unit="B", unit_scale=True, unit_divisor=1000,
            desc="download", disable=not missing, leave=False, delay=0.5,
        ) as bar,
    ):  # fmt: skip
        for i, file in enumerate(missing, 1):
            bar.set_postfix_str(f"file {i}/{len(missing)}", refresh=False)
            target = cache / file.name
            _remove_leftovers(target.parent)
            receive = ResumingDownloader(target, expected[file.name], file.size, session, bar)
            if file.name in recorded:
                receive.origin = f" as first downloaded ({cache / RECORD})"
            store.fetch(file.name, downloader=receive)
            _record_first(file, expected, recorded, cache)
    for file in files:  # those that somebody put there
        _record_first(file, expected, recorded, cache)


def _record_first(file: RemoteFile, expected: dict, recorded: dict[str, str], cache: pathlib.Path) -> None:
    """Hold a file without a published checksum to what it is now."""
    if expected[file.name] is None:
        expected[file.name] = recorded[file.name] = pooch.file_hash(str(cache / file.name))
        with atomic_write(cache / RECORD) as path:
            path.write_text(json.dumps(recorded, indent=1, sort_keys=True) + "\n", encoding="utf-8")


class ResumingDownloader:
    """A downloader for pooch that resumes, which pooch's own do not.

    Bytes go to ``target`` + ``.part``; what is there already is not asked for again (HTTP ``Range``), and a
    connection that breaks is taken up again as long as each attempt brings something. The checksum is
    compared before pooch gets the file; on a mismatch the part is removed.

    Without a checksum nothing but the server tells whether a file is whole and of one piece. Then a part from before is
    thrown away, a connection is taken up again only for the very file that it broke off in (HTTP ``If-Range``), and an
    answer must say how long it is, or end as one in chunks does.
    """

    origin = ""  # where the expected checksum comes from, for the error

    def __init__(
        self,
        target: str | os.PathLike,
        sha256: str | None = None,
        size: int | None = None,
        session: requests.Session | None = None,
        bar: tqdm | None = None,
    ):
        self.target = pathlib.Path(target)
        self.part = self.target.with_name(self.target.name + ".part")
        self.sha256, self.size = sha256, size
        self.session = session or requests
        self.bar = bar
        self._version: str | None = None  # of the file at the server, what If-Range asks for

    def __call__(self, url: str, output_file: str | os.PathLike, _: object = None) -> None:
        """As pooch calls it: the bytes at ``url`` become the file ``output_file``; else ``DownloadError``."""
        if self.sha256 is None:
            self.part.unlink(missing_ok=True)
        resumed = self._had() > 0
        try:
            if resumed and self._had() == self.size:  # cut off between the last byte and the check
                self._progress(self.size)
            else:
                self._receive_all(url)
            if resumed and not _is_right(self.part, self.sha256):  # the old part is to blame, or so it may be
                self._progress(-self._had())
                self.part.unlink()
                self._receive_all(url)
        except DownloadError:
            if self.sha256 is None:
                self.part.unlink(missing_ok=True)
            raise
        self._check(url)
        os.replace(self.part, output_file)

    def _had(self) -> int:
        return self.part.stat().st_size if self.part.exists() else 0

    def _receive_all(self, url: str) -> None:
        failed = 0
        while True:
            before = self._had() if self.sha256 or self._version else 0
            try:
                if self._receive(url, before):
                    return
                if self._had() > before:  # a piece of what was asked for; on to the next
                    continue
                failed += 1
            except requests.RequestException as error:
                failed += 1
                if failed == ATTEMPTS or self._had() <= before:
                    kept = f", {self._had()} bytes are kept to go on from" if self._had() and self.sha256 else ""
                    raise DownloadError(f"{_reason(url, error)}{kept}") from None
            if failed == ATTEMPTS:
                raise DownloadError(f"{url}: the server keeps sending other bytes than were asked for")

    def _receive(self, url: str, offset: int) -> bool:
        """One request, for the bytes from ``offset`` on; whether that was all (if not, ask on, or from zero again)."""
        headers = {"Accept-Encoding": "identity"}  # a compressed answer could not be resumed by offset
        if offset:
            headers["Range"] = f"bytes={offset}-"
            if self.sha256 is None:
                headers["If-Range"] = self._version
        with self._get(url, headers) as answer:
            span = answer.headers.get("Content-Range", "")
            if answer.status_code == 416 and offset:  # nothing after it: all there, or another file's part
                if span == f"bytes */{offset}":
                    self._progress(offset)
                    return True
                self.part.unlink()
                return False
            answer.raise_for_status()
            if answer.status_code != 206:
                # the whole file, whatever was asked for
                etag = answer.headers.get("ETag", "W/")
                self._version = answer.headers.get("Last-Modified") if etag.startswith("W/") else etag
                self._append(answer, 0, self._length(url, answer))
                return True
            piece = re.fullmatch(rf"bytes {offset}-(\d+)/(\d+|\*)", span.strip())
            if not piece:
                self.part.unlink(missing_ok=True)
                return False
            end = int(piece[1]) + 1
            self._append(answer, offset, end - offset)
            if piece[2] == str(end) == str(self._had()):
                return True
            self._progress(-end)  # it counts again with the next piece
            return False

    def _get(self, url: str, headers: dict[str, str]) -> requests.Response:
        try:
            return self.session.get(url, headers=headers, stream=True, timeout=TIMEOUT)
        except requests.RequestException:
            raise
        except ValueError as error:  # requests lets through what is wrong with an address that it is sent on to
            raise DownloadError(f"{url} leads to an address that is none: {' '.join(str(error).split())}") from None

    def _length(self, url: str, answer: requests.Response) -> int | None:
        """Bytes of a whole file; None where chunks tell its end, or a checksum does."""
        if "chunked" in answer.headers.get("Transfer-Encoding", "").lower():
            return None
        told = answer.headers.get("Content-Length", "").strip()
        if told.isascii() and told.isdigit():
            return int(told)
        if self.sha256 is None and self.size is None:
            said = f"Content-Length {told[:40]!r}" if told else "no Content-Length"
            raise DownloadError(
                f"{url}: {said}, and no checksum is known: expected an answer that says how long it is, or a cut "
                "would not be noticed; nothing was kept"
            )
        return self.size

    def _append(self, answer: requests.Response, offset: int, length: int | None) -> None:
        """The body of ``answer``, so many bytes, to the part from ``offset`` on, as far as it comes."""
        received = 0
        self._progress(offset)
        try:
            with open(self.part, "ab" if offset else "wb") as out:
                for chunk in answer.iter_content(CHUNK):
                    out.write(chunk)
                    received += len(chunk)
                    self._progress(len(chunk))
            if length is not None and received < length:
                raise requests.ConnectionError(f"cut off after {received} of {length} bytes")
        except requests.RequestException:
            self._progress(-(offset + received))  # it counts again when it is resumed
            raise

    def _progress(self, n_bytes: int) -> None:
        if self.bar is not None:
            self.bar.update(n_bytes)

    def _check(self, url: str) -> None:
        if self.sha256 is not None:
            found = pooch.file_hash(str(self.part))
            if found != self.sha256:
                size = self._had()
                self.part.unlink()
                raise DownloadError(
                    f"{url}: expected SHA-256 {self.sha256}{self.origin}, found {found} ({size} bytes); "
                    f"nothing was kept"
                )
        elif self.target.suffix.lower() in (".asf", ".amc"):
            # no checksum yet, so at least not a log-in page: both formats open with a comment or a keyword
            with open(self.part, "rb") as file:
                start = file.read(64)
            if start.lstrip()[:1] not in (b"#", b":"):
                self.part.unlink()
                raise DownloadError(
                    f"{url}: expected a file that starts with '#' or ':', found {start[:24]!r}; nothing was kept"
                )


def offline() -> bool:
    """Whether the environment variable TUTORIAL_OFFLINE forbids the network: set, neither empty nor 0."""
    return os.environ.get(OFFLINE, "").strip().lower() not in ("", "0", "no", "false")


def _reason(url: str, error: requests.RequestException) -> str:
    """One short line for what requests tells in several."""
    try:
        host = urlsplit(url).hostname
    except ValueError:
        host = url
    if error.response is not None:
        return f"{url} answered {error.response.status_code} {error.response.reason}"
    if isinstance(error, requests.ConnectTimeout):
        return f"no network: {host} did not answer in time"
    if isinstance(error, requests.Timeout):
        return f"{host} did not answer in time"
    if isinstance(error, requests.exceptions.ChunkedEncodingError):
        return f"the connection to {host} broke off"
    if isinstance(error, requests.ConnectionError):
        text = str(error)
        if any(sign in text for sign in ("cut off", "IncompleteRead", "Connection aborted", "timed out")):
            return f"the connection to {host} broke off"
        if "resolve" in text or "getaddrinfo" in text:
            return f"no network: the name {host} cannot be resolved"
        return f"no network: {host} cannot be reached"
    return f"{url}: {' '.join(str(error).split())}"


def _is_right(path: pathlib.Path, sha256: str | None) -> bool:
    return path.is_file() and (sha256 is None or pooch.file_hash(str(path)) == sha256)


def _remove_leftovers(folder: pathlib.Path) -> None:
    """The empty temporary files that pooch leaves behind when its process is killed."""
    for path in folder.glob("tmp*"):
        if path.is_file() and path.stat().st_size == 0:
            path.unlink()


RECORD = "checksums.json"


def _read_record(cache: pathlib.Path) -> dict[str, str]:
    path = cache / RECORD
    if not path.exists():
        return {}
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        if not all(isinstance(v, str) for v in record.values()):
            raise ValueError
        return record
    except (ValueError, AttributeError):
        raise DataError(f"{path}: expected a JSON object of file names and SHA-256 sums") from None


@contextlib.contextmanager
def _one_process_at_a_time(cache: pathlib.Path) -> Iterator[None]:
    """Two processes that fetch the same set take turns; the second then finds the files there."""
    try:
        import fcntl
    except ImportError:  # Windows
        yield
        return
    with open(cache / ".lock", "a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print("Another process is downloading; waiting for it.")
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@contextlib.contextmanager
def _quiet(logger: logging.Logger) -> Iterator[None]:
    """pooch announces every file; the progress bar says enough."""
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(level)
