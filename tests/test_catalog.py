"""The catalogue: which names there are, where a data set is looked for, and what ``load`` gives."""

import os
import pathlib
import re
import subprocess
import sys

import numpy as np
import pytest

from tutorial_lib import data
from tutorial_lib.data import catalog
from tutorial_lib.data.catalog import ClosedFolder, DataSet, EmptyFolder, NotAtHand, drop_static_root
from tutorial_lib.data.download import RemoteFile
from tutorial_lib.errors import DataError, MotionFileError
from tutorial_lib.motion import Motion, Skeleton
from tutorial_lib.motion.rotations import quat_about_y

STICK = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Head
  {
    OFFSET 0 80 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 80 0
    }
  }
}
MOTION
Frames: 4
Frame Time: 0.05
"""


def write_stick(path, x=0):
    """A stick of 1.6 m that stands at ``x`` cm for four frames at 20 fps."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(STICK + f"{x} 90 0 0 0 0 0 0 0\n" * 4)


@pytest.fixture
def own(tmp_path, monkeypatch):
    """TUTORIAL_DATA, empty; no network, an empty cache."""
    folder = tmp_path / "own"
    folder.mkdir()
    monkeypatch.setenv("TUTORIAL_DATA", str(folder))
    monkeypatch.setenv("TUTORIAL_OFFLINE", "1")
    return folder


@pytest.fixture
def samples(tmp_path, monkeypatch):
    """A stand-in for the checkout's data_samples, with two clips of walking."""
    folder = tmp_path / "data_samples"
    write_stick(folder / "walking/02.bvh", 2)
    write_stick(folder / "walking/01.bvh", 1)
    monkeypatch.setattr(catalog, "SAMPLES", folder)
    return folder


# -- names and sources ---------------------------------------------------------------------------------------


def test_names():
    assert set(data.names()) == {
        "cmu/indian", "cmu/martial", "cmu/salsa", "cmu/walking", "cmu/running", "cmu/boxing",
        "bandai-namco/locomotion",
        "samples/walking", "samples/running", "samples/boxing", "samples/dancing",
    }  # fmt: skip


@pytest.mark.parametrize(("name", "clips"), [("cmu/indian", 6), ("cmu/martial", 7), ("cmu/salsa", 26)])
def test_published_bvh_sets_are_pinned(name, clips):
    entry = data.entry(name)
    assert entry.clips == len(entry.files) == clips
    for file in entry.files:
        assert re.fullmatch(r"https://raw\.githubusercontent\.com/[\w.-]+/[\w.-]+/[0-9a-f]{40}/.+\.bvh", file.url)
        assert re.fullmatch("[0-9a-f]{64}", file.sha256) and file.size > 1000 and file.frames > 10


def test_bandai_namco_addresses():
    entry = data.entry("bandai-namco/locomotion")
    assert entry.clips == 318 and "NC" in entry.licence
    urls = {f.name: f.url for f in entry.files}
    url = urls["bandai-namco/walk-turn-left/active_001.bvh"]
    assert re.search(r"/[0-9a-f]{40}/.*/dataset-2_walk-turn-left_active_001\.bvh$", url)
    assert all(f.sha256 for f in entry.files) and len(set(urls.values())) == 318


def test_cmu_trials_are_the_database_s_own_files():
    """Trials as the database describes them: 07 walks, 35 walks until 16 and runs from 17 to 26, 14 boxes."""
    trials = {name: [f.name.split("/")[-1] for f in data.entry(name).files] for name in data.names()}
    assert trials["cmu/walking"] == (
        ["07.asf"] + [f"07_{n:02d}.amc" for n in range(1, 13)]
        + ["35.asf"] + [f"35_{n:02d}.amc" for n in range(1, 17)]
    )  # fmt: skip
    assert trials["cmu/boxing"] == ["14.asf", "14_01.amc", "14_02.amc", "14_03.amc"]
    assert "16_35.amc" in trials["cmu/running"] and "35_26.amc" in trials["cmu/running"]
    assert data.entry("cmu/walking").clips == 28  # the skeletons are no clips
    for name in ("cmu/walking", "cmu/running", "cmu/boxing"):
        for file in data.entry(name).files:
            trial = file.name.split("/")[-1]
            assert file.url == f"http://mocap.cs.cmu.edu/subjects/{trial[:2]}/{trial}" and file.sha256 is None


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [
        ("cmu/indain", "cmu/indian"),
        ("walkin", "cmu/walking or samples/walking"),
        ("CMU", ""),
        ("", ""),
        (None, ""),
    ],
)
def test_unknown_name_lists_close_and_all(wrong, meant):
    with pytest.raises(DataError) as error:
        data.load(wrong)
    text = str(error.value)
    assert all(name in text for name in data.names()) and "\n" not in text
    assert (f"did you mean {meant}?" in text) if meant else ("did you mean" not in text)


