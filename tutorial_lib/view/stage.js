// A place in which one player takes another's place; stands after page.js and player.js in one module.

function makeStage(parent) {
  const root = make('div', parent, { className: 'stage' });
  make('style', root, { textContent: '.stage { position: relative } .stage > .next { position: absolute; inset: 0 0 auto; visibility: hidden }' });
  let host = null, asked = 0;
  const api = { root, player: null, readout: null, show, stop, dispose };
  // show(key, spec, bytes): as for mount. The old figure stays until the new one is drawn, so that nothing flickers; time,
  // view and whether it plays stay as they were. -> its player, or null where nothing changed: key is the one on stage, or
  // another was asked for in the meantime
  async function show(key, spec, bytes) {
    const turn = ++asked, before = api.player, was = before?.state, start = spec.start;
    if (host?.key === key) return null;
    const next = make('div', root, { className: 'next' });
    if (was) {
      const { speed, loop, follow, trails, ghosts, overlay } = was;
      spec = { ...spec, start: { ...start, speed, loop, follow, trails, ghosts, overlay } };
    }
    const player = mount(next, spec, bytes);
    next.key = key;
    if (was) {
      const { zoom, pan, elevation } = was, duration = (spec.frames - 1) / spec.fps;
      const azimuth = start.azimuth + was.azimuth - before.azimuth;
      Object.assign(player.state, { zoom, pan: [...pan], elevation, azimuth, t: Math.min(was.t, duration) });
    }
    player.azimuth = start.azimuth;
    await player.ready;
    if (turn !== asked) {
      player.dispose();
      next.remove();
      return null;
    }
    const playing = was?.playing;
    before?.dispose();
    host?.remove();
    next.className = '';
    host = next;
    api.player = player;
    api.readout = next.shadowRoot.querySelector('output');
    if (was) player.state.t = Math.min(was.t, (spec.frames - 1) / spec.fps);
    if (playing) player.play();
    else player.seek(Math.round(player.state.t * spec.fps));
    return player;
  }
  function stop() { // what is on its way does not come
    asked++;
    api.player?.pause();
  }
  function dispose() {
    asked++;
    api.player?.dispose();
  }
  return api;
}
