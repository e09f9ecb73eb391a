// Skeleton player on a 2D canvas; stands after page.js in one module. mount(el, spec, bytes) returns its controls.
// spec comes from player.py; bytes are the motions' payloads one after another, see codec.py.

const NEAR = 0.05; // metres before the eye

async function decode(bytes, parents, frames, step) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
  const raw = new Uint8Array(await new Response(stream).arrayBuffer());
  const width = parents.length * 3, count = width * frames, out = new Float32Array(count);
  if (raw.length !== 2 * count) throw Error('motion of another length');
  let since = performance.now();
  for (let k = 0, i = 0; k < width; k++) { // a joint coordinate
    const parent = parents[k / 3 | 0] * 3 + k % 3;
    for (let f = 0, v = 0, x = 0, o = k; f < frames; f++, i++, o += width) {
      const u = raw[i] | raw[count + i] << 8;
      v += u >>> 1 ^ -(u & 1);
      x += v;
      out[o] = x * step + (parent < 0 ? 0 : out[o - k + parent]);
    }
    if (performance.now() - since > 8) { // let the page breathe
      await new Promise(done => setTimeout(done));
      since = performance.now();
    }
  }
  return out;
}

export function mount(el, spec, bytes) {
  const shadow = el.shadowRoot || el.attachShadow({ mode: 'open' });
  shadow.replaceChildren();
  const last = spec.frames - 1, duration = last / spec.fps, several = spec.characters.length > 1;
  make('style', shadow, { textContent: spec.style });
  const root = make('div', shadow, { className: 'player', tabIndex: 0, role: 'group',
    ariaLabel: `Motion player, ? shows its keys. ${spec.title}` });
  root.style.width = spec.width + 'px';
  const canvas = make('canvas', root, { role: 'img', ariaLabel: spec.title, height: spec.height });
  const g = canvas.getContext('2d');
  const help = make('pre', root, { textContent: spec.keys, hidden: true });
  const slider = make('input', root, { type: 'range', min: 0, max: last, value: 0, ariaLabel: 'Frame',
    oninput: () => seek(+slider.value) });
  const bar = make('nav', root);
  const playButton = make('button', bar, { className: 'play', onclick: () => setPlaying(!S.playing) });
  make('i', playButton);
  const readout = make('output', bar, { textContent: '…', ariaLive: 'off' });
  const speeds = [...new Set([0.1, 0.25, 0.5, 1, 2, 4, spec.start.speed])].sort((a, b) => a - b);
  const menu = make('select', bar, { title: 'Speed (, .)', onchange: () => { S.speed = +menu.value; } });
  for (const s of speeds) make('option', menu, { value: s, textContent: s + ' ×' });

  const S = { ...spec.start, t: 0, playing: false, visible: true, zoom: 1, pan: [0, 0, 0] };
  const api = el.player = { state: S, drawn: 0, drawMs: 0, play: () => setPlaying(true),
    pause: () => setPlaying(false), seek, dispose };
  const keys = {
    ' ': () => setPlaying(!S.playing),
    arrowleft: e => seek(frameNow() - step(e)), arrowright: e => seek(frameNow() + step(e)),
    home: () => seek(0), end: () => seek(last), ',': () => faster(-1), '.': () => faster(1),
    '+': () => zoom(0.85), '=': () => zoom(0.85), '-': () => zoom(1 / 0.85),
    r: resetView, '?': () => { help.hidden = !help.hidden; },
  };
  for (const name of ['follow', 'ghosts', 'trails', 'loop', 'overlay'].slice(0, several ? 5 : 4)) {
    const button = make('button', bar, { textContent: name, title: `${name} (${name[0]})`, ariaPressed: S[name] });
    button.onclick = keys[name[0]] = () => {
      button.ariaPressed = S[name] = !S[name];
      redraw(true);
    };
  }
  make('button', bar, { textContent: 'reset', title: 'Reset the view (r)', onclick: resetView });
  make('button', bar, { textContent: '?', ariaLabel: 'Keys', onclick: keys['?'] });
  bar.onmousedown = e => { // so that space still plays
    if (e.target.closest('button')) { e.preventDefault(); root.focus({ preventScroll: true }); }
  };

  // state
  let raf = 0, clock = 0, jump = true, cast = [], fit = 0;
  const aimed = [0, 0, 0], target = [0, 0, 0];
  const frameNow = () => Math.round(S.t * spec.fps), step = e => e.shiftKey ? Math.round(spec.fps) : 1;
  function redraw(jumps) { // once; it goes on only while playing in sight
    jump ||= jumps;
    if (!raf && S.visible) raf = requestAnimationFrame(tick);
  }
  function setPlaying(on) {
    if (on && S.t >= duration) S.t = 0;
    S.playing = on;
    clock = 0;
    root.classList.toggle('playing', on);
    playButton.title = on ? 'Pause' : 'Play';
    redraw();
  }
  function seek(frame) {
    S.t = clamp(frame, 0, last) / spec.fps;
    redraw(true);
  }
  function faster(by) {
    S.speed = menu.value = speeds[clamp(speeds.indexOf(S.speed) + by, 0, speeds.length - 1)];
  }
  function resetView() {
    Object.assign(S, { azimuth: spec.start.azimuth, elevation: 0.2, zoom: 1, pan: [0, 0, 0] });
    redraw(true);
  }
  function orbit(dx, dy) {
    S.azimuth -= dx * 0.008;
    S.elevation = clamp(S.elevation + dy * 0.008, -0.1, 1.55);
    redraw();
  }
  function move(dx, dy) {
    const k = D / F;
    S.pan[0] -= dx * k * ca;
    S.pan[1] += dy * k;
    S.pan[2] += dx * k * sa;
    redraw();
  }
  function zoom(factor) {
    S.zoom = clamp(S.zoom * factor, 0.1, 12);
    redraw();
  }

  // pointers, wheel, keys
  const fingers = new Map();
  canvas.onpointerdown = e => {
    canvas.setPointerCapture(e.pointerId);
    fingers.set(e.pointerId, [e.clientX, e.clientY]);
    root.focus({ preventScroll: true });
  };
  canvas.onpointermove = e => {
    const from = fingers.get(e.pointerId), to = [e.clientX, e.clientY];
    if (!from) return;
    const dx = to[0] - from[0], dy = to[1] - from[1];
    fingers.set(e.pointerId, to);
    if (fingers.size === 2) { // each gives its share
      const other = [...fingers].find(([id]) => id !== e.pointerId)[1];
      const apart = p => Math.max(8, Math.hypot(p[0] - other[0], p[1] - other[1]));
      move(dx / 2, dy / 2);
      zoom(apart(from) / apart(to));
    } else if (fingers.size === 1) (e.shiftKey || e.buttons & 4 ? move : orbit)(dx, dy);
  };
  canvas.onpointerup = canvas.onpointercancel = e => fingers.delete(e.pointerId);
  canvas.ondblclick = resetView;
  canvas.addEventListener('wheel', e => { // without a click first it scrolls the page
    if (!e.ctrlKey && shadow.activeElement !== root) return;
    e.preventDefault();
    zoom(Math.exp(e.deltaY * (e.ctrlKey ? 0.01 : 0.002)));
  }, { passive: false });
  function onKey(e) {
    const at = shadow.activeElement?.tagName, action = keys[e.key.toLowerCase()];
    if (!action || e.ctrlKey || e.metaKey || e.altKey || at === 'SELECT' || at === 'BUTTON' && e.key === ' ') return;
    action(e);
    e.preventDefault();
    e.stopImmediatePropagation();
  }
  // JupyterLab takes keys on the document while they are still on their way down: ours come first
  root.addEventListener('focusin', () => addEventListener('keydown', onKey, true));
  root.addEventListener('focusout', () => removeEventListener('keydown', onKey, true));

  let dark = false;
  const endTheme = onTheme(on => {
    root.classList.toggle('dark', dark = on);
    redraw();
  });

  // drawing
  let W = 0, H = 0, F = 1, D = 1, ca = 1, sa = 0, ce = 1, se = 0;
  const tonesOf = (c, t) => spec.tones[t * c.fps < c.seed - 0.5 ? 0 : c.tones][+dark];
  function pose(c, t, out) { // world positions at time t; a shorter motion holds its last frame
    const n = out.length, f = clamp(t * c.fps, 0, c.frames - 1), i = Math.floor(f + 1e-6), a = Math.max(0, f - i);
    const from = i * n, to = Math.min(i + 1, c.frames - 1) * n, p = c.positions;
    for (let k = 0; k < n; k++) out[k] = p[from + k] + a * (p[to + k] - p[from + k]) + c.at[k % 3];
    return out;
  }
  function camera(x, y, z) { // -> right, up, distance
    x -= target[0]; y -= target[1]; z -= target[2];
    const ahead = sa * x + ca * z;
    return [ca * x - sa * z, ce * y - se * ahead, D - se * y - ce * ahead];
  }
  const screen = p => [W / 2 + F * p[0] / p[2], H / 2 - F * p[1] / p[2]];
  function project(p, q) { // positions -> screen x, screen y, pixels a metre (0 behind the eye)
    for (let j = 0; j < p.length; j += 3) {
      const c = camera(p[j], p[j + 1], p[j + 2]);
      [q[j], q[j + 1]] = screen(c);
      q[j + 2] = c[2] > NEAR ? F / c[2] : 0;
    }
    return q;
  }
  function line(a, b) { // adds a segment to the path, cut off behind the eye
    if (a[2] < NEAR && b[2] < NEAR) return;
    const cut = (p, q) => p[2] >= NEAR ? p : p.map((x, i) => x + (NEAR - p[2]) / (q[2] - p[2]) * (q[i] - x));
    g.moveTo(...screen(cut(a, b)));
    g.lineTo(...screen(cut(b, a)));
  }
  function capsule(p, q) { // a limb: circles [x, y, radius] and their tangents, clockwise
    const [x, y, r] = p, length = Math.hypot(q[0] - x, q[1] - y);
    if (r < q[2]) return capsule(q, p);
    const apart = length > r - q[2], b = apart ? Math.acos((r - q[2]) / length) : 0, a = Math.atan2(q[1] - y, q[0] - x);
    g.moveTo(x + r * Math.cos(a + b), y + r * Math.sin(a + b));
    g.arc(x, y, r, a + b, a - b + 2 * Math.PI);
    if (apart) g.arc(...q, a - b, a + b);
    g.closePath();
  }
  function limb({ bones, radius, torso, height }, [, start, end], q) {
    const at = (j, r) => [q[3 * j], q[3 * j + 1], r * q[3 * j + 2]];
    const join = (p, r) => p[2] * r[2] && p[2] + r[2] > (g.globalAlpha < 0.3 ? 4 : 1.6) && capsule(p, r);
    for (const [a, b] of bones.slice(start, end)) join(at(a, radius[a]), at(b, radius[b]));
    if (start) return;
    const ring = torso.map(j => at(j, 0.026 * height)), next = i => ring[(i + 1) % 4]; // the trunk
    if (ring.some(p => !p[2])) return;
    if (ring.reduce((sum, p, i) => sum + p[0] * next(i)[1] - next(i)[0] * p[1], 0) < 0) ring.reverse();
    ring.forEach(([x, y], i) => i ? g.lineTo(x, y) : g.moveTo(x, y));
    ring.forEach((p, i) => join(p, next(i)));
  }
  function head({ head: [a, b, k, r] }, q) {
    const [x, y] = [0, 1].map(i => q[3 * b + i] + k * (q[3 * b + i] - q[3 * a + i])), size = r * q[3 * b + 2];
    if (size) capsule([x, y, size], [x, y, size]);
  }
  function figure(body, q, tones, alpha, bg) { // far parts first, each with a thin rim that sets it off
    const parts = body.groups.map(group => {
      const [side, start, end] = group, own = body.bones.slice(start, end);
      return [own.reduce((sum, bone) => sum + q[3 * bone[1] + 2], 0) / own.length, tones[side], () => limb(body, group, q)];
    });
    if (body.head) parts.push([q[3 * body.head[1] + 2], tones[0], () => head(body, q)]);
    const large = q[3 * body.root + 2] * body.height > 110; // pixels
    g.globalAlpha = alpha;
    g.strokeStyle = bg;
    g.lineWidth = 2.5;
    g.beginPath();
    for (const [, fill, trace] of parts.sort((a, b) => a[0] - b[0])) {
      trace();
      g.fillStyle = alpha < 1 ? tones[0] : fill;
      if (alpha < 1) continue; // translucent: one shape in one colour, so that no seams show
      if (large) g.stroke();
      g.fill();
      g.beginPath();
    }
    g.fill();
  }
  const flat = (p, metres) => metres * F / p[2] * Math.max(0.35, se); // pixels across, on the ground
  function shadowOf({ body, pose: p }) {
    const at = j => camera(p[3 * j], 0, p[3 * j + 2]), centre = at(body.root);
    if (centre[2] < NEAR) return;
    g.strokeStyle = '#000';
    g.beginPath();
    for (const [a, b] of body.bones) if (body.radius[a] * F > centre[2]) line(at(a), at(b));
    for (const [size, alpha] of [[0.15, 0.05], [0.09, 0.06], [0.045, 0.07]]) {
      g.globalAlpha = alpha * (dark ? 2.5 : 1);
      g.lineWidth = flat(centre, size * body.height);
      g.stroke();
    }
  }
  function grid() {
    const cell = D > 25 ? 5 : D > 12 ? 2 : 1, half = Math.ceil(D / cell), R = half * cell;
    const [cx, cz] = [target[0], target[2]].map(x => Math.round(x / cell) * cell);
    const [x, y] = screen(camera(target[0], 0, target[2]));
    g.lineWidth = 1;
    for (const odd of D < 6 ? [1, 0] : [0]) {
      const color = spec.scene[+dark][1 + odd];
      g.strokeStyle = g.createRadialGradient(x, y, 0, x, y, Math.max(W, H) * 0.62);
      g.strokeStyle.addColorStop(0.35, color);
      g.strokeStyle.addColorStop(1, color + '00');
      g.beginPath();
      for (let k = odd - 2 * half; k <= 2 * half; k += 2) {
        const at = k / 2 * cell;
        line(camera(cx + at, 0, cz - R), camera(cx + at, 0, cz + R));
        line(camera(cx - R, 0, cz + at), camera(cx + R, 0, cz + at));
      }
      g.stroke();
    }
  }
  function trails(c) { // where the feet stood, and the last second of their way
    const now = S.t * c.fps, n = c.pose.length, { body, at: [x, y, z] } = c, tones = spec.tones[c.tones][+dark];
    for (const [side, first, end, ax, az, bx, bz] of c.prints) {
      const age = Math.max(0, now - end) / c.fps, a = camera(ax + x, 0, az + z);
      if (first > now || age > 12 || a[2] < NEAR) continue;
      g.globalAlpha = (dark ? 0.75 : 0.4) * (1 - age / 13);
      g.strokeStyle = tones[side];
      g.lineWidth = flat(a, 0.045 * body.height);
      g.beginPath();
      line(a, camera(bx + x, 0, bz + z));
      g.stroke();
    }
    const from = Math.min(Math.floor(now), c.frames - 1), every = Math.max(1, Math.round(c.fps / 30));
    g.lineWidth = 1.6;
    g.globalAlpha = 0.45;
    for (const [, toe] of body.feet) {
      g.strokeStyle = tones[body.side[toe]];
      g.beginPath();
      for (let f = from, before; f >= 0 && f > from - c.fps; f -= every) {
        const o = f * n + 3 * toe, p = camera(c.positions[o] + x, c.positions[o + 1] + y, c.positions[o + 2] + z);
        if (before) line(before, p);
        before = p;
      }
      g.stroke();
    }
  }
  function aim(smooth) { // the camera's target, and how far off it has everybody in sight
    if (!S.follow && fit) return;
    const tall = Math.max(...cast.map(c => c.body.height));
    const at = cast.map(({ body: { root }, pose: p }) => [p[3 * root], p[3 * root + 2]]);
    const ends = (x, z) => { // -> middle and half of the extent along (x, z)
      const all = at.map(p => p[0] * x + p[1] * z), low = Math.min(...all), high = Math.max(...all);
      return [(low + high) / 2, (high - low) / 2];
    };
    const [u, wide] = ends(ca, -sa), [v, deep] = ends(sa, ca);
    const far = Math.max(1.85 * tall, (wide + 0.5 * tall) * F / (0.47 * W)) + 1.3 * deep;
    [ca * u + sa * v, 0.52 * tall, ca * v - sa * u].forEach((goal, k) => {
      aimed[k] += smooth * (goal - aimed[k]);
    });
    fit += smooth * (far - fit);
  }
  function names(bg) { // over their heads, or listed where they stand on one spot
    g.globalAlpha = 1;
    g.font = '600 12px system-ui, sans-serif';
    g.lineWidth = 3;
    g.strokeStyle = bg;
    g.textAlign = S.overlay ? 'left' : 'center';
    const placed = [];
    cast.forEach(({ body, pose: p, name, tones }, i) => {
      const j = 3 * (body.head?.[1] ?? body.root), over = (body.head ? 0.2 : 0.7) * body.height;
      const eye = camera(p[j], p[j + 1] + over, p[j + 2]), [x, y] = S.overlay ? [14, 22 + 18 * i] : screen(eye);
      const half = g.measureText(name).width / 2 + 4;
      if (eye[2] >= NEAR) placed.push({ name, x, y, head: y, half, colour: spec.tones[tones][+dark][dark ? 1 : 2] });
    });
    placed.sort((a, b) => b.head - a.head); // who stands in front keeps the place, others move up to where it is free
    placed.forEach((label, n) => {
      const met = () => placed.slice(0, S.overlay ? 0 : n).find(other =>
        Math.abs(other.x - label.x) < other.half + label.half && Math.abs(other.y - label.y) < 15);
      for (let other = met(); other; other = met()) label.y = other.y - 15;
    });
    for (const { x, y, head, colour } of placed.filter(label => label.y < label.head)) { // a thread to the head
      g.fillStyle = colour;
      g.fillRect(x - 0.5, y + 3, 1, head - y);
    }
    for (const { name, x, y, colour } of placed) {
      g.strokeText(name, x, y);
      g.fillStyle = colour;
      g.fillText(name, x, y);
    }
  }
  function draw() {
    const ratio = Math.min(2, devicePixelRatio || 1), bg = spec.scene[+dark][0];
    W = canvas.clientWidth;
    H = Math.round(Math.min(spec.height, W * 0.95));
    if (!W) return;
    if (canvas.width !== Math.round(W * ratio) || canvas.height !== Math.round(H * ratio)) {
      canvas.style.height = H + 'px';
      [canvas.width, canvas.height] = [W, H].map(x => Math.round(x * ratio));
      jump = true;
    }
    F = 1.15 * H;
    for (const c of cast) {
      const [x, z] = S.overlay ? [0, 0] : c.spot;
      c.at = [x + c.shift[0], c.shift[1], z + c.shift[2]];
      pose(c, S.t, c.pose);
    }
    [ca, sa, ce, se] = [Math.cos(S.azimuth), Math.sin(S.azimuth), Math.cos(S.elevation), Math.sin(S.elevation)];
    aim(jump || !S.playing ? 1 : 0.08);
    jump = false;
    aimed.forEach((x, k) => { target[k] = x + S.pan[k]; });
    D = S.zoom * fit;
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    g.lineCap = g.lineJoin = 'round';
    g.globalAlpha = 1;
    g.fillStyle = bg;
    g.fillRect(0, 0, W, H);
    grid();
    cast.forEach(shadowOf);
    if (S.trails) cast.forEach(trails);
    for (const c of cast) {
      for (const t of S.ghosts ? spec.ghostTimes.map(dt => S.t + dt) : []) {
        if (t < 0 || t * c.fps > c.frames - 1) continue;
        figure(c.body, project(pose(c, t, c.ghost), c.screen), tonesOf(c, t), 0.1 + 0.14 * Math.exp(-Math.abs(t - S.t)));
      }
      project(c.pose, c.screen);
    }
    for (const c of [...cast].sort((a, b) => a.screen[3 * a.body.root + 2] - b.screen[3 * b.body.root + 2])) {
      figure(c.body, c.screen, tonesOf(c, S.t), S.overlay && c !== cast[0] ? 0.5 : 1, bg);
    }
    if (several) names(bg);
    const frame = slider.value = frameNow(), seed = Math.max(...cast.map(c => c.seed / c.fps)) * spec.fps;
    const text = readout.textContent = `frame ${frame} / ${last} · ${S.t.toFixed(2)} s${frame < seed ? ' · seed' : ''}`;
    if (!S.playing) slider.ariaValueText = text;
    slider.style.setProperty('--seed', spec.tones[0][+dark][0]);
    slider.style.setProperty('--share', 100 * Math.min(1, seed / last) + '%');
    api.drawn++;
  }

  function tick(now) {
    raf = 0;
    if (!cast.length) return;
    if (S.playing) {
      if (clock) S.t += Math.min(0.25, (now - clock) / 1000) * S.speed;
      clock = now;
      if (S.t >= duration && S.loop && duration) { S.t %= duration; jump = true; }
      if (S.t >= duration) { S.t = duration; setPlaying(false); }
    }
    const before = performance.now();
    draw();
    api.drawMs += (performance.now() - before - api.drawMs) * 0.1;
    if (S.playing) redraw();
  }
  function setVisible(visible) {
    S.visible = visible;
    clock = 0;
    raf = cancelAnimationFrame(raf) || 0;
    redraw();
  }
  const sight = new IntersectionObserver(entries => setVisible(entries.at(-1).isIntersecting));
  const size = new ResizeObserver(() => redraw());
  function dispose() {
    setVisible(false);
    sight.disconnect();
    size.disconnect();
    endTheme();
    removeEventListener('keydown', onKey, true);
    shadow.replaceChildren();
  }
  async function load() {
    const started = performance.now(), loaded = [];
    for (const c of spec.characters) {
      const body = spec.bodies[c.body], n = body.parents.length * 3;
      const positions = await decode(bytes.subarray(...c.bytes), body.parents, c.frames, c.step);
      const [pose, ghost, screen] = [0, 0, 0].map(() => new Float32Array(n));
      loaded.push({ ...c, body, positions, pose, ghost, screen });
    }
    cast = api.characters = loaded;
    api.loadMs = performance.now() - started;
    sight.observe(root);
    size.observe(canvas);
    draw();
    if (spec.autoplay) setPlaying(true);
  }
  faster(0);
  resetView();
  setPlaying(false);
  api.ready = load().catch(error => { readout.textContent = `Cannot be shown: ${error.message}`; });
  return api;
}
