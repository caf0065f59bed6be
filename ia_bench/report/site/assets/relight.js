"use strict";
// A novel light that goes around the object: truth and two rows, turned by a slider or by dragging.
(() => {
  const section = bench.find("#relight");
  if (!section || !Object.keys(bench.data.pictures).length) return;
  const canvases = bench.all("canvas", section), selects = [bench.find("#relight-a"), bench.find("#relight-b")];
  const slider = bench.find("#relight-turn"), turns = Number(slider.max) + 1;
  let scene = null;

  const draw = () => {
    ["truth", ...selects.map((select) => select.value)].forEach((source, place) =>
      bench.drawPicture(canvases[place], source, "turned", Number(slider.value), bench.data.pictures[scene]));
    bench.find("#relight-angle").textContent = `${(360 * slider.value / turns).toFixed(0)}°`;
  };
  const choose = bench.sceneTabs(bench.find("#relight-scenes"), (name) => {
    scene = name;
    const rows = Object.keys(bench.data.pictures[name].rows), plain = rows.filter((row) => !bench.data.rows.find((one) => one.name === row).bound);
    bench.fill(selects[0], rows, selects[0].value || plain[0]);
    bench.fill(selects[1], rows, selects[1].value || plain[1]);
    draw();
  }, Object.keys(bench.data.pictures).filter((name) => bench.data.pictures[name].lights.length));
  [slider, ...selects].forEach((control) => control.addEventListener("input", draw));
  canvases.forEach((canvas) => canvas.addEventListener("pointerdown", (event) => {
    const start = Number(slider.value), wide = canvas.getBoundingClientRect().width;
    canvas.setPointerCapture(event.pointerId);
    canvas.onpointermove = (now) => {
      slider.value = (((start + Math.round((turns * (now.clientX - event.clientX)) / wide)) % turns) + turns) % turns;
      draw();
    };
    canvas.onpointerup = canvas.onpointercancel = () => { canvas.onpointermove = null; };
  }));
  bench.whenNear(section, () => choose());
})();
