"""A page with path canvases as JupyterLab would fill them; in the kernel's place a model that keeps what it is sent."""

from __future__ import annotations

import json
import pathlib

from tutorial_lib.view import PathCanvas

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


def page_of(canvases: list[PathCanvas], path: pathlib.Path, copies: int = 1) -> str:
    """Write the page, each canvas ``copies`` times on the same model; its address."""
    names = ("path", "pace", "walked", "note", "busy", "spec", "picture")
    states = [{name: getattr(canvas.widget, name) for name in names} for canvas in canvases]
    script = canvases[0].widget._esm.replace("export default { render };", "")
    hosts = "<div class=host></div><br>" * (len(canvases) * copies)
    text = json.dumps(states).replace("<", "\\u003c")
    path.write_text(_PAGE.format(hosts=hosts, script=script, states=text), encoding="utf-8")
    return path.as_uri()
