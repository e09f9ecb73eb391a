"""The reproduce command on the samples with tiny networks: what it trains, resumes, measures, writes and says."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import pathlib
import shutil
import subprocess
import sys
import time

import numpy as np
import pytest
import torch

from tutorial_lib import cli, metrics
from tutorial_lib.data import load
from tutorial_lib.errors import CheckpointError, DataError, TutorialError
from tutorial_lib.generate import prepare
from tutorial_lib.recipes import Recipe, sets_of
from tutorial_lib.representations import make_representation
from tutorial_lib.reproduce import acrnn, acrnn_examples, cost, grid
from tutorial_lib.reproduce.acrnn_plan import QUICK, STYLES, SYSTEMS, Budget, Plan, label
from tutorial_lib.reproduce.failures import RULES, Truth, failures
from tutorial_lib.reproduce.published import ACRNN_TABLE_1, ACRNN_TABLE_2
from tutorial_lib.threads import torch_threads
from tutorial_lib.training.checkpoints import load_checkpoint, read_header
from tutorial_lib.view.explorer import note

SAMPLES = pathlib.Path(__file__).resolve().parents[1] / "data_samples"
WIDER = {"steps": 2000, "hidden": 128, "mirror": True}  # the budget of the second result that is shipped
WIDER_OPTIONS = ("--steps", "2000", "--hidden", "128", "--mirror")
TINY = Recipe("aclstm", ("samples/boxing",), hidden=8, batch=2, length=12, steps=6)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A quick result on the samples: the folder, what was told, and the result."""
    folder, told = tmp_path_factory.mktemp("reproduce"), []
    result = acrnn.reproduce("samples", runs=folder, jobs=1, quick=True, long=True, tell=told.append)
    return folder, told, result


# --- the plan -------------------------------------------------------------------------------------


def test_what_is_trained():
    names = [run.name for run in Plan().runs()]
    assert names[:5] == [f"walking/{system}" for system in SYSTEMS]
    assert names[15:] == ["indian/aclstm-u10-v10", "indian/aclstm-u2-v2", "indian/aclstm-u1-v1"]
    several = Plan(grid=True, seeds=(0, 3)).runs()
    assert len(several) == len({run.name for run in several}) == 2 * 18 + 4
    assert {run.recipe.options["u"] for run in several if "u1-" in run.name} == {1}
    assert {run.recipe.seed for run in several if run.name.endswith("-seed3")} == {3}
    for field in ("steps", "hidden", "batch", "length", "schedule", "clip", "rotate", "rates"):
        assert len({getattr(run.recipe, field) for run in several}) == 1, f"the same {field} for every system"
    assert label(5, 5) == "aclstm"


def test_the_first_seed_is_the_lowest_however_they_are_given(tmp_path, monkeypatch):
    """The grid, long samples and motions are of the seed that the explorer and figures take, whatever its number."""
    plan = Plan(grid=True, seeds=(3, 1))
    assert plan.seeds == (1, 3)
    assert {run.recipe.seed for run in plan.runs() if "u10-v1-" in run.name} == {1}
    assert [plan.first(run) for run in plan.runs() if run.name.startswith("martial/lstm")] == ["martial/lstm", None]
    result = acrnn.reproduce("samples", runs=tmp_path, jobs=1, quick=True, long=True, seeds=(1,), styles=("indian",),
                             tell=lambda line: None)  # fmt: skip
    assert set(result["long"]) == {"indian/aclstm-seed1", "indian/lstm-seed1"}
    asked = []
    monkeypatch.setattr(acrnn_examples, "divergence_time", lambda *_, **__: asked.append(1) or np.inf)
    for run in result["runs"].values():
        run["failures"]["latest"] = {"sample": 0, "seconds": 1.0, "rule": "stuck"}
    found, _ = acrnn_examples.examples(result, Plan(samples=True, styles=("indian",), seeds=(1,), **QUICK), tmp_path)
    assert len(asked) == len(SYSTEMS) == sum(name.startswith("failure") for name in found)


def test_plans_that_cannot_be():
    with pytest.raises(TutorialError, match="'tango'.*walking, indian, martial"):
        Plan(styles=("tango",))
    with pytest.raises(TutorialError, match="each once"):
        Plan(seeds=(1, 1))


# --- the whole command ----------------------------------------------------------------------------


def test_the_cost_is_told_before_anything_is_trained(made):
    _, told, _ = made
    whole = next(k for k, line in enumerate(told) if "the whole cost" in line)
    assert "18 runs of 4 steps" in told[0]
    assert whole < next(k for k, line in enumerate(told) if "1 of 18 runs done" in line)
    assert sum(int(line.split()[2]) for line in told[2:whole]) == 18 * 4  # steps left, over the systems