# -- where it is looked for ----------------------------------------------------------------------------------


def test_own_folder_comes_before_the_cache(own, tmp_path):
    remote = RemoteFile("some/set/1.bvh", "http://127.0.0.1:9/1.bvh")
    some = DataSet("some/set", "", "", "some/set", (remote,), 20)
    cache = tmp_path / "cache"
    write_stick(cache / "some/set/1.bvh", 50)
    assert data.load(some, cache=cache)[0].positions[0, 0, 0] == pytest.approx(0.5)
    assert data.where(some, cache=cache) == cache / "some/set"
    write_stick(own / "some/set/mine.bvh", 70)
    (motion,) = data.load(some, cache=cache)
    assert motion.positions[0, 0, 0] == pytest.approx(0.7) and motion.name == "some/set/mine"
    assert data.where(some, cache=cache) == own / "some/set"


def test_incomplete_cache_is_not_taken_for_the_set(own, tmp_path):
    files = tuple(RemoteFile(f"some/set/{n}.bvh", "http://127.0.0.1:9/") for n in (1, 2))
    write_stick(tmp_path / "cache/some/set/1.bvh")
    with pytest.raises(NotAtHand, match="TUTORIAL_OFFLINE is set"):
        data.load(DataSet("some/set", "", "", "some/set", files, 20), cache=tmp_path / "cache")


def test_any_motion_file_below_counts_sorted_and_hidden_ones_do_not(own, tmp_path):
    folder = own / "cmu/boxing"
    for name in ("b.bvh", "a/2.BVH", "a/10.bvh", ".hidden.bvh", ".trash/1.bvh"):
        write_stick(folder / name)
    (folder / "README.txt").write_text("mine")
    motions = data.load("cmu/boxing", cache=tmp_path)
    assert [m.name for m in motions] == ["cmu/boxing/a/10", "cmu/boxing/a/2", "cmu/boxing/b"]
    assert [m.fps for m in motions] == [20.0] * 3


def test_empty_own_folder_is_an_error_that_names_it(own, tmp_path):
    (own / "cmu/boxing").mkdir(parents=True)
    (own / "cmu/boxing/14.asf").write_text(":version 1.10\n")
    with pytest.raises(EmptyFolder, match=re.escape(str(own / "cmu/boxing")) + " holds no motion file"):
        data.load("cmu/boxing", cache=tmp_path)


def test_own_folder_that_is_not_there(monkeypatch, tmp_path):
    monkeypatch.setenv("TUTORIAL_DATA", str(tmp_path / "none"))
    for call in (data.load, data.where, data.load_first):
        with pytest.raises(DataError, match=r"TUTORIAL_DATA=.*none: no such folder"):
            call("samples/walking")
    with pytest.raises(DataError, match="no such folder"):
        data.listing(cache=tmp_path)


def test_own_folder_that_is_a_file(monkeypatch, tmp_path):
    write_stick(tmp_path / "clip.bvh")
    monkeypatch.setenv("TUTORIAL_DATA", str(tmp_path / "clip.bvh"))
    with pytest.raises(DataError, match=r"TUTORIAL_DATA=.*clip\.bvh is a file, expected a folder"):
        data.load("samples/walking")


