"use strict";
// Behind a number: every seed, what it means, the paper's figure, and for each run its command, configuration, hashes, machine.
(() => {
  const { make, data } = bench;
  const dialog = bench.find("#evidence");
  let opener = null;

  const value = (run, key) => {
    const place = data.metrics.findIndex((metric) => metric.key === key);
    return place >= 0 ? run.values[place] : run[key];
  };
  const text = (number, key) => {
    if (key === "failed") return "finished"; // of a run that has not
    if (number === null || number === undefined) return "–";
    const metric = bench.metricOf(key);
    if (metric) return number.toFixed(metric.digits);
    return key === "memory" ? `${(number / 2 ** 20).toFixed(0)} MiB` : `${number.toFixed(1)} s`;
  };

  const list = (table) => make("dl", {}, ...Object.entries(table).flatMap(([name, entry]) =>
    [make("dt", { text: name }), make("dd", { text: typeof entry === "string" ? entry : JSON.stringify(entry) })]));

  const folded = (title, ...content) => make("details", {}, make("summary", { text: title }), ...content);

  // A click on the command selects all of it, for a browser that keeps its clipboard from files.
  const copy = (text) => make("button", { type: "button", class: "quiet", text: "copy", on: { click: async (event) => {
    await navigator.clipboard.writeText(text);
    event.target.classList.add("done");
    bench.say("Command copied");
  } } });
  const command = (run) => {
    if (!run.command) return make("p", { class: "fine", text: "This report does not know the configuration of this run, so not its command." });
    return make("div", { class: "command" }, make("code", { text: run.command }), copy(run.command));
  };

  const one = (run, key) => {
    const settings = data.configurations[run.configuration], machine = data.machines[run.machine] || {};
    const heading = `${data.scenes[run.scene]}, seed ${run.seed}: ${run.problem ? "failed" : text(value(run, key), key)}`;
    const why = run.problem || (run.reasons || {})[key];
    return make("details", { class: "run" },
      make("summary", { text: heading }),
      why ? make("p", { class: "bad", text: why }) : null,
      command(run),
      list({
        ...(run.hash ? { "configuration hash": run.hash } : {}),
        ...(run.preset ? { preset: run.preset } : {}),
        ...(run.renderer ? { "drawn by": run.renderer } : {}),
        ...Object.fromEntries(Object.entries(run.phases || {}).filter(([, seconds]) => seconds >= 0.05).map(([name, seconds]) => [`seconds: ${name}`, seconds.toFixed(1)])),
        ...Object.fromEntries(["cpu", "device", "threads", "commit"].filter((name) => machine[name]).map((name) => [name, machine[name]])),
      }),
      run.folder ? make("p", {}, make("a", { href: `${run.folder.split("/").map(encodeURIComponent).join("/")}/`, text: "its run folder" })) : null,
      settings ? folded("Whole configuration", list(settings)) : null,
      run.files ? folded("Machine and versions", list(machine)) : null,
      run.files ? folded("Checksums of its files (SHA-256, first 12 digits)", list(run.files)) : null);
  };

  bench.kindOf = (key) => ({ albedo: "albedo", aligned_albedo: "aligned", view_synthesis: "view", roughness: "roughness", light: "light", log_light: "light" })[key.split(".")[0]] || "relit";

  // Seeds as dots on a line, so that their spread is seen before it is read.
  const strip = (runs, key) => {
    const values = runs.map((run) => value(run, key)).filter((number) => typeof number === "number");
    if (values.length < 2) return null;
    const [low, high] = [Math.min(...values), Math.max(...values)], wide = high - low || 1;
    const dots = values.map((number) => make("i", { style: `left:${(4 + 92 * (number - low) / wide).toFixed(1)}%` }));
    return make("div", { class: "strip", "aria-hidden": "true" }, make("span", { text: text(low, key) }), make("div", {}, ...dots), make("span", { text: text(high, key) }));
  };

  bench.showEvidence = (name, scope, key, from) => {
    const place = data.rows.findIndex((row) => row.name === name), row = data.rows[place], metric = bench.metricOf(key);
    const runs = data.runs.filter((run) => run.row === place && (!data.scenes.includes(scope) || data.scenes[run.scene] === scope));
    const cell = bench.all(`.scope`).find((panel) => panel.dataset.scope === scope);
    const entry = bench.cellOf(bench.find(`tr[data-row="${CSS.escape(name)}"]`, cell), key).cloneNode(true);
    const whole = bench.find(".whole", entry);
    bench.all(".paper, .whole", entry).forEach((part) => part.remove());
    const paper = row.paper && row.paper.values[key];
    opener = from;
    const seen = data.scenes.filter((scene) => [scene, bench.scopes.length > 1 ? bench.scopes[0] : scene].includes(scope) && data.pictures[scene]?.rows[name]);
    const look = (scene) => make("button", { type: "button", class: "quiet", text: `Look at it: ${scene}`,
      on: { click: () => { opener = null; dialog.close(); bench.lookAt(scene, name, bench.kindOf(key)); } } });
    dialog.replaceChildren(...[
      make("form", { method: "dialog" }, make("button", { class: "quiet close", "aria-label": "Close", text: "✕" })),
      make("p", { class: "where", text: `${metric ? metric.title : key}, ${scope}` }),
      make("h2", { id: "evidence-title", text: name }),
      make("p", { class: "figure", text: entry.textContent.trim() }),
      whole ? make("p", { text: whole.textContent }) : null,
      make("p", { class: "fine", text: metric ? metric.definition : `${data.costs[key]}.` }),
      row.note ? make("p", { text: `${row.note[0].toUpperCase()}${row.note.slice(1)}.` }) : null,
      paper !== undefined && paper !== null
        ? make("p", {}, make("b", { text: `The paper has ${text(paper, key)}` }), ` (${row.paper.method}). `,
          make("span", { class: "fine", text: data.whyPaper }))
        : null,
      strip(runs, key),
      seen.length ? make("p", { class: "looks" }, ...seen.map(look)) : null,
      ...runs.map((run) => one(run, key)),
      runs.length ? null : make("p", { text: "No run of this row was found." }),
    ].filter((part) => part !== null));
    const first = bench.find("details.run", dialog);
    if (first) first.open = true;
    dialog.showModal();
  };
  dialog.addEventListener("click", (event) => { if (event.target === dialog) dialog.close(); });
  dialog.addEventListener("close", () => { if (opener) opener.focus(); });
})();
