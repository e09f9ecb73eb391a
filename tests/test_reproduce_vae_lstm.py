"""reproduce vae-lstm on the samples with tiny networks: what it trains, measures, writes and says."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from findings import assert_only_wrong

from tutorial_lib import cli
from tutorial_lib.cleanup import clean_up
from tutorial_lib.clip_errors import PAPER_FRAMES
from tutorial_lib.data.windows import evaluation_windows
from tutorial_lib.errors import CheckpointError, DataError, TutorialError
from tutorial_lib.evaluate_control import gait_of
from tutorial_lib.generate import generate_features
from tutorial_lib.generate_control import features_from_code, generate_control_features, generate_from_control
from tutorial_lib.models.vae_lstm import VAELSTM
from tutorial_lib.recipes import Recipe, sets_of
from tutorial_lib.reproduce import sources, vae_lstm
from tutorial_lib.reproduce.published import VAE_LSTM_TABLE_1, VAE_LSTM_TABLE_2
from tutorial_lib.reproduce.vae_lstm_measure import GIVEN, PER_STEP, POSTERIOR, PREDICTED, PRIOR
from tutorial_lib.reproduce.vae_lstm_plan import BASELINES, QUICK, SYSTEMS, VAE, Budget, Plan, name_of
from tutorial_lib.training.checkpoints import load_checkpoint, read_header

AT = [35, 45, 60, 80, 105]  # the paper's frames at 30 per second, from 1


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A quick result on the samples: the folder, what was told, and the result."""
    folder, told = tmp_path_factory.mktemp("vae"), []
    result = vae_lstm.reproduce("samples", runs=folder, jobs=1, quick=True, tell=told.append)
    return folder, told, result


@pytest.fixture(scope="module")
def truth():
    """The test windows of the quick result, (4, 120, 66), as the test takes them from the clips itself."""
    test = [motion for _, clips in sets_of(Plan(samples=True).recipe(VAE)) for motion in clips]
    from tutorial_lib.representations import make_representation

    representation = make_representation("hip-frame", test[0].skeleton, 30.0)
    first, rest = evaluation_windows([m.resample(30.0) for m in test], representation, seed_frames=4,
                                     future_frames=116, count=QUICK["protocol"].clips)  # fmt: skip
    return representation, np.concatenate([first, rest], 1)


# --- the plan -------------------------------------------------------------------------------------


def test_all_systems_have_the_same_but_their_own():
    runs = Plan(seeds=(0, 2)).runs()
    assert [run.name for run in runs[:5]] == [VAE, *BASELINES] and runs[5].name == "vae-lstm-seed2"
    assert [name_of(run) for run in runs[5:]] == [VAE, *BASELINES]
    for field in ("data", "representation", "joints", "height", "length", "batch", "pad", "rotate", "normalize",
                  "hidden", "schedule", "clip", "learning_rate", "test_fraction", "fps"):  # fmt: skip
        assert len({getattr(run.recipe, field) for run in runs}) == 1, f"the same {field} for every system"
    steps = {name_of(run): run.recipe.steps for run in runs}
    assert min(steps.values()) == steps[VAE] == Budget().steps, "no baseline sees fewer windows"
    assert {name_of(run): run.recipe.options["cd"] for run in runs if run.recipe.system == "crbm"} == {
        "crbm-cd1": 1, "crbm-cd15": 15,
    }  # fmt: skip


def test_plans_that_cannot_be():
    with pytest.raises(TutorialError, match="each once"):
        Plan(seeds=(1, 1))
    with pytest.raises(TutorialError, match="multiple of 4"):
        Plan(budget=Budget(length=122))


# --- the whole command ----------------------------------------------------------------------------


