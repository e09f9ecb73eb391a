"""Downloads, against a server on the loopback address that cuts, lies and refuses."""

import hashlib
import http.server
import json
import multiprocessing
import os
import socket
import stat
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest

from tutorial_lib import data
from tutorial_lib.data import download
from tutorial_lib.data.catalog import DataSet, NotAtHand
from tutorial_lib.data.download import DownloadError, RemoteFile, default_cache, download_files
from tutorial_lib.errors import DataError

BODY = bytes(range(256)) * 2000  # 512 kB
CUT = 12 * download.CHUNK  # what is received up to here is kept whole
SHA = hashlib.sha256(BODY).hexdigest()


class Server:
    """Serves ``files``; ``cuts``: the bytes after which the next answers break off; ``log``: what came, and
    ``conditions``, its If-Range."""

    def __init__(self):
        self.files, self.cuts, self.log, self.conditions = {}, [], [], []
        self.ranges = True  # False: ignores Range and sends all, as some servers do
        self.shift = 0  # a broken server that begins elsewhere than asked
        self.pause = 0.0  # seconds between chunks
        self.version = {}  # headers that tell which version of a file it is
        self.length = (
            "told"  # how long an answer is: "told", "chunked", or a Content-Length as it stands, None for none
        )
        self.piece = None  # bytes; a longer rest is sent in pieces, as some servers do with ranges
        self.total = True  # False: a piece does not tell of how many bytes it is one
        self.onward = None  # another address, to which all is sent on
        outer = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self):
                outer.answer(self)

            def log_message(self, *_):
                pass

        self.httpd = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.httpd.daemon_threads = True
        self.url = f"http://127.0.0.1:{self.httpd.server_address[1]}"
        threading.Thread(target=self.httpd.serve_forever, args=(0.02,), daemon=True).start()

    def answer(self, request):
        wanted = request.headers.get("Range")
        self.log.append((request.path, wanted))
        self.conditions.append(request.headers.get("If-Range"))
        if self.onward is not None:
            request.send_response(302)
            request.send_header("Location", self.onward)
            return request.end_headers()
        if self.conditions[-1] not in (None, *self.version.values()):
            wanted = None  # it is another file by now: all of it
        body = self.files.get(request.path.lstrip("/"))
        if body is None:
            return request.send_error(404)
        start = 0
        if wanted and self.ranges:
            start = int(wanted.removeprefix("bytes=").rstrip("-")) + self.shift
            if start >= len(body):
                request.send_response(416)
                request.send_header("Content-Range", f"bytes */{len(body)}")
                request.send_header("Content-Length", "0")
                return request.end_headers()
            rest = body[start : None if self.piece is None else start + self.piece]
            request.send_response(206)
            total = len(body) if self.total else "*"
            request.send_header("Content-Range", f"bytes {start}-{start + len(rest) - 1}/{total}")
        else:
            rest = body
            request.send_response(200)
        if self.length == "chunked":
            request.send_header("Transfer-Encoding", "chunked")
            rest = b"".join(b"%x\r\n%s\r\n" % (len(p), p) for p in (rest[:1000], rest[1000:])) + b"0\r\n\r\n"
        elif self.length is not None:
            request.send_header("Content-Length", str(len(rest)) if self.length == "told" else self.length)
        for name, value in self.version.items():
            request.send_header(name, value)
        request.end_headers()
        if self.cuts:
            rest = rest[: self.cuts.pop(0)]
        try:
            for i in range(0, len(rest), 1 << 14):
                request.wfile.write(rest[i : i + (1 << 14)])
                request.wfile.flush()
                time.sleep(self.pause)
        except OSError:  # the client went away
            pass
        request.close_connection = True


@pytest.fixture
def server(monkeypatch):
    monkeypatch.delenv("TUTORIAL_OFFLINE", raising=False)
    monkeypatch.delenv("TUTORIAL_DATA", raising=False)
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    server = Server()
    server.files["set/a.bvh"] = BODY
    yield server
    server.httpd.shutdown()
    server.httpd.server_close()


def remote(server, name="set/a.bvh", sha256=SHA, size=None):
    return RemoteFile(name, f"{server.url}/{name}", sha256, size)


