"""reproduce dynamic-future-net on the samples with tiny networks: what it trains, measures, writes and says."""

from __future__ import annotations

import copy
import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest
from findings import assert_only_wrong

from tutorial_lib import cli, data
from tutorial_lib.data.windows import evaluation_windows
from tutorial_lib.errors import CheckpointError, DataError, TutorialError
from tutorial_lib.generate import prepare_for
from tutorial_lib.generate_futures import generate_futures
from tutorial_lib.motion.mirror import mirrored
from tutorial_lib.motion.retarget import to_common
from tutorial_lib.recipes import Recipe
from tutorial_lib.representations import BodyFrame
from tutorial_lib.reproduce import dynamic_future_net as dfn
from tutorial_lib.reproduce import dynamic_future_net_measure
from tutorial_lib.reproduce.dynamic_future_net_fan import data_fan, joints_of
from tutorial_lib.reproduce.dynamic_future_net_measure import copies, stability, truth_of
from tutorial_lib.reproduce.dynamic_future_net_plan import (
    ACLSTM,
    ACTIONS,
    JOINT,
    NETWORKS,
    NO_FUTURE,
    NO_TEMPORAL,
    QUICK,
    SHIPPED,
    VAE,
    Plan,
    Protocol,
    first_seconds,
    name_of,
    sets_for,
)
from tutorial_lib.reproduce.dynamic_future_net_tables import at_times, band_share, growth
from tutorial_lib.reproduce.grid import clips_for
from tutorial_lib.training.checkpoints import load_checkpoint, read_header