def test_the_cost_is_told_before_anything_is_trained(made):
    _, told, _ = made
    whole = next(k for k, line in enumerate(told) if "the whole cost" in line)
    assert whole < next(k for k, line in enumerate(told) if "1 of 5 runs done" in line)
    left = {" ".join(line.split()[:1]): int(line.split()[2]) for line in told[2:whole]}
    assert left == {name: 2 * row.steps for name, row in SYSTEMS.items()}


def test_the_result_is_whole_and_has_no_place_of_this_machine(made):
    folder, _, result = made
    text = (folder / "vae_lstm.json").read_text(encoding="utf-8")
    assert result == json.loads(text) == vae_lstm.load_result(folder / "vae_lstm.json")
    assert "NaN" not in text and "Infinity" not in text and str(folder) not in text and len(text) < 150_000
    assert result["data"] == "samples" and result["quick"] is True and set(result["runs"]) == set(SYSTEMS)
    split = result["splits"]["seed 0"]
    assert not set(split["train"]) & set(split["test"])
    for name, run in result["runs"].items():
        assert Recipe.from_dict(run["recipe"]) == Plan(samples=True, **QUICK).recipe(name)
        assert read_header(folder / f"{name}.safetensors")["provenance"]["clips"] == split["train"]
        for way in run["ways"].values():
            assert np.shape(way["curve"]) == (120,)
            for kind in ("pose", "motion", "motion_given"):
                each = np.array(way[kind]["clips"])  # (clips, 5)
                np.testing.assert_allclose(each.mean(0), way[kind]["error"], rtol=1e-3)
                spread = each.std(0, ddof=1) / np.sqrt(len(each))
                np.testing.assert_allclose(spread, way[kind]["standard_error"], rtol=0.02, atol=1e-6)
                # the mean of squares is no less than the square of the mean
                assert (np.array(way[kind]["squared"]) >= np.square(way[kind]["error"]) * 0.999).all()
    for figure in ("figure-3", "figure-4"):
        assert (folder / f"vae_lstm-{figure}.png").stat().st_size > 5000


def test_the_errors_are_those_of_what_the_networks_make(made, truth):
    """From the checkpoints anew, in the test's own arithmetic: poses in the body's frame at the paper's frames."""
    folder, _, result = made
    representation, true = truth
    joints, control = representation.slices["joints"], representation.slices["control"]

    def distance(features):  # of joints in the body's own frame, mean over clips and joints, at the paper's times
        gap = (features - true)[..., joints].reshape(*true.shape[:2], -1, 3)
        return np.linalg.norm(gap, axis=-1).mean((0, 2))[[k - 1 for k in AT]]

    for name in ("erd", "crbm-cd1"):
        checkpoint = load_checkpoint(folder / f"{name}.safetensors")
        rest = generate_features(checkpoint, true[:, :4], 116, given={"control": true[:, 4:, control]})
        pose = result["runs"][name]["ways"][GIVEN]["pose"]["error"]
        np.testing.assert_allclose(distance(np.concatenate([true[:, :4], rest], 1)), pose, rtol=1e-3)
        assert result["runs"][name]["ways"][GIVEN]["curve"][:4] == [0.0] * 4
        assert result["runs"][name]["ways"][PREDICTED]["curve"][:30] == [0.0] * 30
    checkpoint = load_checkpoint(folder / "vae-lstm.safetensors")
    prior = generate_control_features(checkpoint, true[..., control])
    own = result["runs"][VAE]["ways"]
    np.testing.assert_allclose(distance(prior), own[PRIOR]["pose"]["error"], rtol=1e-3)
    # moved by the true control, a prior sample is what the library generates
    motions = generate_from_control(checkpoint, true[..., control])
    world = np.stack([m.positions for m in motions]) - np.stack([representation.decode(x).positions for x in true])
    moved = np.linalg.norm(world, axis=-1).mean((0, 2))[[k - 1 for k in AT]]
    np.testing.assert_allclose(moved, own[PRIOR]["motion_given"]["error"], rtol=1e-3)
    np.testing.assert_allclose(distance(prior), moved, rtol=1e-3)  # the same root: only the pose can differ
    assert own[POSTERIOR]["curve"][:4] != own[PRIOR]["curve"][:4]
    # references: the mean of all training frames, and the last frame that was shown
    train = [m for clips, _ in sets_of(Plan(samples=True).recipe(VAE)) for m in clips]
    mean = np.concatenate([representation.encode(m.resample(30.0)) for m in train]).mean(0)
    held = {k: ways[w]["pose"]["error"] for k, ways in result["splits"]["seed 0"]["references"].items() for w in ways
            if (k, w) in (("mean pose", GIVEN), ("last pose", PREDICTED))}  # fmt: skip
    np.testing.assert_allclose(distance(np.broadcast_to(mean, true.shape)), held["mean pose"], rtol=1e-3)
    last = np.broadcast_to(true[:, 29:30], true.shape)
    np.testing.assert_allclose(distance(last), held["last pose"], rtol=1e-3)


