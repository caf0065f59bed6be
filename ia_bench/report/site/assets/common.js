"use strict";
// What all scripts of the page share: the data, small makers of elements, and numbers as texts.
const bench = { data: JSON.parse(document.getElementById("data").textContent) };
bench.data.pictures = window.benchPictures || {}; // none where the page was sent without its folder

// An element with properties ("class", "text", "on" for listeners, all else attributes) and children.
bench.make = (tag, properties = {}, ...children) => {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === null || value === undefined) continue;
    if (name.startsWith("aria-")) element.setAttribute(name, value); // where "false" is a value
    else if (value === false) continue;
    else if (name === "text") element.textContent = value;
    else if (name === "on") for (const [event, act] of Object.entries(value)) element.addEventListener(event, act);
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== null));
  return element;
};

bench.find = (selector, within = document) => within.querySelector(selector);
bench.all = (selector, within = document) => [...within.querySelectorAll(selector)];
bench.metricOf = (key) => bench.data.metrics.find((metric) => metric.key === key);
bench.secondsText = (seconds) => `${seconds < 100 ? seconds.toFixed(1) : seconds.toFixed(0)} s`;
bench.mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;

// Colours that colour-blind readers tell apart (Petroff, ten of them), and three shapes of marks, so that thirty rows differ: handed
// out to the rows that have curves, so that two of few rows never look alike. Dashes are left to runs that go on.
bench.colours = ["#3f90da", "#ffa90e", "#bd1f01", "#94a4a2", "#832db6", "#a96b59", "#e76300", "#b9ac70", "#717581", "#92dadd"];
bench.shapes = ["circle", "square", "triangle"];
bench.drawn = bench.data.rows.map((_, row) => row).filter((row) => bench.data.live || bench.data.runs.some((run) => run.row === row && run.curve && !run.curve.level));
bench.styleOf = (row) => {
  const place = Math.max(0, bench.drawn.indexOf(row));
  return { colour: bench.colours[place % 10], shape: bench.shapes[place % 3] };
};
bench.swatch = (row) => bench.make("i", { class: bench.styleOf(row).shape, style: `background:${bench.styleOf(row).colour}` });

// One line for readers of screens, such as "copied".
bench.say = (text) => { bench.find("#said").textContent = text; };
