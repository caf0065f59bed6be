"use strict";
// Error against run time: a plot for every metric of one scene, one cursor for all of them.
(() => {
  const { make, data } = bench;
  const box = bench.find("#plots");
  bench.grow = () => {}; // what runs have measured that go on; for a page that is watched
  if (!box) return;
  const metrics = data.curveMetrics.map(bench.metricOf);
  const POINTS = 160; // of a line, evenly spaced in log time
  const TOLD = "relighting.psnr"; // the metric whose level is told before anybody asks
  const state = { scene: null, time: "log", value: "log", off: new Set(), lit: null, plots: [], levels: new Map(), growing: [] };

  const curvesOf = (scene) => data.rows.map(({ name }, row) => ({
    row, curves: data.runs.filter((run) => run.row === row && run.scene === scene && run.curve).map((run) => run.curve),
    growing: state.growing.filter((curve) => curve.row === name && curve.scene === data.scenes[scene]),
  })).filter((one) => one.curves.length + one.growing.length);

  // Where one seed's curve is at a time: straight in log time between two measured points.
  const between = (points, time) => {
    const at = points.findIndex(([seconds]) => seconds >= time);
    if (at < 0) return points.at(-1)[1];
    if (at === 0) return points[0][1];
    const [[t0, v0], [t1, v1]] = [points[at - 1], points[at]];
    return t1 === t0 ? v1 : v0 + (v1 - v0) * (Math.log(time / t0) / Math.log(t1 / t0));
  };
  const measured = (curve, place) => curve.seconds.map((seconds, at) => [seconds, curve.values[place][at]]).filter(([seconds, value]) => seconds > 0 && value !== null);

  // Times, then three series a row: mean, lowest and highest seed, null where not all seeds are.
  const series = (rows, place) => {
    const seeds = rows.map((one) => one.curves.filter((curve) => !curve.level).map((curve) => measured(curve, place)).filter((points) => points.length));
    const growing = rows.map((one) => one.growing.filter((curve) => !curve.level).map((curve) => measured(curve, place)).filter((points) => points.length));
    const dots = seeds.map((all, at) => [...all, ...growing[at]]);
    const every = dots.flat(2).map(([seconds]) => seconds);
    if (!every.length) return null;
    const [first, last] = [Math.min(...every), Math.max(...every)];
    const times = Array.from({ length: POINTS }, (_, at) => first * (last / first) ** (at / (POINTS - 1)));
    times[POINTS - 1] = last;
    const lines = seeds.flatMap((all) => {
      const values = times.map((time) => {
        const inside = all.length && all.every((points) => time >= points[0][0] * (1 - 1e-9) && time <= points.at(-1)[0] * (1 + 1e-9));
        return inside ? all.map((points) => between(points, time)) : null;
      });
      const of = (take) => values.map((seen) => (seen ? take(seen) : null));
      return [of(bench.mean), of((seen) => Math.min(...seen)), of((seen) => Math.max(...seen))];
    });
    return { columns: [times, ...lines], dots, growing };
  };

  // A canvas wants a colour that is resolved, and light-dark() is not.
  const probe = bench.find("#said");
  const style = (name) => {
    if (name === "--sans") return getComputedStyle(document.body).fontFamily;
    probe.style.color = `var(${name})`;
    return getComputedStyle(probe).color;
  };
  // Where many rows are drawn, marks and bands would cover them all: then a row has them when it is pointed at, and else the last mark.
  const crowded = (rows) => rows.filter((one) => !state.off.has(one.row)).length > 8;
  const faint = (row) => state.lit !== null && state.lit !== row;

  // ---- what uPlot does not draw: marks where something was measured, and the levels of ceiling and floor ------------
  const MARK = 3, LONE = 4.5, RING = 5.5; // radii: of a mark on a line, of one that is all there is of its seed, of a run's end that goes on
  const TRIANGLE = [[0, -1.25], [1.15, 0.8], [-1.15, 0.8]]; // as large as the circle of radius 1
  const mark = (ctx, shape, x, y, radius) => {
    ctx.beginPath();
    if (shape === "circle") ctx.arc(x, y, radius, 0, 2 * Math.PI);
    else if (shape === "square") ctx.rect(x - 0.9 * radius, y - 0.9 * radius, 1.8 * radius, 1.8 * radius);
    else for (const [right, down] of TRIANGLE) ctx.lineTo(x + right * radius, y + down * radius);
    ctx.fill();
  };
  const overlay = (plot, rows, { dots, growing }, place) => {
    const { ctx, bbox } = plot, ratio = devicePixelRatio;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    rows.forEach((one, at) => {
      if (state.off.has(one.row)) return;
      const { colour, shape } = bench.styleOf(one.row);
      ctx.globalAlpha = faint(one.row) ? 0.06 : 0.8;
      ctx.fillStyle = ctx.strokeStyle = colour;
      for (const points of dots[at]) {
        const shown = crowded(rows) && state.lit !== one.row ? points.slice(-1) : points;
        const radius = (points.length > 1 ? MARK : LONE) * ratio;
        for (const [seconds, value] of shown) mark(ctx, shape, plot.valToPos(seconds, "x", true), plot.valToPos(value, "y", true), radius);
      }
      for (const points of growing[at]) {
        const [x, y] = points.map(([seconds, value]) => [plot.valToPos(seconds, "x", true), plot.valToPos(value, "y", true)]).reduce((from, to) => {
          if (from) { ctx.moveTo(...from); ctx.lineTo(...to); } else ctx.beginPath();
          return to;
        }, null);
        ctx.setLineDash([4 * ratio, 3 * ratio]);
        ctx.lineWidth = 1.4 * ratio;
        if (points.length > 1) ctx.stroke();
        ctx.setLineDash([]);
        ctx.beginPath();
        ctx.arc(x, y, RING * ratio, 0, 2 * Math.PI);
        ctx.stroke();
      }
      const levels = one.curves.filter((curve) => curve.level).map((curve) => curve.values[place].at(-1)).filter((value) => value !== null);
      if (!levels.length || !data.rows[one.row].bound) return;
      const y = plot.valToPos(bench.mean(levels), "y", true);
      ctx.strokeStyle = ctx.fillStyle = style("--muted");
      ctx.globalAlpha = 0.9;
      ctx.lineWidth = ratio;
      ctx.beginPath();
      ctx.moveTo(bbox.left, y);
      ctx.lineTo(bbox.left + bbox.width, y);
      ctx.stroke();
      ctx.font = `${11 * ratio}px ${style("--sans")}`;
      [ctx.textAlign, ctx.textBaseline] = ["left", "alphabetic"]; // uPlot's axes leave others
      const below = y - bbox.top < 14 * ratio; // no place for the word above the line
      ctx.fillText(data.rows[one.row].bound, bbox.left + 4 * ratio, y + (below ? 12 : -3) * ratio);
    });
    ctx.restore();
  };

  // ---- the values under the cursor -------------------------------------------------------------------------------
  const readout = make("div", { class: "readout", hidden: true });
  document.body.append(readout);
  const read = (plot, rows, metric) => {
    const { idx, left, top } = plot.cursor;
    if (idx === null || idx === undefined || left < 0 || !plot.over.matches(":hover")) { readout.hidden = true; return; }
    const seen = rows.map((one, at) => ({ row: one.row, value: plot.data[1 + 3 * at][idx] }))
      .filter((one) => one.value !== null && !state.off.has(one.row))
      .sort((a, b) => (metric.higher ? b.value - a.value : a.value - b.value));
    readout.replaceChildren(make("b", { text: `${metric.group} ${metric.label} after ${bench.secondsText(plot.data[0][idx])}` }),
      ...seen.map((one) => make("div", {}, bench.swatch(one.row), make("span", { text: data.rows[one.row].name }),
        make("span", { class: "n", text: one.value.toFixed(metric.digits) }))));
    readout.hidden = false;
    const over = plot.over.getBoundingClientRect(), own = readout.getBoundingClientRect();
    const x = over.left + left + 16 + own.width > document.documentElement.clientWidth ? over.left + left - own.width - 16 : over.left + left + 16;
    readout.style.left = `${Math.max(4, x) + scrollX}px`;
    readout.style.top = `${Math.max(4, Math.min(over.top + top, innerHeight - own.height - 8)) + scrollY}px`;
  };

  // ---- when does a row first measure a level or better? The first measured point, never one between two of them ----
  const showLevels = (rows, metric, place, level, scene) => {
    const found = rows.map(({ row, curves }) => {
      const times = curves.map((curve) => { // of every seed, null where it does not get there
        const at = curve.values[place].findIndex((value) => value !== null && (metric.higher ? value >= level : value <= level));
        return at < 0 ? null : curve.seconds[at];
      });
      return { row, times: times.filter((time) => time !== null), seeds: times.length };
    });
    found.sort((a, b) => (b.times.length > 0) - (a.times.length > 0) || bench.mean(a.times) - bench.mean(b.times) || a.row - b.row);
    const some = (one) => (one.times.length && one.times.length < one.seeds ? ` (${one.times.length} of ${one.seeds} seeds)` : "");
    const longest = Math.max(...found.filter((one) => one.times.length).map((one) => bench.mean(one.times)), 0) || 1;
    bench.find("#levels").replaceChildren(
      make("h3", { text: `${metric.group} ${metric.label} ${metric.higher ? "≥" : "≤"} ${level.toFixed(metric.digits)} on ${scene}: first measured after` }),
      make("ol", { class: "times" }, ...found.map((one) => make("li", {},
        make("span", { class: "who", text: data.rows[one.row].name }),
        make("span", { class: "stretch" }, make("i", { style: `width:${one.times.length ? (100 * bench.mean(one.times) / longest).toFixed(1) : 0}%;background:${bench.styleOf(one.row).colour}` })),
        make("span", { class: "n", text: one.times.length ? bench.secondsText(bench.mean(one.times)) + some(one) : "never" })))));
  };

  // ---- the handle that chooses a level ----------------------------------------------------------------------------
  const handle = (plot, rows, metric, place) => {
    const { min, max } = plot.scales.y;
    const key = `${state.scene} ${metric.key}`;
    const clamp = (value) => Math.min(Math.max(value, min), max);
    const start = () => { // where the median row ends
      const ends = rows.filter((one) => !data.rows[one.row].bound).flatMap((one) => one.curves.map((curve) => curve.values[place].at(-1))).filter((value) => value !== null).sort((a, b) => a - b);
      return ends.length ? ends[Math.floor(ends.length / 2)] : (min + max) / 2;
    };
    const knob = make("div", { class: "level", role: "slider", tabindex: 0, "aria-orientation": "vertical", "aria-label": `Level of ${metric.title}`,
      "aria-valuemin": min, "aria-valuemax": max });
    const put = (value, tell) => {
      const level = clamp(value);
      state.levels.set(key, level);
      knob.style.top = `${plot.valToPos(level, "y")}px`;
      knob.dataset.text = level.toFixed(metric.digits);
      knob.setAttribute("aria-valuenow", level.toFixed(metric.digits));
      if (tell) showLevels(rows.filter((one) => !data.rows[one.row].bound && !state.off.has(one.row)), metric, place, level, data.scenes[state.scene]);
    };
    const drag = (event) => put(plot.posToVal(event.clientY - plot.over.getBoundingClientRect().top, "y"), true);
    knob.addEventListener("pointerdown", (event) => { event.stopPropagation(); event.preventDefault(); knob.focus(); knob.setPointerCapture(event.pointerId); knob.onpointermove = drag; });
    knob.addEventListener("pointerup", () => { knob.onpointermove = null; });
    knob.addEventListener("mousedown", (event) => event.stopPropagation()); // no zoom of uPlot's
    knob.addEventListener("keydown", (event) => {
      const step = { ArrowUp: -4, ArrowDown: 4, PageUp: -24, PageDown: 24 }[event.key];
      if (!step) return;
      event.preventDefault();
      put(plot.posToVal(plot.valToPos(state.levels.get(key), "y") + step, "y"), true);
    });
    knob.addEventListener("focus", () => put(state.levels.get(key), true));
    plot.over.append(knob);
    put(state.levels.has(key) ? state.levels.get(key) : start(), false);
    return () => put(state.levels.get(key), true);
  };

  // From the worst to the best that was measured, with some air; what is hidden does not count, nor do ceiling and floor.
  const rangeOf = (rows, dots, log) => {
    const values = rows.flatMap((one, at) => (state.off.has(one.row) ? [] : dots[at].flat().map(([, value]) => value)));
    if (!values.length) return [log ? 0.01 : 0, 1];
    return bench.reach(Math.min(...values), Math.max(...values), log);
  };

  // ---- one plot ---------------------------------------------------------------------------------------------------
  const draw = (metric, place, rows, holder) => {
    const found = series(rows, place);
    if (!found) { holder.append(make("p", { class: "fine", text: "not measured" })); return null; }
    const stroke = (row) => () => bench.styleOf(row).colour + (faint(row) ? "22" : "");
    const lines = rows.flatMap((one) => {
      const show = !state.off.has(one.row);
      const edge = { show, stroke: "transparent", width: 0, points: { show: false } };
      return [{ show, stroke: stroke(one.row), width: state.lit === one.row ? 3 : 1.6, points: { show: false } }, { ...edge }, { ...edge }];
    });
    const bands = rows.map((one, at) => ({ series: [3 * at + 3, 3 * at + 2], fill: () => bench.styleOf(one.row).colour + (faint(one.row) ? "08" : state.lit === one.row ? "44" : crowded(rows) ? "0e" : "22") }));
    const logX = state.time === "log", logY = metric.label === "MSE" && state.value === "log";
    const [first, last] = [found.columns[0][0], found.columns[0].at(-1)];
    const axis = { stroke: () => style("--muted"), grid: { stroke: () => style("--line"), width: 1 }, ticks: { show: false }, font: `11px ${style("--sans")}`,
      filter: (_, ticks) => ticks, // uPlot's own leaves powers of ten alone with a label
      values: (_, ticks) => ticks.map(bench.tickText) };
    const ticks = (log) => (_, at, low, high) => bench.ticks(low, high, log);
    const plot = new uPlot({
      width: Math.max(240, holder.clientWidth), height: 250, legend: { show: false }, padding: [10, 12, 0, 0],
      scales: {
        // A part that somebody has chosen by dragging is shown as it was chosen.
        x: { time: false, distr: logX ? 3 : 1, range: (_, low, high) => (low === first && high === last ? bench.reach(low, high, logX) : [low, high]) },
        y: { distr: logY ? 3 : 1, range: () => rangeOf(rows, found.dots, logY) },
      },
      cursor: { sync: { key: "curves", scales: ["x", null] }, points: { show: false }, y: false, drag: { x: true, y: false } },
      axes: [{ ...axis, splits: ticks(logX), size: 32 }, { ...axis, splits: ticks(logY), size: 48 }],
      series: [{}, ...lines], bands,
      hooks: {
        draw: [(self) => overlay(self, rows, found, place)],
        setCursor: [(self) => read(self, rows, metric)],
        ready: [(self) => { const tell = handle(self, rows, metric, place); if (metric.key === TOLD) tell(); }],
      },
    }, found.columns, holder);
    plot.over.addEventListener("pointerleave", () => { readout.hidden = true; });
    return plot;
  };

  const redraw = () => {
    state.plots.forEach((plot) => plot.destroy());
    readout.hidden = true;
    const rows = curvesOf(state.scene);
    const holders = metrics.map((metric) => make("figure", { class: "plot" }, make("figcaption", { text: metric.title + (metric.label === "PSNR" ? ", dB" : "") })));
    box.replaceChildren(...holders);
    state.plots = metrics.map((metric, place) => draw(metric, place, rows, holders[place])).filter(Boolean);
  };

  const chips = () => {
    const rows = curvesOf(state.scene).filter((one) => !data.rows[one.row].bound);
    bench.find("#curve-rows").replaceChildren(...rows.map(({ row }) => {
      const chip = make("button", { type: "button", class: "chip", "aria-pressed": !state.off.has(row) }, bench.swatch(row), data.rows[row].name);
      const light = (lit) => { state.lit = lit; state.plots.forEach((plot) => plot.redraw()); };
      chip.addEventListener("click", () => {
        if (!state.off.delete(row)) state.off.add(row);
        chip.setAttribute("aria-pressed", !state.off.has(row));
        redraw();
      });
      chip.addEventListener("pointerenter", () => light(row));
      chip.addEventListener("pointerleave", () => light(null));
      chip.addEventListener("focus", () => light(row));
      chip.addEventListener("blur", () => light(null));
      return chip;
    }));
  };

  const scenes = data.scenes.map((_, scene) => scene).filter((scene) => data.live || curvesOf(scene).some((one) => one.curves.some((curve) => !curve.level)));
  if (!scenes.length) { box.replaceChildren(make("p", { class: "fine", text: "Nothing was optimised: there are levels, but no curve." })); return; }
  const tabs = scenes.map((scene) => make("button", { type: "button", "aria-pressed": false, text: data.scenes[scene] }));
  const choose = (place) => {
    state.scene = scenes[place];
    tabs.forEach((tab, at) => tab.setAttribute("aria-pressed", at === place));
    chips();
    redraw();
  };
  tabs.forEach((tab, place) => tab.addEventListener("click", () => choose(place)));
  bench.find("#curve-scenes").append(...tabs);
  for (const key of ["time", "value"]) bench.find(`#curve-${key}`).addEventListener("change", (event) => { state[key] = event.target.value; redraw(); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  let width = innerWidth;
  addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; redraw(); } });
  bench.plots = state;
  bench.grow = (curves) => {
    const seen = (all) => JSON.stringify(all.filter((curve) => curve.scene === data.scenes[state.scene]));
    const changed = seen(curves) !== seen(state.growing);
    state.growing = curves;
    if (changed && state.scene !== null) { chips(); redraw(); }
  };
  // Only once they are near: the table is painted first.
  bench.whenNear(bench.find("#curves"), () => choose(Math.max(0, scenes.indexOf(data.scenes.indexOf(bench.kept?.scene)))));
})();