TRAINED = (JOINT, "dancing", "dancing, 7 s", ACLSTM, VAE)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A quick result on the samples: the folder, what was told, and the result."""
    folder, told = tmp_path_factory.mktemp("dfn"), []
    result = dfn.reproduce("samples", runs=folder, jobs=1, quick=True, networks=TRAINED, tell=told.append)
    return folder, told, result


# --- the plan -------------------------------------------------------------------------------------


def test_every_network_has_its_data_and_its_own_options():
    plan = Plan(samples=True)
    runs = {name_of(run): run.recipe for run in plan.runs()}
    assert set(runs) == set(NETWORKS) - {SHIPPED}, "the weights that come with the library are not trained here"
    for name, recipe in runs.items():
        assert recipe.data == tuple(f"samples/{action}" for action in NETWORKS[name].actions)
        assert (recipe.joints, recipe.height, recipe.fps) == ("common", 1.54, 30.0), "all are measured alike"
    assert runs[NO_FUTURE].options["future"] == 0 and runs[NO_TEMPORAL].options["temporal"] == 0
    own = {"options": None, "steps": None}
    for name in (NO_FUTURE, NO_TEMPORAL):
        same = {k: v for k, v in runs[name].to_dict().items() if k not in (*own, "future", "temporal")}
        assert same == {k: v for k, v in runs[JOINT].to_dict().items() if k in same}, "nothing else is cut"
        assert runs[name].steps == runs[JOINT].steps
    captured = Plan().recipe("running")
    assert captured.data == ("cmu/running",) and captured.join > 0 and runs["running"].join == 0
    assert Plan().published == "dfn-cmu" and plan.published == "dfn-samples" and Plan(quick=True).published is None


def test_limited_data_is_a_beginning_of_the_clips():
    run = next(run for run in Plan(samples=True).runs() if name_of(run) == "dancing, 20 s")
    ((train, test),) = sets_for(run)
    ((whole, kept_out),) = clips_for(run.recipe)
    assert sum(len(m) for m in train) == round(20 * train[0].fps) and test == kept_out
    np.testing.assert_array_equal(train[0].positions, whole[0].positions[: len(train[0])])
    assert "first" in train[0].name, "it is not taken for the whole clip"
    two = first_seconds(whole, whole[0].duration + 1)
    assert [len(m) for m in two] == [len(whole[0]), round(whole[1].fps)]


def test_plans_that_cannot_be():
    with pytest.raises(TutorialError, match="unknown network 'dancin'"):
        Plan(networks=("dancin",))
    with pytest.raises(TutorialError, match="no network to measure"):
        Plan(networks=())


# --- the whole command ----------------------------------------------------------------------------


def test_the_cost_is_told_before_anything_is_trained(made):
    _, told, _ = made
    whole = next(k for k, line in enumerate(told) if "the whole cost" in line)
    assert whole < next(k for k, line in enumerate(told) if "1 of 5 runs done" in line)


def test_the_result_is_whole_and_has_no_place_of_this_machine(made):
    folder, _, result = made
    text = (folder / "dynamic_future_net.json").read_text(encoding="utf-8")
    assert result == json.loads(text) == dfn.load_result(folder / "dynamic_future_net.json")
    assert "NaN" not in text and "Infinity" not in text and str(folder) not in text and len(text) < 150_000
    assert result["data"] == "samples" and result["quick"] is True and tuple(result["runs"]) == TRAINED
    for name, run in result["runs"].items():
        plan = Plan(samples=True, **QUICK)
        assert Recipe.from_dict(run["recipe"]) == plan.recipe(name)
    for figure in range(6, 10):
        assert (folder / f"dynamic_future_net-figure-{figure}.png").stat().st_size > 5000
    small = result["runs"]["dancing, 7 s"]
    assert small["train_seconds"] == pytest.approx(7, abs=0.1)
    header = read_header(folder / "dancing-7-s.safetensors")
    assert all("first" in name for name in header["provenance"]["clips"])


def test_the_fan_is_what_the_network_makes(made):
    """From the checkpoint anew, in the test's own arithmetic."""
    folder, _, result = made
    run, protocol = result["runs"]["dancing"], QUICK["protocol"]
    checkpoint = load_checkpoint(folder / "dancing.safetensors")
    ((_, test),) = clips_for(Plan(samples=True).recipe("dancing"))
    clips = prepare_for(checkpoint, test)
    prefix, _ = evaluation_windows(clips, checkpoint.representation, seed_frames=20, future_frames=0, count=1)
    futures = generate_futures(checkpoint, 32, prefix=prefix, count=16)
    poses = joints_of(checkpoint.representation, futures.features())
    mean = np.linalg.norm(poses - poses.mean(0), axis=-1).mean(0)
    np.testing.assert_allclose(at_times(result, run, "dancing", "band"), mean[[7, 31]], rtol=1e-3)
    assert band_share(result, run, "dancing") == pytest.approx(mean[31] / run["fan"]["data"][0], rel=1e-3)
    apart = [np.linalg.norm(a - b) for k, a in enumerate(poses[:, 31]) for b in poses[:k, 31]]
    assert at_times(result, run, "dancing")[1] == pytest.approx(np.mean(apart), rel=1e-3)
    world = np.stack([m.positions[20:] for m in futures])  # (16, 32, 21, 3): the same twenty frames in one place
    apart = [[np.linalg.norm(a - b) for k, a in enumerate(world[:, t]) for b in world[:k, t]] for t in (7, 31)]
    assert run["fan"]["prefixes"]["dancing"]["world"] == pytest.approx(np.mean(apart, axis=1), rel=1e-3)
    latent = result["runs"][JOINT]["fan"]["prefixes"]["walking"]["latent"]
    assert {len(points) for time in latent["z"].values() for points in [time]} == {protocol.points}
    assert run["fan"]["prefixes"]["dancing"].get("latent") is None, "only figures need it"


def test_what_can_be_known_beforehand(made):
    _, _, result = made
    runs = result["runs"]
    assert all(entry["pairwise"] == [0, 0] for entry in runs[ACLSTM]["fan"]["prefixes"].values()), "one future"
    assert all(min(entry["pairwise"]) > 0 for entry in runs[VAE]["fan"]["prefixes"].values())
    assert runs["dancing"]["transitions"] is None and runs[JOINT]["transitions"]["motions"] == 8
    for label in (JOINT, "dancing"):
        assert all(entry["bone_drift"] < 1e-4 for entry in runs[label]["stability"].values())
        assert all(entry["samples"] == 3 and entry["frames"] == 60 for entry in runs[label]["stability"].values())
    assert runs["dancing"]["copies"]["held_out"] == sorted(runs["dancing"]["copies"]["held_out"])
    assert set(runs[JOINT]["data"]) == set(ACTIONS)


