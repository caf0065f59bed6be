"use strict";
// A page that is watched: asks for news every few seconds, and loads itself again when a cell has ended.
(() => {
  const { make, data } = bench;
  if (!data.live) return;
  const KEPT = "ia_bench watched page", IDLE = 6, STILL = 30; // seconds: without a hand on the page, which may then load itself again; without a cell at work
  const MARKS = { finished: "✓", running: "●", waiting: "○", failed: "✕" };
  const duration = (seconds) => (seconds < 60 ? `${seconds} s` : seconds < 3600 ? `${Math.round(seconds / 60)} min` : `${Math.floor(seconds / 3600)} h ${Math.round((seconds % 3600) / 60)} min`);
  const clock = (made) => new Date(1000 * made).toLocaleTimeString();
  let touched = 0, last = null, turn = 0, told = "", worked = Date.now();
  for (const event of ["pointerdown", "keydown", "wheel", "touchstart"]) addEventListener(event, () => { touched = Date.now(); }, { passive: true });

  // What the reader had chosen before the page loaded itself again.
  try {
    bench.kept = JSON.parse(sessionStorage.getItem(KEPT)) || {};
    sessionStorage.removeItem(KEPT);
  } catch { bench.kept = {}; } // a browser that keeps nothing for pages from disk
  if (bench.scopes.includes(bench.kept.scope)) bench.showScope(bench.kept.scope);
  const again = () => {
    try { sessionStorage.setItem(KEPT, JSON.stringify({ scope: bench.scope().dataset.scope, scene: data.scenes[bench.plots?.scene] })); } catch { /* as above */ }
    location.reload();
  };
  bench.find("#now-reload").addEventListener("click", again);

  const line = ([row, scene, seed, state, seconds, says]) => {
    const took = seconds === null ? "" : state === "finished" ? ` in ${duration(seconds)}` : ` for ${duration(seconds)}`;
    return `${row}, ${scene}, seed ${seed}: ${state}${took}${says ? ` (${says})` : ""}`;
  };
  const grid = (cells) => {
    const scenes = [...new Set(cells.map((cell) => cell[1]))], rows = [...new Set(cells.map((cell) => cell[0]))];
    const marks = (row, scene) => cells.filter((cell) => cell[0] === row && cell[1] === scene)
      .map((cell) => make("span", { class: `mark ${cell[3]}`, role: "img", "aria-label": line(cell), "data-tip": line(cell), text: MARKS[cell[3]] }));
    return [make("thead", {}, make("tr", {}, make("th", { scope: "col", text: "Row" }), ...scenes.map((scene) => make("th", { scope: "col", text: scene })))),
      make("tbody", {}, ...rows.map((row) => make("tr", {}, make("th", { scope: "row", text: row }), ...scenes.map((scene) => make("td", {}, ...marks(row, scene))))))];
  };

  bench.news = (news) => {
    last = news;
    const of = (state) => news.cells.filter((cell) => cell[3] === state);
    const counts = Object.keys(MARKS).filter((state) => of(state).length).map((state) => `${of(state).length} ${state}`).join(", ");
    const open = of("running").length + of("waiting").length;
    if (of("running").length) worked = Date.now(); // between two cells there is a moment without any
    const still = open && Date.now() - worked > 1000 * STILL;
    const left = news.left === null || !open || still ? "" : `, about ${duration(news.left)} left`;
    const why = still ? " Nothing is at work: the command that makes the table goes on with what waits." : "";
    bench.find("#now-said").textContent = `${news.cells.length} cells: ${counts}${left}.${why}`;
    for (const state of ["finished", "failed", "running"]) bench.find(`#now-bar .${state}`).style.width = `${100 * of(state).length / news.cells.length}%`;
    bench.find("#now-running").replaceChildren(...of("running").map((cell) => make("li", { text: line(cell) })));
    const cells = JSON.stringify(news.cells.map((cell) => (cell[3] === "running" ? cell.slice(0, 4) : cell)));
    if (cells !== told) { told = cells; bench.find("#now-cells").replaceChildren(...grid(news.cells)); } // else what is pointed at would go
    bench.grow(news.curves);
    if (news.key === data.live.key) return;
    bench.find("#now-reload").hidden = false;
    if (Date.now() - touched > 1000 * IDLE && !bench.find("dialog[open]")) again();
  };

  const ask = () => {
    const script = make("script", { src: `parts/live.js?${turn++}` });
    const next = () => {
      script.remove();
      if (last && last.ended) bench.find("#now-title").textContent = `At ${clock(last.made)}, when the watch ended`;
      else if (last && Date.now() / 1000 - last.made > 5 + 3 * last.every) bench.find("#now-title").textContent = `At ${clock(last.made)}: no news since`;
      else bench.find("#now-title").textContent = "Now";
      setTimeout(ask, 1000 * data.live.every);
    };
    script.addEventListener("load", next);
    script.addEventListener("error", next);
    document.head.append(script);
  };
  addEventListener("load", ask); // once all that grows is there
})();
