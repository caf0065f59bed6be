"use strict";
// Score against seconds: a mark for every row, the Pareto front as steps, and the reference with more work as a dashed line.
(() => {
  const { make, data } = bench;
  const box = bench.find("#pareto");
  if (!box) return;
  const captures = data.pareto;
  const metrics = [...new Set(captures.flatMap((one) => one.rows.flatMap((row) => Object.keys(row.scores))))].map(bench.metricOf);
  const state = { capture: 0, metric: metrics[0], plot: null };
  const MARK = 4, NEAR = 24; // radius of a mark; how near the pointer must be to it, in pixels
  const readout = bench.find(".readout") || make("div", { class: "readout", hidden: true }); // that of the curves, where there are any
  document.body.append(readout);

  const rowsNow = () => captures[state.capture].rows.filter((row) => state.metric.key in row.scores);
  const score = (row) => row.scores[state.metric.key];
  const colour = (row) => bench.styleOf(data.rows.findIndex((one) => one.name === row.row)).colour; // that of its curves
  const nearest = (plot) => {
    const away = (row) => Math.hypot(plot.valToPos(row.cost, "x") - plot.cursor.left, plot.valToPos(score(row), "y") - plot.cursor.top);
    return rowsNow().map((row) => [away(row), row]).filter(([distance]) => distance <= NEAR).sort((a, b) => a[0] - b[0]).map(([, row]) => row)[0];
  };

  // Marks, full where a row is on the front, with as many names as there is room for.
  const overlay = (plot) => {
    const { ctx } = plot, ratio = devicePixelRatio, taken = [];
    ctx.save();
    ctx.font = `${11.5 * ratio}px ${getComputedStyle(document.body).fontFamily}`;
    [ctx.textAlign, ctx.textBaseline] = ["left", "middle"];
    ctx.setLineDash([]);
    for (const row of rowsNow()) {
      const [x, y] = [plot.valToPos(row.cost, "x", true), plot.valToPos(score(row), "y", true)];
      ctx.beginPath();
      ctx.arc(x, y, MARK * ratio, 0, 2 * Math.PI);
      ctx.fillStyle = ctx.strokeStyle = colour(row);
      ctx.lineWidth = 1.6 * ratio;
      if (row.front.includes(state.metric.key)) ctx.fill(); else ctx.stroke();
      const wide = ctx.measureText(row.name).width, high = 14 * ratio, gap = 8 * ratio;
      const places = [[x + gap, y + high / 2], [x + gap, y - high / 2], [x - gap - wide, y - high / 2], [x - gap - wide, y + high / 2]];
      const free = places.find(([left, middle]) => taken.every((other) => left > other.right || left + wide < other.left || Math.abs(middle - other.middle) > high));
      if (!free) continue;
      taken.push({ left: free[0], right: free[0] + wide, middle: free[1] });
      ctx.fillStyle = getComputedStyle(bench.find("#said")).color;
      ctx.fillText(row.name, ...free);
    }
    ctx.restore();
  };

  const read = (plot) => {
    const row = plot.cursor.left >= 0 && plot.over.matches(":hover") ? nearest(plot) : null;
    readout.hidden = !row;
    plot.over.style.cursor = row ? "pointer" : "";
    if (!row) return;
    readout.replaceChildren(make("b", { text: row.row }),
      make("div", {}, make("span", { text: "seconds" }), make("span", { class: "n", text: `${row.cost.toFixed(2)} × ${captures[state.capture].reference}` })),
      make("div", {}, make("span", { text: state.metric.title }), make("span", { class: "n", text: score(row).toFixed(state.metric.digits) })));
    const over = plot.over.getBoundingClientRect();
    readout.style.left = `${Math.max(4, Math.min(over.left + plot.cursor.left + 16, innerWidth - readout.offsetWidth - 8)) + scrollX}px`;
    readout.style.top = `${over.top + plot.cursor.top + 16 + scrollY}px`;
  };

  const draw = () => {
    state.plot?.destroy();
    readout.hidden = true;
    const rows = rowsNow();
    if (!rows.length) { box.replaceChildren(make("p", { class: "fine", text: "not measured" })); return; }
    let best = -Infinity;
    const more = rows.map((row) => (row.curve && score(row) > best ? (best = score(row)) : null));
    const front = rows.map((row) => (row.front.includes(state.metric.key) ? score(row) : null));
    const muted = () => getComputedStyle(bench.find("#said")).color;
    const axis = { stroke: muted, ticks: { show: false }, grid: { stroke: "#8883", width: 1 }, filter: (_, ticks) => ticks, values: (_, ticks) => ticks.map(bench.tickText) };
    const ticks = (log) => (_, at, low, high) => bench.ticks(low, high, log);
    const range = (log) => (_, low, high) => bench.reach(low, high, log);
    const holder = make("figure", { class: "pareto" }, make("figcaption", { text: `${state.metric.title}${state.metric.label === "PSNR" ? ", dB" : ""}, against seconds of a fit over those of ${captures[state.capture].reference}` }));
    box.replaceChildren(holder);
    state.plot = new uPlot({
      width: Math.max(240, box.clientWidth), height: 340, legend: { show: false }, padding: [14, 130, 0, 0],
      scales: { x: { time: false, distr: 3, range: range(true) }, y: { range: range(false) } },
      cursor: { points: { show: false }, y: false, drag: { x: false, y: false } },
      axes: [{ ...axis, splits: ticks(true), size: 32 }, { ...axis, splits: ticks(false), size: 48 }],
      series: [{},
        { stroke: "transparent", points: { show: false } },
        { stroke: "#888", width: 1.4, spanGaps: true, points: { show: false }, paths: uPlot.paths.stepped({ align: 1 }) },
        { stroke: "#888", width: 1.4, dash: [5, 4], spanGaps: true, points: { show: false } }],
      hooks: { draw: [overlay], setCursor: [read] },
    }, [rows.map((row) => row.cost), rows.map(score), front, more], holder);
    state.plot.over.addEventListener("pointerleave", () => { readout.hidden = true; });
    state.plot.over.addEventListener("click", () => { const row = nearest(state.plot); if (row) bench.showEvidence(row.row, bench.scopes[0], state.metric.key, state.plot.over); });
  };

  const tabs = (holder, names, key, values) => {
    const buttons = names.map((text, at) => make("button", { type: "button", "aria-pressed": at === 0, text, on: { click: () => {
      state[key] = values[at];
      buttons.forEach((other, place) => other.setAttribute("aria-pressed", place === at));
      draw();
    } } }));
    if (buttons.length > 1) bench.find(holder).append(...buttons);
  };
  tabs("#pareto-metrics", metrics.map((metric) => `${metric.group} ${metric.label}`), "metric", metrics);
  tabs("#pareto-captures", captures.map((one) => one.capture || "all views"), "capture", captures.map((_, at) => at));
  let width = innerWidth;
  addEventListener("resize", () => { if (innerWidth !== width && state.plot) { width = innerWidth; draw(); } });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => state.plot && draw());
  bench.pareto = state;
  bench.whenNear(bench.find("#seconds"), draw);
})();