def test_called_again_it_trains_nothing_and_finds_the_same(made, capsys):
    folder, _, result = made
    told = []
    again = dfn.reproduce("samples", runs=folder, jobs=1, quick=True, networks=("dancing",), train_missing=False,
                          tell=told.append)  # fmt: skip
    assert again["runs"]["dancing"] == result["runs"]["dancing"], "what was measured is kept, times and all"
    kept = json.loads((folder / "dancing.json").read_text())
    (folder / "dancing.json").write_text(json.dumps({**kept, "weights": "of another run"}))
    anew = dfn.reproduce("samples", runs=folder, jobs=1, quick=True, networks=("dancing",), train_missing=False,
                         tell=told.append)  # fmt: skip
    ((train, test),) = kept["clips"]
    assert train == read_header(folder / "dancing.safetensors")["provenance"]["clips"] and not set(test) & set(train)
    older = [{key: value for key, value in kept.items() if key != gone} for gone in ("clips", "measures")]
    for stale in ({**kept, "clips": [[train, ["another"]]]}, *older):
        (folder / "dancing.json").write_text(json.dumps({**stale, "entry": {"of": "other clips"}}))
        other = dfn.reproduce("samples", runs=folder, jobs=1, quick=True, networks=("dancing",), train_missing=False,
                              tell=told.append)  # fmt: skip
        assert other["runs"]["dancing"]["loss"] == result["runs"]["dancing"]["loss"], "measured anew"
    one, two = (copy.deepcopy(r["runs"]["dancing"]) for r in (result, anew))
    for run in (one, two):
        for entry in run["fan"]["prefixes"].values():
            entry.pop("seconds")
    assert one == two, "measured again it is the same but for the time that it took"
    with pytest.raises(CheckpointError, match="steps 4"):
        dfn.reproduce("samples", runs=folder, jobs=1, quick=True, networks=("dancing",), budget={"steps": 5},
                      tell=told.append)  # fmt: skip


def test_the_clips_themselves_are_followed():
    """Places of one periodic motion that begin alike stay together; of two motions they part."""

    class Clip:
        def __init__(self, frames):
            self.frames = frames

    class Plain:
        slices, fps = {"joints": slice(0, 3)}, 30.0

        def encode(self, clip):
            return clip.frames

        def decode_positions(self, features):
            """The body goes ahead by a tenth of its height every frame."""
            ahead = np.arange(features.shape[-2])[:, None] * features[..., 1:2] / 10
            return np.concatenate([features[..., :2], features[..., 2:] + ahead], -1)[..., None, :]

    t = np.arange(240)[:, None] / 20 * 2 * np.pi
    cycle = np.concatenate([np.sin(t), np.cos(t), 0 * t], 1).astype(np.float32)
    protocol = Protocol(prefix=20, fan_frames=40, at=(8, 40), similar=3)
    same = data_fan(Plain(), [Clip(cycle), Clip(cycle.copy()), Clip(cycle.copy())], protocol)
    assert same["alike"] < 1e-3 and max(same["pairwise"]) < 1e-3
    other = cycle.copy()
    other[120:] *= -1.0
    parted = data_fan(Plain(), [Clip(cycle), Clip(other)], protocol)
    assert parted["pairwise"][1] > 20 * same["pairwise"][1] + 0.02
    assert max(same["world"]) < 5e-3 and parted["world"][1] > 2 * parted["pairwise"][1], "places count in the world"
    assert data_fan(Plain(), [Clip(cycle[:50])], protocol) is None, "too short to be followed"


def as_trained(representation, **training):
    """What the measures ask of a checkpoint."""
    return SimpleNamespace(system="dynamic-future-net", representation=representation, training=training)


def test_of_windows_kept_out_each_action_counts_the_same():
    """However long its clips are: three quarters of the windows here are of boxing, half of the median is walking's."""
    walks, boxes = ([to_common(clip) for clip in data.load(f"samples/{name}")] for name in ("walking", "boxing"))
    representation = BodyFrame(walks[0].skeleton, walks[0].fps)
    protocol = dataclasses.replace(QUICK["protocol"], window=30)
    encode, shown = representation.encode, walks[:1]
    found = {}
    for names in (("walking",), ("boxing",), ("walking", "boxing")):
        kept_out = {"walking": [walks[1][:150]], "boxing": boxes[1:3]}
        found[names] = copies(as_trained(representation), {"walking": shown}, {n: kept_out[n] for n in names},
                              encode(walks[2])[None], protocol)  # fmt: skip
    walking, boxing = (found[(name,)]["held_out"] for name in ("walking", "boxing"))
    assert walking[2] < boxing[0], "windows of the one are all nearer than those of the other"
    both = found["walking", "boxing"]
    assert both["held_out"][0] == pytest.approx(walking[1], rel=1e-2)
    assert both["held_out"][2] == pytest.approx(boxing[1], rel=1e-2)
    assert both["generated"] == found[("walking",)]["generated"]


