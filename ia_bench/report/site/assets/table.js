"use strict";
// The table: one scene or all, sorted, scene by scene below a row, and arrow keys among its numbers.
(() => {
  const { data } = bench;
  const tabs = bench.all("#table [role=tab]");
  const panels = bench.all("#table .scope");
  const order = new Map(); // table -> its rows as they came

  bench.gains = { gain: "aligned_albedo.psnr", equal: "aligned_albedo.psnr" }; // columns of differences -> the metric behind them
  bench.scope = () => panels[tabs.findIndex((tab) => tab.getAttribute("aria-selected") === "true")];

  const choose = (tab) => {
    tabs.forEach((other, place) => {
      const chosen = other === tab;
      other.setAttribute("aria-selected", chosen);
      other.tabIndex = chosen ? 0 : -1;
      panels[place].toggleAttribute("data-away", !chosen);
    });
  };
  bench.scopes = panels.map((panel) => panel.dataset.scope);
  bench.showScope = (name) => choose(tabs[panels.findIndex((panel) => panel.dataset.scope === name)]);
  tabs.forEach((tab) => tab.addEventListener("click", () => choose(tab)));
  tabs.forEach((tab, place) => tab.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    const next = tabs[(place + step + tabs.length) % tabs.length];
    next.focus();
    choose(next);
  }));

  // ---- sort: better first, then worse first, then as it came ------------------------------------------------------
  const keys = bench.all("thead th", panels[0]).map((head) => head.dataset.key);
  bench.cellOf = (row, key) => row.cells[keys.indexOf(key)];
  bench.keyOf = (cell) => keys[cell.cellIndex];
  // Tab leads to the first number, from where arrow keys go on; also after the one that it led to has gone.
  const reachable = (table) => bench.all("tbody td", table).forEach((number, place) => { number.tabIndex = place ? -1 : 0; });
  const rowsOf = (body) => [...body.rows].filter((row) => !row.classList.contains("part"));

  bench.sort = (table, key, how) => {
    const body = table.tBodies[0], metric = bench.metricOf(key);
    if (!order.has(table)) order.set(table, rowsOf(body));
    bench.all("tr.part", body).forEach((row) => row.remove());
    bench.all(".unfold", body).forEach((button) => button.setAttribute("aria-expanded", false));
    const up = (metric && metric.higher) || key in bench.gains ? -1 : 1; // what is better comes first: fewer seconds, fewer failures, A before B
    const value = (row) => { const text = bench.cellOf(row, key).dataset.v; return key === "row" ? row.dataset.row : text === undefined ? NaN : Number(text); };
    const compare = (a, b) => {
      const [x, y] = [value(a), value(b)];
      if (key === "row") return x.localeCompare(y, undefined, { numeric: true }); // 8 views before 16
      return Number.isNaN(x) - Number.isNaN(y) || x - y || 0;
    };
    const sign = how === "better" ? up : -up;
    const empty = (row) => (Number.isNaN(value(row)) ? 1 : 0); // without a value: last, either way
    const sorted = how === "none" ? order.get(table) : [...order.get(table)].sort((a, b) => (key !== "row" && empty(a) - empty(b)) || sign * compare(a, b));
    body.append(...sorted);
    reachable(table);
    bench.all("thead th", table).forEach((head) => {
      const mine = head.dataset.key === key && how !== "none";
      head.setAttribute("aria-sort", mine ? (sign > 0 ? "ascending" : "descending") : "none");
      head.dataset.how = mine ? how : "none";
    });
  };
  bench.all("table.results [data-sort]").forEach((button) => button.addEventListener("click", () => {
    const head = button.closest("th");
    const next = { better: "worse", worse: "none" }[head.dataset.how] || "better";
    bench.sort(button.closest("table"), head.dataset.key, next);
  }));

  // ---- a row's scenes below it ------------------------------------------------------------------------------------
  const parts = (name) => panels.slice(1).map((panel) => {
    const row = bench.find(`tr[data-row="${CSS.escape(name)}"]`, panel).cloneNode(true);
    row.className = "part";
    row.cells[0].textContent = panel.dataset.scope;
    row.dataset.scope = panel.dataset.scope;
    return row;
  });
  bench.all(".unfold").forEach((button) => button.addEventListener("click", () => {
    const row = button.closest("tr"), open = button.getAttribute("aria-expanded") !== "true";
    button.setAttribute("aria-expanded", open);
    if (open) row.after(...parts(row.dataset.row));
    else while (row.nextElementSibling && row.nextElementSibling.classList.contains("part")) row.nextElementSibling.remove();
    reachable(row.closest("table"));
  }));

  // ---- what is shown ----------------------------------------------------------------------------------------------
  for (const [id, name] of [["all-metrics", "wide"], ["whole-images", "with-whole"], ["with-paper", "with-paper"]]) {
    const box = bench.find(`#${id}`);
    if (box) box.addEventListener("change", () => {
      bench.find("#table").classList.toggle(name, box.checked);
      bench.all("table.results").forEach(reachable);
    });
  }

  // ---- numbers: click, or arrow keys and Enter --------------------------------------------------------------------
  bench.all(".paper").forEach((figure) => {
    const { paper } = data.rows.find((row) => row.name === figure.closest("tr").dataset.row);
    figure.dataset.tip = `${paper.method} of the paper's table 1. ${data.whyPaper}`;
  });
  const open = (number) => {
    const row = number.closest("tr"), key = bench.keyOf(number);
    bench.showEvidence(row.dataset.row, row.dataset.scope || number.closest(".scope").dataset.scope, bench.gains[key] || key, number);
  };
  for (const table of bench.all("table.results")) {
    reachable(table);
    table.addEventListener("click", (event) => { const number = event.target.closest("tbody td"); if (number) open(number); });
    table.addEventListener("keydown", (event) => {
      const number = event.target.closest("tbody td");
      if (!number) return;
      if (event.key === "Enter" || event.key === " ") { event.preventDefault(); open(number); return; }
      const [down, right] = { ArrowDown: [1, 0], ArrowUp: [-1, 0], ArrowRight: [0, 1], ArrowLeft: [0, -1] }[event.key] || [0, 0];
      if (!down && !right) return;
      event.preventDefault();
      const line = down > 0 ? number.parentElement.nextElementSibling : down < 0 ? number.parentElement.previousElementSibling : number.parentElement;
      let next = down ? line && line.cells[number.cellIndex] : number;
      while (right && next) {
        next = right > 0 ? next.nextElementSibling : next.previousElementSibling;
        if (next && next.offsetParent !== null) break;
      }
      if (!next || next.tagName !== "TD") return;
      number.tabIndex = -1;
      next.tabIndex = 0;
      next.focus();
    });
  }
  bench.all(".leaders .who").forEach((button) => button.addEventListener("click", () =>
    bench.showEvidence(button.dataset.row, button.closest(".scope").dataset.scope, button.dataset.key, button)));
})();