def test_the_tables_have_the_papers_numbers_beside_ours(made):
    _, told, result = made
    tables = vae_lstm.tables(result)
    assert result["protocol"]["at"] == list(PAPER_FRAMES)
    for number, published, kind in ((1, VAE_LSTM_TABLE_1, "motion"), (2, VAE_LSTM_TABLE_2, "pose")):
        (group,) = tables[f"table {number}"].groups.values()
        for row, numbers in published.items():
            label = "VAE-LSTM (prior sample)" if row == "vae-lstm-prior" else SYSTEMS[row].title
            cells = {who: cells for name, who, cells in group if name == label}
            assert [text for text, _ in cells["paper"]] == [f"{x:.2f}" for x in numbers]
            own = {VAE: POSTERIOR, "vae-lstm-prior": PRIOR}.get(row, PREDICTED if number == 1 else GIVEN)
            squared = result["runs"][row.removesuffix("-prior")]["ways"][own][kind]["squared"]
            np.testing.assert_allclose([float(text) for text, _ in cells["ours"]], 1e4 * np.array(squared), atol=0.006)
    for table in tables.values():
        assert all(line in told for line in str(table).splitlines())
    assert "SAMPLE MOTIONS" in tables["table 1"].caption and "QUICK" in tables["table 2"].caption


