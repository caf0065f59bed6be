"use strict";
// Any two of photograph, truth and rows under a slider; every row at the same place of the same view.
(() => {
  const { make, data } = bench;
  if (!bench.find("#look-slider") || !Object.keys(bench.data.pictures).length) return;
  const kinds = { albedo: "Albedo", aligned: "Aligned albedo", roughness: "Roughness", view: "View synthesis", relit: "Relit", light: "Light" };
  const look = { scene: null, kind: "aligned", view: 0, zoom: 1, x: 0.5, y: 0.5 };
  bench.look = look; // read by the error map
  const [first, second] = bench.all("#look-slider canvas");
  const [left, right] = [bench.find("#look-left"), bench.find("#look-right")];
  const here = () => data.pictures[look.scene];

  // ---- which picture ----------------------------------------------------------------------------------------------
  const sheetOf = (source, kind, scene = here()) => {
    if (source === "photograph") {
      const sheet = kind === "view" || kind === "relit" ? kind : "photograph";
      return { place: `${scene.folder}/truth/${sheet}`, shape: scene.sheets[sheet] };
    }
    const name = source === "truth" && kind === "aligned" ? "albedo" : kind;
    const [folder, sheets] = source === "truth" ? ["truth", scene.sheets] : [scene.rows[source].folder, scene.rows[source].sheets];
    return sheets[name] ? { place: `${scene.folder}/${folder}/${name}`, shape: sheets[name] } : null;
  };
  const count = () => (look.kind === "light" ? 1 : sheetOf(original(), look.kind).shape[0]);
  // Rows with a picture of a kind: some methods recover no light of the whole scene, and no view under it.
  const rowsWith = (kind) => Object.keys(here().rows).filter((row) => here().rows[row].sheets[kind]);
  // A photograph is the truth of its own view; in a scene without any other truth it is called by its name.
  const sources = () => {
    const known = ["albedo", "roughness", "light"].some((kind) => here().sheets[kind]);
    const itself = ["view", "relit"].includes(look.kind), photograph = itself ? !known : look.kind !== "light";
    return [...(photograph ? ["photograph"] : []), ...(sheetOf("truth", look.kind) && (known || !itself) ? ["truth"] : []), ...rowsWith(look.kind)];
  };
  const original = () => (sheetOf("truth", look.kind) ? "truth" : sources()[0]);
  const offered = () => Object.keys(kinds).filter((kind) => sheetOf("truth", kind) || rowsWith(kind).length);
  const viewName = () => {
    const scene = here();
    if (look.kind === "light") return `as it was recovered, ${here().sheets.light ? "over the alignment" : "each at an exposure of its own"}`;
    if (look.kind === "relit") return `${scene.relit[look.view][1]} under ${scene.relit[look.view][0]}`;
    return scene.views[look.kind === "view" ? "view" : "albedo"][look.view];
  };

  // The part of a unit square that is seen: its corner and its side.
  bench.crop = () => {
    const side = 1 / look.zoom, at = (centre) => Math.min(Math.max(centre - side / 2, 0), 1 - side);
    return [at(look.x), at(look.y), side];
  };

  bench.drawPicture = async (canvas, source, kind, view, scene = here()) => {
    const sheet = sheetOf(source, kind, scene), context = canvas.getContext("2d");
    const token = canvas.token = {}; // of several calls the last one is drawn
    const image = sheet && (await bench.image(`${sheet.place}.webp`));
    if (canvas.token !== token) return;
    context.fillStyle = "#808080";
    context.fillRect(0, 0, canvas.width, canvas.height);
    if (!image) return;
    const [number, columns] = sheet.shape, width = image.naturalWidth / columns, height = image.naturalHeight / Math.ceil(number / columns);
    const [x, y, side] = kind === "turned" || kind === "light" ? [0, 0, 1] : bench.crop();
    const tall = canvas.width * (height / width), top = kind === "light" ? (canvas.height - tall) / 2 : 0;
    context.imageSmoothingEnabled = width * side > 48;
    context.drawImage(image, (view % columns + x) * width, (Math.floor(view / columns) + y) * height, side * width, side * height,
      0, top, canvas.width, kind === "light" ? tall : canvas.height);
  };

  // ---- everything that follows the choice -------------------------------------------------------------------------
  const score = (row) => {
    const value = here().rows[row].scores[look.kind]?.[look.view];
    return value === undefined || value === null ? "" : look.kind === "roughness" ? `MSE ${value.toFixed(4)}` : `${value.toFixed(1)} dB`;
  };
  const gallery = () => bench.find("#look-rows").replaceChildren(...sources().map((source) => {
    const canvas = make("canvas", { width: 192, height: look.kind === "light" ? 96 : 192, tabindex: 0, role: "img", "aria-label": `${kinds[look.kind]}, ${source}` });
    canvas.dataset.source = source;
    return make("figure", {}, canvas, make("figcaption", {}, make("span", { text: source }), make("small", { text: here().rows[source] ? score(source) : "" })));
  }));

  bench.drawLook = () => {
    bench.drawPicture(first, left.value, look.kind, look.view);
    bench.drawPicture(second, right.value, look.kind, look.view);
    bench.all("#look-rows canvas").forEach((canvas) => bench.drawPicture(canvas, canvas.dataset.source, look.kind, look.view));
    bench.drawError();
    bench.find("#look-view").textContent = `${look.view + 1} of ${count()}: ${viewName()}`;
    bench.all("#look-views button").forEach((button, at) => button.setAttribute("aria-pressed", at === look.view));
  };
  const thumbs = () => {
    const { place, shape: [number, columns] } = sheetOf(original(), look.kind), lines = Math.ceil(number / columns);
    const part = (at, all) => (all > 1 ? `${(100 * at) / (all - 1)}%` : "0");
    const url = `parts/${place.split("/").map(encodeURIComponent).join("/")}.webp`;
    bench.find("#look-views").replaceChildren(...Array.from({ length: look.kind === "light" ? 0 : number }, (_, at) => {
      const button = make("button", { type: "button", "aria-label": `View ${at + 1}`, "aria-pressed": false,
        style: `background:#808080 url("${url}") ${part(at % columns, columns)} ${part(Math.floor(at / columns), lines)} / ${100 * columns}% ${100 * lines}%` });
      button.addEventListener("click", () => { look.view = at; gallery(); bench.drawLook(); });
      return button;
    }));
  };
  const choose = () => {
    look.view = Math.min(look.view, count() - 1);
    const names = sources(), rows = rowsWith(look.kind), usual = rows.find((row) => !data.rows.find((one) => one.name === row).bound) || rows[0];
    bench.fill(left, names, left.value || "truth");
    bench.fill(right, names, right.value || usual);
    bench.fill(bench.find("#look-of"), rows, bench.find("#look-of").value || usual);
    bench.find("#look-error").hidden = look.kind === "light" || !sheetOf("truth", look.kind);
    thumbs();
    gallery();
    bench.drawLook();
  };
  const step = (by) => { look.view = (look.view + by + count()) % count(); gallery(); bench.drawLook(); };
  bench.find("#look-before").addEventListener("click", () => step(-1));
  bench.find("#look-next").addEventListener("click", () => step(1));
  for (const select of [left, right, bench.find("#look-of")]) select.addEventListener("change", bench.drawLook);
  bench.find("#look-zoom").addEventListener("input", (event) => { look.zoom = Number(event.target.value); bench.drawLook(); });

  // ---- the part that is seen: drag, or arrow keys -----------------------------------------------------------------
  const move = (x, y) => {
    const half = 0.5 / look.zoom, inside = (value) => Math.min(Math.max(value, half), 1 - half);
    [look.x, look.y] = [inside(x), inside(y)];
    bench.drawLook();
  };
  const rows = bench.find("#look-rows");
  rows.addEventListener("pointerdown", (event) => {
    const canvas = event.target.closest("canvas");
    if (!canvas) return;
    const [x, y, size] = [look.x, look.y, canvas.getBoundingClientRect().width * look.zoom];
    canvas.setPointerCapture(event.pointerId);
    canvas.onpointermove = (now) => move(x - (now.clientX - event.clientX) / size, y - (now.clientY - event.clientY) / size);
    canvas.onpointerup = canvas.onpointercancel = () => { canvas.onpointermove = null; };
  });
  rows.addEventListener("keydown", (event) => {
    const [x, y] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key] || [0, 0];
    if (!x && !y) return;
    event.preventDefault();
    move(look.x + (0.1 * x) / look.zoom, look.y + (0.1 * y) / look.zoom);
  });

  const tabs = Object.entries(kinds).map(([kind, name]) => make("button", { type: "button", "aria-pressed": kind === look.kind, text: name, "data-kind": kind }));
  const chooseKind = (kind) => {
    look.kind = offered().includes(kind) ? kind : offered()[0];
    tabs.forEach((tab) => { tab.hidden = !offered().includes(tab.dataset.kind); });
    tabs.forEach((tab) => tab.setAttribute("aria-pressed", tab.dataset.kind === look.kind));
    choose();
  };
  tabs.forEach((tab) => tab.addEventListener("click", () => chooseKind(tab.dataset.kind)));
  bench.find("#look-kinds").append(...tabs);
  const chooseScene = bench.sceneTabs(bench.find("#look-scenes"), (scene) => { look.scene = scene; chooseKind(look.kind); });
  // From elsewhere on the page: a row of a scene beside the truth, or beside another row.
  bench.lookAt = (scene, row, kind, other = "truth") => {
    chooseScene(scene);
    if (!here().rows[row]) return;
    chooseKind(here().rows[row].sheets[kind] ? kind : "relit");
    [left.value, right.value, bench.find("#look-of").value] = [rowsWith(look.kind).includes(other) ? other : original(), row, row];
    bench.drawLook();
    bench.find("#look").scrollIntoView();
  };
  bench.whenNear(bench.find("#look"), () => { if (!look.scene) chooseScene(); });
})();