def test_the_result_is_whole_and_has_no_place_of_this_machine(made):
    folder, _, result = made
    text = (folder / "acrnn.json").read_text(encoding="utf-8")
    assert result == json.loads(text) == acrnn.load_result(folder / "acrnn.json")
    assert "NaN" not in text and "Infinity" not in text and str(folder) not in text
    assert len(text) < 300_000
    assert result["data"] == "samples" and result["quick"] is True
    assert set(result["runs"]) == {run.name for run in Plan(samples=True).runs()}
    assert set(result["long"]) == {"martial/aclstm", "martial/lstm", "indian/aclstm", "indian/lstm"}
    for name, run in result["runs"].items():
        assert name.startswith(f"{run['style']}/{run['label']}")
        assert Recipe.from_dict(run["recipe"]).system == run["system"]
        assert np.shape(run["errors"]) == (8, QUICK["protocol"].seeds)
        np.testing.assert_allclose(np.mean(run["errors"], axis=1), run["error"], rtol=1e-3, err_msg=name)
        spread = np.std(run["errors"], axis=1, ddof=1) / np.sqrt(QUICK["protocol"].seeds)
        np.testing.assert_allclose(spread, run["standard_error"], rtol=0.1, err_msg=name)
        split = result["splits"][f"{run['style']} seed {run['seed']}"]
        assert not set(split["train"]) & set(split["test"])
        assert read_header(folder / f"{name}.safetensors")["provenance"]["clips"] == split["train"]
        assert set(run["failures"]["rules"]) == set(RULES)


def test_the_tables_have_the_papers_numbers_beside_ours(made):
    _, told, result = made
    tables = acrnn.tables(result)
    for style, rows in ACRNN_TABLE_1.items():
        group = tables["table 1"].groups[f"{STYLES[style].title} (here {STYLES[style].sample})"]
        for system, numbers in rows.items():
            cells = {who: cells for row, who, cells in group if row == SYSTEMS[system].title}
            assert [text for text, _ in cells["paper"]] == [f"{x:.2f}" for x in numbers]
            ours = result["runs"][f"{style}/{system}"]["error"]
            np.testing.assert_allclose([float(text) for text, _ in cells["ours"]], ours, atol=0.006)
    (second,) = tables["table 2"].groups.values()
    assert [row for row, who, _ in second if who == "ours"] == [
        "c-length 10", "c-length 5", "c-length 2", "c-length 1", "sch. smp.",
    ]  # fmt: skip
    assert ACRNN_TABLE_2["aclstm"] == ACRNN_TABLE_1["indian"]["aclstm"]  # the paper prints the row twice
    assert ACRNN_TABLE_2["scheduled-sampling"] == ACRNN_TABLE_1["indian"]["scheduled-sampling"]
    for table in tables.values():
        assert all(line in told for line in str(table).splitlines())
    assert "SAMPLE MOTIONS" in tables["table 1"].caption and "QUICK" in tables["table 1"].caption


def test_several_training_seeds_are_a_mean_and_a_range(made):
    _, _, result = made
    two = json.loads(json.dumps(result))
    two["budget"]["training_seeds"] = [0, 1]
    for name, run in result["runs"].items():
        more = [e + 0.5 for e in run["error"]]
        two["runs"][f"{name}-seed1"] = {**run, "seed": 1, "error": more}
    np.testing.assert_allclose(
        acrnn.error(two, "martial", "erd"), np.array(result["runs"]["martial/erd"]["error"]) + 0.25
    )
    tables = acrnn.tables(two)
    assert tables["standard errors"].caption == "Standard error of one training seed's means, over 4 seeds"
    once = acrnn.tables(result)["standard errors"].caption
    assert once == "Standard error of table 1's means, over 4 seeds"
    assert "mean of 2 training seeds" in tables["table 1"].caption
    rows = {row: cells for row, _, cells in tables["training seeds"].groups["Martial Arts (here samples/boxing)"]}
    low, high = (float(rows[f"ERD, {which}"][0][0]) for which in ("lowest", "highest"))
    assert high - low == pytest.approx(0.5, abs=0.011)
    mean, spread = acrnn.difference(two, "martial", "aclstm", "lstm")
    once, wider = acrnn.difference(result, "martial", "aclstm", "lstm")
    np.testing.assert_allclose(mean, once)  # twice the same seeds: the same mean, a smaller standard error
    np.testing.assert_allclose(spread, wider * np.sqrt(3 / 7), atol=1e-9)  # s / sqrt(n) of 8 values instead of 4


def test_a_folder_that_is_half_finished_is_told_as_far_as_it_is(made):
    """As ``--no-train`` leaves it: styles without a run, a first seed without one length, a second of one system."""
    half = json.loads(json.dumps(made[2]))
    half["budget"]["training_seeds"] = [0, 1]
    half["runs"] = {name: run for name, run in half["runs"].items() if run["style"] == "indian"}
    half["splits"] = {name: split for name, split in half["splits"].items() if name.startswith("indian")}
    half["long"] = {}
    tables = acrnn.tables(half)
    assert list(tables["table 1"].groups) == ["Indian Dance (here samples/dancing)"]
    assert "training seeds" not in tables["table 1"].caption and "training seeds" not in tables
    half["runs"]["indian/aclstm-u2-v2-seed1"] = {**half["runs"].pop("indian/aclstm-u2-v2"), "seed": 1}
    half["runs"]["indian/erd-seed1"] = {**half["runs"]["indian/erd"], "seed": 1}
    found = {f.claim: f for f in acrnn.findings(half)}
    assert found["Figure 9: a longer condition length moves less in the long run"].evidence == "not measured"
    assert "Table 2: a longer condition length errs less, at all times" in found
    assert found["Walking: at 80 ms seq2seq errs least"].ours is None
    assert "mean of 1 to 2 training seeds" in acrnn.tables(half)["table 1"].caption


