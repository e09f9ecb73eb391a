"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import stat
import threading

import pytest

from tutorial_lib.atomic import atomic_write


def test_the_old_file_stays_until_the_new_one_is_whole(tmp_path):
    path = tmp_path / "new folder" / "a.txt"
    with atomic_write(path) as temporary:
        assert temporary.parent == path.parent and not path.exists()
        temporary.write_text("one")
    with atomic_write(path) as temporary:
        temporary.write_text("two")
        assert path.read_text() == "one"
    assert path.read_text() == "two" and os.listdir(path.parent) == ["a.txt"]


def test_an_error_leaves_nothing_behind(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("one")
    for error in (ValueError, KeyboardInterrupt):
        with pytest.raises(error), atomic_write(path) as temporary:
            temporary.write_text("half of tw")
            raise error
    assert path.read_text() == "one" and os.listdir(tmp_path) == ["a.txt"]


def test_several_writers_of_one_file(tmp_path):
    path = tmp_path / "a.txt"
    ready = threading.Barrier(4)

    def write(text):
        with atomic_write(path) as temporary:
            temporary.write_text(text)
            ready.wait(10)

    writers = [threading.Thread(target=write, args=(letter * 1000,)) for letter in "abcd"]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert path.read_text() in [letter * 1000 for letter in "abcd"] and os.listdir(tmp_path) == ["a.txt"]


def test_a_link_stays_one(tmp_path):
    """The file that it leads to is written, also where it is not there yet."""
    link, target = tmp_path / "link.txt", tmp_path / "far" / "a.txt"
    link.symlink_to("far/a.txt")
    for text in ("one", "two"):
        with atomic_write(link) as temporary:
            assert temporary.parent.samefile(target.parent)
            temporary.write_text(text)
        assert link.is_symlink() and target.read_text() == text and os.listdir(target.parent) == ["a.txt"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_what_is_no_file_is_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    (tmp_path / "folder").mkdir()
    for name, told in (("pipe", "a pipe or a device"), ("link", "a pipe or a device"), ("folder", "this is a folder")):
        with pytest.raises(OSError, match=told), atomic_write(tmp_path / name):
            raise AssertionError("begun in vain")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode) and len(os.listdir(tmp_path)) == 3


@pytest.mark.skipif(os.name != "posix", reason="permissions as POSIX has them")
def test_the_result_has_the_usual_permissions(tmp_path):
    (tmp_path / "usual").touch()
    with atomic_write(tmp_path / "a.txt") as temporary:
        temporary.write_text("one")
    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("usual", "a.txt")]
    assert modes[0] == modes[1]
