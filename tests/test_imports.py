"""Importing does nothing but define names, and imports run only downwards."""

from __future__ import annotations

import ast
import json
import pathlib
import subprocess
import sys

import pytest

import tutorial_lib

PACKAGE = pathlib.Path(tutorial_lib.__file__).parent

# Each room stands on the ones before it; rooms of one floor do not know each other.
FLOORS = (
    {"errors", "atomic", "threads"},
    {"chance"},
    {"motion"},
    {"representations", "metrics", "diversity"},
    {"models"},
    {"data", "cleanup", "control"},
    {"training"},
    {"generate"},
    {"generate_control", "generate_futures"},
    {"walk"},
    {"evaluate", "recipes", "clip_errors", "actions"},
    {"evaluate_control"},
    {"pretrained"},
    {"view"},
    {"reproduce"},
    {"cli"},
    {"__main__"},
)
# A player shows motions: it knows what a motion is and how it is measured, not how one is learned.
ONLY = {"view": {"errors", "chance", "atomic", "motion", "metrics", "view"}}


def modules() -> dict[str, pathlib.Path]:
    """Every module's dotted name below the package, ``motion.bvh``, and its file."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(name: str, path: pathlib.Path, known: set[str], top_only: bool = False) -> set[str]:
    """The package's own modules that a module imports, anywhere in it, or only when it is itself imported."""
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    package = [p for p in package if p]
    found = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    inner = {
        id(n) for f in ast.walk(tree) if isinstance(f, ast.FunctionDef | ast.AsyncFunctionDef) for n in ast.walk(f)
    }
    guarded = {
        id(n)
        for f in ast.walk(tree)
        if isinstance(f, ast.If) and "TYPE_CHECKING" in ast.unparse(f.test)
        for n in ast.walk(f)
    }
    for node in ast.walk(tree):
        if top_only and (id(node) in inner or id(node) in guarded):
            continue
        if isinstance(node, ast.Import):
            targets = [a.name for a in node.names if a.name.split(".")[0] == "tutorial_lib"]
            found |= {t.removeprefix("tutorial_lib").lstrip(".") for t in targets}
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                base = package[: len(package) - (node.level - 1)]
            elif (node.module or "").split(".")[0] == "tutorial_lib":
                base = []
            else:
                continue
            tail = (node.module or "").split(".") if node.level else (node.module or "").split(".")[1:]
            base = [p for p in (*base, *tail) if p]
            for alias in node.names:  # "from .motion import bvh" names a module, "... import Motion" what is in one
                whole = ".".join((*base, alias.name))
                found.add(whole if whole in known else ".".join(base))
    return found & known


GRAPH = {name: imported(name, path, set(modules())) for name, path in modules().items()}


def test_imports_are_found():
    """The reading of the source finds what is surely there; else the tests below could not fail."""
    assert {"errors", "atomic", "motion.clip", "motion.rotations"} <= GRAPH["motion.bvh"]
    assert {"motion.bvh", "motion.skeleton"} <= GRAPH["motion"]


def test_every_module_has_its_floor():
    rooms = {name.split(".")[0] for name in GRAPH if name}
    assert rooms <= set().union(*FLOORS), "a new module: say in FLOORS what it may stand on"


@pytest.mark.parametrize("name", sorted(GRAPH))
def test_imports_run_downwards(name):
    floor = {room: k for k, rooms in enumerate(FLOORS) for room in rooms}
    room = name.split(".")[0]
    for other in GRAPH[name]:
        below = other.split(".")[0]
        if not room:
            raise AssertionError(f"tutorial_lib itself imports {other}: every import would pay for it")
        if below and below != room:
            assert floor[below] < floor[room], f"{name} imports {other}, which stands above or beside it"
            assert room not in ONLY or below in ONLY[room], f"{name} imports {other}"


def test_no_circle_among_modules():
    """Also within a room, for what runs when a module is imported."""
    graph = {n: imported(n, p, set(modules()), top_only=True) - {n} for n, p in modules().items()}
    done: set[str] = set()

    def visit(name: str, path: tuple[str, ...]):
        assert name not in path, f"a circle of imports: {' -> '.join((*path[path.index(name) :], name))}"
        if name not in done:
            for other in sorted(graph[name]):
                # importing from the package's own folder goes through its __init__, which is then half done
                visit(other, (*path, name))
            done.add(name)

    for name in sorted(graph):
        visit(name, ())


PROBE = r"""
import importlib, json, os, random, sys
import numpy, torch, scipy.spatial

threads = torch.get_num_threads(), torch.get_num_interop_threads()
environment = dict(os.environ)
key, place = numpy.random.get_state()[1:3]
state = torch.get_rng_state().clone(), key.copy(), place, random.getstate()


def torch_defaults():
    return torch.get_default_dtype(), torch.is_grad_enabled(), torch.are_deterministic_algorithms_enabled()


default = torch_defaults()
errors = numpy.geterr()
opened, connected = [], []

def watch(event, args):
    if event == "open" and isinstance(args[0], (str, bytes, os.PathLike)):
        opened.append((os.fsdecode(args[0]), args[1]))
    # not socket.bind: urllib3 asks the machine whether it has IPv6, on the loopback address, when pooch imports it
    elif event in ("socket.connect", "socket.getaddrinfo", "subprocess.Popen", "os.system"):
        connected.append((event, str(args)))
    elif event in ("os.mkdir", "os.rename", "os.remove"):
        opened.append((f"{event} {args[0]}", "w"))

sys.addaudithook(watch)
for name in sys.argv[1:]:
    importlib.import_module(name)

package = os.path.dirname(sys.modules["tutorial_lib"].__file__)
mine = [
    [name, mode] for name, mode in opened
    if (os.path.abspath(name).startswith(package) and not name.endswith((".py", ".pyc")) and "__pycache__" not in name)
    or name.endswith((".bvh", ".amc", ".asf", ".safetensors"))
]
print(json.dumps({
    "threads": threads == (torch.get_num_threads(), torch.get_num_interop_threads()),
    "torch seed": bool((state[0] == torch.get_rng_state()).all()),
    "numpy seed": bool((state[1] == numpy.random.get_state()[1]).all() and state[2] == numpy.random.get_state()[2]),
    "python seed": state[3] == random.getstate(),
    "defaults": default == torch_defaults(),
    "numpy errors": errors == numpy.geterr(),
    "files": mine,
    "connections": connected,
    "pyplot": "matplotlib.pyplot" in sys.modules,
    "environment": environment == dict(os.environ),
}))
"""


def test_importing_has_no_effect():
    names = ["tutorial_lib", *(f"tutorial_lib.{name}" for name in GRAPH if name and name != "__main__")]
    result = subprocess.run(
        [sys.executable, "-W", "error::DeprecationWarning:tutorial_lib", "-c", PROBE, *names],
        capture_output=True,
        text=True,
        cwd=PACKAGE.parent,
        timeout=120,
    )
    assert result.returncode == 0, result.stderr
    *printed, last = result.stdout.strip().splitlines()
    assert not printed, "nothing is printed on import"
    found = json.loads(last)
    assert found.pop("pyplot") is False, "matplotlib.pyplot chooses a backend for the whole program when imported"
    assert found.pop("files") == [] and found.pop("connections") == []
    assert all(found.values()), found
