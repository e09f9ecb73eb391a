// A canvas for a path along the ground, seen from above; stands after page.js in one module.
// pathCanvas(el, model): model is anywidget's. Its path (points [x, z] in metres) and pace (m/s) go to Python when pen
// or key comes up; spec, walked, note and busy come from there. z runs to the right and x up, so that headings
// turn as angles do: to the left is positive.

const SPANS = [6, 8, 10, 12, 16, 20, 24, 32, 40, 60, 80, 120, 160, 240, 400, 800, 1600, 4000, 12000]; // metres across
const AHEAD = { ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] };
const SLIDE = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -5, PageUp: 5, Home: -1e6, End: 1e6 };

export function pathCanvas(el, model) {
  const spec = model.get('spec'), shadow = el.shadowRoot || el.attachShadow({ mode: 'open' });
  shadow.replaceChildren();
  make('style', shadow, { textContent: spec.style });
  const root = make('div', shadow, { className: 'canvas', role: 'group', ariaLabel: spec.title });
  root.style.width = spec.width + 'px';
  make('h4', root, { textContent: spec.title });
  const bar = make('nav', root, { ariaLabel: 'Prepared paths and tools' });
  const prepared = make('span', bar, { className: 'set' });
  for (const [name, points] of spec.prepared) {
    const button = make('button', prepared, { type: 'button', title: `Take the prepared path: ${name}` });
    const icon = makeSvg(button, 'svg', { viewBox: '-9 -9 18 18', width: 18, height: 18, 'aria-hidden': 'true' });
    makeSvg(icon, 'path', { d: iconOf(points) });
    make('span', button, { textContent: name });
    button.onclick = () => { commit(points); fit(points); };
  }
  const tools = make('span', bar, { className: 'set' });
  const tool = (text, label, title, onclick) => make('button', tools, { type: 'button', textContent: text, ariaLabel: label, title, onclick });
  const undoButton = tool('undo', 'Undo', 'Undo (Backspace)', () => step(-1));
  const redoButton = tool('redo', 'Redo', 'Redo (Ctrl+Y)', () => step(1));
  const clearButton = tool('clear', 'Clear', 'Clear (Delete)', () => commit([]));
  tool('−', 'Show more ground', 'Show more ground (-)', () => zoom(1));
  tool('+', 'Show less ground', 'Show less ground (+)', () => zoom(-1));
  const surface = makeSvg(root, 'svg', { class: 'surface', tabindex: 0, role: 'application',
    'aria-roledescription': 'drawing surface', 'aria-label': 'Path seen from above. Draw with mouse, pen or finger, or '
    + 'with the arrow keys, half a metre each; with Shift a tenth. Backspace takes back, Delete clears, Enter sends.' });
  const foot = make('div', root, { className: 'foot' });
  const label = make('label', foot, {});
  const says = make('span', label, { className: 'says' });
  const pace = make('input', label, { type: 'range', min: spec.paces[0], max: spec.paces[1], step: 0.1, ariaLabel: 'Pace' });
  const readout = make('output', foot, { ariaLive: 'off' });
  const note = make('p', root, { className: 'note', role: 'status' });
  const spoken = make('p', root, { className: 'spoken', role: 'status' });

  // state
  const S = { path: model.get('path'), pen: null, stroke: null, centre: [0, 0], span: spec.metres };
  let history = [S.path], now = 0, waiting = 0;
  const held = new Set();
  const far = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);
  const metres = points => points.slice(1).reduce((sum, p, i) => sum + far(points[i], p), 0);
  const end = points => points[points.length - 1];
  const round = p => p.map(v => Math.round(v * 1000) / 1000);
  const shown = () => S.stroke || S.path;
  const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);

  function change(points) { // to another path, not yet told to Python
    S.path = points.map(round);
    redraw();
  }
  function keep() { // as a step that can be undone
    if (same(S.path, history[now])) return;
    history = [...history.slice(0, now + 1), S.path].slice(-200);
    now = history.length - 1;
  }
  function send() {
    clearTimeout(waiting);
    waiting = 0;
    const length = metres(S.path);
    if (S.path.length && length < 0.05 || same(S.path, model.get('path'))) return;
    model.set('walked', []);
    model.set('path', S.path);
    model.save_changes();
    spoken.textContent = S.path.length ? `Path of ${length.toFixed(1)} metres, ${S.path.length} points.` : 'No path.';
  }
  function commit(points) {
    change(points);
    keep();
    send();
    redraw();
  }
  function step(by) {
    if (!history[now + by]) return;
    now += by;
    change(history[now]);
    reveal(S.path);
    send();
  }
  function extend(by, points = S.path) { // a straight piece further
    const from = points.length ? end(points) : [0, 0];
    change([...(points.length ? points : [from]), [from[0] + by[0], from[1] + by[1]]]);
    keep();
    reveal([end(S.path)]);
    clearTimeout(waiting); // while keys follow one another Python need not know of each
    waiting = setTimeout(send, 600);
  }

  // the part of the ground that is seen
  let W = 0, H = 0, k = 1; // pixels; pixels a metre
  const at = p => [W / 2 + (p[1] - S.centre[1]) * k, H / 2 - (p[0] - S.centre[0]) * k];
  const ground = (x, y) => [S.centre[0] - (y - H / 2) / k, S.centre[1] + (x - W / 2) / k];
  const place = e => {
    const box = surface.getBoundingClientRect();
    return ground(e.clientX - box.left, e.clientY - box.top);
  };
  function fit(points) {
    if (!points.length || !W) return;
    const [low, high] = [Math.min, Math.max].map(most => [0, 1].map(c => points.reduce((m, p) => most(m, p[c]), points[0][c])));
    const wide = Math.max(high[1] - low[1], (high[0] - low[0]) * W / H) * 1.02 + 1.6;
    S.span = SPANS.find(s => s >= Math.max(wide, Math.min(spec.metres, 12))) || wide;
    S.centre = [0, 1].map(c => Math.round(low[c] + high[c]) / 2);
    redraw();
  }
  function reveal(points) {
    const inside = ([x, y]) => x > 12 && y > 12 && x < W - 12 && y < H - 12;
    if (points.length && !points.every(p => inside(at(p)))) fit(S.path);
  }
  function zoom(by) {
    const i = SPANS.findIndex(s => s >= S.span);
    S.span = SPANS[clamp(i + by, 0, SPANS.length - 1)];
    redraw();
  }

  // pen, mouse, finger
  surface.onpointerdown = e => {
    if (S.pen !== null || e.button) return;
    S.pen = e.pointerId;
    surface.setPointerCapture(e.pointerId);
    root.classList.add('byhand');
    surface.focus({ preventScroll: true });
    const from = place(e), tip = S.path.length && end(S.path);
    S.from = from;
    S.begun = tip && far(tip, from) * k < 20 ? S.path : [from]; // from its end on, or anew
  };
  surface.onpointermove = e => {
    if (e.pointerId !== S.pen) return;
    const all = e.getCoalescedEvents?.() || [];
    for (const p of (all.length ? all : [e]).map(place)) {
      if (!S.stroke && far(S.from, p) * k < 5) continue;
      S.stroke ||= [...S.begun];
      if (far(end(S.stroke), p) * k > 3) S.stroke.push(p);
    }
    redraw();
  };
  surface.onpointerup = e => {
    if (e.pointerId !== S.pen) return;
    const stroke = S.stroke, last = place(e);
    S.pen = S.stroke = null;
    if (stroke) commit(far(end(stroke), last) * k > 1 ? [...stroke, last] : stroke);
    else commit(S.path.length && far(end(S.path), last) * k < 5 ? S.path : [...S.path, last]); // a tap: straight there
    reveal(S.path);
  };
  surface.onpointercancel = e => {
    if (e.pointerId !== S.pen) return;
    S.pen = S.stroke = null;
    redraw();
  };

  // pace
  const word = v => v < 0.9 ? 'a stroll' : v < 1.9 ? 'a walk' : v < 2.6 ? 'a jog' : 'a run';
  function setPace(value) {
    pace.value = value;
    pace.oninput();
    pace.onchange();
  }
  pace.oninput = () => redraw();
  pace.onchange = () => {
    if (+pace.value === model.get('pace')) return;
    clearTimeout(waiting);
    waiting = setTimeout(() => {
      send();
      model.set('pace', +pace.value);
      model.save_changes();
    }, 250);
  };

  // keys; JupyterLab takes them on the document while they are still on their way down: ours come first
  const keys = {
    Backspace: () => step(-1), Delete: () => commit([]), Enter: () => send(),
    '+': () => zoom(-1), '=': () => zoom(-1), '-': () => zoom(1),
  };
  function onKey(e) {
    const on = shadow.activeElement, taken = () => { e.preventDefault(); e.stopImmediatePropagation(); };
    root.classList.remove('byhand');
    if (e.type === 'keyup') { held.delete(e.key); return; }
    if (e.metaKey || e.altKey || !on) return;
    if (e.ctrlKey) {
      const by = { z: e.shiftKey ? 1 : -1, y: 1 }[e.key.toLowerCase()];
      if (by) { step(by); taken(); }
    } else if (on === pace) {
      if (!SLIDE[e.key]) return;
      setPace(clamp(+pace.value + SLIDE[e.key] / 10, ...spec.paces));
      taken();
    } else if (on !== surface) {
      if (e.key === ' ' || e.key === 'Enter') e.stopImmediatePropagation(); // the button is pressed all the same
    } else if (AHEAD[e.key]) { // two held together go across
      held.add(e.key);
      const by = [...held].reduce((sum, name) => [0, 1].map(c => sum[c] + AHEAD[name][c]), [0, 0]), long = Math.hypot(...by);
      if (long) extend(by.map(v => v / long * (e.shiftKey ? 0.1 : 0.5)));
      taken();
    } else if (keys[e.key]) { keys[e.key](); taken(); }
  }
  const listen = on => { for (const type of ['keydown', 'keyup']) window[on](type, onKey, true); };
  root.addEventListener('focusin', () => listen('addEventListener'));
  root.addEventListener('focusout', () => { held.clear(); listen('removeEventListener'); });

  // drawing
  function iconOf(points) {
    const z = points.map(p => p[1]), x = points.map(p => p[0]);
    const mid = v => (Math.min(...v) + Math.max(...v)) / 2, size = Math.max(...[x, z].map(v => Math.max(...v) - Math.min(...v)));
    return lineOf(points.map(p => [(p[1] - mid(z)) * 16 / size, -(p[0] - mid(x)) * 16 / size]));
  }
  function lineOf(corners) {
    return corners.map(([x, y], i) => `${i ? 'L' : 'M'}${x.toFixed(1)} ${y.toFixed(1)}`).join('');
  }
  function along(points, s) { // -> place and direction on the screen, s metres along
    for (let i = 1; i < points.length; i++) {
      const d = far(points[i - 1], points[i]);
      if (s <= d + 1e-9 && d || i === points.length - 1) {
        const [a, b] = [at(points[i - 1]), at(points[i])], share = d ? Math.min(1, s / d) : 1;
        return [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), Math.atan2(b[1] - a[1], b[0] - a[0])];
      }
      s -= d;
    }
    return null;
  }
  function arrow([x, y, angle], corners) {
    const c = Math.cos(angle), s = Math.sin(angle);
    return lineOf(corners.map(([u, v]) => [x + c * u - s * v, y + s * u + c * v])) + 'z';
  }
  let asked = 0;
  function redraw() { asked ||= requestAnimationFrame(paint); }
  function paint() {
    asked = 0;
    W = surface.clientWidth;
    H = Math.round(Math.min(spec.height, W * 0.8));
    if (!W) return;
    surface.style.height = H + 'px';
    surface.setAttribute('viewBox', `0 0 ${W} ${H}`);
    k = W / S.span;
    surface.replaceChildren();
    grid();
    const points = shown(), speed = +pace.value, length = metres(points), walked = S.stroke ? [] : model.get('walked');
    if (points.length > 1) {
      makeSvg(surface, 'path', { class: walked.length > 1 ? 'line under' : 'line', d: lineOf(points.map(at)) });
      const every = Math.ceil(22 / (speed * k)); // an arrow each second, or so many seconds
      let marks = '';
      for (let t = every; t * speed < length - 12 / k && t < 400 * every; t += every) {
        marks += arrow(along(points, t * speed), [[7, 0], [-5, 6], [-2.5, 0], [-5, -6]]);
      }
      if (walked.length < 2) makeSvg(surface, 'path', { class: 'second', d: marks });
    }
    if (walked.length > 1) makeSvg(surface, 'path', { class: 'walked', d: lineOf(walked.map(at)) });
    if (points.length) ends(points, length);
    else {
      makeSvg(surface, 'text', { class: 'hint halo', x: W / 2, y: H / 2 - 6, 'text-anchor': 'middle' }, 'Draw a path here');
      makeSvg(surface, 'text', { class: 'hint halo small', x: W / 2, y: H / 2 + 16, 'text-anchor': 'middle' }, 'with mouse, pen, finger or arrow keys');
    }
    if (history.length === 1 && points.length && !S.stroke) {
      makeSvg(surface, 'text', { class: 'hint halo small', x: W / 2, y: 20, 'text-anchor': 'middle' }, 'draw here with mouse, pen or finger');
    }
    if (walked.length > 1) legend();
    says.replaceChildren('pace ', Object.assign(document.createElement('b'), { textContent: speed.toFixed(1) + ' m/s' }), `, ${word(speed)}`);
    pace.ariaValueText = `${speed.toFixed(1)} metres a second, ${word(speed)}`;
    readout.title = 'The small arrows show the way and the pace: about one a second';
    readout.textContent = points.length > 1 ? `${length.toFixed(1)} m · ${(length / speed).toFixed(1)} s` : '';
    [undoButton.disabled, redoButton.disabled, clearButton.disabled] = [now === 0, now === history.length - 1, !S.path.length];
    note.textContent = model.get('busy') ? 'walking …' : model.get('note');
    note.classList.toggle('busy', model.get('busy'));
    root.classList.toggle('drawing', !!S.stroke);
    api.drawn++;
  }
  function grid() {
    const cell = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000].find(c => c * k >= 38) || 5000, lines = ['', ''];
    const [left, right] = [ground(0, 0)[1], ground(W, 0)[1]], [low, high] = [ground(0, H)[0], ground(0, 0)[0]];
    const marks = [];
    for (let z = Math.ceil(left / cell); z * cell <= right; z++) {
      const x = at([0, z * cell])[0];
      lines[+!z] += `M${x} 0V${H}`;
      if (x > 34 && x < W - 40) marks.push([x, H - 7, 'middle', z * cell]);
    }
    for (let x = Math.ceil(low / cell); x * cell <= high; x++) {
      const y = at([x * cell, 0])[1];
      lines[+!x] += `M0 ${y}H${W}`;
      if (y > 26 && y < H - 26) marks.push([6, y + 4, 'start', x * cell]);
    }
    makeSvg(surface, 'path', { class: 'grid', d: lines[0] });
    makeSvg(surface, 'path', { class: 'grid zero', d: lines[1] });
    for (const [x, y, anchor, text] of marks) makeSvg(surface, 'text', { x, y, 'text-anchor': anchor, class: 'halo' }, String(text).replace('-', '−'));
    makeSvg(surface, 'text', { x: W - 6, y: H - 7, 'text-anchor': 'end', class: 'halo axis' }, 'z, m');
    makeSvg(surface, 'text', { x: 6, y: 16, class: 'halo axis' }, 'x, m');
  }
  function ends(points, length) {
    const [x, y] = at(points[0]);
    if (points.length > 1) {
      makeSvg(surface, 'path', { class: 'tip', d: arrow(along(points, length), [[9, 0], [-7, 7], [-4, 0], [-7, -7]]) });
    }
    makeSvg(surface, 'circle', { class: 'start', cx: x, cy: y, r: 5.5 });
    const above = points.length > 1 && along(points, 0.3)[1] > y ? -12 : 21;
    makeSvg(surface, 'text', { class: 'halo name', x, y: y + above, 'text-anchor': 'middle' }, 'start');
  }
  function legend() {
    const x = W - 8, each = [['line under', 'asked for'], ['walked', 'walked']];
    each.forEach(([name, text], i) => {
      makeSvg(surface, 'path', { class: name, d: `M${x - 22} ${14 + 17 * i}h22` });
      makeSvg(surface, 'text', { class: 'halo', x: x - 28, y: 18 + 17 * i, 'text-anchor': 'end' }, text);
    });
  }

  // what comes from Python
  const heard = {
    path() {
      const path = model.get('path');
      if (same(path, S.path) || S.pen !== null) return;
      S.path = path;
      keep();
      reveal(path);
    },
    pace() { if (shadow.activeElement !== pace) pace.value = model.get('pace'); },
    walked() {}, note() {}, busy() {},
  };
  const hear = Object.entries(heard).map(([name, call]) => [`change:${name}`, () => { call(); redraw(); }]);
  for (const one of hear) model.on(...one);

  const endTheme = onTheme(dark => root.classList.toggle('dark', dark));
  let width = 0, still = null;
  const size = new ResizeObserver(() => {
    if (!surface.clientWidth || surface.clientWidth === width) return;
    const first = !width;
    width = surface.clientWidth;
    paint();
    if (first) fit(S.path);
    // the picture before it is for pages in which nobody can draw; the notebook keeps it
    still ||= el.closest('.jp-OutputArea-child')?.previousElementSibling;
    const picture = model.get('picture');
    if (!picture || !still?.querySelector('img')?.src.endsWith(picture)) still = null;
    if (still) still.style.display = 'none';
  });
  const api = el.canvas = { state: S, drawn: 0, at, ground, dispose };
  function dispose() {
    clearTimeout(waiting);
    if (asked) cancelAnimationFrame(asked);
    for (const one of hear) model.off(...one);
    if (still) still.style.display = '';
    size.disconnect();
    endTheme();
    listen('removeEventListener');
    shadow.replaceChildren();
  }
  pace.value = model.get('pace');
  size.observe(root);
  return api;
}