def test_findings_say_what_the_numbers_say(made):
    _, _, result = made
    better = json.loads(json.dumps(result))
    for name, run in better["runs"].items():
        for way in run["ways"].values():
            for kind, grows in (("pose", [1, 1, 1, 1, 1]), ("motion", [0.5, 1, 2, 4, 8])):
                size = np.ones(5) if name == VAE else 2.5 * np.array(grows)
                way[kind]["error"], way[kind]["squared"] = (0.01 * size).tolist(), (1e-4 * size**2).tolist()
    found = {f.claim: f.ours for f in vae_lstm.findings(better)}
    assert all(ours for claim, ours in found.items() if claim.startswith("Table") and "frame 70 the" not in claim)
    assert found["Pose error (mean distance) at every time at least 2 times below the best baseline with true control"]
    assert found["Motion error (mean squared) at frame 210 at least 3 times below the best baseline without"]
    assert found["Prior samples (mean squared) within 1.5 times of posterior ones, in both tables at all times"]
    assert not found["Table 1: at frame 70 the baselines, shown 60 frames, err less than the VAE-LSTM"]
    assert found["Table 1: at frame 90 already the VAE-LSTM errs less than every baseline"]
    later = json.loads(json.dumps(better))
    for way in later["runs"]["erd"]["ways"].values():  # one baseline keeps its lead a little longer
        way["motion"]["squared"][1] = 0.9e-4
    told = {f.claim: f.ours for f in vae_lstm.findings(later)}
    assert [claim for claim in found if told[claim] != found[claim]] == [
        "Table 1: at frame 90 already the VAE-LSTM errs less than every baseline"
    ]
    exploded = json.loads(json.dumps(better))
    for way in exploded["runs"]["lstm"]["ways"].values():  # as wrong as can be, so its error grew most
        way["motion"]["squared"][-1] = None
    assert {f.claim: f.ours for f in vae_lstm.findings(exploded)} == found
    for way in exploded["runs"][VAE]["ways"].values():
        way["motion"]["squared"] = [None] * 5
    worst = {f.claim: f.ours for f in vae_lstm.findings(exploded)}
    assert worst["Table 1: at frame 70 the baselines, shown 60 frames, err less than the VAE-LSTM"]
    assert not any(ours for claim, ours in worst.items() if claim.startswith("Table 1: from frame"))
    for way in better["runs"]["crbm-cd1"]["ways"].values():  # one baseline a little better, at one time
        way["pose"]["squared"][2] = 1.5e-4
    found = {f.claim: f.ours for f in vae_lstm.findings(better)}
    assert found["Table 2: given the true control, the VAE-LSTM errs less than every baseline at all times"]
    assert not found[
        "Pose error (mean squared) at every time at least 2 times below the best baseline with true control"
    ]
    better["beyond"]["seed 0"]["speed"]["ms"] = {"1": 3.0, "5": 12.5}
    assert not {f.claim: f.ours for f in vae_lstm.findings(better)}["5 at once cost at most 4 times what one does"]
    del better["runs"]["lstm"]
    better["beyond"] = {}
    assert not [f for f in vae_lstm.findings(better) if f.ours is not None and "Section 3.3" not in f.claim]
    assert vae_lstm.tables(better)["table 1"].groups  # a missing run leaves the paper's row alone


def test_true_feet_that_never_touch_the_ground_leave_a_gap(made):
    broken = json.loads(json.dumps(made[2]))
    for split in broken["splits"].values():
        split["foot_skate"] = None
    rows = vae_lstm.tables(broken)["feet"].groups["speed of feet that stand"]
    assert [cells[-1][0] for name, _, cells in rows if name == "true motion"] == ["–"]


def test_several_training_seeds_are_a_mean(made):
    _, _, result = made
    two = json.loads(json.dumps(result))
    two["budget"]["training_seeds"] = [0, 1]
    two["runs"]["erd-seed1"] = json.loads(json.dumps(result["runs"]["erd"]))
    two["runs"]["erd-seed1"]["ways"][GIVEN]["pose"]["error"] = [1.0] * 5
    mine = np.array(result["runs"]["erd"]["ways"][GIVEN]["pose"]["error"])
    np.testing.assert_allclose(vae_lstm.error(two, "erd", GIVEN), (mine + 1) / 2)
    assert "mean of 1 to 2 training seeds" in vae_lstm.tables(two)["table 1"].caption
    only = {**two, "runs": result["runs"]}
    assert "training seeds" not in vae_lstm.tables(only)["table 1"].caption, "asked for, and not there"
    assert vae_lstm.error(two, "seq2seq", GIVEN) is None


def test_called_again_it_trains_nothing(made):
    folder, _, result = made
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*.safetensors")}
    (folder / "erd.safetensors").rename(folder / "away")
    again = vae_lstm.reproduce("samples", runs=folder, out=folder / "again", jobs=1, quick=True, train_missing=False,
                               tell=lambda line: None)  # fmt: skip
    (folder / "away").rename(folder / "erd.safetensors")
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*.safetensors")} == before
    assert set(again["runs"]) == set(SYSTEMS) - {"erd"}
    for name, run in again["runs"].items():
        assert run == result["runs"][name], "measured alike"
    assert again["beyond"]["seed 0"]["paths"] == result["beyond"]["seed 0"]["paths"]


# --- what the paper has not -----------------------------------------------------------------------