def test_a_mirror_image_that_a_network_was_shown_is_no_failure(monkeypatch):
    """Boxers with the other hand in front are out of the range of the clips, and not of what the network has seen."""
    boxes = [to_common(clip) for clip in data.load("samples/boxing")]
    representation = BodyFrame(boxes[0].skeleton, boxes[0].fps)
    changed = np.stack([representation.encode(mirrored(boxes[k])[:300]) for k in (3, 4)])
    monkeypatch.setattr(dynamic_future_net_measure, "generate_features", lambda *_: changed)
    protocol = dataclasses.replace(QUICK["protocol"], stable=2)
    sets = {"boxing": boxes[:3]}, {"boxing": boxes[3:]}
    for mirror, fail in ((False, 2), (True, 0)):
        checkpoint = as_trained(representation, mirror=mirror)
        found, _ = stability(checkpoint, truth_of(checkpoint, *sets), sets[1], protocol)
        assert found["boxing"]["count"] == fail, found["boxing"]["first"]


# --- what is said of it ---------------------------------------------------------------------------


def test_tables_and_findings_follow_the_numbers(made):
    _, told, result = made
    tables = dfn.tables(result)
    assert "QUICK TRIAL" in str(tables["diversity"]) and "24 futures" in "\n".join(told)
    found = {finding.claim: finding for finding in dfn.findings(result)}
    changes = next(f for claim, f in found.items() if "3 of 12 kinds" in claim and "shipped" not in claim)
    assert changes.ours is False
    better = copy.deepcopy(result)
    better["runs"][JOINT]["transitions"].update(kinds=5)
    for what in ("stability", "stability_short"):
        for entry in better["runs"]["dancing"][what].values():
            entry["count"] = 0
    better["runs"]["dancing"]["copies"].update(generated=[0.2] * 3, held_out=[0.1] * 3)
    fan = better["runs"]["dancing"]["fan"]
    entry = fan["prefixes"]["dancing"]
    entry["pairwise"] = np.linspace(0.1, 1.0, len(entry["pairwise"])).tolist()
    entry["world"] = [1.0, 2.1]
    entry["band"][0] = np.linspace(0.1, fan["data"][0], len(entry["band"][0])).tolist()
    said = {f.claim: f.ours for f in dfn.findings(better)}
    for claim, ours in said.items():
        if "3 of 12" in claim and "shipped" not in claim:
            assert ours is True
        if "counted too" in claim:
            assert ours is None, "8 frames are within the beginning's 20"
        elif claim.endswith("each action alone"):
            assert ours is True, claim
        if "shipped" in claim or "Without" in claim:
            assert ours is None, "not measured"


def test_what_is_not_finite_is_a_gap_and_no_finding(made):
    broken = copy.deepcopy(made[2])
    for label in (JOINT, "dancing", "dancing, 7 s"):
        run = broken["runs"][label]
        for action, entry in run["fan"]["prefixes"].items():
            entry["pairwise"] = [None] * len(entry["pairwise"])
            entry["world"] = [None, None]
            entry["band"][0] = [None] * len(entry["band"][0])
            entry["coverage"] = entry["own"]["coverage"] = entry["own"]["data"][0] = entry["seconds"] = None
            if run["data"].get(action) is not None:
                run["data"][action]["band"][-1] = None
        run["fan"]["data"][0] = None
        for entry in run["stability"].values():
            entry["bone_drift"] = entry["lowest"] = entry["foot_slide"]["generated"] = None
        run["copies"].update(generated=[None] * 3, held_out=[None] * 3)
    broken["runs"][JOINT]["transitions"]["accuracy"] = None
    broken["elsewhere"] = {action: [None] * 3 for action in ACTIONS}
    tables = dfn.tables(broken)
    assert set(tables) == set(dfn.tables(made[2])) and "right about nan %" in tables["transitions"].caption
    held = {f.claim: f.ours for f in dfn.findings(broken)}
    for claim in ("Bones keep their length to 1e-4", "4096 motions of 128 frames in 60 s"):
        assert held[claim] is False, claim
    beginnings = (
        "Nothing is copied",
        "Figure 9's",
        "The band",
        "Nor",
        "Section 6.3: div",
        "Futures",
        "The same of their poses",
    )
    assert not any(ours for claim, ours in held.items() if claim.startswith(beginnings))