def files_in(cache):
    return sorted(p.relative_to(cache).as_posix() for p in cache.rglob("*") if p.is_file() and p.name != ".lock")


def test_good_file_arrives_once_and_readable(server, tmp_path):
    download_files([remote(server, size=len(BODY))], tmp_path)
    assert (tmp_path / "set/a.bvh").read_bytes() == BODY
    assert files_in(tmp_path) == ["set/a.bvh"]
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE((tmp_path / "set/a.bvh").stat().st_mode) == 0o666 & ~mask
    download_files([remote(server)], tmp_path)
    assert server.log == [("/set/a.bvh", None)]  # the second time nothing is asked for


def test_damaged_file_in_the_cache_is_fetched_again_and_only_it(server, tmp_path):
    server.files["set/b.bvh"] = BODY[::-1]
    both = [remote(server), remote(server, "set/b.bvh", hashlib.sha256(BODY[::-1]).hexdigest())]
    download_files(both, tmp_path)
    (tmp_path / "set/a.bvh").write_bytes(BODY[:-1])
    download_files(both, tmp_path)
    assert (tmp_path / "set/a.bvh").read_bytes() == BODY
    assert [path for path, _ in server.log] == ["/set/a.bvh", "/set/b.bvh", "/set/a.bvh"]


def test_wrong_checksum_keeps_nothing_and_says_both(server, tmp_path):
    server.files["set/a.bvh"] = BODY[:-1] + b"!"
    with pytest.raises(DownloadError) as error:
        download_files([remote(server)], tmp_path)
    found = hashlib.sha256(BODY[:-1] + b"!").hexdigest()
    assert f"expected SHA-256 {SHA}" in str(error.value) and f"found {found}" in str(error.value)
    assert "\n" not in str(error.value)
    assert files_in(tmp_path) == []


def test_wrong_checksum_leaves_the_file_that_was_there(server, tmp_path):
    """An update that fails does not take away what there is."""
    (tmp_path / "set").mkdir()
    (tmp_path / "set/a.bvh").write_bytes(b"older")
    server.files["set/a.bvh"] = b"wrong"
    with pytest.raises(DownloadError):
        download_files([remote(server)], tmp_path)
    assert (tmp_path / "set/a.bvh").read_bytes() == b"older"


def test_cut_off_twice_is_resumed_in_one_call(server, tmp_path):
    server.cuts = [CUT, 4 * download.CHUNK + 1]
    download_files([remote(server)], tmp_path)
    assert (tmp_path / "set/a.bvh").read_bytes() == BODY
    assert [r for _, r in server.log] == [None, f"bytes={CUT}-", f"bytes={CUT + 4 * download.CHUNK}-"]
    assert files_in(tmp_path) == ["set/a.bvh"]


def test_cut_off_for_good_keeps_a_part_that_the_next_call_resumes(server, tmp_path):
    server.cuts = [CUT, 0]
    with pytest.raises(DownloadError, match=f"broke off, {CUT} bytes are kept"):
        download_files([remote(server)], tmp_path)
    assert files_in(tmp_path) == ["set/a.bvh.part"]
    assert (tmp_path / "set/a.bvh.part").read_bytes() == BODY[:CUT]
    download_files([remote(server)], tmp_path)
    assert server.log[-1] == ("/set/a.bvh", f"bytes={CUT}-")
    assert (tmp_path / "set/a.bvh").read_bytes() == BODY


def test_server_that_ignores_range_sends_all_again(server, tmp_path):
    server.ranges = False
    server.cuts = [CUT]
    download_files([remote(server)], tmp_path)
    assert [r for _, r in server.log] == [None, f"bytes={CUT}-"]
    assert (tmp_path / "set/a.bvh").read_bytes() == BODY


def test_server_that_starts_elsewhere_is_asked_from_zero(server, tmp_path):
    server.cuts, server.shift = [CUT], 7
    download_files([remote(server)], tmp_path)
    assert [r for _, r in server.log] == [None, f"bytes={CUT}-", None]
    assert (tmp_path / "set/a.bvh").read_bytes() == BODY


