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
    """Serves ``files``; ``cuts``: the bytes after which the next answers break off; ``log``: what came."""

    def __init__(self):
        self.files, self.cuts, self.log = {}, [], []
        self.ranges = True  # False: ignores Range and sends all, as some servers do
        self.shift = 0  # a broken server that begins elsewhere than asked
        self.pause = 0.0  # seconds between chunks
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
            request.send_response(206)
            request.send_header("Content-Range", f"bytes {start}-{len(body) - 1}/{len(body)}")
        else:
            request.send_response(200)
        request.send_header("Content-Length", str(len(body) - start))
        request.end_headers()
        rest = body[start:]
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
