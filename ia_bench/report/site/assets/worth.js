"use strict";
// The maps of gains: one row and one metric at a time; a click leads to the pictures, or to the numbers where there are none.
(() => {
  const select = bench.find("#worth-row");
  if (!select) return;
  const panels = bench.all("#worth .worth"), tabs = bench.all("#worth-metrics button");
  const choose = (key) => {
    tabs.forEach((tab) => tab.setAttribute("aria-pressed", tab.dataset.key === key));
    panels.forEach((panel) => panel.toggleAttribute("data-away", panel.dataset.row !== select.value || panel.dataset.key !== key));
  };
  const chosen = () => tabs.find((tab) => tab.getAttribute("aria-pressed") === "true").dataset.key;
  tabs.forEach((tab) => tab.addEventListener("click", () => choose(tab.dataset.key)));
  select.addEventListener("change", () => choose(chosen()));

  bench.find("#worth").addEventListener("click", (event) => {
    const cell = event.target.closest(".gain");
    if (!cell) return;
    const { row, reference, key, scenes } = cell.dataset;
    const drawn = scenes.split("|").filter((scene) => bench.data.pictures[scene]?.rows[row]);
    const scene = drawn.includes(bench.look?.scene) ? bench.look.scene : drawn[0];
    if (scene) bench.lookAt(scene, row, bench.kindOf(key), reference);
    else bench.showEvidence(row, bench.scopes[0], key, cell);
  });
})();
