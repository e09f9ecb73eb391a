"""A page with anywidgets as JupyterLab would fill them; in the kernel's place a model that keeps what it is sent."""

from __future__ import annotations

import json
import pathlib

from anywidget import AnyWidget

from tutorial_lib.view import Fan, PathCanvas

CANVAS = "document.querySelectorAll('.host')[0].canvas"

_PAGE = """<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content="width=device-width">
<style>:root {{ color-scheme: light dark }} body {{ margin: 16px }}</style>
{hosts}
<script type=module>
{script}
class Model {{
  constructor(state) {{ this.state = state; this.told = []; this.heard = {{}}; }}
  get(name) {{ return this.state[name]; }}
  set(name, value) {{
    if (JSON.stringify(this.state[name]) === JSON.stringify(value)) return;
    this.state[name] = value;
    this.dirty = {{ ...this.dirty, [name]: value }};
    for (const call of this.heard['change:' + name] || []) call();
  }}
  save_changes() {{ if (this.dirty) this.told.push(this.dirty); this.dirty = null; }}
  on(name, call) {{ (this.heard[name] ||= []).push(call); }}
  off(name, call) {{ this.heard[name] = this.heard[name].filter(other => other !== call); }}
}}
window.models = {states}.map(state => new Model(state));
const hosts = [...document.querySelectorAll('.host')];
window.leave = hosts.map((el, i) => render({{ model: models[i % models.length], el }}));
</script>"""


def page_of(shown: list[PathCanvas] | list[Fan], path: pathlib.Path, copies: int = 1) -> str:
    """Write the page, each widget ``copies`` times on the same model; its address."""
    every = AnyWidget.class_trait_names(sync=True)
    own = [name for name in shown[0].widget.trait_names(sync=True) if name not in every and not name.startswith("_")]
    states = [{name: getattr(one.widget, name) for name in own} for one in shown]
    script = shown[0].widget._esm.replace("export default { render };", "")
    hosts = "<div class=host></div><br>" * (len(shown) * copies)
    text = json.dumps(states).replace("<", "\\u003c")
    path.write_text(_PAGE.format(hosts=hosts, script=script, states=text), encoding="utf-8")
    return path.as_uri()