def test_findings_say_what_the_numbers_say(made):
    _, _, result = made
    found = {f.claim: f for f in acrnn.findings(result)}
    gap, _ = acrnn.difference(result, "martial", "aclstm", "lstm")
    assert found["Martial Arts: from 400 ms on acLSTM errs less than LSTM-3LR"].ours == bool((gap[4:] < 0).all())
    better = json.loads(json.dumps(result))
    for name, run in better["runs"].items():
        size = 1.0 if run["system"] == "aclstm" else 2.0
        run["errors"] = np.full((8, 4), size).tolist()
        run["error"] = [size] * 8
        run["failures"]["count"] = 0 if "aclstm" in name else 1
    found = {f.claim: f for f in acrnn.findings(better)}
    assert found["Martial Arts: from 400 ms on acLSTM errs less than LSTM-3LR"].ours is True
    assert found["Indian Dance: acLSTM errs least at most times"].ours is True
    assert found["Indian Dance: acLSTM-3LR never fails"].ours is True and found["Indian Dance: ERD fails"].ours is True
    assert found["Martial Arts: at 640 ms seq2seq errs most"].ours is False  # as much as others is not most
    assert found["Table 2: a longer condition length errs less, at all times"].ours is False
    for name in [n for n in better["runs"] if n.startswith("indian/seq2seq")]:
        del better["runs"][name]
    found = {f.claim: f for f in acrnn.findings(better)}
    assert found["Indian Dance: at 80 ms seq2seq errs least"].ours is None
    assert len(acrnn.tables(better)["table 1"].groups) == 3  # a missing run leaves the paper's row alone


def test_what_is_not_finite_is_as_wrong_as_can_be(made):
    broken = json.loads(json.dumps(made[2]))
    runs = {label: broken["runs"][f"indian/{label}"] for label in (label(n, n) for n in (10, 5, 2, 1))}
    for size, (moved, run) in enumerate(zip((1.0, 2.0, None, 0.5), runs.values(), strict=True)):
        run["error"], run["errors"] = [1.0 + size] * 8, [[1.0 + size] * 4] * 8
        run["motion_change"]["values"] = [moved] * len(run["motion_change"]["values"])
    for run in (broken["runs"]["indian/lstm"], runs["aclstm-u1-v1"]):
        run["error"], run["errors"] = [None] * 8, [[None] * 4] * 8
    found = {f.claim: f.ours for f in acrnn.findings(broken)}
    assert found["Indian Dance: from 400 ms on acLSTM errs less than LSTM-3LR"] is True
    assert found["Table 2: a longer condition length errs less, at all times"] is True
    assert found["Figure 9: a longer condition length moves less in the long run"] is False, "how much is not known"
    runs["aclstm"]["error"], runs["aclstm"]["errors"] = [None] * 8, [[None] * 4] * 8
    found = {f.claim: f.ours for f in acrnn.findings(broken)}
    assert found["Indian Dance: from 400 ms on acLSTM errs less than LSTM-3LR"] is False, "neither errs less"


def test_differences_are_taken_seed_by_seed():
    run = {"style": "indian", "seed": 0}
    one = {**run, "label": "aclstm", "errors": [[1.0, 5.0, 9.0]] * 8}
    other = {**run, "label": "lstm", "errors": [[2.0, 6.0, 10.5]] * 8}
    mean, spread = acrnn.difference({"runs": {"a": one, "b": other}}, "indian", "aclstm", "lstm")
    # -1, -1, -1.5: far smaller a spread than that of either
    np.testing.assert_allclose(mean, np.full(8, -3.5 / 3))
    np.testing.assert_allclose(spread, np.full(8, np.std([1, 1, 1.5], ddof=1) / np.sqrt(3)))
    assert acrnn.difference({"runs": {"a": one}}, "indian", "aclstm", "lstm") is None


def test_curves_and_figures(made):
    folder, _, result = made
    run = result["runs"]["indian/lstm"]
    curve = acrnn.motion_change(result, "indian/lstm")
    assert curve.shape == (QUICK["protocol"].curve,)
    np.testing.assert_allclose(curve[::5], run["motion_change"]["values"])
    for name in ("figure-2-walking", "figure-2-indian", "figure-2-martial", "figure-7", "figure-9"):
        assert (folder / f"acrnn-{name}.png").stat().st_size > 5000 or name == "figure-7"
    assert acrnn.pairs(result) == {
        (1, 0): "indian/lstm", (1, 1): "indian/aclstm-u1-v1", (2, 2): "indian/aclstm-u2-v2",
        (5, 5): "indian/aclstm", (10, 10): "indian/aclstm-u10-v10",
    }  # fmt: skip


