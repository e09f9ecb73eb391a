"""reproduce side-by-side on the samples with tiny networks: one measure for all systems, and the table of it."""

from __future__ import annotations

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest
from findings import assert_only_wrong

from tutorial_lib import cli
from tutorial_lib.data import load
from tutorial_lib.data.windows import evaluation_places, evaluation_windows
from tutorial_lib.errors import CheckpointError, DataError, MotionError, TutorialError
from tutorial_lib.generate import generate_features, prepare
from tutorial_lib.metrics import PAPER_TIMES_MS
from tutorial_lib.motion.retarget import to_common
from tutorial_lib.recipes import Recipe
from tutorial_lib.representations import make_representation
from tutorial_lib.reproduce import side_by_side, side_by_side_measure, side_by_side_networks, sources
from tutorial_lib.reproduce.side_by_side_measure import blocks, errors_of, flaws_of, futures_of, root_speed
from tutorial_lib.reproduce.side_by_side_plan import DFN, QUICK, SYSTEMS, VAE, Budget, Plan, name_of
from tutorial_lib.reproduce.side_by_side_rollouts import control_for, go_on, motions_of, placed, windows_of
from tutorial_lib.reproduce.side_by_side_tables import COLUMNS
from tutorial_lib.training.checkpoints import load_checkpoint, read_header

