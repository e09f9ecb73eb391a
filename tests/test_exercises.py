"""The gate of the problem sets: what nbgrader makes of them, of blank, right, wrong and harmful submissions."""

from __future__ import annotations

import multiprocessing
import pathlib
import re
from concurrent.futures import ProcessPoolExecutor

import pytest

pytest.importorskip(
    "nbgrader", reason="no nbgrader: pip install -c constraints.txt -e '.[instructor]', Python 3.11 or later"
)

from exercises import COURSE, HIDDEN, SETS, SOLUTION, grade, graded, pack, regions, source  # noqa: E402
from exercises_wrong import BAD, COPIED, COSTS, RIGHT, WRONG  # noqa: E402


@pytest.fixture(scope="module")
def results(tmp_path_factory, request):
    """Each set graded once, two at a time, each in a process of its own; a test waits for the set that it is about."""
    folder = tmp_path_factory.mktemp("course")
    using = [item for item in request.session.items if "results" in getattr(item, "fixturenames", ())]
    wanted = {item.callspec.params["name"] for item in using if hasattr(item, "callspec")} or {"bad"}
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        jobs = {}
        if "bad" in wanted:
            harmful = {
                "careless": ("source", {cell: text for cell, (_, text) in BAD.items()}),
                "copier": ("source", {}),
                "other": ("source", {}),
            }
            jobs["bad"] = pool.submit(
                grade, "ps1", folder / "bad", harmful, ["careless"], False, ["test-bone"], {"copier": COPIED}
            )
        for name in SETS:
            if name in wanted:
                handed_in = {"blank": ("release", {}), "solved": ("source", {})}
                for k, submission in enumerate(pack(name, WRONG[name])):
                    handed_in[f"wrong-{k}"] = ("source", submission.answers)
                for submission in pack(name, RIGHT.get(name, [])):
                    handed_in["right"] = ("source", submission.answers)
                jobs[name] = pool.submit(grade, name, folder / name, handed_in, ["blank"])
        yield {name: job.result for name, job in jobs.items()}
        pool.shutdown(cancel_futures=True)


@pytest.fixture
def result(results, name):
    found = results[name]()
    assert "error" not in found, found.get("error")
    return found


def points(name: str) -> dict[str, int]:
    """The points of each test of a set."""
    return {
        graded(cell)["grade_id"]: graded(cell)["points"] for cell in source(name).cells if graded(cell).get("grade")
    }


# -- what stands in the sources ------------------------------------------------------------------------------


def test_there_is_a_set_for_each_lesson():
    assert list(SETS) == [f"ps{k}" for k in range(1, len(SETS) + 1)]
    assert set(WRONG) == set(SETS)


@pytest.mark.parametrize("name", SETS)
def test_the_source_is_whole(name):
    cells = source(name).cells
    ids = [graded(cell)["grade_id"] for cell in cells if graded(cell)]
    assert len(ids) == len(set(ids)), "grade ids must be unique"
    answers = [cell for cell in cells if graded(cell).get("solution")]
    tests = [cell for cell in cells if graded(cell).get("grade")]
    assert 3 <= len(answers) <= 6 and len(WRONG[name]) >= 3
    assert all(SOLUTION in cell.source for cell in answers) and all(HIDDEN in cell.source for cell in tests)
    assert not any(graded(cell).get("solution") and graded(cell).get("grade") for cell in cells), "nothing by hand"
    assert all(not cell.get("outputs") and not cell.get("execution_count") for cell in cells), "outputs tell solutions"
    assert any("To discuss" in cell.source for cell in cells if cell.cell_type == "markdown")


def test_the_readme_has_the_points_of_each_set():
    table = dict(re.findall(r"^\| `(ps\d)` .*\| (\d+) \|$", (COURSE / "README.md").read_text(), re.MULTILINE))
    assert {name: int(value) for name, value in table.items()} == {name: sum(points(name).values()) for name in SETS}


# -- what nbgrader makes of them -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", SETS)
def test_release_tells_no_solution_and_no_hidden_test(result, name):
    import nbformat

    assert result["release"]["success"], result["release"]
    file = result["folder"] / "release" / name / f"{name}.ipynb"
    assert sorted(p.name for p in file.parent.iterdir()) == sorted(
        p.name for p in (COURSE / "source" / name).iterdir() if p.name != ".ipynb_checkpoints"
    )
    text = file.read_text(encoding="utf-8")
    assert not re.search("(BEGIN|END) (SOLUTION|HIDDEN)", text)
    released = {line.strip() for cell in nbformat.read(file, as_version=4).cells for line in cell.source.splitlines()}
    parts = [regions(cell.source) for cell in source(name).cells]
    told = {line.strip() for _, outside in parts for line in outside}
    secret = {line.strip() for inside, _ in parts for line in inside} - told
    assert len(secret) > 10, "the search found no solutions to look for"
    assert not secret & released


@pytest.mark.parametrize("name", SETS)
def test_blank_scores_nothing_and_the_solution_everything(result, name):
    assert result["autograde"]["success"], result["autograde"]
    assert result["scores"]["solved"] == points(name)
    assert result["scores"]["blank"] == dict.fromkeys(points(name), 0)


@pytest.mark.parametrize("name", SETS)
def test_no_cell_of_the_solution_writes_to_standard_error(result, name):
    """It would cost points: nbgrader takes it for an error."""
    for cell, outputs in result["outputs"]["solved"].items():
        assert not [o for o in outputs if o.output_type == "error" or o.get("name") == "stderr"], (cell, outputs)


