// Before each moving figure a notebook keeps a picture of it, for places where no script runs: here one does.
const figures = '[data-motion-player], [data-motion-explorer], [data-path-canvas]';
document.addEventListener('DOMContentLoaded', () => {
  for (const figure of document.querySelectorAll(figures)) {
    const before = figure.closest('.output')?.previousElementSibling;
    if (before?.matches('img.still')) before.hidden = true;
  }
  // The figures ask the page for its theme as JupyterLab tells it.
  const tell = () => {
    const { theme } = document.body.dataset;
    if (theme === 'dark' || theme === 'light') document.body.dataset.jpThemeLight = String(theme === 'light');
    else delete document.body.dataset.jpThemeLight;
  };
  new MutationObserver(tell).observe(document.body, { attributeFilter: ['data-theme'] });
  tell();
});
