// A fan of futures: what they go on from, how many, how wild; stands after page.js, player.js and stage.js in one module.
// futureFan(el, model): model is anywidget's. Its choice { clip, first, count, temperature, seed } goes to Python when a
// control is let go; spec, shown (the player's spec and bytes), note and busy come from there.

export function futureFan(el, model) {
  const spec = model.get('spec'), shadow = el.shadowRoot || el.attachShadow({ mode: 'open' });
  shadow.replaceChildren();
  make('style', shadow, { textContent: spec.style });
  const root = make('div', shadow, { className: 'fan', role: 'group', ariaLabel: spec.title });
  root.style.width = spec.width + 'px';
  make('h4', root, { textContent: spec.title });
  const clips = make('nav', root, { className: 'set', ariaLabel: 'What the futures go on from' });
  const buttons = spec.clips.map(({ name, pose }, clip) => {
    const button = make('button', clips, { type: 'button', title: `Futures of ${name}`,
      onclick: () => choose({ clip, first: Math.min(S.first, spec.clips[clip].last) }) });
    const icon = makeSvg(button, 'svg', { viewBox: '-50 -100 100 100', width: 26, height: 26, 'aria-hidden': 'true' });
    makeSvg(icon, 'path', { d: pose.map(([x, y, u, v]) => `M${x} ${y}L${u} ${v}`).join('') });
    make('span', button, { textContent: name });
    return button;
  });
  const S = { ...model.get('choice') }, frames = n => `${n} frame${n > 1 ? 's' : ''}`;
  const controls = make('div', root, { className: 'controls' });
  const sliders = [
    ['first', 'Where the past begins', () => spec.clips[S.clip].last, 0, 1, v => `at ${(v / spec.clips[S.clip].fps).toFixed(2)} s, ${frames(spec.past)}`],
    ['count', 'How many futures', () => spec.most, 1, 1, v => `${v}`],
    ['temperature', 'Temperature', () => spec.hottest, 0, 0.1, v => `${v.toFixed(1)}, ${warmth(v)}`],
  ].map(([key, name, most, min, step, says]) => {
    const label = make('label', controls, {});
    const line = make('span', label, {});
    make('b', line, { textContent: `${name} ` });
    const value = make('output', line, { ariaLive: 'off' });
    const tell = () => { value.textContent = input.ariaValueText = says(+input.value); };
    const input = make('input', label, { type: 'range', min, step, ariaLabel: name, oninput: tell,
      onchange: () => choose({ [key]: +input.value }) });
    return () => {
      input.max = most();
      input.disabled = most() <= min;
      if (shadow.activeElement !== input || +input.value > most()) input.value = S[key];
      tell();
    };
  });
  const again = make('button', controls, { type: 'button', textContent: 'Draw others',
    title: 'The same past, other draws', onclick: () => choose({ seed: S.seed + 1 }) });
  const note = make('p', root, { className: 'note', role: 'status' });
  const stage = makeStage(root);
  const warmth = v => v === 0 ? 'no chance at all' : v < 0.95 ? 'tamer than learnt' : v < 1.05 ? 'as learnt' : 'wilder than learnt';

  function choose(change) {
    if (Object.entries(change).every(([key, value]) => S[key] === value)) return;
    Object.assign(S, change);
    model.set('choice', { ...S });
    model.save_changes();
    update();
  }
  function update() {
    buttons.forEach((button, i) => { button.ariaPressed = i === S.clip; });
    for (const show of sliders) show();
  }
  const hear = {
    choice() {
      Object.assign(S, model.get('choice'));
      update();
    },
    shown() {
      const shown = model.get('shown');
      if (shown.spec) api.ready = stage.show(shown, shown.spec, fromBase64(shown.bytes));
    },
    note() { tell(); },
    busy() { tell(); },
  };
  function tell() {
    root.classList.toggle('busy', model.get('busy'));
    note.textContent = model.get('busy') ? 'imagining …' : model.get('note');
  }
  for (const name in hear) model.on(`change:${name}`, hear[name]);

  // JupyterLab takes arrow keys on the document while they are still on their way down: here they move the slider alone
  function onKey(e) {
    if (shadow.activeElement?.tagName === 'INPUT' && !e.ctrlKey && !e.metaKey && !e.altKey) e.stopImmediatePropagation();
  }
  root.addEventListener('focusin', () => addEventListener('keydown', onKey, true));
  root.addEventListener('focusout', () => removeEventListener('keydown', onKey, true));

  // the picture and the player before it are for pages in which nobody can choose; the notebook keeps them
  const still = [];
  function hideStill() {
    let before = el.closest('.jp-OutputArea-child')?.previousElementSibling;
    for (const found of [`[data-motion-player="${spec.still.player}"]`, `img[src$="${spec.still.picture}"]`]) {
      if (!before?.querySelector(found)) break;
      before.style.display = 'none';
      before.querySelector(found).player?.pause();
      still.push(before);
      before = before.previousElementSibling;
    }
  }
  const placed = new ResizeObserver(() => { if (!still.length) hideStill(); });
  const endTheme = onTheme(dark => root.classList.toggle('dark', dark));
  const api = el.fan = { state: S, ready: null, choose, dispose, get player() { return stage.player; } };
  function dispose() {
    for (const name in hear) model.off(`change:${name}`, hear[name]);
    for (const output of still) output.style.display = '';
    placed.disconnect();
    stage.dispose();
    endTheme();
    removeEventListener('keydown', onKey, true);
    shadow.replaceChildren();
  }
  update();
  tell();
  hear.shown();
  placed.observe(root);
  return api;
}