def test_relative_own_folder_from_here_and_else_from_the_project(tmp_path, monkeypatch, samples):
    project, notebooks = tmp_path / "project", tmp_path / "project/notebooks"
    notebooks.mkdir(parents=True)
    monkeypatch.setattr(catalog, "PROJECT", project)
    monkeypatch.setenv("TUTORIAL_DATA", "../clips")
    write_stick(tmp_path / "clips/samples/walking/x.bvh", 30)
    monkeypatch.chdir(project)
    assert data.where("samples/walking") == tmp_path / "clips/samples/walking"
    monkeypatch.chdir(notebooks)  # from here ../clips is not there
    assert data.where("samples/walking") == tmp_path / "clips/samples/walking"
    write_stick(project / "clips/samples/walking/y.bvh")
    assert data.where("samples/walking") == project / "clips/samples/walking"


def test_where_before_any_download(monkeypatch, tmp_path):
    monkeypatch.delenv("TUTORIAL_DATA", raising=False)
    assert data.where("cmu/indian", cache=tmp_path) == tmp_path / "cmu/indian"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    if sys.platform.startswith("linux"):
        assert data.where("bandai-namco/locomotion") == tmp_path / "tutorial_lib/bandai-namco"


def test_offline_error_names_command_and_own_folder(own, tmp_path):
    with pytest.raises(NotAtHand) as error:
        data.load("cmu/martial", cache=tmp_path)
    assert str(error.value) == (
        "cmu/martial is not at hand: no folder cmu/martial in TUTORIAL_DATA, and TUTORIAL_OFFLINE is set; "
        "run `python -m tutorial_lib data fetch cmu/martial` later, "
        f"or put motion files into {own}/cmu/martial"
    )


def test_missing_samples_say_how_to_have_them(samples, monkeypatch):
    monkeypatch.delenv("TUTORIAL_DATA", raising=False)
    for call in (data.load, data.fetch):
        with pytest.raises(NotAtHand, match="samples/boxing is not at hand.*install from a clone"):
            call("samples/boxing")
    assert data.fetch("samples/walking") == samples / "walking"


def test_links_to_folders_are_followed_each_folder_once(own, tmp_path):
    write_stick(tmp_path / "elsewhere/b/2.bvh", 20)
    walking = own / "cmu/walking"
    write_stick(walking / "z/1.bvh", 10)
    (walking / "linked").symlink_to(tmp_path / "elsewhere")
    (walking / "a").symlink_to(walking / "z")  # named as it lies there, not as the link that comes first
    (walking / "z" / "round").symlink_to(walking)
    (walking / ".hidden").symlink_to(tmp_path / "elsewhere")
    motions = data.load("cmu/walking", cache=tmp_path)
    assert [m.name for m in motions] == ["cmu/walking/linked/b/2", "cmu/walking/z/1"]
    assert [m.positions[0, 0, 0] for m in motions] == pytest.approx([0.2, 0.1])


def test_a_folder_that_cannot_be_opened_is_told(own, tmp_path, monkeypatch):
    """Not left out without a word; the list of all data sets goes on."""
    write_stick(own / "cmu/walking/open/1.bvh")
    closed = own / "cmu/walking/closed"
    write_stick(closed / "2.bvh")
    scandir = os.scandir

    def refuses(path):  # also as root, whom no permission stops
        if pathlib.Path(path) == closed:
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refuses)
    with pytest.raises(ClosedFolder) as error:
        data.load("cmu/walking", cache=tmp_path)
    assert str(error.value) == f"{closed}: cannot be opened (Permission denied), expected a folder of motion files"
    row = next(row for row in data.listing(cache=tmp_path) if row.name == "cmu/walking")
    assert (row.at_hand, row.clips, row.path) == ("closed folder", 0, closed)


# -- what load gives -----------------------------------------------------------------------------------------


def test_load_samples_sorted_named_and_in_metres(samples, monkeypatch):
    monkeypatch.delenv("TUTORIAL_DATA", raising=False)
    motions = data.load("samples/walking")
    assert [m.name for m in motions] == ["samples/walking/01", "samples/walking/02"]
    np.testing.assert_allclose(motions[1].positions[0], [[0.02, 0.9, 0], [0.02, 1.7, 0], [0.02, 2.5, 0]], atol=1e-9)