@pytest.mark.parametrize("size", [None, len(BODY)])
def test_whole_part_is_taken_without_its_bytes_again(server, tmp_path, size):
    (tmp_path / "set").mkdir()
    (tmp_path / "set/a.bvh.part").write_bytes(BODY)
    download_files([remote(server, size=size)], tmp_path)
    assert (tmp_path / "set/a.bvh").read_bytes() == BODY
    assert [r for _, r in server.log] == ([] if size else [f"bytes={len(BODY)}-"])


def test_part_that_is_too_long_is_started_again(server, tmp_path):
    (tmp_path / "set").mkdir()
    (tmp_path / "set/a.bvh.part").write_bytes(BODY + b"more")
    download_files([remote(server)], tmp_path)
    assert (tmp_path / "set/a.bvh").read_bytes() == BODY


def test_part_of_another_file_is_started_again_at_once(server, tmp_path):
    """Whole by its size, or a beginning: what comes is wrong by its checksum, and the part is to blame."""
    for stale in (BODY[::-1], BODY[: CUT - 1] + b"!"):
        (tmp_path / "set").mkdir(exist_ok=True)
        (tmp_path / "set/a.bvh.part").write_bytes(stale)
        download_files([remote(server, size=len(BODY))], tmp_path)
        assert (tmp_path / "set/a.bvh").read_bytes() == BODY and files_in(tmp_path) == ["set/a.bvh"]
        (tmp_path / "set/a.bvh").unlink()
    assert [r for _, r in server.log] == [None, f"bytes={CUT}-", None]


@pytest.mark.parametrize("total", [True, False])
def test_a_server_that_sends_a_range_in_pieces_is_asked_on(server, tmp_path, total):
    server.cuts, server.piece, server.total = [CUT], 200_000, total
    download_files([remote(server)], tmp_path)
    assert (tmp_path / "set/a.bvh").read_bytes() == BODY
    at = [CUT, CUT + 200_000, CUT + 400_000, *([] if total else [len(BODY)])]
    assert [r for _, r in server.log] == [None, *(f"bytes={k}-" for k in at)]


def test_many_pieces_are_no_failures(server, tmp_path):
    server.cuts, server.piece = [CUT], 40_000
    download_files([remote(server)], tmp_path)
    assert (tmp_path / "set/a.bvh").read_bytes() == BODY and len(server.log) > 2 * download.ATTEMPTS


@pytest.mark.parametrize("length", ["many", "-5", ""])
def test_a_length_that_is_no_number_is_as_good_as_none(server, tmp_path, length):
    server.length = length
    download_files([remote(server)], tmp_path)
    assert (tmp_path / "set/a.bvh").read_bytes() == BODY
    with pytest.raises(DownloadError, match="expected an answer that says how long it is") as error:
        download_files([remote(server, sha256=None)], tmp_path / "other")
    assert "\n" not in str(error.value)


# --- without a checksum: only the server tells what is whole ------------------------------------------


def test_an_answer_that_just_ends_is_refused(server, tmp_path):
    server.length, server.cuts = None, [CUT]
    with pytest.raises(DownloadError, match="no Content-Length, and no checksum is known.*nothing was kept") as error:
        download_files([remote(server, sha256=None)], tmp_path)
    assert "\n" not in str(error.value) and files_in(tmp_path) == []
    server.cuts = []
    download_files([remote(server)], tmp_path)  # a checksum tells


def test_chunks_tell_their_end(server, tmp_path):
    server.length = "chunked"
    download_files([remote(server, sha256=None)], tmp_path / "whole")
    assert (tmp_path / "whole/set/a.bvh").read_bytes() == BODY
    server.cuts = [CUT] * download.ATTEMPTS
    with pytest.raises(DownloadError, match="broke off$"):
        download_files([remote(server, sha256=None)], tmp_path / "cut")
    assert files_in(tmp_path / "cut") == []


def test_a_part_from_before_is_thrown_away(server, tmp_path):
    for part in (b"older" * 1000, BODY):
        (tmp_path / "set").mkdir(exist_ok=True)
        (tmp_path / "set/a.bvh.part").write_bytes(part)
        download_files([remote(server, sha256=None, size=len(BODY))], tmp_path)
        assert (tmp_path / "set/a.bvh").read_bytes() == BODY and server.log == [("/set/a.bvh", None)]
        server.log.clear()
        for name in ("set/a.bvh", "checksums.json"):
            (tmp_path / name).unlink()


