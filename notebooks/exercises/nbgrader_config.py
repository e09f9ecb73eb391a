"""The course: ``nbgrader generate_assignment ps1`` and the like, run in this folder, read this file."""

import os
import pathlib
import sys

from jupyter_core.utils import run_sync
from nbclient.exceptions import DeadKernelError
from nbformat.v4 import new_output
from nbgrader.converters import Autograde
from nbgrader.preprocessors import DeduplicateIds, Execute
from traitlets import Bool

MOST_OUTPUT = 500_000  # characters of a cell that are kept; what it prints beyond is thrown away as it comes


class ExecuteToTheEnd(Execute):
    """Runs every cell, whatever the ones before did: a submission loses the points of its mistakes and no others.

    nbgrader's own stops a cell that takes too long, and gives the whole submission up when the kernel dies, cannot be
    interrupted or prints without end. Here the kernel is started again then, and the next task goes on in a fresh one:
    every task of the problem sets begins with its own imports. And a warning is no wrong answer: nbgrader takes
    whatever a test writes to standard error for a failure.
    """

    warnings_cost = Bool(False, help="Whether what is written to standard error costs the points of a test.").tag(
        config=True
    )

    def preprocess_cell(self, cell, resources, index):
        self._printed = 0
        try:
            cell, resources = super().preprocess_cell(cell, resources, index)
        except DeadKernelError:
            message = "The kernel died: out of memory, or ended by this cell. The cells below run in a new one."
            cell.outputs.append(new_output("error", ename="DeadKernelError", evalue=message, traceback=[message]))
            self.nb.cells[index] = cell
            self._start_again()
        else:
            stopped = any(o.output_type == "error" and o.ename == "CellTimeoutError" for o in cell.get("outputs", ()))
            if stopped and not self._answers():
                self._start_again()
        return cell, resources

    def process_message(self, msg, cell, cell_index):
        """Takes a message of the kernel for a cell, unless the cell has said too much already."""
        content = msg["content"]
        if msg["msg_type"] == "stream":
            size = len(content["text"])
            if not self.warnings_cost:
                content["name"] = "stdout"
        elif msg["msg_type"] in ("display_data", "execute_result", "update_display_data"):
            size = sum(len(str(value)) for value in content["data"].values())
        else:
            size = 0
        self._printed += size
        if size and self._printed > MOST_OUTPUT:
            if self._printed - size > MOST_OUTPUT:
                return None
            if msg["msg_type"] != "stream":  # half a picture is none
                return None
            content["text"] = content["text"][: max(0, size - self._printed + MOST_OUTPUT)] + "\n... and so on"
        return super().process_message(msg, cell, cell_index)

    def _answers(self) -> bool:
        """Whether the kernel is free again after its cell was interrupted."""
        timeout, self.timeout = self.timeout, 5
        try:
            return self.wait_for_reply(self.kc.kernel_info()) is not None
        finally:
            self.timeout = timeout

    def _start_again(self) -> None:
        run_sync(self.km.restart_kernel)(now=True)
        run_sync(self.kc.wait_for_ready)(timeout=self.startup_timeout)


class CopiesAreCode(DeduplicateIds):
    """Of a cell that was copied with its grade id, the last keeps the id, and the others become ordinary cells.

    nbgrader's own leaves the others an empty entry, takes that for metadata of an old version, and stops grading there,
    with all students who come after.
    """

    def preprocess_cell(self, cell, resources, cell_index):
        cell, resources = super().preprocess_cell(cell, resources, cell_index)
        if not cell.metadata.get("nbgrader", True):
            del cell.metadata["nbgrader"]
        return cell, resources


TOOLS = str(pathlib.Path(sys.executable).parent)
if TOOLS not in os.environ.get("PATH", "").split(os.pathsep):  # nbgrader calls alembic by its name alone
    os.environ["PATH"] = os.pathsep.join([TOOLS, os.environ.get("PATH", "")])

c = get_config()  # noqa: F821 (nbgrader defines it)

c.CourseDirectory.course_id = "moving-people"
c.IncludeHeaderFooter.header = ""  # the source notebooks are whole

c.Autograde.sanitize_preprocessors = [
    CopiesAreCode if step is DeduplicateIds else step for step in Autograde.sanitize_preprocessors.default()
]
c.Autograde.autograde_preprocessors = [
    ExecuteToTheEnd if step is Execute else step for step in Autograde.autograde_preprocessors.default()
]
# Seconds. A cell that takes longer is stopped and costs its own points; the slowest of a solution takes a few.
c.Execute.timeout = 120
c.Execute.iopub_timeout = 20  # seconds for what a cell printed to arrive; the usual 4 are few beside other work
c.Execute.raise_on_iopub_timeout = False
c.LimitOutput.max_lines = 200
