// What the moving figures share; stands first in their module.

const clamp = (x, low, high) => Math.max(low, Math.min(high, x));

function make(tag, parent, properties) { // an HTML element at the end of another
  const node = Object.assign(document.createElement(tag), properties);
  parent.append(node);
  return node;
}

function makeSvg(parent, tag, attributes, text = '') { // the same in a drawing
  const node = document.createElementNS('http://www.w3.org/2000/svg', tag);
  for (const name in attributes) node.setAttribute(name, attributes[name]);
  node.textContent = text;
  parent.append(node);
  return node;
}

export function fromBase64(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes;
}

export function onTheme(tell) { // tell(dark) now and at each change: the notebook's, else the system's
  const system = matchMedia('(prefers-color-scheme: dark)'), notebook = new MutationObserver(look);
  function look() {
    const { jpThemeLight: light, vscodeThemeKind: kind } = document.body.dataset;
    tell(light ? light === 'false' : kind ? !/light/.test(kind) : system.matches);
  }
  notebook.observe(document.body, { attributeFilter: ['data-jp-theme-light', 'data-vscode-theme-kind'] });
  system.onchange = look;
  look();
  return () => { notebook.disconnect(); system.onchange = null; };
}