def test_samples_and_lines_between_codes(made, truth):
    folder, _, result = made
    representation, true = truth
    more, control = result["beyond"]["seed 0"], true[0, :, representation.slices["control"]]
    checkpoint = load_checkpoint(folder / "vae-lstm.safetensors")
    many = np.broadcast_to(control, (5, *control.shape))
    made_features = generate_control_features(checkpoint, many, codes="held")[..., representation.slices["joints"]]
    x = made_features.reshape(5, 120, -1, 3)
    pairs = [np.linalg.norm(x[a] - x[b], axis=-1).mean(-1) for a in range(5) for b in range(a)]
    np.testing.assert_allclose(
        more["diversity"]["codes"]["held"]["given"], np.mean(pairs, 0)[[k - 1 for k in AT]], rtol=1e-3
    )
    for line in more["interpolation"]["codes"].values():
        assert line["length"] >= 1 - 1e-6 and line["largest"] >= 1 - 1e-6 and len(line["change"]) == 2
    model: VAELSTM = checkpoint.model
    code = np.zeros((2, model.config.hidden), np.float32)
    import torch

    both = features_from_code(checkpoint, many[:2], torch.from_numpy(code))
    np.testing.assert_array_equal(both[0], both[1])


def test_paths_are_gone_along(made):
    _, _, result = made
    for name, walked in result["beyond"]["seed 0"]["paths"].items():
        off = walked["deviation"]
        assert off["mean"] < 0.1 and off["covered"] == 1.0, f"{name}: it moves as it was told"
        assert off["predicted"] > off["mean"], "tiny networks know nothing of where they go"


def test_steps_are_those_of_the_windows(made, truth):
    """Of true motion, by the library's one measure; tiny networks make none, and that is told as None."""
    representation, true = truth
    _, _, result = made
    found = result["beyond"]["seed 0"]["steps"]
    motions = [representation.decode(x) for x in true]
    assert found["true"]["before"] == pytest.approx(gait_of(motions), rel=1e-3)
    assert found["true"]["after"]["slide"] == pytest.approx(gait_of([clean_up(m) for m in motions])["slide"], rel=1e-2)
    assert found["made"]["before"]["step_length"] is None or found["made"]["before"]["step_length"] < 1.0


# --- learning rates -------------------------------------------------------------------------------


def test_rates_are_chosen_on_clips_that_are_neither_trained_on_nor_tested(tmp_path, monkeypatch):
    monkeypatch.setattr(vae_lstm, "RATES_TRIED", (1e-9, 5e-3))
    monkeypatch.setattr(vae_lstm, "SYSTEMS", {name: SYSTEMS[name] for name in ("lstm", VAE)})
    plan = Plan(samples=True, **{**QUICK, "budget": dataclasses.replace(QUICK["budget"], steps=15)})
    chosen, record = vae_lstm.tune(plan, tmp_path, jobs=1, tell=lambda line: None)
    assert record["steps"] == {"lstm": 30, VAE: 15} and set(record["chosen"]) == {"lstm", VAE}
    for system in record["chosen"]:
        ((low, high),) = record["error"][system].values()
        assert chosen.rates[system] == (1e-9 if low < high else 5e-3)
    header = read_header(tmp_path / "tuning" / "vae-lstm-0.005.safetensors")
    assert header["training"]["steps_done"] == 15
    sets = sets_of(plan.recipe(VAE))
    trained, aside = header["provenance"]["clips"], header["provenance"]["test_clips"]
    assert sorted(trained + aside) == sorted(m.name for train, _ in sets for m in train)
    assert len({name.split("/")[1] for name in aside}) == 2, "of each data set"
    assert not {m.name for _, test in sets for m in test} & {*trained, *aside}


# --- bad input ------------------------------------------------------------------------------------


def test_without_the_papers_kind_of_data_the_samples_stand_in(tmp_path, monkeypatch):
    monkeypatch.setattr(sources, "at_hand", lambda name: False)
    told: list[str] = []
    with pytest.raises(DataError, match="none of the 5 runs is finished"):
        vae_lstm.reproduce(runs=tmp_path, train_missing=False, tell=told.append)
    assert told == ["bandai-namco/locomotion is not at hand, so the sample motions stand in for it"]