@pytest.mark.parametrize(
    ("version", "asked"),
    [
        ({}, None),
        ({"ETag": 'W/"1"'}, None),
        ({"ETag": '"1"', "Last-Modified": "Mon, 06 Jan 2025 00:00:00 GMT"}, '"1"'),
        ({"ETag": 'W/"1"', "Last-Modified": "Mon, 06 Jan 2025 00:00:00 GMT"}, "Mon, 06 Jan 2025 00:00:00 GMT"),
    ],
)
def test_what_broke_off_is_taken_up_only_in_the_same_file(server, tmp_path, version, asked):
    server.cuts, server.version = [CUT], version
    download_files([remote(server, sha256=None)], tmp_path)
    assert (tmp_path / "set/a.bvh").read_bytes() == BODY
    assert [r for _, r in server.log] == [None, f"bytes={CUT}-" if asked else None]
    assert server.conditions == [None, asked]


def test_a_file_that_was_changed_meanwhile_is_fetched_whole(server, tmp_path, monkeypatch):
    server.cuts, server.version = [CUT], {"ETag": '"1"'}
    receive = download.ResumingDownloader._receive

    def then_changed(self, url, offset):
        if offset:
            server.files["set/a.bvh"], server.version = BODY[::-1], {"ETag": '"2"'}
        return receive(self, url, offset)

    monkeypatch.setattr(download.ResumingDownloader, "_receive", then_changed)
    download_files([remote(server, sha256=None)], tmp_path)
    assert (tmp_path / "set/a.bvh").read_bytes() == BODY[::-1] and server.conditions == [None, '"1"']


@pytest.mark.parametrize(
    "onward",
    ["http://[::1", "http://a:99999999/", "http://.a.b/", "http://" + "a" * 70 + "/", "ftp://a/b", "http://", "//[x"],
)
def test_being_sent_on_to_no_address_is_one_line(server, tmp_path, onward):
    server.onward = onward
    with pytest.raises(DownloadError) as error:
        download_files([remote(server)], tmp_path)
    assert "\n" not in str(error.value) and files_in(tmp_path) == []


def test_404_names_the_address(server, tmp_path):
    with pytest.raises(DownloadError, match=f"{server.url}/set/none.bvh answered 404 Not Found"):
        download_files([remote(server, "set/none.bvh")], tmp_path)
    assert files_in(tmp_path) == []


