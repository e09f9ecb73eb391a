"""Grading the problem sets through nbgrader, as ``test_exercises`` does it: a course folder, submissions, scores."""

from __future__ import annotations

import copy
import dataclasses
import os
import pathlib
import shutil
import time
import traceback
from collections.abc import Collection, Mapping
from typing import Any

ROOT = pathlib.Path(__file__).resolve().parents[1]
COURSE = ROOT / "notebooks" / "exercises"
SETS = tuple(sorted(folder.name for folder in (COURSE / "source").iterdir() if folder.is_dir()))
BEGIN, END = "### BEGIN ", "### END "
SOLUTION, HIDDEN = "SOLUTION", "HIDDEN TESTS"


@dataclasses.dataclass(frozen=True)
class Wrong:
    """A known wrong answer, told as a change of the right one.

    answer : the grade id of the cell it is written in. old, new : a piece of the solution that stands in it once, and
    what stands there instead. loses : the tests that must notice; all others must not.
    """

    name: str
    answer: str
    old: str
    new: str
    loses: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Submission:
    """What a student hands in: the solution with some answer cells replaced, and the tests that it must lose."""

    answers: Mapping[str, str]
    loses: frozenset[str]


def source(name: str) -> Any:
    """The source notebook of a problem set."""
    import nbformat

    return nbformat.read(COURSE / "source" / name / f"{name}.ipynb", as_version=4)


def graded(cell: Any) -> dict[str, Any]:
    """A cell's nbgrader metadata, empty where it has none."""
    return cell.metadata.get("nbgrader", {})


def regions(text: str) -> tuple[list[str], list[str]]:
    """The lines of a cell inside solutions and hidden tests, and those outside."""
    inside, outside, within = [], [], False
    for line in text.splitlines():
        if line.strip().startswith((BEGIN, END)):
            within = line.strip().startswith(BEGIN)
        else:
            (inside if within else outside).append(line)
    return inside, outside


def pack(name: str, wrong: list[Wrong]) -> list[Submission]:
    """As few submissions as hold all wrong answers, such that in each every test is lost for one reason alone."""
    solution = {graded(cell)["grade_id"]: cell.source for cell in source(name).cells if graded(cell).get("solution")}
    packed: list[tuple[dict[str, str], set[str]]] = []
    for one in wrong:
        assert solution[one.answer].count(one.old) == 1, f"{name}, {one.name}: {one.old!r} is not in the answer once"
        for answers, loses in packed:
            if not loses & set(one.loses) and answers.get(one.answer, solution[one.answer]).count(one.old) == 1:
                break
        else:
            answers, loses = {}, set()
            packed.append((answers, loses))
        answers[one.answer] = answers.get(one.answer, solution[one.answer]).replace(one.old, one.new)
        loses |= set(one.loses)
    return [Submission(answers, frozenset(loses)) for answers, loses in packed]


def environment() -> dict[str, str]:
    """What the kernels need: this tree, no network, the samples alone, one thread, this Python."""
    return {
        "PYTHONPATH": str(ROOT),
        "TUTORIAL_OFFLINE": "1",
        "TUTORIAL_DATA": "",
        "OMP_NUM_THREADS": "1",
        "JUPYTER_PREFER_ENV_PATH": "1",
        "JUPYTER_PLATFORM_DIRS": "1",
    }


class Course:
    """A copy of the course in a folder of its own, and nbgrader's interface to it.

    strict: what is written to standard error costs points, as with nbgrader's own settings.
    impatient: tests that get ten seconds alone, because something in them is known to loop.
    """

    def __init__(self, folder: pathlib.Path, strict: bool, impatient: Collection[str] = ()):
        from nbgrader.apps import NbGraderAPI
        from traitlets.config.loader import PyFileConfigLoader

        self.folder = folder
        shutil.copytree(COURSE, folder, ignore=shutil.ignore_patterns("release", "*.db", "submitted", "autograded"))
        config = PyFileConfigLoader("nbgrader_config.py", path=str(folder)).load_config()
        config.CourseDirectory.root = str(folder)
        config.ExecuteToTheEnd.warnings_cost = strict
        if impatient:
            patience = config.Execute.timeout
            config.Execute.timeout_func = lambda cell: 10 if graded(cell).get("grade_id") in impatient else patience
        self.api = NbGraderAPI(config=config)

    def file(self, step: str, name: str, student: str = ".", ending: str = "ipynb") -> pathlib.Path:
        return self.folder / step / student / name / f"{name}.{ending}"

    def hand_in(
        self,
        name: str,
        student: str,
        step: str,
        answers: Mapping[str, str] | None = None,
        copied: Collection[str] = (),
    ) -> None:
        """Submit the notebook of ``step`` (source: the solution; release: blank) with some answer cells replaced.

        copied: the grade ids of cells that stand in it twice, as Jupyter copies them: with their metadata.
        """
        import nbformat

        notebook = nbformat.read(self.file(step, name), as_version=4)
        for cell in notebook.cells:
            if graded(cell).get("solution"):
                cell.source = (answers or {}).get(graded(cell)["grade_id"], cell.source)
        for cell in [cell for cell in notebook.cells if graded(cell).get("grade_id") in copied]:
            twin = copy.deepcopy(cell)
            twin.id = f"{cell.id}-copy"
            notebook.cells.insert(notebook.cells.index(cell) + 1, twin)
        file = self.file("submitted", name, student)
        file.parent.mkdir(parents=True)
        nbformat.write(notebook, file)

    def scores(self, name: str, student: str) -> dict[str, float | None]:
        """The points of each test."""
        with self.api.gradebook as gradebook:
            submission = gradebook.find_submission(name, student)
            return {grade.name: grade.auto_score for book in submission.notebooks for grade in book.grades}

    def outputs(self, name: str, student: str) -> dict[str, list[Any]]:
        """What each graded cell put out."""
        import nbformat

        cells = nbformat.read(self.file("autograded", name, student), as_version=4).cells
        return {graded(cell)["grade_id"]: cell.get("outputs", []) for cell in cells if graded(cell)}


def grade(
    name: str,
    folder: pathlib.Path,
    handed_in: Mapping[str, tuple[str, Mapping[str, str]]],
    feedback: Collection[str] = (),
    strict: bool = True,
    impatient: Collection[str] = (),
    copied: Mapping[str, Collection[str]] | None = None,
) -> dict[str, Any]:
    """Make the release of one set, grade what students hand in, give some of them feedback; in a process of its own.

    handed_in: what each student starts from, source or release, and the answer cells replaced. feedback: for whom.
    copied: the cells that stand twice in what a student hands in.
    """
    os.environ.update(environment())
    try:
        course = Course(folder, strict, impatient)
        result: dict[str, Any] = {"folder": folder, "release": course.api.generate_assignment(name)}
        for student, (step, answers) in handed_in.items():
            course.hand_in(name, student, step, answers, (copied or {}).get(student, ()))
        begin = time.monotonic()
        result["autograde"] = course.api.autograde(name, "*")
        result["seconds"] = time.monotonic() - begin
        result["scores"] = {student: course.scores(name, student) for student in handed_in}
        result["outputs"] = {student: course.outputs(name, student) for student in handed_in}
        result["feedback"] = {student: course.api.generate_feedback(name, student) for student in feedback}
        return result
    except Exception:  # nbgrader's own do not travel from process to process
        return {"error": traceback.format_exc()}