def test_a_result_from_before_the_world_was_measured_is_read(made):
    older = copy.deepcopy(made[2])
    for run in (run for run in older["runs"].values() if "frames" in run["fan"]):
        for entry in (*run["fan"]["prefixes"].values(), *filter(None, run["data"].values())):
            del entry["world"]
    assert set(dfn.tables(made[2])) - set(dfn.tables(older)) == {"world"}
    assert {f.ours for f in dfn.findings(older) if "in the world" in f.claim} == {None}


def test_growth_counts_from_the_fork_or_from_the_beginning():
    """Between kept frames the distance is a straight line; the beginning's frames are before the first of them."""
    fan = {"frames": [4, 8, 12, 16], "prefixes": {"walking": {"pairwise": [1.0, 2.0, 4.0, 8.0]}}}
    result = {"protocol": {"at": (8, 16)}}
    assert growth(result, {"fan": fan}, "walking") == pytest.approx(8 / 2)
    assert growth(result, {"fan": fan}, "walking", given=2) == pytest.approx(6 / 1.5)
    assert growth(result, {"fan": fan}, "walking", given=4) == pytest.approx(4 / 1)


def test_one_wild_frame_does_not_make_figure_6_small(made):
    result = copy.deepcopy(made[2])
    wide = np.ptp(dfn.figure_6(result).axes[0].get_xlim())
    run = next(run for run in (result["runs"].get(name) for name in ("shipped", "joint")) if run)
    next(iter(run["paths"]["clips"].values()))[0] = [1000.0, 0.0]
    assert np.ptp(dfn.figure_6(result).axes[0].get_xlim()) < 2 * wide


def test_figures_of_what_is_not_there_are_none(made):
    _, _, result = made
    without = {**result, "runs": {"dancing": result["runs"]["dancing"]}}
    assert [draw(without) for draw in (dfn.figure_6, dfn.figure_7, dfn.figure_8)] == [None] * 3
    assert len(dfn.figure_9(without).axes) == 1 and len(dfn.figure_9(result).axes) == 4
    assert len(dfn.figure_8(result).axes) == 8


def test_the_command_line_reaches_it(tmp_path, monkeypatch, capsys):
    seen = {}
    monkeypatch.setattr(dfn, "reproduce", lambda *args, **kwargs: seen.update(args=args, **kwargs))
    arguments = ["reproduce", "dynamic-future-net", "--data", "samples", "--steps", "30", "--quick", "--jobs", "1"]
    assert cli.main([*arguments, "--runs", str(tmp_path)]) == 0
    assert seen["args"] == ("samples",) and seen["budget"] == {"steps": 30} and seen["quick"] and seen["jobs"] == 1
    with pytest.raises(SystemExit):
        cli.main(["reproduce", "dynamic-future-net", "--tune"])  # it has no rates to choose


def test_data_that_is_not_there(tmp_path):
    with pytest.raises(DataError, match="cmu/walking"):
        dfn.reproduce(str(tmp_path), runs=tmp_path / "runs", tell=lambda line: None)
    with pytest.raises(DataError, match="wrong: no such folder, expected one that holds cmu/walking, cmu/running"):
        dfn.reproduce(str(tmp_path / "wrong"), runs=tmp_path / "runs", tell=lambda line: None)
    with pytest.raises(DataError, match="reproduce dynamic-future-net makes one"):
        dfn.load_result(tmp_path / "none.json")


def flattering() -> dict:
    """The committed result with numbers of which every finding is true."""
    result = dfn.load_result()
    for label, run in result["runs"].items():
        if label in (ACLSTM, VAE):
            continue
        fan = run["fan"]
        fan["data"] = [1.0, 0.1]
        for entry in fan["prefixes"].values():
            entry["pairwise"] = np.linspace(0.1, 1.0, len(fan["frames"])).tolist()
            entry["band"][0] = np.linspace(0.1, 1.0, len(fan["frames"])).tolist()
            entry["own"] = {**entry["own"], "data": [1.0, 0.1]}
            entry["seconds"], entry["world"] = 10.0, [1.0, 2.5]
        for entry in (*run["stability"].values(), *run["stability_short"].values()):
            entry["count"], entry["bone_drift"] = 0, 1e-5
        run["copies"].update(generated=[0.1, 0.3, 0.5], held_out=[0.1, 0.2, 0.6])
        run["data"] = {action: data and {**data, "band": [1.0, 1.0]} for action, data in run["data"].items()}
        if run["transitions"]:
            run["transitions"]["kinds"] = 3
    result["elsewhere"] = {action: [0.1, 0.2, 0.6] for action in ACTIONS}
    for label, part in (("dancing, 20 s", 0.8), ("dancing, 7 s", 0.6), (NO_FUTURE, 0.8), (NO_TEMPORAL, 0.8)):
        for entry in result["runs"][label]["fan"]["prefixes"].values():
            entry["pairwise"] = [part * x for x in entry["pairwise"]]
    for entry in result["runs"][ACLSTM]["fan"]["prefixes"].values():
        entry["pairwise"] = [0.0] * len(entry["pairwise"])
    return result