def test_no_network_fails_fast_and_tells_what_to_do(tmp_path, monkeypatch):
    for name in ("TUTORIAL_OFFLINE", "TUTORIAL_DATA", "http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    with socket.socket() as held:  # bound, not listening: connections are refused
        held.bind(("127.0.0.1", 0))
        indian = data.entry("cmu/indian").with_base(f"http://127.0.0.1:{held.getsockname()[1]}")
        start = time.monotonic()
        with pytest.raises(NotAtHand) as error:
            data.load(indian, cache=tmp_path)
        assert time.monotonic() - start < 5
    text = str(error.value)
    assert "cmu/indian is not at hand: no network: 127.0.0.1 cannot be reached" in text
    assert "python -m tutorial_lib data fetch cmu/indian" in text and str(tmp_path / "cmu/indian") in text
    assert "\n" not in text


def test_offline_setting_never_touches_the_network(server, tmp_path, monkeypatch):
    monkeypatch.setenv("TUTORIAL_OFFLINE", "1")
    with pytest.raises(NotAtHand, match="TUTORIAL_OFFLINE is set.*data fetch cmu/salsa"):
        data.fetch(data.entry("cmu/salsa").with_base(server.url), cache=tmp_path)
    assert server.log == []
    (tmp_path / "set").mkdir()
    (tmp_path / "set/a.bvh").write_bytes(BODY)
    download_files([remote(server)], tmp_path)  # all there and right: no error
    monkeypatch.setenv("TUTORIAL_OFFLINE", "0")
    (tmp_path / "set/a.bvh").unlink()
    download_files([remote(server)], tmp_path)
    assert len(server.log) == 1


def test_a_complete_cache_is_only_read(server, tmp_path, monkeypatch):
    """One that cannot be written, as for all users of a machine. (Root may write everywhere, so its lock fails.)"""
    server.files["set/b.bvh"] = BODY[::-1]
    both = [remote(server), remote(server, "set/b.bvh", None)]  # the second is held to what is recorded
    download_files(both, tmp_path)
    before = sorted(tmp_path.rglob("*"))

    def refused(cache):
        raise PermissionError(13, "Permission denied", str(cache / ".lock"))

    monkeypatch.setattr(download, "_one_process_at_a_time", refused)
    server.log.clear()
    download_files(both, tmp_path)
    assert sorted(tmp_path.rglob("*")) == before and server.log == []
    (tmp_path / "set/b.bvh").write_bytes(b"damaged")
    with pytest.raises(DownloadError, match="cannot write to .*lock: Permission denied"):
        download_files(both, tmp_path)


AMC = b"#!OML:ASF\n:FULLY-SPECIFIED\n:DEGREES\n1\nroot 0 0 0 0 0 0\n"


def test_first_download_is_recorded_and_held_to(server, tmp_path):
    unpublished = [remote(server, "set/1.amc", None)]
    server.files["set/1.amc"] = AMC
    download_files(unpublished, tmp_path)
    sha = hashlib.sha256(AMC).hexdigest()
    assert json.loads((tmp_path / "checksums.json").read_text()) == {"set/1.amc": sha}

    server.files["set/1.amc"] = AMC + b"2\nroot 0 0 0 0 0 0\n"
    (tmp_path / "set/1.amc").unlink()
    with pytest.raises(DownloadError, match=f"expected SHA-256 {sha} as first downloaded .*checksums.json.*found"):
        download_files(unpublished, tmp_path)
    assert files_in(tmp_path) == ["checksums.json"]

    server.files["set/1.amc"] = AMC
    (tmp_path / "set").mkdir(exist_ok=True)
    (tmp_path / "set/1.amc").write_bytes(b"changed on disk")
    download_files(unpublished, tmp_path)
    assert (tmp_path / "set/1.amc").read_bytes() == AMC


def test_files_before_a_failure_are_kept_and_recorded(server, tmp_path):
    server.files["set/1.amc"] = AMC
    with pytest.raises(DownloadError, match="404"):
        download_files([remote(server, "set/1.amc", None), remote(server, "set/2.amc", None)], tmp_path)
    assert files_in(tmp_path) == ["checksums.json", "set/1.amc"]


def test_log_in_page_is_not_recorded_as_motion(server, tmp_path):
    server.files["set/1.amc"] = b"<!DOCTYPE html><html>Please log in</html>"
    with pytest.raises(DownloadError, match="expected a file that starts with '#' or ':', found b'<!DOCTYPE"):
        download_files([remote(server, "set/1.amc", None)], tmp_path)
    assert files_in(tmp_path) == []


def test_damaged_record_is_named(server, tmp_path):
    (tmp_path / "checksums.json").write_text("[1, 2")
    with pytest.raises(DataError, match="checksums.json: expected a JSON object"):
        download_files([remote(server)], tmp_path)


def test_cache_that_is_a_file_is_named(server, tmp_path):
    (tmp_path / "cache").write_text("")
    with pytest.raises(DownloadError, match="cannot write to .*cache"):
        download_files([remote(server)], tmp_path / "cache")


def test_killed_half_way_nothing_stands_under_the_name_and_it_resumes(server, tmp_path):
    server.pause = 0.02  # 32 chunks of 16 kB
    code = f"""
        from tutorial_lib.data.download import RemoteFile, download_files
        download_files([RemoteFile("set/a.bvh", "{server.url}/set/a.bvh", "{SHA}")], {str(tmp_path)!r})
    """
    child = subprocess.Popen([sys.executable, "-c", textwrap.dedent(code)], stderr=subprocess.DEVNULL)
    part, until = tmp_path / "set/a.bvh.part", time.monotonic() + 30
    while not (part.exists() and part.stat().st_size > 100_000):
        assert child.poll() is None and time.monotonic() < until
        time.sleep(0.01)
    child.kill()
    child.wait()
    assert not (tmp_path / "set/a.bvh").exists()
    had = part.stat().st_size
    assert 100_000 < had < len(BODY)
    server.pause = 0
    download_files([remote(server)], tmp_path)
    assert server.log[-1] == ("/set/a.bvh", f"bytes={had}-")
    assert (tmp_path / "set/a.bvh").read_bytes() == BODY
    assert files_in(tmp_path) == ["set/a.bvh"]


@pytest.mark.skipif(sys.platform == "win32", reason="the lock is POSIX")
def test_two_processes_fetch_the_same_file_once(server, tmp_path):
    server.pause = 0.005
    context = multiprocessing.get_context("spawn")
    children = [context.Process(target=download_files, args=([remote(server)], tmp_path)) for _ in range(2)]
    for child in children:
        child.start()
    for child in children:
        child.join(60)
    assert [child.exitcode for child in children] == [0, 0]
    assert server.log == [("/set/a.bvh", None)]
    assert (tmp_path / "set/a.bvh").read_bytes() == BODY


def test_progress_counts_every_byte_once(server, tmp_path, monkeypatch):
    bars = []

    class Bar(download.tqdm):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            bars.append(self)

        def close(self):
            self.last = self.n
            super().close()

    monkeypatch.setattr(download, "tqdm", Bar)
    server.cuts = [CUT]
    download_files([remote(server, size=len(BODY))], tmp_path)
    assert bars[0].total == bars[0].last == len(BODY)


ASF = """# a root and one bone
:version 1.10
:name stick
:units
  mass 1.0
  length 0.45
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name trunk
    direction 0 1 0
    length 9
    axis 0 0 0 XYZ
    dof rx
    limits (-180 180)
  end
:hierarchy
  begin
    root trunk
  end
"""


def test_load_downloads_skeleton_and_trials_and_reads_them(server, tmp_path, capsys):
    """As for cmu/boxing: the first call downloads, the second reads what is there; units are the ASF's."""
    server.files["boxing/14.asf"] = ASF.encode()
    frame = "root 0 {y} 0 0 0 0\ntrunk 90\n"
    for trial in (1, 2):
        text = "#!OML:ASF\n:FULLY-SPECIFIED\n:DEGREES\n" + "".join(
            f"{n}\n{frame.format(y=18 * trial)}" for n in (1, 2, 3)
        )
        server.files[f"boxing/14_0{trial}.amc"] = text.encode()
    files = tuple(remote(server, f"boxing/{name}", None) for name in ("14.asf", "14_01.amc", "14_02.amc"))
    boxing = DataSet("some/boxing", "", "free for all uses", "boxing", files, 120)
    motions = data.load_first(boxing, "samples/boxing", cache=tmp_path)
    assert [(m.name, len(m), m.fps) for m in motions] == [("boxing/14_01", 3, 120), ("boxing/14_02", 3, 120)]
    inch = 0.0254 / 0.45  # CMU's length unit in metres: 0.45 of it are an inch
    np.testing.assert_allclose(motions[1].positions[0, 0], [0, 36 * inch, 0], atol=1e-6)
    out = capsys.readouterr().out
    assert "some/boxing: 3 files downloaded. Licence: free for all uses.\n" in out
    assert "Data: some/boxing, 2 clips, 0 s, from the download.\n" in out
    asked = len(server.log)
    assert len(data.load(boxing, cache=tmp_path, limit=1)) == 1 and len(server.log) == asked == 3


def test_fetch_prints_the_licence_once(server, tmp_path, capsys):
    small = DataSet("a/set", "", "CC BY-NC 4.0", "set", (remote(server, size=len(BODY)),), 30)
    assert data.fetch(small, cache=tmp_path) == tmp_path / "set"
    assert capsys.readouterr().out == "a/set: 1 files downloaded. Licence: CC BY-NC 4.0.\n"
    data.fetch(small, cache=tmp_path)
    assert capsys.readouterr().out == ""


def test_the_cache_can_be_put_elsewhere(monkeypatch, tmp_path):
    monkeypatch.setenv("TUTORIAL_CACHE", str(tmp_path / "here"))
    assert default_cache() == tmp_path / "here" and not default_cache().exists()
    monkeypatch.setenv("TUTORIAL_CACHE", "")
    assert default_cache() != tmp_path / "here" and default_cache().name == "tutorial_lib"
