// The explorer of u and v; stands after page.js, player.js and stage.js in one module and uses what is in them.
// explore(el, spec, bytes): spec comes from explorer.py; bytes are the cells' player payloads one after another.

const ARROWS = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -1, PageUp: 1, Home: -1e6, End: 1e6 };

export function explore(el, spec, bytes) {
  const shadow = el.shadowRoot || el.attachShadow({ mode: 'open' });
  shadow.replaceChildren();
  const pair = (u, v) => v ? `u = ${u}, v = ${v}` : 'teacher forcing';
  const cellAt = (u, v) => spec.cells.find(c => c.v === v && (!v || c.u === u));

  make('style', shadow, { textContent: spec.style });
  const root = make('div', shadow, { className: 'explorer', role: 'group', ariaLabel: spec.title });
  root.style.width = spec.width + 'px';
  make('h4', root, { textContent: spec.title });
  const choice = make('div', root, { className: 'row' }), sliders = make('div', choice, { className: 'sliders' });
  const map = makeSvg(choice, 'svg', { class: 'map', role: 'img', 'aria-label': 'The trained pairs of u and v' });
  const S = { u: spec.start[0], v: spec.start[1], over: null };
  const inputs = [['u', 'frames of truth in a row', spec.us], ['v', 'own frames in a row', spec.vs]].map(([name, says, values]) => {
    const label = make('label', sliders, {});
    make('b', label, { textContent: name });
    make('span', label, { textContent: ` ${says}: ` });
    const number = make('strong', label, {});
    const input = make('input', label, { type: 'range', min: 0, max: values.length - 1, step: 1,
      ariaLabel: `${name}, ${says}`, disabled: values.length < 2, oninput: () => set(+input.value) });
    const ticks = make('span', label, { className: 'ticks', ariaHidden: 'true' });
    values.forEach((value, i) => {
      make('i', ticks, { textContent: value }).style.left = `${100 * i / Math.max(1, values.length - 1)}%`;
    });
    const set = i => choose({ ...S, [name]: values[clamp(i, 0, values.length - 1)] });
    const show = () => {
      input.value = values.indexOf(S[name]);
      number.textContent = input.ariaValueText = S[name] || '0, teacher forcing';
    };
    return { input, set, show };
  });
  const schedule = makeSvg(root, 'svg', { class: 'schedule', role: 'img' });
  const words = make('p', root, { role: 'status' });
  const found = make('div', root, { className: 'row' });
  const curves = makeSvg(found, 'svg', { class: 'curves', role: 'img', 'aria-label': `${spec.unit}, all pairs` });
  const facts = make('dl', found, {});
  const stage = makeStage(root);
  stage.root.hidden = !spec.player;
  const absent = make('p', stage.root, { className: 'absent' });

  // what is chosen
  function choose({ u, v }) {
    if (u === S.u && v === S.v) return;
    Object.assign(S, { u, v, over: null });
    update();
  }
  function update() {
    const { u, v } = S, cell = api.cell = cellAt(u, v) || null;
    for (const slider of inputs) slider.show();
    words.textContent = v
      ? `${u} frame${u > 1 ? 's' : ''} of truth, then ${v} of the network’s own, over and over: `
        + `${Math.round(100 * u / (u + v))} % of what it is fed is truth.`
      : 'The truth at every frame (teacher forcing): in training the network never meets its own output.';
    schedule.setAttribute('aria-label', words.textContent);
    facts.replaceChildren();
    const notes = cell ? cell.notes : [['not in the grid', 'No network was trained with this pair; the filled dots are those that were.']];
    facts.className = cell ? '' : 'none';
    make('div', facts, { className: 'name', textContent: pair(u, v) });
    for (const [name, value] of notes) {
      const entry = make('div', facts, {});
      make('dt', entry, { textContent: name });
      make('dd', entry, { textContent: value });
    }
    drawMap();
    drawSchedule();
    drawCurves();
    watch(cell);
  }

  // the grid
  function drawMap() {
    const { us, vs } = spec, step = 24, left = 30, W = left + step * us.length + 8, H = step * vs.length + 32;
    map.replaceChildren();
    for (const [name, value] of Object.entries({ viewBox: `0 0 ${W} ${H}`, width: W, height: H })) map.setAttribute(name, value);
    const x = i => left + step * (i + 0.5), y = i => step * (vs.length - i - 0.5) + 2;
    us.forEach((u, i) => makeSvg(map, 'text', { x: x(i), y: H - 17, 'text-anchor': 'middle', class: u === S.u ? 'on' : '' }, u));
    vs.forEach((v, i) => makeSvg(map, 'text', { x: left - 4, y: y(i) + 4, 'text-anchor': 'end', class: v === S.v ? 'on' : '' }, v));
    makeSvg(map, 'text', { x: x((us.length - 1) / 2), y: H - 3, 'text-anchor': 'middle' }, 'u');
    makeSvg(map, 'text', { x: 4, y: y((vs.length - 1) / 2) + 4 }, 'v');
    us.forEach((u, i) => vs.forEach((v, k) => {
      const cell = cellAt(u, v), spot = makeSvg(map, 'g', { class: `dot${cell ? ' known' : ''}` });
      if (u === S.u && v === S.v) makeSvg(spot, 'circle', { cx: x(i), cy: y(k), r: 9.5, class: 'chosen' });
      makeSvg(spot, 'circle', { cx: x(i), cy: y(k), r: cell ? 5 : 2 });
      makeSvg(spot, 'rect', { x: x(i) - step / 2, y: y(k) - step / 2, width: step, height: step, class: 'touch' });
      makeSvg(spot, 'title', {}, `${pair(u, v)}${cell ? '' : ' (not trained)'}`);
      spot.onclick = () => choose({ u, v });
    }));
  }

  // figure 1 of the paper: the network over time, fed the truth or its own last output
  function drawSchedule() {
    const W = schedule.getBoundingClientRect().width, H = 134, left = 56;
    if (!W) return;
    schedule.replaceChildren();
    schedule.setAttribute('viewBox', `0 0 ${W} ${H}`);
    schedule.setAttribute('height', H);
    const { u, v } = S, period = u + v, pitch = clamp(W / 36, 18, 22), count = Math.floor((W - left - 4) / pitch);
    const half = 0.29 * pitch, [out, net, fed] = [14, 52, 90], at = t => left + pitch * (t + 0.5);
    const own = t => t >= 0 && t % period >= u;
    for (const [text, y] of [['output', out], ['network', net], ['is fed', fed]]) makeSvg(schedule, 'text', { x: 0, y: y + 4 }, text);
    const box = (t, y, name, round = 2) => makeSvg(schedule, 'rect', { x: at(t) - half, y: y - half, width: 2 * half, height: 2 * half, rx: round, class: name });
    let wires = '', back = '', heads = '';
    for (let t = 0; t < count; t++) {
      const x = at(t);
      wires += `M${x} ${fed - half}V${net + half}M${x} ${net - half}V${out + half}`;
      if (t) wires += `M${at(t - 1) + half} ${net}H${x - half}`;
      if (!own(t)) continue;
      const gap = x - pitch / 2, r = pitch / 2 - half;
      back += `M${at(t - 1) + half} ${out}Q${gap} ${out} ${gap} ${out + r + 3}V${fed - r - 3}Q${gap} ${fed} ${x - half - 1} ${fed}`;
      heads += `M${x - half} ${fed}l-4.5 -3v6z`;
    }
    makeSvg(schedule, 'path', { d: wires, class: 'wire' });
    makeSvg(schedule, 'path', { d: back, class: 'back' });
    for (let t = 0; t < count; t++) {
      box(t, out, own(t + 1) && t + 1 < count ? 'result fed' : 'result', half);
      box(t, net, 'network');
      box(t, fed, own(t) ? 'own' : 'truth', 1);
    }
    makeSvg(schedule, 'path', { d: heads, class: 'head' });
    const brace = (from, to, text) => {
      if (to > count || from >= to) return;
      const a = at(from) - half, b = at(to - 1) + half, y = fed + half + 5;
      makeSvg(schedule, 'path', { d: `M${a} ${y}v5H${b}v-5`, class: 'brace' });
      makeSvg(schedule, 'text', { x: (a + b) / 2, y: y + 19, 'text-anchor': 'middle' }, text);
    };
    if (v) {
      brace(0, u, u > 2 ? `u = ${u}` : 'u');
      brace(u, period, v > 2 ? `v = ${v}` : 'v');
    }
    const legend = makeSvg(schedule, 'g', { 'text-anchor': 'end' });
    const entry = (name, x, text) => {
      makeSvg(legend, 'rect', { x: x - 11, y: H - 14, width: 10, height: 10, rx: 1, class: name });
      makeSvg(legend, 'text', { x: x - 16, y: H - 5 }, text);
    };
    entry('own', W - 2, 'own last output');
    entry('truth', W - 122, 'truth');
    api.frames = count;
  }

  // motion change
  const ticksOf = (top, most) => {
    const rough = top / most, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map(k => k * power).find(k => k >= rough - 1e-12), all = [];
    for (let k = 0; k * step <= top * (1 + 1e-9); k++) all.push(+(k * step).toPrecision(6));
    return all;
  };
  let plot = null; // -> where things lie in the picture
  function drawCurves() {
    const W = curves.getBoundingClientRect().width, H = 224, left = 40, low = H - 34, high = 22, right = W - 8;
    if (!W) return;
    curves.replaceChildren();
    curves.setAttribute('viewBox', `0 0 ${W} ${H}`);
    curves.setAttribute('height', H);
    const X = frame => left + (right - left) * frame / spec.frames, Y = value => low - (low - high) * value / spec.top;
    plot = { X, Y, left, right, low, high };
    makeSvg(curves, 'text', { x: 0, y: 12 }, spec.unit);
    for (const value of ticksOf(spec.top, 4)) {
      makeSvg(curves, 'path', { d: `M${left} ${Y(value)}H${right}`, class: 'grid' });
      makeSvg(curves, 'text', { x: left - 6, y: Y(value) + 4, 'text-anchor': 'end' }, value);
    }
    for (const frame of ticksOf(spec.frames, W / 80)) {
      makeSvg(curves, 'text', { x: X(frame), y: low + 15, 'text-anchor': frame / spec.frames > 0.97 ? 'end' : 'middle' }, frame);
    }
    makeSvg(curves, 'text', { x: (left + right) / 2, y: H - 4, 'text-anchor': 'middle' }, `frames after the seed, ${spec.fps} a second`);
    const clip = makeSvg(curves, 'svg', { x: left, y: high - 6, width: right - left, height: low - high + 8,
      viewBox: `${left} ${high - 6} ${right - left} ${low - high + 8}`, preserveAspectRatio: 'none' });
    const line = cell => {
      let d = '', pen = 'M';
      cell.curve.forEach((value, i) => {
        if (value === null) { pen = 'M'; return; }
        d += `${pen}${X(spec.first + i * spec.every).toFixed(1)} ${Y(value * spec.top / 1000).toFixed(1)}`;
        pen = 'L';
      });
      return d;
    };
    const mine = api.cell;
    for (const cell of spec.cells) if (cell !== mine) makeSvg(clip, 'path', { d: line(cell), class: cell === S.over ? 'curve over' : 'curve' });
    if (spec.truth !== null) {
      makeSvg(clip, 'path', { d: `M${left} ${Y(spec.truth)}H${right}`, class: 'true' });
      makeSvg(curves, 'text', { x: right, y: Y(spec.truth) - 5, 'text-anchor': 'end', class: 'halo' }, 'true motion');
    }
    if (mine) makeSvg(clip, 'path', { d: line(mine), class: 'curve mine' });
    const head = makeSvg(clip, 'path', { d: '', class: 'playhead' });
    Object.assign(plot, { head });
    const name = (cell, kind) => {
      const at = Math.floor(cell.curve.length * 0.55), value = cell.curve.slice(at).find(x => x !== null);
      if (value === undefined) return;
      const y = clamp(Y(value * spec.top / 1000) - 7, high + 6, low - 6);
      makeSvg(curves, 'text', { x: X(spec.first + at * spec.every), y, 'text-anchor': 'middle', class: `halo ${kind}` }, pair(cell.u, cell.v));
    };
    if (S.over && S.over !== mine) name(S.over, 'over');
    if (mine) name(mine, 'mine');
    movePlayhead();
  }
  function near(e) { // -> the cell whose curve is under the pointer
    if (!plot) return null;
    const box = curves.getBoundingClientRect(), x = e.clientX - box.left, y = e.clientY - box.top;
    const i = Math.round(((x - plot.left) / (plot.right - plot.left) * spec.frames - spec.first) / spec.every);
    let best = null, least = 18;
    for (const cell of spec.cells) {
      const away = Math.abs(plot.Y((cell.curve[i] ?? NaN) * spec.top / 1000) - y);
      if (away < least) [best, least] = [cell, away];
    }
    return best;
  }
  curves.onpointermove = e => {
    const over = near(e);
    curves.style.cursor = over ? 'pointer' : '';
    if (over === S.over) return;
    S.over = over;
    drawCurves();
  };
  curves.onpointerleave = () => { S.over = null; drawCurves(); };
  curves.onclick = e => {
    const cell = near(e);
    if (cell) choose({ u: cell.v ? cell.u : S.u, v: cell.v });
  };

  // the motion
  const readouts = new MutationObserver(() => movePlayhead());
  function movePlayhead() { // with the picture that the player shows
    if (!plot) return;
    const { player } = stage, { cell } = api, seed = cell?.player ? cell.player.seed * spec.fps : 0;
    const frame = cell?.player && player ? player.state.t * spec.fps - seed : -1;
    plot.head.setAttribute('d', frame < 0 || frame > spec.frames ? '' : `M${plot.X(frame)} ${plot.high}V${plot.low}`);
  }
  async function watch(cell) {
    const own = cell?.player;
    stage.root.classList.toggle('nothing', !own);
    absent.textContent = cell ? 'No clip was kept for this pair.' : 'Nothing to watch: this pair was not trained.';
    if (!own) { stage.stop(); return; }
    if (!await stage.show(cell, { ...spec.player, ...own.spec }, bytes.subarray(...own.bytes))) return;
    readouts.disconnect();
    readouts.observe(stage.readout, { childList: true });
    movePlayhead();
  }

  // JupyterLab takes arrow keys on the document while they are still on their way down: the sliders' come first
  function onKey(e) {
    const slider = inputs.find(s => s.input === shadow.activeElement), by = ARROWS[e.key];
    if (!slider || !by || e.ctrlKey || e.metaKey || e.altKey) return;
    slider.set(+slider.input.value + by);
    e.preventDefault();
    e.stopImmediatePropagation();
  }
  root.addEventListener('focusin', () => addEventListener('keydown', onKey, true));
  root.addEventListener('focusout', () => removeEventListener('keydown', onKey, true));

  const endTheme = onTheme(dark => root.classList.toggle('dark', dark));
  let width = 0;
  const size = new ResizeObserver(() => {
    if (root.clientWidth === width) return;
    width = root.clientWidth;
    drawSchedule();
    drawCurves();
  });
  const api = el.explorer = { state: S, cell: null, frames: 0, choose: (u, v) => choose({ u, v }), dispose,
    get player() { return stage.player; } };
  function dispose() {
    stage.dispose();
    for (const observer of [size, readouts]) observer.disconnect();
    endTheme();
    removeEventListener('keydown', onKey, true);
    shadow.replaceChildren();
  }
  update();
  size.observe(root);
  return api;
}