def of(result: dict, label: str, action: str = "dancing") -> dict:
    return result["runs"][label]["fan"]["prefixes"][action]


FIGURE_9, GROWS, PLACED = "Figure 9's band at frame 128", "wherever they stand", "twice as far apart at frame 128"
ALL_DATA = "The same of all data of all actions"


@pytest.mark.parametrize("change, claims", [
    (lambda r: None, []),
    (lambda r: r["runs"]["dancing"]["stability"]["dancing"].update(count=1), ["of 20 stay stable: each action alone"]),
    (lambda r: r["runs"][JOINT]["stability"]["boxing"].update(count=1), ["of 20 stay stable: all together"]),
    (lambda r: r["runs"][JOINT]["stability_short"]["boxing"].update(count=1), ["of 8 stay stable: all together"]),
    (lambda r: r["runs"]["dancing, 7 s"]["stability"]["dancing"].update(count=1), ["stable trained on 7 s"]),
    (lambda r: r["runs"][SHIPPED]["stability"]["boxing"].update(bone_drift=2e-4), ["Bones keep their length"]),
    (lambda r: of(r, "walking", "walking").update(world=[1.0, 1.9]), [PLACED]),
    (lambda r: of(r, "walking", "walking").update(pairwise=[1.0] * 32), ["diversity increases", GROWS, "counted too"]),
    # 1.9 times, and 2.3 times where the first 20 frames count
    (lambda r: of(r, "walking", "walking").update(pairwise=np.linspace(0.4, 1.0, 32).tolist()), [GROWS]),
    (lambda r: of(r, "walking", "walking").update(pairwise=np.linspace(0.8, 1.0, 32).tolist()), [GROWS, "counted too"]),
    (lambda r: of(r, "running", "running")["own"].update(data=[1.3, 0.1]), [FIGURE_9]),
    (lambda r: of(r, "running", "running")["own"].update(data=[0.8, 0.1]), [FIGURE_9]),
    (lambda r: r["runs"][JOINT]["fan"].update(data=[1.3, 0.1]), [ALL_DATA]),
    (lambda r: r["runs"]["boxing"]["data"]["boxing"].update(band=[1.0, 1.3]), ["at least 80 % as much"]),
    (lambda r: r["runs"][JOINT]["transitions"].update(kinds=2), ["at least 3 of 12 kinds): all together"]),
    (lambda r: r["runs"][JOINT]["copies"].update(generated=[0.3, 0.19, 0.7]), ["at the median: all together"]),
    (lambda r: r["elsewhere"].update(boxing=[0.1, 0.4, 0.4]), ["Nor nearer than windows"]),
    (lambda r: of(r, JOINT).update(seconds=61.0), ["4096 motions"]),
    (lambda r: of(r, JOINT).update(seconds=31.0, motions=2048), ["4096 motions"]),
    (lambda r: of(r, "dancing, 20 s").update(pairwise=[0.97] * 32), ["less data, less diversity"]),
    (lambda r: r["runs"].pop("dancing, 20 s"), ["stable trained on 7 s", "less data, less diversity"]),
    (lambda r: [of(r, NO_FUTURE, a).update(pairwise=[0.97] * 32) for a in ACTIONS], ["Without the future state"]),
    (lambda r: of(r, ACLSTM, "boxing").update(pairwise=[0.0, 1e-3]), ["a deterministic network"]),
])  # fmt: skip
def test_each_finding_hangs_on_its_own_numbers(change, claims):
    result = flattering()
    change(result)
    assert_only_wrong(dfn.findings(result), claims)