def test_a_file_by_its_path_is_the_clip_of_the_set(own, tmp_path):
    """An end site that lies in its joint is left out either way: Hips and Head remain."""
    path = own / "cmu/boxing/1.bvh"
    write_stick(path)
    path.write_text(path.read_text().replace("      OFFSET 0 80 0", "      OFFSET 0 0 0"))
    (named,) = data.load("cmu/boxing", cache=tmp_path)
    clip = catalog.read_clip(path)
    assert clip.skeleton.names == ("Hips", "Head") and clip.skeleton == named.skeleton
    assert np.array_equal(clip.positions, named.positions)


def test_limit_and_fps(samples, monkeypatch):
    monkeypatch.delenv("TUTORIAL_DATA", raising=False)
    (motion,) = data.load("samples/walking", limit=1, fps=10)
    assert motion.name == "samples/walking/01" and motion.fps == 10 and len(motion) == 2
    for wrong in (0, -1, 1.5, "2"):
        with pytest.raises(DataError, match="limit=.*at least 1"):
            data.load("samples/walking", limit=wrong)


def test_file_that_cannot_be_read_is_named(own, tmp_path):
    write_stick(own / "cmu/boxing/1.bvh")
    (own / "cmu/boxing/2.bvh").write_text("HIERARCHY\n")
    with pytest.raises(MotionFileError, match="2.bvh"):
        data.load_first("cmu/boxing", "samples/boxing", cache=tmp_path)


# -- load_first ----------------------------------------------------------------------------------------------


def test_load_first_takes_the_real_one_when_it_is_there(own, samples, tmp_path, capsys):
    write_stick(own / "cmu/walking/1.bvh")
    motions = data.load_first("cmu/walking", "samples/walking", cache=tmp_path)
    assert [m.name for m in motions] == ["cmu/walking/1"]
    assert capsys.readouterr().out == "Data: cmu/walking, 1 clips, 0 s, from TUTORIAL_DATA.\n"


def test_load_first_says_why_not_an_earlier_one(own, samples, tmp_path, capsys):
    """cmu/boxing has no folder here: the next name is tried."""
    motions = data.load_first("cmu/boxing", "cmu/martial", "samples/walking", limit=1, cache=tmp_path)
    assert [m.name for m in motions] == ["samples/walking/01"]
    out = capsys.readouterr().out
    assert out == (
        "Data: samples/walking, 1 clips, 0 s, from data_samples "
        "(not cmu/boxing: no folder cmu/boxing in TUTORIAL_DATA, and TUTORIAL_OFFLINE is set; "
        "not cmu/martial: no folder cmu/martial in TUTORIAL_DATA, and TUTORIAL_OFFLINE is set).\n"
    )