def test_the_explorer_of_runs_that_are_not_finite(made):
    broken = json.loads(json.dumps(made[2]))
    run = broken["runs"]["indian/aclstm"]
    run["error"], run["loss"] = [None] * 8, None
    explorer = acrnn.explore(broken, {})
    assert "error at 400 ms" in explorer._repr_html_() and explorer.png
    assert [note(x) for x in (None, np.nan, 1.23456, 3, "3 of 20")] == ["–", "–", "1.23", "3", "3 of 20"]


def test_motions_to_be_looked_at(made, tmp_path):
    folder, _, result = made
    motions = acrnn.load_examples(folder / "acrnn.safetensors")
    shown = [f"pair {u} {v}" for u, v in acrnn.pairs(result)]
    assert [name for name in motions if name.startswith("pair ")] == sorted(shown)
    assert all(np.isfinite(motion.positions).all() for motion in motions.values())
    explorer = acrnn.explore(result, motions)
    assert set(explorer.cells) == {(1, 0), (1, 1), (2, 2), (5, 5), (10, 10)}
    assert explorer.cells[5, 5].motion is motions["pair 5 5"]
    failed = [name for name in motions if name.startswith("failure ")]
    assert (acrnn.failure_strip(motions) is None) == (not failed) == (not (folder / "acrnn-figure-7.png").exists())
    (tmp_path / "broken.safetensors").write_bytes(b"nothing")
    with pytest.raises(DataError, match="no motions beside a result"):
        acrnn.load_examples(tmp_path / "broken.safetensors")


def test_called_again_it_trains_nothing(made):
    folder, _, result = made
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*.safetensors")}
    told: list[str] = []
    again = acrnn.reproduce("samples", runs=folder, out=folder / "again", jobs=1, quick=True, styles=["martial"],
                            train_missing=False, tell=told.append)  # fmt: skip
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*.safetensors")} == before
    for name, run in again["runs"].items():
        assert run == result["runs"][name], "measured alike"


def test_the_command_line_chooses_the_budget(tmp_path, monkeypatch):
    seen = {}
    monkeypatch.setattr(acrnn, "reproduce", lambda *args, **kwargs: seen.update(kwargs))
    command = ["reproduce", "acrnn", "--data", "samples", "--runs", str(tmp_path)]
    assert cli.main(command) == 0 and seen["budget"] == {}
    assert cli.main([*command, *WIDER_OPTIONS]) == 0 and seen["budget"] == WIDER
    recipe = Plan(samples=True, budget=dataclasses.replace(Budget(), **WIDER)).recipe("martial", "seq2seq")
    assert (recipe.steps, recipe.hidden, recipe.mirror) == (2000, 128, True)


def test_two_budgets_are_held_against_the_same_sentences(capsys):
    """The results that come with the library: of the plan's own budget, and of the wider one."""
    small, wide = acrnn.load_result(), acrnn.load_result(acrnn.WIDER_RESULT)
    for result, budget in ((small, Budget()), (wide, dataclasses.replace(Budget(), **WIDER))):
        assert {name: result["budget"].get(name, False) for name in WIDER} == {n: getattr(budget, n) for n in WIDER}
        runs = [run["recipe"] for run in result["runs"].values()]
        trained = {(run["steps"], run["hidden"], run.get("mirror", False)) for run in runs}
        assert trained == {(budget.steps, budget.hidden, budget.mirror)}
    assert [f.claim for f in acrnn.findings(small)] == [f.claim for f in acrnn.findings(wide)]
    assert small["splits"].keys() == wide["splits"].keys()
    for name, split in small["splits"].items():
        assert wide["splits"][name]["test"] == split["test"], "measured on the same clips"
    assert cli.main(["results", "acrnn-wider"]) == 0
    assert "2000 steps, 128 cells a layer, mirrored clips too" in capsys.readouterr().out


