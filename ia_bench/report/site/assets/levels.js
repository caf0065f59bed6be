"use strict";
// When does a row first measure a level or better? The first measured point, never one between two of them.
(() => {
  const { make, data } = bench;

  // Seconds of every seed of a row that reaches the level, and how many seeds there are.
  bench.timesTo = (curves, metric, place, level) => {
    const times = curves.map((curve) => {
      const at = curve.values[place].findIndex((value) => value !== null && (metric.higher ? value >= level : value <= level));
      return at < 0 ? null : curve.seconds[at];
    });
    return { times: times.filter((time) => time !== null), seeds: times.length };
  };

  bench.showLevels = (rows, metric, place, level, scene) => {
    const found = rows.map(({ row, curves }) => ({ row, ...bench.timesTo(curves, metric, place, level) }));
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
})();