SEED, HORIZON = QUICK["protocol"].seed_frames, 19  # 640 ms at 30 frames a second


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A quick result on the samples: the folder, what was told, and the result."""
    folder, told = tmp_path_factory.mktemp("side"), []
    result = side_by_side.reproduce("samples", runs=folder, jobs=1, quick=True, tell=told.append)
    return folder, told, result


@pytest.fixture(scope="module")
def walks():
    """The sample walks as the networks are trained on them."""
    return prepare([to_common(m) for m in load("samples/walking")], height=1.54)


# --- the plan -------------------------------------------------------------------------------------


def test_all_systems_have_the_same_but_their_own():
    runs = Plan(seeds=(0, 2)).runs()
    assert [name_of(run) for run in runs] == [*SYSTEMS, *SYSTEMS] and runs[-1].name == "aclstm-hip-seed2"
    for field in ("data", "joints", "height", "fps", "batch", "hidden", "learning_rate", "schedule", "clip",
                  "test_fraction", "pad", "join"):  # fmt: skip
        assert len({getattr(run.recipe, field) for run in runs}) == 1, f"the same {field} for every system"
    assert {name_of(run): run.recipe.representation for run in runs if run.recipe.representation != "positions"} == {
        "crbm": "hip-frame", VAE: "hip-frame", DFN: "body-frame", "lstm-hip": "hip-frame", "aclstm-hip": "hip-frame",
    }  # fmt: skip
    for name, row in SYSTEMS.items():  # the additional rows are the first two but for the representation
        if name.endswith("-hip"):
            other = SYSTEMS[name.removesuffix("-hip")]
            assert (row.system, row.share, row.options) == (other.system, other.share, other.options)


def test_plans_that_cannot_be():
    with pytest.raises(TutorialError, match="each once"):
        Plan(seeds=(1, 1))
    with pytest.raises(TutorialError, match="multiple of 4"):
        Plan(budget=Budget(length=58))


# --- one language ---------------------------------------------------------------------------------


def test_windows_are_those_of_every_other_evaluation(walks):
    windows = windows_of(walks, 40, 5)
    representation = make_representation("positions", walks[0].skeleton, 30.0)
    first, rest = evaluation_windows(
        prepare(walks, fps=30.0), representation, seed_frames=20, future_frames=20, count=5
    )
    both = np.concatenate([first, rest], 1)
    np.testing.assert_allclose(np.stack([representation.encode(w) for w in windows])[:, 1:], both[:, 1:], atol=1e-5)
    assert len(set(evaluation_places(prepare(walks, fps=30.0), 40, count=50))) == 50
    with pytest.raises(DataError, match="long enough"):
        evaluation_places(walks[:1], 10_000, count=1)


@pytest.mark.parametrize("name", ["positions", "hip-frame", "body-frame"])
def test_all_representations_say_the_same_in_the_common_language(walks, name):
    """A system that made exactly the truth would have no error, whatever it speaks."""
    windows = windows_of(walks, SEED + HORIZON, 3)
    representation = make_representation(name, windows[0].skeleton, 30.0)
    features = np.stack([representation.encode(w) for w in windows])
    again = placed(representation, features, [w[:SEED] for w in windows])
    np.testing.assert_allclose(again, np.stack([w.positions for w in windows]), atol=1e-4)


def test_a_network_goes_on_from_where_its_beginning_stands(made, walks):
    folder, _, _ = made
    starts = [w[:SEED].translate((3.0, 0.0, -2.0)) for w in windows_of(walks, SEED + HORIZON, 2)]
    for name in ("lstm", "crbm", DFN):
        checkpoint = load_checkpoint(folder / f"{name}.safetensors")
        positions = go_on(checkpoint, starts, 5)
        assert positions.shape == (2, SEED + 5, 21, 3)
        np.testing.assert_allclose(positions[:, :SEED], np.stack([s.positions for s in starts]), atol=1e-4)
    checkpoint = load_checkpoint(folder / "lstm.safetensors")
    first = checkpoint.representation.encode(starts[0])[None]
    step = generate_features(checkpoint, first, 1)[0, 0, :3]  # of the root
    made_step = go_on(checkpoint, starts[:1], 1)[0, SEED, 0] - starts[0].positions[-1, 0]
    np.testing.assert_allclose(made_step, step, atol=1e-5)


def test_one_that_follows_a_control_is_told_one(made, walks):
    folder, _, _ = made
    checkpoint = load_checkpoint(folder / f"{VAE}.safetensors")
    windows = windows_of(walks, SEED + HORIZON, 2)
    starts = [w[:SEED] for w in windows]
    control = control_for(windows, walks, 80)
    hip = make_representation("hip-frame", starts[0].skeleton, 30.0)
    own = np.stack([hip.encode(w)[:, hip.slices["control"]] for w in windows])
    assert control.shape == (2, 80, 3)
    np.testing.assert_array_equal(control[:, : SEED + HORIZON], own)
    assert 0.3 < control[:, SEED + HORIZON :, 1].mean() < 2.5, "afterwards people go on walking"
    assert not np.allclose(control[0, 45:], control[1, 45:]), "each from another place"
    assert go_on(checkpoint, starts, 60, control=control).shape == (2, 80, 21, 3)
    with pytest.raises(DataError, match="follows a control: expected \\(2, 30, 3\\), not none"):
        go_on(checkpoint, starts, 10)
    with pytest.raises(MotionError, match="expected one length"):
        go_on(checkpoint, [starts[0], starts[1][:5]], 10, control=control)


def test_motions_to_be_watched_end_where_they_are_no_longer_finite(walks):
    positions = np.stack([walks[0].positions[:50]] * 2)
    positions[1, 30:] = np.nan
    whole, cut = motions_of(positions, walks[0], ["a", "b"])
    assert (len(whole), len(cut), cut.name) == (50, 30, "b")


# --- measures -------------------------------------------------------------------------------------


def test_errors_are_centimetres_of_joints():
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(3, HORIZON, 21, 3))
    found = errors_of(truth + np.array([0.03, 0.0, 0.04]), truth, 30.0)
    np.testing.assert_allclose(found["error"], 5.0, rtol=1e-4)  # drawn aside by 5 cm
    np.testing.assert_allclose(found["pose_error"], 0.0, atol=1e-6)  # which the pose does not tell
    assert np.shape(found["errors"]) == (len(PAPER_TIMES_MS), 3)


def test_a_statue_that_glides(walks):
    """Bones as they were, and feet that slide as fast as it glides."""
    still = np.repeat(walks[0].resample(30.0).positions[None, :1], 91, axis=1)
    way = np.arange(91)[:, None, None] / 30 * np.array([0.3, 0.0, 0.0])
    found = flaws_of(still + way, walks[0].skeleton, 30.0)
    assert found["foot_slide"] == pytest.approx(30 * 3, rel=1e-3), "one step of three seconds"
    assert found["steps"] == 1.0 and found["bones"] == pytest.approx(0.0, abs=1e-9)
    flying = flaws_of(still + 10 * way, walks[0].skeleton, 30.0)  # too fast to stand
    assert flying["steps"] == 0.0 and np.isnan(flying["foot_slide"])
    assert root_speed(still + way, 30.0) == pytest.approx(0.3)
    grown = still * (1 + 0.1 * (np.arange(91) > 45)[:, None, None])
    assert flaws_of(grown, walks[0].skeleton, 30.0)["bones"] == pytest.approx(10 * 45 / 91, rel=1e-3)


def test_motion_change_by_three_seconds():
    change = np.repeat([[1.0, 2.0, 3.0]], 90, axis=0).T.reshape(1, -1)
    np.testing.assert_allclose(blocks(change), [[1.0, 2.0, 3.0]])
    np.testing.assert_allclose(blocks(change[:, :40]), [[1.0]])


def test_what_draws_has_many_futures_and_the_rest_one(made, walks):
    folder, _, result = made
    windows = windows_of(walks, SEED + HORIZON, 4)
    for name, run in result["runs"].items():
        futures = run["futures"]
        if not SYSTEMS[name].chance:
            assert max(futures["place"] + futures["pose"]) < 1e-3, f"{name} makes the same motion each time"
            assert futures["best"] == pytest.approx(futures["mean"], rel=1e-5)
            assert futures["mean"] == pytest.approx(run["error"][-1], rel=1e-3), "the error of the table"
        assert futures["best"] <= futures["mean"] + 1e-9
    checkpoint = load_checkpoint(folder / f"{DFN}.safetensors")
    with_chance = futures_of(checkpoint, windows, walks, QUICK["protocol"])
    assert max(with_chance["place"]) > 0


# --- the whole command ----------------------------------------------------------------------------


def test_the_result_is_whole_and_has_no_place_of_this_machine(made):
    folder, told, result = made
    text = (folder / "side_by_side.json").read_text(encoding="utf-8")
    assert result == json.loads(text) == side_by_side.load_result(folder / "side_by_side.json")
    assert "NaN" not in text and "Infinity" not in text and str(folder) not in text and len(text) < 100_000
    assert list(result["runs"]) == list(SYSTEMS) and result["data"] == "samples" and result["quick"] is True
    split = result["splits"]["seed 0"]
    assert not set(split["train"]) & set(split["test"])
    for name, run in result["runs"].items():
        assert Recipe.from_dict(run["recipe"]) == Plan(samples=True, **QUICK).recipe(name)
        assert read_header(folder / f"{name}.safetensors")["provenance"]["clips"] == split["train"]
        np.testing.assert_allclose(np.mean(run["errors"], axis=1), run["error"], rtol=1e-3)
        assert (run["paths"] is not None) == SYSTEMS[name].control
    assert any("the whole cost" in line for line in told) and told[-2].startswith("wrote")


def test_the_networks_beside_a_result_are_those_that_were_measured(made, walks):
    folder, told, result = made
    networks = side_by_side.load_networks(folder / "side_by_side")
    assert list(networks) == list(SYSTEMS) and told[-1].startswith("wrote 10 networks")
    test = [w for w in walks if w.name in result["splits"]["seed 0"]["test"]]
    windows = windows_of(test, SEED + HORIZON, QUICK["protocol"].seeds)
    truth = np.stack([w.positions for w in windows])[:, SEED:]
    for name in ("aclstm", DFN):
        size = (folder / "side_by_side" / f"{name}.safetensors").stat().st_size
        assert size < (folder / f"{name}.safetensors").stat().st_size
        assert networks[name].seed_frames is None, "no captured motion goes along"
        positions = go_on(networks[name], [w[:SEED] for w in windows], HORIZON)[:, SEED:]
        np.testing.assert_allclose(errors_of(positions, truth, 30.0)["error"], result["runs"][name]["error"], rtol=1e-3)
    assert networks[VAE].sway is not None, "so that it walks paths"
    with pytest.raises(DataError, match="no networks here, expected lstm.safetensors"):
        side_by_side.load_networks(folder / "nowhere")


def test_the_networks_are_of_the_first_seed_whatever_its_number(tmp_path, monkeypatch):
    written = []
    monkeypatch.setattr(side_by_side_networks, "load_checkpoint", lambda path: path)
    monkeypatch.setattr(
        side_by_side_networks,
        "rounded",
        lambda path: SimpleNamespace(
            system=path.stem, model=None, representation=None, normalizer=None, training={}, provenance={}, sway=None
        ),
    )
    monkeypatch.setattr(side_by_side_networks, "save_checkpoint", lambda path, system, **_: written.append(
        (path.name, system)))  # fmt: skip
    plan = Plan(seeds=(4, 2))
    result = {"runs": {run.name: {} for run in plan.runs()}}
    assert side_by_side_networks.write_networks(result, plan, tmp_path, tmp_path) == len(SYSTEMS)
    assert written == [(f"{name}.safetensors", f"{name}-seed2") for name in SYSTEMS]


def test_the_table_has_the_numbers_of_the_result(made):
    _, told, result = made
    tables = side_by_side.tables(result)
    rows, compared = tables["side by side"].groups.values()
    cells = {name: [text for text, _ in numbers] for name, _, numbers in rows}
    assert list(cells) == [row.title for row in SYSTEMS.values()]
    for label, row in SYSTEMS.items():
        run, shown = result["runs"][label], dict(zip(COLUMNS, cells[row.title], strict=True))
        numbers = {"80 ms, cm": run["error"][0], "640 ms, cm": run["error"][-1], "bones, %": run["flaws"]["bones"]}
        for name, value in numbers.items():  # large ones are told with a power of ten
            assert float(shown[name]) == pytest.approx(value, abs=0.051, rel=0.05), name
        assert (
            shown["steps"] == str(run["recipe"]["steps"]) and shown["weights, k"] == f"{run['parameters'] / 1000:.0f}"
        )
        assert int(shown["stops, %"]) + int(shown["leaves, %"]) == 100 * run["failures"]["count"] / 4
        assert (shown["off path, cm"] != "–") == (label == VAE)
    people = [text for name, _, numbers in compared if name == "people" for text, _ in numbers]
    assert people[COLUMNS.index("moves, %")] == "100" and people[0] == "–"
    for table in tables.values():
        assert all(line in told for line in str(table).splitlines())
    assert "SAMPLE MOTIONS" in tables["side by side"].caption and "QUICK" in tables["side by side"].caption
    shown = {"side by side", "errors", "pose errors", "standard errors", "long run", "failures", "futures", "paths"}
    assert set(tables) == shown


def test_findings_say_what_the_numbers_say(made):
    _, _, result = made
    best = json.loads(json.dumps(result))
    for name, run in best["runs"].items():
        run["error"] = [5.0, 6, 7, 8, 9, 10, 11, 12] if name != VAE else [6.0, 6, 6, 6, 6, 6, 6, 6]
        run["failures"]["first"] = [None] * 4 if name in ("aclstm", DFN) else [["freezing", 3.0]] * 4
        run["error"] = [0.4 * e for e in run["error"]] if name.endswith("-hip") else run["error"]
    best["runs"]["aclstm"]["error"] = [5.5, 6, 7, 7.5, 8, 9, 10, 11]
    best["runs"][VAE]["paths"]["circle"]["before"]["step_length"] = 0.6
    best["runs"][DFN]["futures"]["pose"][-1], best["runs"][DFN]["flaws"]["bones"] = 3.0, 1e-4
    best["runs"][VAE]["error"][-1] = 3.0
    best["runs"][DFN]["error"][0] = 5.8  # it draws and never fails, and is not among the best at first
    assert all(f.ours for f in side_by_side.findings(best)), [str(f) for f in side_by_side.findings(best)]
    exploded = json.loads(json.dumps(best))
    exploded["runs"]["lstm"]["error"] = [5.0, *[None] * 7]  # as wrong as can be
    assert all(f.ours for f in side_by_side.findings(exploded)), [str(f) for f in side_by_side.findings(exploded)]
    exploded["runs"]["lstm"]["error"][0] = None
    assert "LSTM-3LR nan" not in side_by_side.findings(exploded)[-1].evidence, "not among the least"
    best["runs"]["aclstm"]["error"][4] = 9.5
    best["runs"][DFN]["error"][0] = 1.0
    wrong = [f.claim for f in side_by_side.findings(best) if not f.ours]
    assert len(wrong) == 2 and "from 400 ms" in wrong[0] and wrong[1].startswith("No system")
    for name in ("aclstm", VAE, DFN):
        del best["runs"][name]
    assert all(f.ours is None for f in side_by_side.findings(best))
    assert side_by_side.tables(best)["side by side"].groups and "paths" not in side_by_side.tables(best)


def test_several_training_seeds_are_a_mean(made):
    _, _, result = made
    two = json.loads(json.dumps(result))
    two["budget"]["training_seeds"] = [0, 1]
    two["runs"]["erd-seed1"] = json.loads(json.dumps(result["runs"]["erd"]))
    two["runs"]["erd-seed1"]["flaws"]["bones"] = 50.0
    mine = result["runs"]["erd"]["flaws"]["bones"]
    assert side_by_side.value(two, "erd", "flaws", "bones") == pytest.approx((mine + 50) / 2)
    assert "mean of 1 to 2 training seeds" in side_by_side.tables(two)["side by side"].caption
    only = {**two, "runs": result["runs"]}
    assert "training seeds" not in side_by_side.tables(only)["side by side"].caption, "asked for, and not there"
    assert side_by_side.value(two, "nobody", "ms") is None


def test_a_run_that_is_not_finite_has_gaps_in_the_table(made):
    _, _, result = made
    broken = json.loads(json.dumps(result))
    run = broken["runs"]["seq2seq"]
    run["error"], run["flaws"], run["moves"] = (
        [1.0] + [None] * 7,
        {"foot_slide": None, "steps": 0.0, "bones": None},
        [None],
    )
    broken["runs"][VAE]["paths"]["circle"]["deviation"]["mean"] = None
    for split in broken["splits"].values():
        split["true"]["foot_slide"] = None  # nobody touches the ground
    rows, compared = side_by_side.tables(broken)["side by side"].groups.values()
    (people,) = ([text for text, _ in numbers] for name, _, numbers in compared if name == "people")
    assert people[COLUMNS.index("feet, cm")] == "–"
    told = next(f for f in side_by_side.findings(broken) if "goes where it is told" in f.claim)
    assert told.ours is False and told.evidence.startswith("nan cm off")
    (cells,) = ([text for text, _ in numbers] for name, _, numbers in rows if name == "seq2seq")
    assert cells[0] == "1.0" and cells[1:4] == ["–"] * 3 and cells[7:9] == ["–"] * 2


def test_a_clip_in_which_no_foot_touches_the_ground_leaves_the_others_mean(walks, monkeypatch):
    slides = iter([float("nan"), *range(1, len(walks))])
    monkeypatch.setattr(side_by_side_measure, "flaws_of", lambda *_: {"foot_slide": float(next(slides)), "bones": 0.0})
    truth = SimpleNamespace(to_dict=dict)
    split = side_by_side_measure.split_of(walks, walks, truth, QUICK["protocol"])
    assert split["true"]["foot_slide"] == pytest.approx(len(walks) / 2) and split["true"]["bones"] == 0


def test_called_again_it_trains_nothing(made):
    folder, _, result = made
    before = {path: path.stat().st_mtime_ns for path in folder.glob("*.safetensors")}
    (folder / "erd.safetensors").rename(folder / "away")
    again = side_by_side.reproduce("samples", runs=folder, out=folder / "again", jobs=1, quick=True,
                                   train_missing=False, tell=lambda line: None)  # fmt: skip
    (folder / "away").rename(folder / "erd.safetensors")
    assert {path: path.stat().st_mtime_ns for path in folder.glob("*.safetensors")} == before
    assert set(again["runs"]) == set(SYSTEMS) - {"erd"}
    for name, run in again["runs"].items():
        clock = {"ms": 0, "core_seconds": 0}
        assert {**run, **clock} == {**result["runs"][name], **clock}, "measured alike, but for the clock"


# --- bad input ------------------------------------------------------------------------------------


def test_without_captured_walks_the_samples_stand_in(tmp_path, monkeypatch):
    monkeypatch.setattr(sources, "at_hand", lambda name: False)
    told: list[str] = []
    with pytest.raises(DataError, match="none of the 10 runs is finished"):
        side_by_side.reproduce(runs=tmp_path, train_missing=False, tell=told.append)
    assert told == ["cmu/walking is not at hand, so the sample motions stand in for it"]


def test_a_folder_without_the_data(tmp_path, fails):
    told = fails("reproduce", "side-by-side", "--data", tmp_path, "--runs", tmp_path / "runs")
    assert f"not at hand in {tmp_path}: cmu/walking; expected" in told and "--data samples" in told
    assert not (tmp_path / "runs").exists()


def test_numbers_that_cannot_be(fails):
    assert "10 or more" in fails("reproduce", "side-by-side", "--steps", "3")


def test_runs_of_another_recipe_in_that_place(made, capsys):
    folder, _, _ = made
    command = ["reproduce", "side-by-side", "--data", "samples", "--quick", "--jobs", "1", "--runs", str(folder)]
    assert cli.main([*command, "--hidden", "5"]) == 2
    assert "lstm.safetensors: holds a run with hidden 8, asked for 5" in capsys.readouterr().err
    with pytest.raises(CheckpointError, match="asked for"):
        side_by_side.reproduce("samples", runs=folder, jobs=1, quick=True, budget={"batch": 5}, tell=lambda line: None)


def test_results_that_are_none(tmp_path, made):
    _, _, result = made
    (tmp_path / "x.json").write_text(json.dumps({**result, "schema": 99}), encoding="utf-8")
    with pytest.raises(DataError, match="expected paper 'side-by-side' and schema 1"):
        side_by_side.load_result(tmp_path / "x.json")
    with pytest.raises(DataError, match="reproduce side-by-side makes one"):
        side_by_side.load_result(tmp_path / "y.json")


def test_a_network_of_another_skeleton_is_refused(made, walks):
    folder, _, _ = made
    other = dataclasses.replace(walks[0][:SEED], fps=25.0)
    with pytest.raises(MotionError, match="25 frames per second"):
        go_on(load_checkpoint(folder / "lstm.safetensors"), [other], 5)


# --- what comes with the library ------------------------------------------------------------------


def test_the_committed_result_is_of_captured_motion_and_has_every_system():
    result, networks = side_by_side.load_result(), side_by_side.load_networks()
    assert result["data"] == "cmu" and result["quick"] is False and list(networks) == list(SYSTEMS)
    assert {run["label"] for run in result["runs"].values()} == set(SYSTEMS)
    assert all(f.ours is not None for f in side_by_side.findings(result))
    assert "SAMPLE" not in str(side_by_side.tables(result)["side by side"])
    for label, network in networks.items():
        run = result["runs"][label]
        assert (network.system, network.n_parameters) == (run["recipe"]["system"], run["parameters"])
        assert network.provenance["clips"] == result["splits"]["seed 0"]["train"]
        assert network.seed_frames is None, "no captured motion"
        assert run["recipe"] == Plan().recipe(label).to_dict(), "made by the plan as it stands"
    files = list(side_by_side_networks.NETWORKS.glob("*.safetensors"))
    assert sum(file.stat().st_size for file in files) < 6e6


def flattering() -> dict:
    """The committed result with numbers of which every finding is true."""
    result = side_by_side.load_result()
    for name, run in result["runs"].items():
        run["error"] = [6.0] * 8 if name == VAE else [5.0, 6, 7, 8, 9, 10, 11, 12]
        run["error"] = [0.4 * e for e in run["error"]] if name.endswith("-hip") else run["error"]
        failing = name not in ("aclstm", DFN)
        run["failures"]["first"] = [["freezing", 3.0] if failing else None] * len(run["failures"]["first"])
    runs = result["runs"]
    runs["aclstm"]["error"] = [5.5, 6, 7, 7.5, 8, 9, 10, 11]
    runs[VAE]["error"][-1] = 3.0
    for walked in runs[VAE]["paths"].values():
        walked["deviation"]["mean"], walked["before"]["step_length"] = 0.05, 0.6
    runs[DFN]["error"][0], runs[DFN]["flaws"]["bones"], runs[DFN]["futures"]["pose"][-1] = 5.8, 1e-4, 3.0
    return result


def fails(run: dict, count: int) -> None:
    first = run["failures"]["first"]
    run["failures"]["first"] = [["stuck", 1.0]] * count + [None] * (len(first) - count)


LEAST = "acRNN, figure 7"
NOBODY = "No system is among the three"


@pytest.mark.parametrize("change, claims", [
    (lambda r: None, []),
    (lambda r: r["aclstm"]["error"].__setitem__(4, 9.5), ["from 400 ms on"]),
    (lambda r: r["aclstm"]["error"].__setitem__(3, 9.5), []),
    (lambda r: (fails(r["aclstm"], 3), fails(r["erd"], 2)), [LEAST]),
    (lambda r: [fails(r[name], 0) for name in ("lstm", "erd", "seq2seq", "scheduled-sampling")], [LEAST]),
    (lambda r: r[VAE]["error"].__setitem__(0, 4.9), ["the systems that are shown the seed"]),
    (lambda r: r[VAE]["error"].__setitem__(7, 4.9), ["told where to go, it errs least"]),
    (lambda r: [w["deviation"].update(mean=0.11) for w in r[VAE]["paths"].values()], ["goes where it is told"]),
    (lambda r: r[VAE]["paths"]["circle"]["before"].update(step_length=0.49), ["goes where it is told"]),
    (lambda r: r[DFN]["futures"]["pose"].__setitem__(-1, 0.9), ["many futures"]),
    (lambda r: fails(r[DFN], 1), ["none of its motions"]),
    (lambda r: r[DFN]["flaws"].update(bones=0.011), ["bones keep their length"]),
    (lambda r: r["lstm-hip"]["error"].__setitem__(7, 6.1), ["half as much in the hip frame"]),
    (lambda r: r[DFN]["error"].__setitem__(0, 2.5), [NOBODY]),  # the third least
    (lambda r: (r[DFN]["error"].__setitem__(0, 2.5), fails(r[DFN], 1)), ["none of its motions"]),
])  # fmt: skip
def test_each_finding_hangs_on_its_own_numbers(change, claims):
    result = flattering()
    change(result["runs"])
    assert_only_wrong(side_by_side.findings(result), claims)