def test_runs_of_another_recipe_in_that_place(made, capsys):
    folder, _, _ = made
    command = ["reproduce", "acrnn", "--data", "samples", "--quick", "--jobs", "1", "--runs", str(folder)]
    assert cli.main([*command, "--steps", "5"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and "walking/lstm.safetensors: holds a run with steps 4, asked for 5" in error


# --- bad input ------------------------------------------------------------------------------------


def test_shipped_weights_are_measured_anew_in_a_result_that_is_there(made, tmp_path, fails, monkeypatch, capsys):
    folder, _, before = made
    path = tmp_path / "acrnn.json"
    whole = {**json.loads((folder / "acrnn.json").read_text()), "data": "cmu", "quick": False}
    path.write_text(json.dumps(whole))
    fails("reproduce", "acrnn", "--shipped", tmp_path / "none.json")
    assert "not at hand" in fails("reproduce", "acrnn", "--shipped", path, "--data", tmp_path)
    assert acrnn.load_result(path) == whole

    entry = {**before["long"]["martial/aclstm"], "lowest": 0.5}
    monkeypatch.setattr(acrnn, "measure_published", lambda name, protocol, report: {f"{name} (own seeds)": entry})
    monkeypatch.setattr(acrnn, "published", lambda: ["aclstm-cmu-martial"])
    monkeypatch.setattr(acrnn, "side_by_side", lambda function, tasks, jobs: [function(*task, None) for task in tasks])
    monkeypatch.setattr(acrnn, "clips_from", lambda *_, **__: contextlib.nullcontext())
    assert cli.main(["reproduce", "acrnn", "--shipped", str(path)]) == 0
    assert "aclstm-cmu-martial" in capsys.readouterr().out
    after = acrnn.load_result(path)
    assert after.pop("shipped")["versions"] == before["versions"]
    assert after["long"].pop("aclstm-cmu-martial (own seeds)")["lowest"] == 0.5
    assert after == whole


def test_what_cannot_hold_shipped_weights_is_refused_before_they_are_measured(made, tmp_path, fails, monkeypatch):
    monkeypatch.setattr(acrnn, "clips_from", lambda *_, **__: pytest.fail("long work begins"))
    path = tmp_path / "acrnn.json"
    whole = {**made[2], "data": "cmu", "quick": False}
    run = {"indian/lstm": {key: v for key, v in whole["runs"]["indian/lstm"].items() if key != "failures"}}
    for result, told in (
        (made[2], "is a quick trial, expected a whole result of data 'cmu'"),
        ({**whole, "data": "samples"}, "is of data 'samples', expected a whole result of data 'cmu'"),
        ({key: v for key, v in whole.items() if key != "long"}, "missing or damaged: long; expected"),
        ({**whole, "runs": run}, "missing or damaged: KeyError 'failures'"),
    ):
        path.write_text(json.dumps(result))
        assert told in fails("reproduce", "acrnn", "--shipped", path)
    path.write_text(json.dumps(whole))
    assert "measured on captured motion" in fails("reproduce", "acrnn", "--shipped", path, "--data", "samples")
    assert "empty name" in fails("reproduce", "acrnn", "--shipped", "")


@pytest.mark.parametrize(("count", "options", "told"), [
    (1, (), "cmu/martial: 1 clip, expected at least 2: one is kept out"),
    (2, ("--tune",), "cmu/martial: 2 clips, expected at least 3: rates are chosen on a fifth"),
])  # fmt: skip
def test_too_few_clips_are_told_before_anything_is_trained(tmp_path, fails, count, options, told):
    folder, runs = tmp_path / "cmu/martial", tmp_path / "runs"
    folder.mkdir(parents=True)
    for clip in sorted((SAMPLES / "boxing").glob("*.bvh"))[:count]:
        shutil.copy(clip, folder)
    command = ("reproduce", "acrnn", "--data", tmp_path, "--styles", "martial", "--quick", "--runs", runs)
    assert told in fails(*command, *options)
    assert not list(runs.rglob("*.safetensors"))


def test_missing_data_is_one_error_that_names_it_all(tmp_path, capsys):
    (tmp_path / "cmu" / "indian").mkdir(parents=True)
    (tmp_path / "cmu" / "walking").mkdir()
    (tmp_path / "cmu" / "walking" / "a.bvh").write_text("HIERARCHY\n", encoding="utf-8")
    before = os.environ.get("TUTORIAL_DATA")
    assert cli.main(["reproduce", "acrnn", "--data", str(tmp_path), "--runs", str(tmp_path / "runs")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and f"not at hand in {tmp_path}: cmu/indian; cmu/martial; expected" in error
    assert os.environ.get("TUTORIAL_DATA") == before and not (tmp_path / "runs").exists()
    assert cli.main(["reproduce", "acrnn", "--data", str(tmp_path / "none")]) == 2
    assert "no such folder" in capsys.readouterr().err


def test_nothing_finished_and_no_training(tmp_path, capsys):
    assert cli.main(["reproduce", "acrnn", "--data", "samples", "--no-train", "--runs", str(tmp_path)]) == 2
    assert "none of the 18 runs is finished" in capsys.readouterr().err


def test_results_that_are_none(tmp_path):
    for text, message in (("[1]", "expected paper 'acrnn'"), ("{", "not a result"), ('{"paper": "acrnn"}', "schema 1")):
        (tmp_path / "x.json").write_text(text, encoding="utf-8")
        with pytest.raises(DataError, match=message):
            acrnn.load_result(tmp_path / "x.json")
    with pytest.raises(DataError, match="no such result"):
        acrnn.load_result(tmp_path / "y.json")


# --- resuming -------------------------------------------------------------------------------------


def weights(path) -> dict[str, torch.Tensor]:
    return load_checkpoint(path).model.state_dict()


def assert_same(one, other):
    one, other = weights(one), weights(other)
    assert one.keys() == other.keys() and all(torch.equal(one[name], other[name]) for name in one)


def test_a_run_that_was_stopped_ends_in_the_same_weights(tmp_path):
    run = grid.Run("a/b", TINY)
    heard = []

    def stop_at_three(name, step):
        heard.append((name, step))
        if step == 3:
            raise grid.Stopped

    with torch_threads(1):
        with pytest.raises(grid.Stopped):
            grid.train(run, tmp_path / "one", stop_at_three)
        assert heard == [("a/b", 1), ("a/b", 2), ("a/b", 3)]
        assert run.steps_left(tmp_path / "one") == 3
        grid.train(run, tmp_path / "one", lambda name, step: heard.append(step))
        assert heard[3:] == [4, 5, 6]
        grid.train(run, tmp_path / "whole", lambda name, step: None)
    assert_same(run.path(tmp_path / "one"), run.path(tmp_path / "whole"))
    assert run.steps_left(tmp_path / "one") == 0
    other = grid.Run("a/b", dataclasses.replace(TINY, hidden=9))
    with pytest.raises(CheckpointError, match="hidden 8, asked for 9"):
        other.steps_left(tmp_path / "one")


def test_a_finished_run_is_not_measured_on_other_clips(tmp_path):
    """One clip more in the folder and the split is another: what is kept out now it may have been trained on."""
    run = grid.Run("a/b", TINY)
    with torch_threads(1):
        grid.train(run, tmp_path, lambda name, step: None)
        grid.train(run, tmp_path, lambda name, step: None)  # the same clips
        ((train, test),) = grid.clips_for(TINY)
        for others in ([([*train, test[0]], test[1:])], [([*train[1:], test[0]], test)]):
            with pytest.raises(CheckpointError, match=r"a/b.safetensors: was started on \d+ clips"):
                grid.train(run, tmp_path, lambda name, step: None, others)


SIDE_BY_SIDE = """
import dataclasses, sys
from tutorial_lib.recipes import Recipe
from tutorial_lib.reproduce import grid

if __name__ == "__main__":
    recipe = Recipe("aclstm", ("samples/boxing",), hidden=8, batch=2, length=12, steps=1_000_000)
    runs = [grid.Run(f"a/{seed}", dataclasses.replace(recipe, seed=seed)) for seed in (0, 1)]
    grid.side_by_side(grid.train, [(run, sys.argv[1]) for run in runs], jobs=2,
                      heard=lambda name, step: print(name, step, flush=True))
"""


def test_when_the_command_is_killed_its_processes_save_and_end(tmp_path):
    """By SIGKILL, of which it hears nothing."""
    (tmp_path / "run.py").write_text(SIDE_BY_SIDE, encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "run.py"), str(tmp_path)], stdout=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": str(pathlib.Path(cli.__file__).parents[2])},
    )  # fmt: skip
    seen = set()
    for line in process.stdout:
        seen.add(line.split()[0])
        if len(seen) == 2:  # both are at work
            break
    process.kill()
    process.wait()
    deadline = time.monotonic() + 15
    while len(list(tmp_path.rglob("*.safetensors"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.1)
    time.sleep(0.5)
    done = []
    for seed in (0, 1):
        header = read_header(tmp_path / "a" / f"{seed}.safetensors")
        assert header["resumable"]
        done.append(header["training"]["steps_done"])
    assert min(done) > 0
    time.sleep(1.5)
    assert done == [read_header(tmp_path / "a" / f"{seed}.safetensors")["training"]["steps_done"] for seed in (0, 1)], (
        "no one is training on"
    )


def test_side_by_side_gives_what_one_after_another_does(tmp_path):
    """Two runs beside each other and one that cannot be: its error arrives here, the others stop or are done, and going
    on alone leads to the same weights."""
    runs = [grid.Run(f"a/{k}", dataclasses.replace(TINY, seed=k)) for k in (0, 1)]
    grid.side_by_side(grid.train, [(run, tmp_path / "alone") for run in runs], jobs=1)
    wrong = grid.Run("a/0", dataclasses.replace(TINY, hidden=9))
    heard = []
    with pytest.raises(CheckpointError, match="hidden 8, asked for 9"):
        grid.side_by_side(
            grid.train, [*((run, tmp_path / "beside") for run in runs), (wrong, tmp_path / "alone")], jobs=2,
            heard=lambda name, step: heard.append(name),
        )  # fmt: skip
    assert set(heard) <= {"a/0", "a/1"}
    assert any(run.path(tmp_path / "beside").exists() for run in runs)
    grid.side_by_side(grid.train, [(run, tmp_path / "beside") for run in runs], jobs=1)
    for run in runs:
        assert_same(run.path(tmp_path / "alone"), run.path(tmp_path / "beside"))
    with pytest.raises(TutorialError, match="1 or more, not 0"):
        grid.side_by_side(grid.train, [], jobs=0)


def test_progress_in_plain_lines(monkeypatch):
    runs, told, clock = [grid.Run("a/one", TINY), grid.Run("a/two", TINY)], [], [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    lines = grid.Told(
        runs, {"a/one": 6, "a/two": 6}, {"a/one": (10.0, 40.0), "a/two": (10.0, 40.0)}, jobs=2, tell=told.append
    )
    assert lines.work_left() == 200
    clock[0] += 5
    lines("a/one", 1)
    assert not told, "a line every half minute is enough"
    clock[0] += 35
    lines("a/two", 3)
    # 40 of the 200 seconds are done after 40: the machine is half as fast as two cores should be
    assert told[0].startswith("a/one 1 of 6 steps, a/two 3 of 6 steps; 0 of 2 runs done, all at about ")
    assert told[0].endswith("(3 min more)")
    lines("a/one", 7)
    lines("a/two", 7)
    assert told[1].startswith("a/one: done; 1 of 2 runs done") and told[2] == "a/two: done; 2 of 2 runs done"
    assert [grid.duration(s) for s in (40, 750, 11_100)] == ["40 s", "12 min", "3 h 05 min"]


# --- learning rates -------------------------------------------------------------------------------


def test_rates_are_chosen_on_clips_that_are_neither_trained_on_nor_tested(tmp_path, monkeypatch):
    """Of two rates one is absurd: it is not chosen. The networks have not seen the clips that they are judged by."""
    from tutorial_lib.reproduce import acrnn as module

    monkeypatch.setattr(module, "RATES_TRIED", (1e-9, 5e-3))
    plan = Plan(
        samples=True, styles=("martial",), **{**QUICK, "budget": dataclasses.replace(QUICK["budget"], steps=40)}
    )
    chosen, record = module.tune(plan, tmp_path, jobs=1, tell=lambda line: None)
    assert record["steps"] == 20 and set(record["chosen"]) == set(SYSTEMS)
    again = module.tune(plan, tmp_path, jobs=1, tell=lambda line: None)
    assert again[1] == record, "finished runs are held against the clips without those set aside"
    for system in SYSTEMS:
        low, high = record["error"][system]["martial"]
        assert chosen.rates[system] == (1e-9 if low < high else 5e-3)
    assert chosen.rates["lstm"] == 5e-3, "fresh weights predict the mean pose at best"
    header = read_header(tmp_path / "tuning" / "martial" / "lstm-0.005.safetensors")
    train, test = sets_of(plan.recipe("martial", "lstm"))[0]
    trained, aside = header["provenance"]["clips"], header["provenance"]["test_clips"]
    assert sorted(trained + aside) == sorted(m.name for m in train) and len(aside) == 1
    assert not {m.name for m in test} & {*trained, *aside}


def test_a_data_set_that_no_rate_can_learn_does_not_choose(tmp_path, monkeypatch):
    """It made every total infinite, so that the first rate was taken, whatever the other data sets said."""
    inf = np.inf
    errors = {"walking": [3.0, 1.0, 2.0], "martial": [inf, inf, inf]}
    trials = {("lstm", name, rate): grid.Run(f"{name}-{rate}", TINY) for name in errors for rate in (0.1, 0.2, 0.4)}
    monkeypatch.setattr(cost, "side_by_side", lambda *_, **__: sum(errors.values(), []))
    told = []

    def chosen() -> dict:
        return cost.choose_rates(None, trials, tmp_path, None, lambda run: 1.0, jobs=1, tell=told.append)

    record = chosen()
    assert record["chosen"] == {"lstm": 0.2} and record["error"]["lstm"]["martial"] == [None] * 3
    assert told[-1].endswith(" 0.2; without martial, where no rate has a finite error")
    errors["martial"] = [1.0, inf, 9.0]
    assert chosen()["chosen"] == {"lstm": 0.1} and "without" not in told[-1]
    for errors["walking"], errors["martial"] in (([inf] * 3, [inf] * 3), ([inf, 1.0, inf], [1.0, inf, inf])):
        with pytest.raises(TutorialError, match="none of the learning rates 0.1, 0.2, 0.4 .* on walking, martial"):
            chosen()


# --- failures -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def boxing():
    """Boxing clips at 30 frames a second, their representation, the truth of the first four."""
    clips = prepare(load("samples/boxing"), fps=30.0)
    representation = make_representation("positions", clips[0].skeleton, 30.0)
    return clips, representation, Truth.of(clips[:4], clips[4:], representation)


def judged(boxing, features) -> dict:
    _, representation, truth = boxing
    features = np.asarray(features, dtype=np.float32)[None]
    return failures(features[:, :10], features[:, 10:], representation, truth)


def counts(found) -> dict[str, int]:
    return {rule: found["rules"][rule]["count"] for rule in RULES}


def test_true_motion_does_not_fail(boxing):
    clips, representation, _ = boxing
    for clip in clips:
        found = judged(boxing, representation.encode(clip))
        assert found["count"] == 0 and found["latest"] is None and found["lowest"] > 0.1


def test_a_statue_freezes_and_a_trembling_one_is_stuck(boxing):
    clips, representation, _ = boxing
    x = representation.encode(clips[4])
    statue = np.concatenate([x[:100], np.repeat(x[99:100], 400, 0)])
    found = judged(boxing, statue)
    assert counts(found) == {"freezing": 1, "stuck": 1, "divergence": 0, "out of range": 0}
    rule, seconds = found["first"][0]
    # it moves for 3 s after the seed, of which the window of 10 s may hold a little
    assert rule in ("freezing", "stuck") and 1.0 < seconds <= 3.0
    assert found["latest"] == {"sample": 0, "rule": rule, "seconds": seconds}
    trembling = statue + np.random.default_rng(0).normal(scale=0.01, size=statue.shape) * (
        np.arange(len(statue)) >= 100
    )[:, None]  # fmt: skip
    assert counts(judged(boxing, trembling)) == {"freezing": 0, "stuck": 1, "divergence": 0, "out of range": 0}


def test_a_pause_is_a_stagnation_and_no_failure(boxing):
    clips, representation, _ = boxing
    x = representation.encode(clips[4])
    paused = np.concatenate([x[:100], np.repeat(x[99:100], 90, 0), x[100:]])
    found = judged(boxing, paused)
    assert found["count"] == 0
    assert found["stagnations"]["count"] == 1 and 2.9 <= found["stagnations"]["longest"] <= 3.4


def test_what_explodes_diverges_and_what_is_bent_is_out_of_range(boxing):
    clips, representation, _ = boxing
    x = representation.encode(clips[4])
    growing = x * np.exp(np.clip(np.arange(len(x)) - 200, 0, None) / 30)[:, None]
    found = judged(boxing, growing)
    assert counts(found)["divergence"] == 1 and counts(found)["freezing"] == 0
    # from 190 frames after the seed on it grows, e-fold in 30 frames; the mean of a second looks that much ahead
    assert 160 / 30 <= found["first"][0][1] < 230 / 30
    nan = x.copy()
    nan[300:] = np.nan
    assert counts(judged(boxing, nan))["divergence"] == 1
    positions = x.copy().reshape(len(x), -1, 3)
    positions[200:, 1:, 1] *= -1  # on its head, its limbs no longer than before
    found = judged(boxing, positions.reshape(x.shape))
    assert counts(found) == {"freezing": 0, "stuck": 0, "divergence": 0, "out of range": 1}
    assert found["first"][0][0] == "out of range" and 5.3 < found["first"][0][1] <= 6.5


def test_the_latest_failure_is_the_last_of_the_first_ones(boxing):
    clips, representation, truth = boxing
    x = representation.encode(clips[4])[:410]
    late, early = x.copy(), x.copy()
    late[300:], early[100:] = np.nan, np.nan
    both = np.stack([early, late, x])
    found = failures(both[:, :10], both[:, 10:], representation, truth)
    assert found["count"] == 2 and found["first"][2] is None
    assert found["latest"] == {"sample": 1, "rule": "divergence", "seconds": round(290 / 30, 2)} or (
        found["latest"]["sample"] == 1 and found["latest"]["rule"] == "out of range"
    )


def test_truth_is_of_the_training_clips(boxing):
    """Every frame counts the same; only the range of poses looks at test clips too."""
    clips, representation, _ = boxing
    short = dataclasses.replace(clips[1][:120:3], fps=30.0)  # three times as fast
    reaching = clips[4].scaled(1.2)
    train = [clips[0], short]
    truth = Truth.of(train, [reaching], representation)
    changes = [metrics.frame_change(representation.encode(m)) for m in train]
    assert truth.change == pytest.approx(np.concatenate(changes).mean())
    spreads = [
        np.sqrt(np.square(x - x.mean(0)).sum(-1).mean()) for x in (m.positions - m.positions[:, :1] for m in train)
    ]
    assert truth.spread == pytest.approx(np.average(spreads, weights=[len(m) for m in train]), rel=1e-4)
    assert truth.reach == pytest.approx(max(metrics.reach(m.positions) for m in train))
    assert truth.reach < metrics.reach(reaching.positions)
    assert len(truth.poses) == sum(-(-len(m) // 5) for m in train), "six a second"


def test_a_short_sample_is_held_against_the_rules_as_a_whole(boxing):
    clips, representation, _ = boxing
    x = representation.encode(clips[4])
    found = judged(boxing, np.repeat(x[100:101], 70, 0))  # a statue for two seconds
    assert counts(found) == {"freezing": 1, "stuck": 1, "divergence": 0, "out of range": 0}
    jumping = np.repeat(x[100:101], 70, 0)
    jumping[:10, 3:] += 1.0  # the first step is from the seed to it
    assert judged(boxing, jumping)["lowest"] > 1


def test_the_rules_bounds(boxing):
    """1.5 times the reach, 1.25 times the range: a little more, and a little less."""
    clips, representation, truth = boxing
    x = representation.encode(clips[4])[:310]
    positions = representation.decode_positions(x)
    reach, distance = float(metrics.reach(positions[10:])), metrics.pose_distance(positions[10:], truth.poses)
    for share, count in ((1.45, 0), (1.55, 1)):
        found = failures(x[None, :10], x[None, 10:], representation, dataclasses.replace(truth, reach=reach / share))
        assert found["rules"]["divergence"]["count"] == count
    mean = max(metrics.moving_mean(distance[::5], 6))  # of a second, six poses
    for share, count in ((1.2, 0), (1.3, 1)):
        found = failures(x[None, :10], x[None, 10:], representation, dataclasses.replace(truth, range=mean / share))
        assert found["rules"]["out of range"]["count"] == count


def test_stagnations_are_told_of_all_samples(boxing):
    clips, representation, truth = boxing
    x = representation.encode(clips[4])[:500]
    one = np.concatenate([x[:200], np.repeat(x[199:200], 60, 0), x[200:440]])
    two = np.concatenate([x[:50], np.repeat(x[49:50], 45, 0), x[50:300], np.repeat(x[299:300], 75, 0), x[300:380]])
    three = np.stack([x, one, two])
    found = failures(three[:, :10], three[:, 10:], representation, truth)["stagnations"]
    assert (found["count"], found["samples without"]) == (3, 1)
    assert 2.4 < found["longest"] < 3.4, "its edges move a little, too"