def test_load_first_without_own_data_does_not_speak_of_it(own, samples, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("TUTORIAL_DATA")
    data.load_first("cmu/boxing", "samples/walking", cache=tmp_path)
    assert "(not cmu/boxing: TUTORIAL_OFFLINE is set)" in capsys.readouterr().out


def test_load_first_passes_over_what_has_too_few_clips(own, samples, tmp_path, capsys):
    write_stick(own / "cmu/walking/1.bvh")
    motions = data.load_first("cmu/walking", "samples/walking", cache=tmp_path, at_least=2)
    assert motions[0].name == "samples/walking/01" and len(motions) >= 2
    assert "(not cmu/walking: 1 clips in TUTORIAL_DATA, expected at least 2)" in capsys.readouterr().out
    write_stick(own / "cmu/walking/2.bvh")
    assert len(data.load_first("cmu/walking", "samples/walking", cache=tmp_path, at_least=2)) == 2
    with pytest.raises(NotAtHand, match="cmu/walking: 2 clips in TUTORIAL_DATA, expected at least 3"):
        data.load_first("cmu/walking", cache=tmp_path, at_least=3)


def test_load_first_of_none(own, samples, tmp_path):
    with pytest.raises(NotAtHand, match="none is at hand: cmu/boxing: .*; samples/boxing: "):
        data.load_first("cmu/boxing", "samples/boxing", cache=tmp_path)
    with pytest.raises(DataError, match="at least one name"):
        data.load_first()
    with pytest.raises(DataError, match="unknown data set"):
        data.load_first("samples/walking", "samples/wlaking")


# -- listing -------------------------------------------------------------------------------------------------


def test_listing(own, samples, tmp_path):
    write_stick(own / "cmu/walking/1.bvh")
    (own / "cmu/salsa").mkdir()
    remote = data.entry("cmu/boxing").files
    for file in remote:
        (tmp_path / "cache" / file.name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "cache" / file.name).write_bytes(b"#" * 1000)
    rows = {row.name: row for row in data.listing(cache=tmp_path / "cache")}
    assert tuple(rows) == data.names()
    assert {name: (row.at_hand, row.clips) for name, row in rows.items()} == {
        "cmu/indian": ("to download", 6),
        "cmu/martial": ("to download", 7),
        "cmu/salsa": ("empty folder", 0),
        "cmu/walking": ("TUTORIAL_DATA", 1),
        "cmu/running": ("to download", 16),
        "cmu/boxing": ("cache", 3),
        "bandai-namco/locomotion": ("to download", 318),
        "samples/walking": ("data_samples", 2),
        "samples/running": ("missing", 0),
        "samples/boxing": ("missing", 0),
        "samples/dancing": ("missing", 0),
    }
    indian, boxing = rows["cmu/indian"], rows["cmu/boxing"]
    assert indian.minutes == pytest.approx(2.18, abs=0.01)
    assert indian.megabytes == pytest.approx(20.18, abs=0.01)
    assert boxing.minutes is None and boxing.megabytes == pytest.approx(0.003)
    assert rows["cmu/walking"].minutes == pytest.approx(4 * 0.05 / 60)  # four frames at 20 fps
    assert rows["samples/walking"].minutes == pytest.approx(2 * 4 * 0.05 / 60)
    assert rows["samples/running"].minutes is None and rows["cmu/salsa"].minutes is None
    assert rows["cmu/walking"].path == own / "cmu/walking" and indian.path == tmp_path / "cache/cmu/indian"
    assert "MIT" in indian.licence and "free for all uses" in indian.licence
    assert rows["bandai-namco/locomotion"].licence.startswith("CC BY-NC 4.0")


@pytest.mark.parametrize("wrong", [b"1.2.3", b".", b"x"])
def test_a_file_that_does_not_tell_its_length_leaves_out_the_minutes(own, samples, tmp_path, wrong):
    write_stick(own / "cmu/walking/1.bvh")
    write_stick(own / "cmu/walking/2.bvh")
    write_stick(own / "cmu/running/1.bvh")
    text = (own / "cmu/walking/2.bvh").read_bytes()
    (own / "cmu/walking/2.bvh").write_bytes(text.replace(b"Frame Time: 0.05", b"Frame Time: " + wrong))
    rows = {row.name: row for row in data.listing(cache=tmp_path / "cache")}
    assert rows["cmu/walking"].minutes is None and rows["cmu/walking"].clips == 2
    assert rows["cmu/running"].minutes == pytest.approx(4 * 0.05 / 60)


def test_a_file_that_cannot_be_opened_leaves_out_the_minutes(own, samples, tmp_path, monkeypatch):
    write_stick(own / "cmu/walking/1.bvh")

    def refuse(path, *_):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(catalog, "open", refuse, raising=False)  # root may read any file
    rows = {row.name: row for row in data.listing(cache=tmp_path / "cache")}
    assert rows["cmu/walking"].minutes is None and rows["cmu/walking"].clips == 1


# -- a root that never moves ---------------------------------------------------------------------------------


def rooted(travel):
    """Three frames; a root turned by 90 degrees, Hips that travel below it or stay at their offset, Head."""
    skeleton = Skeleton(("joint_Root", "Hips", "Head"), (-1, 0, 1), [[0, 0, 0], [5, 1, 0], [0, 0.7, 0]])
    rotations = np.tile([1.0, 0, 0, 0], (3, 3, 1))
    rotations[:, 0] = quat_about_y(np.float64(np.pi / 2))
    rotations[1, 1] = quat_about_y(np.float64(0.3))
    translations = np.tile(skeleton.offsets, (3, 1, 1))
    if travel:
        translations[:, 1] = [[0, 1, 0], [0, 1, 1], [0, 1, 2]]
    return Motion.from_rotations(skeleton, 30, np.zeros((3, 3)), rotations, translations, "m")


def test_static_root_goes_and_the_motion_stays():
    motion = rooted(travel=True)
    dropped = drop_static_root(motion)
    assert dropped.skeleton.names == ("Hips", "Head") and dropped.skeleton.parents == (-1, 0)
    # +z in the root's frame is +x in the world, once the root is turned by 90 degrees about y
    np.testing.assert_allclose(dropped.positions[2, 0], [2, 1, 0], atol=1e-12)
    assert np.array_equal(dropped.positions, motion.positions[:, 1:])
    again = dropped.skeleton.fk(dropped.rotations, dropped.positions[:, 0])
    np.testing.assert_allclose(again, motion.positions[:, 1:], atol=1e-12)
    np.testing.assert_allclose(dropped.rotations[1, 0], quat_about_y(np.float64(np.pi / 2 + 0.3)), atol=1e-12)


def test_other_roots_stay():
    still = rooted(travel=False)
    assert drop_static_root(still) is still
    bare = Motion(still.skeleton, 30, rooted(travel=True).positions)
    assert drop_static_root(bare) is bare


def test_nothing_is_read_on_import():
    """Neither the list of sources nor the environment: a wrong TUTORIAL_DATA shows when it is needed."""
    code = (
        "import os; os.environ['TUTORIAL_DATA'] = '/none'\n"
        "from tutorial_lib.data import catalog\n"
        "assert catalog._catalogue.cache_info().currsize == 0"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


# -- real clips ----------------------------------------------------------------------------------------------


@pytest.fixture
def real(real_data, monkeypatch, tmp_path):
    monkeypatch.setenv("TUTORIAL_DATA", str(real_data))
    monkeypatch.setenv("TUTORIAL_OFFLINE", "1")

    def load(name, **options):
        if not (real_data / data.entry(name).folder).is_dir():
            pytest.skip(f"no {name} in TUTORIAL_DATA")
        return data.load(name, cache=tmp_path, **options)

    return load


def test_real_indian_dance(real):
    motions = real("cmu/indian")
    published = {f"cmu/indian/{f.name.removesuffix('.bvh')}": f.frames for f in data.entry("cmu/indian").files}
    assert all(m.fps == pytest.approx(120, abs=0.01) for m in motions)
    assert {m.skeleton.n_joints for m in motions} == {57} and len({m.skeleton for m in motions}) == 1
    for motion in motions:
        assert motion.name.startswith("cmu/indian/") and motion.duration > 5
        assert len(motion) == published.get(motion.name, len(motion))
        assert 0.5 < motion.positions[:, 0, 1].mean() < 1.3  # hips, metres above the ground


def test_real_resampled(real):
    (recorded,), (motion,) = real("cmu/indian", limit=1), real("cmu/indian", limit=1, fps=30)
    assert motion.fps == 30 and motion.duration == pytest.approx(recorded.duration, abs=1 / 30)


def test_real_bandai_namco_has_hips_as_root(real):
    motions = real("bandai-namco/locomotion", limit=20)
    for motion in motions:
        assert motion.skeleton.names[0] == "Hips" and motion.fps == pytest.approx(30, abs=0.01)
        assert np.ptp(motion.positions[:, 0], axis=0).max() > 0.1
        assert 0.5 < np.median(motion.positions[:, 0, 1]) < 1.2
    assert len({m.skeleton for m in motions}) == 1


def test_real_walking(real):
    motions = real("cmu/walking", limit=10)
    assert motions and all(0.5 < np.median(m.positions[:, 0, 1]) < 1.3 for m in motions)