def test_a_folder_without_the_data(tmp_path, capsys):
    assert cli.main(["reproduce", "vae-lstm", "--data", str(tmp_path), "--runs", str(tmp_path / "runs")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and f"not at hand in {tmp_path}: bandai-namco/locomotion; expected" in error
    assert "--data samples" in error and not (tmp_path / "runs").exists()


def test_runs_of_another_recipe_in_that_place(made, capsys):
    folder, _, _ = made
    command = ["reproduce", "vae-lstm", "--data", "samples", "--quick", "--jobs", "1", "--runs", str(folder)]
    assert cli.main([*command, "--steps", "5"]) == 2
    assert "vae-lstm.safetensors: holds a run with steps 2, asked for 5" in capsys.readouterr().err
    with pytest.raises(CheckpointError, match="asked for"):
        vae_lstm.reproduce("samples", runs=folder, jobs=1, quick=True, budget={"pad": False}, tell=lambda line: None)


def test_results_that_are_none(tmp_path, made):
    folder, _, result = made
    (tmp_path / "x.json").write_text(json.dumps({**result, "schema": 99}), encoding="utf-8")
    with pytest.raises(DataError, match="expected paper 'vae-lstm' and schema 2"):
        vae_lstm.load_result(tmp_path / "x.json")
    (tmp_path / "x.json").write_text(json.dumps({**result, "paper": "acrnn"}), encoding="utf-8")
    with pytest.raises(DataError, match="expected paper 'vae-lstm'"):
        vae_lstm.load_result(tmp_path / "x.json")
    with pytest.raises(DataError, match="reproduce vae-lstm makes one"):
        vae_lstm.load_result(tmp_path / "y.json")


# --- the result that comes with the library -------------------------------------------------------


def test_the_committed_result_is_of_captured_motion_and_has_every_system():
    result = vae_lstm.load_result()
    assert result["data"] == "bandai-namco" and result["quick"] is False
    assert {run["label"] for run in result["runs"].values()} == set(SYSTEMS)
    assert all(f.ours is not None for f in vae_lstm.findings(result))
    assert "SAMPLE" not in str(vae_lstm.tables(result)["table 1"]) and vae_lstm.figure_4(result) is not None
    for system, errors in result["tuning"]["error"].items():
        (errors,) = errors.values()
        best = result["tuning"]["rates"][int(np.nanargmin(np.array(errors, dtype=float)))]  # None: it broke off
        assert result["budget"]["learning_rates"][system] == best == result["runs"][system]["recipe"]["learning_rate"]


def flattering() -> dict:
    """The committed result with numbers of which every finding is true."""
    result = vae_lstm.load_result()
    for run in result["runs"].values():
        for way in run["ways"].values():
            for kind, grows in (("pose", [1, 1, 1, 1, 1]), ("motion", [0.1, 1, 2, 4, 8])):
                size = 0.01 * (np.ones(5) if run["label"] == VAE else 4 * np.array(grows))
                way[kind]["error"], way[kind]["squared"] = size.tolist(), (size**2).tolist()
    for more in result["beyond"].values():
        for codes in more["diversity"]["codes"].values():
            codes["given"] = [0.02] * 5
        for walked in more["paths"].values():
            walked["deviation"].update(mean=0.02, predicted=0.2)
            walked["before"].update(step_length=0.6, contact=0.9, slide=8.0)
            walked["after"].update(slide=1.0)
        for who in more["steps"].values():
            who["before"].update(step_length=0.6, slide=8.0)
            who["after"].update(slide=1.0)
        more["speed"]["ms"] = {"1": 9.0, "64": 35.0}
    return result


def squared(result: dict, label: str, way: str, kind: str, at: int, value: float) -> None:
    result["runs"][label]["ways"][way][kind]["squared"][at] = value


def path(result: dict, name: str = "zigzag") -> dict:
    (more,) = result["beyond"].values()
    return more["paths"][name]


def speed(result: dict, one: float, many: float) -> None:
    (more,) = result["beyond"].values()
    more["speed"]["ms"] = {"1": one, "64": many}


BELOW, PRIOR_1 = "Table 1: from frame 120 on the VAE-LSTM errs less", "Table 1: so does the prior sample"
GROWS, POSE = "grows by a smaller factor", "Pose error (mean squared)"
MOTION, WITHIN = "Motion error (mean squared)", "Prior samples (mean squared)"
TABLE_2, PRIOR_2 = "Table 2: given the true control", "Table 2: so does the prior sample"


@pytest.mark.parametrize("change, claims", [
    (lambda r: None, []),
    (lambda r: squared(r, "erd", PREDICTED, "motion", 0, 2e-4), ["at frame 70 the baselines"]),
    (lambda r: squared(r, "erd", PREDICTED, "motion", 0, 0.2), ["at frame 70 the baselines", GROWS]),
    (lambda r: squared(r, "erd", PREDICTED, "motion", 1, 0.5e-4), ["at frame 90 already"]),
    (lambda r: squared(r, "erd", PREDICTED, "motion", 2, 0.5e-4), [BELOW, PRIOR_1]),
    (lambda r: squared(r, VAE, PRIOR, "motion", 2, 100e-4), [PRIOR_1, WITHIN]),
    (lambda r: squared(r, VAE, PRIOR, "motion", 1, 1.6e-4), [WITHIN]),
    (lambda r: squared(r, "lstm", PREDICTED, "motion", 4, 2.9e-4), [MOTION]),
    (lambda r: squared(r, VAE, PRIOR, "pose", 3, 20e-4), [PRIOR_2, WITHIN]),
    (lambda r: squared(r, "crbm-cd1", GIVEN, "pose", 4, 1.9e-4), [POSE]),
    (lambda r: squared(r, "crbm-cd1", GIVEN, "pose", 4, 0.9e-4), [TABLE_2, PRIOR_2, POSE]),
    (lambda r: r["runs"][VAE]["ways"][PER_STEP]["pose"].update(error=[0.009] * 5), ["Section 3.3"]),
    (lambda r: r["runs"][VAE]["ways"][PER_STEP]["pose"].update(error=[0.0115] * 5), ["Section 3.3"]),
    (lambda r: [m["diversity"]["codes"]["one"].update(given=[0.02] * 4 + [0.009]) for m in r["beyond"].values()],
     ["64 motions of one path differ"]),
    (lambda r: [m["diversity"]["codes"]["held"].update(given=[0.02] * 4 + [0.009]) for m in r["beyond"].values()],
     ["of codes that are held"]),
    (lambda r: path(r)["deviation"].update(mean=0.31), ["moved by the control given"]),
    (lambda r: path(r)["deviation"].update(predicted=0.31), ["moved by the control that it puts out"]),
    (lambda r: path(r)["before"].update(step_length=0.41), ["It walks there"]),
    (lambda r: path(r)["before"].update(contact=0.49), ["It walks there"]),
    (lambda r: path(r)["after"].update(slide=2.1), ["Feet slide less"]),
    (lambda r: path(r)["before"].update(slide=None), ["Feet slide less"]),
    (lambda r: speed(r, 10.5, 35.0), ["A second of motion"]),
    (lambda r: speed(r, 10.0, 40.5), ["what one may", "what one does"]),
    (lambda r: speed(r, 8.0, 33.0), ["what one does"]),
])  # fmt: skip
def test_each_finding_hangs_on_its_own_numbers(change, claims):
    result = flattering()
    change(result)
    assert_only_wrong(vae_lstm.findings(result), claims)
