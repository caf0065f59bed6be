"use strict";
// The maps of gains: one metric at a time; a click leads to the pictures, or to the numbers where there are none.
(() => {
  if (!bench.find("#worth")) return;
  const panels = bench.all("#worth .worth"), tabs = bench.all("#worth-metrics button");
  tabs.forEach((tab) => tab.addEventListener("click", () => {
    tabs.forEach((other) => other.setAttribute("aria-pressed", other === tab));
    panels.forEach((panel) => panel.toggleAttribute("data-away", panel.dataset.key !== tab.dataset.key));
  }));

  bench.find("#worth").addEventListener("click", (event) => {
    const cell = event.target.closest(".gain");
    if (!cell) return;
    const { row, reference, key, scenes } = cell.dataset;
    const drawn = JSON.parse(scenes).filter((scene) => bench.data.pictures[scene]?.rows[row]);
    const scene = drawn.includes(bench.look?.scene) ? bench.look.scene : drawn[0];
    if (scene) bench.lookAt(scene, row, bench.kindOf(key), reference);
    else bench.showEvidence(row, bench.scopes[0], key, cell);
  });
})();