@pytest.mark.parametrize("name", SETS)
def test_wrong_answers_lose_their_points_and_no_others(result, name):
    for k, submission in enumerate(pack(name, WRONG[name])):
        wanted = {test: 0 if test in submission.loses else value for test, value in points(name).items()}
        assert result["scores"][f"wrong-{k}"] == wanted, submission.answers


@pytest.mark.parametrize("name", RIGHT)
def test_right_answers_of_another_make_lose_nothing(result, name):
    (submission,) = pack(name, RIGHT[name])
    assert result["scores"]["right"] == points(name), submission.answers


@pytest.mark.parametrize("name", SETS)
def test_feedback_is_a_page_that_says_what_every_test_said(result, name):
    assert result["feedback"]["blank"]["success"], result["feedback"]
    page = (result["folder"] / "feedback" / "blank" / name / f"{name}.html").read_text(encoding="utf-8")
    assert all(test in page for test in points(name))
    assert "NotImplementedError</span>" in page  # coloured as in a traceback: the set's own words name it, too


@pytest.mark.parametrize("name", ["bad"])
def test_harmful_submissions_cost_their_own_points_and_the_grading_goes_on(result, name):
    """It loops, raises, deletes names, prints megabytes, ends the kernel: each task in its own way."""
    assert result["autograde"]["success"], result["autograde"]
    assert result["scores"]["other"] == points("ps1")
    assert result["scores"]["careless"] == {
        test: 0 if test in COSTS else value for test, value in points("ps1").items()
    }
    size = (result["folder"] / "autograded" / "careless" / "ps1" / "ps1.ipynb").stat().st_size
    assert size < 2_000_000, "what it printed was kept"
    assert (result["folder"] / "feedback" / "careless" / "ps1" / "ps1.html").stat().st_size < 4_000_000


@pytest.mark.parametrize("name", ["bad"])
def test_copied_cells_cost_nothing_and_the_grading_goes_on(result, name):
    """nbgrader alone takes them for metadata of an old version, and grades nobody from there on."""
    import nbformat

    handed_in = nbformat.read(result["folder"] / "submitted" / "copier" / "ps1" / "ps1.ipynb", as_version=4)
    ids = [graded(cell)["grade_id"] for cell in handed_in.cells if graded(cell)]
    assert sorted(set(ids)) == sorted(graded(cell)["grade_id"] for cell in source("ps1").cells if graded(cell))
    assert {grade_id for grade_id in ids if ids.count(grade_id) == 2} == COPIED
    assert result["autograde"]["success"], result["autograde"]
    assert result["scores"]["copier"] == result["scores"]["other"] == points("ps1")


@pytest.mark.parametrize("name", ["ps1"])
def test_a_changed_test_and_a_new_submission_count_with_the_commands_of_the_readme(result, name, tmp_path):
    """In a copy of the graded course: blank hands in the solution, and a hidden test is changed to fail."""
    import os
    import shutil
    import subprocess
    import sys

    import nbformat
    from exercises import END, environment
    from nbgrader.api import Gradebook

    course = tmp_path / "course"
    shutil.copytree(result["folder"], course)
    file = f"{name}/{name}.ipynb"
    shutil.copy(course / "submitted" / "solved" / file, course / "submitted" / "blank" / file)
    notebook = nbformat.read(course / "source" / file, as_version=4)
    (test,) = [cell for cell in notebook.cells if graded(cell).get("grade_id") == "test-turn"]
    test.source = test.source.replace(END + HIDDEN, f"assert False, 'the changed test'\n{END}{HIDDEN}")
    nbformat.write(notebook, course / "source" / file)
    commands = (COURSE / "README.md").read_text(encoding="utf-8").partition("## Change a set")[2]
    commands = re.findall(rf"^nbgrader (\w+ {name}\b[^#\n]*)", commands, re.MULTILINE)
    assert [command.split()[0] for command in commands] == ["generate_assignment", "autograde", "generate_feedback"]
    for step in commands:
        one = [] if step.startswith("generate_assignment") else ["--student", "blank"]
        command = [sys.executable, "-m", "nbgrader", *step.split(), *one]
        done = subprocess.run(
            command, cwd=course, env={**os.environ, **environment()}, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stderr
    with Gradebook(f"sqlite:///{course / 'gradebook.db'}", "moving-people") as gradebook:
        (book,) = gradebook.find_submission(name, "blank").notebooks
        scores = {grade.name: grade.auto_score for grade in book.grades}
    assert scores == {**points(name), "test-turn": 0}
    page = (course / "feedback" / "blank" / name / f"{name}.html").read_text(encoding="utf-8")
    assert "the changed test" in page, "the old page was kept"


def test_export_gives_a_table_of_scores(results):
    """With nbgrader's own command, in the folder that the gate has graded."""
    import csv
    import os
    import subprocess
    import sys

    from exercises import environment

    found = next(iter(results.values()))()
    folder = pathlib.Path(found["folder"])
    done = subprocess.run([sys.executable, "-m", "nbgrader", "export"], cwd=folder, env={**os.environ, **environment()},
                          capture_output=True, text=True, timeout=300)  # fmt: skip
    assert done.returncode == 0, done.stderr
    rows = list(csv.DictReader((folder / "grades.csv").read_text().splitlines()))
    scores = {row["student_id"]: float(row["score"]) for row in rows}
    assert scores == {student: sum(given.values()) for student, given in found["scores"].items()}
