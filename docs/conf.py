"""The lessons and the library as a static site, made from the repository's root by
``python -m sphinx -c docs . docs/_build/html``.

The source is the repository itself, so that the lessons are the notebooks and not copies of them; they are shown with
the outputs that they have and not run. Nothing is asked of the network, neither by the build nor by the pages.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import importlib.metadata
import io
import json
import pathlib
import shlex
import sys

from docutils import nodes
from docutils.parsers.rst import Directive

ROOT = pathlib.Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]

project = "How neural networks make people move"
author = "the project's authors"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "sphinx.ext.viewcode"]

root_doc = "docs/index"
include_patterns = ["docs/**", "notebooks/**", "CONTRIBUTING.md", "README.md"]
_read = {"docs", "notebooks", "CONTRIBUTING.md", "README.md"}
exclude_patterns = [path.name for path in ROOT.iterdir() if path.name not in _read]
exclude_patterns += ["docs/_*", "**/.ipynb_checkpoints", "notebooks/exercises/*/**"]  # nbgrader's folders

# --- lessons
nb_execution_mode = "off"
nb_ipywidgets_js = {}  # these scripts would come from other hosts; figures here need none
nb_merge_streams = True
myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath"]
myst_heading_anchors = 3
suppress_warnings = [
    "mystnb.unknown_mime_type",  # a widget: its picture is shown
    "misc.highlighting_failure",
    "myst.header",
    "myst.xref_missing",  # links of a lesson or the README to files that are no pages
]

# --- the library
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_default_options = {"members": True}
add_module_names = False
toc_object_entries = False

# --- pages
html_theme = "furo"
html_title = project
templates_path = ["_templates"]
html_additional_pages = {"index": "to_docs.html"}  # the site's first address leads to root_doc
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_copy_source = False
html_show_sphinx = False
html_favicon = "_static/favicon.svg"


def _mathjax() -> str:
    """The file of MathJax that draws formulas as SVG and needs no fonts, from the installed package."""
    name = "sphinx-mathjax-offline"
    for file in importlib.metadata.files(name) or ():
        if file.name == "tex-svg.js":
            return str(file.locate())
    raise RuntimeError(f"{name} is installed without tex-svg.js: pip install -c constraints.txt -e '.[docs]'")


html_static_path = ["_static", _mathjax()]
mathjax_path = "tex-svg.js"


class CommandOutput(Directive):
    """``{command} results``: what ``python -m tutorial_lib results`` prints now, which is Markdown."""

    required_arguments = 1
    final_argument_whitespace = True
    option_spec = {}

    def run(self):
        from tutorial_lib.cli import main

        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            status = main(shlex.split(self.arguments[0]))
        if status:
            raise self.error(f"python -m tutorial_lib {self.arguments[0]} ended with status {status}")
        shown = nodes.container(classes=["command-output"])
        self.state.nested_parse(printed.getvalue().splitlines(), 0, shown)
        said = nodes.paragraph("", "", nodes.literal("", f"python -m tutorial_lib {self.arguments[0]}"))
        return [said, shown]


def describe_stills(app, doctree):
    """The picture that stands before a moving figure is known by its words, which myst-nb leaves out."""
    path = ROOT / f"{app.env.docname}.ipynb"
    if not path.exists():
        return
    words = {}
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        for output in cell.get("outputs", ()):
            if alt := output.get("metadata", {}).get("image/png", {}).get("alt"):
                data = output["data"]["image/png"]
                picture = base64.b64decode(data if isinstance(data, str) else "".join(data))
                words[hashlib.sha256(picture).hexdigest()] = alt
    for image in doctree.findall(nodes.image):
        if alt := words.get(pathlib.PurePath(image["uri"]).stem):
            image["alt"] = alt
            image["classes"].append("still")
        else:
            image.setdefault("alt", "Figure, described in the text around it")


def setup(app):
    from docstrings import process

    app.add_directive("command", CommandOutput)
    app.connect("autodoc-process-docstring", process)
    app.connect("doctree-read", describe_stills)
