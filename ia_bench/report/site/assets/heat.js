"use strict";
// The error of a row as a map, with its value under the cursor.
(() => {
  const canvas = bench.find("#look-heat");
  if (!canvas) return;
  const value = bench.find("#look-value"), context = canvas.getContext("2d");
  const stops = [[0, 34, 78], [53, 69, 108], [102, 106, 112], [148, 142, 119], [200, 183, 104], [254, 232, 56]]; // cividis
  const colour = (share) => {
    const at = share * (stops.length - 1), low = Math.min(Math.floor(at), stops.length - 2);
    return stops[low].map((channel, place) => channel + (stops[low + 1][place] - channel) * (at - low));
  };
  const decoded = new Map();
  let now = null, cursor = null;

  // Levels of one view of a row: {size, levels, largest, values}.
  const mapOf = async (scene, row, kind, view) => {
    const content = await bench.part(`${scene.folder}/${scene.rows[row].folder}/errors`);
    const name = `${scene.folder}/${row}/${kind}`;
    if (!decoded.has(name)) {
      const image = await bench.image(content.sheets[kind]);
      const copy = new OffscreenCanvas(image.naturalWidth, image.naturalHeight).getContext("2d");
      copy.drawImage(image, 0, 0);
      decoded.set(name, copy.getImageData(0, 0, image.naturalWidth, image.naturalHeight).data.filter((_, place) => place % 4 === 0));
    }
    const size = content.tile;
    return { size, levels: content.levels, largest: content.largest, values: decoded.get(name).subarray(view * size * size, (view + 1) * size * size) };
  };
  const errorOf = (map, level) => map.largest * (level / (map.levels - 1)) ** 2;

  bench.drawError = async () => {
    const { scene, kind, view } = bench.look, row = bench.find("#look-of").value;
    if (bench.find("#look-error").hidden || !row) return; // nothing to compare with
    const token = canvas.token = {};
    const map = await mapOf(bench.data.pictures[scene], row, kind, view);
    if (canvas.token !== token) return;
    const small = new OffscreenCanvas(map.size, map.size), pixels = new ImageData(map.size, map.size);
    map.values.forEach((level, place) => pixels.data.set(level === 255 ? [0, 0, 0, 0] : [...colour(level / (map.levels - 1)), 255], 4 * place));
    small.getContext("2d").putImageData(pixels, 0, 0);
    const [x, y, side] = bench.crop();
    context.imageSmoothingEnabled = false;
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.drawImage(small, x * map.size, y * map.size, side * map.size, side * map.size, 0, 0, canvas.width, canvas.height);
    now = map;
    if (cursor) mark();
  };

  const mark = () => {
    const [x, y, side] = bench.crop(), at = (place, from) => Math.min(Math.floor((from + place * side) * now.size), now.size - 1);
    const level = now.values[at(cursor[1], y) * now.size + at(cursor[0], x)];
    const error = errorOf(now, level), what = bench.look.kind === "roughness" ? "of roughness" : "of 1, sRGB-encoded";
    value.textContent = level === 255 ? "not scored" : level === 0 ? `below ${errorOf(now, 1).toFixed(4)}` : `${error.toFixed(3)} ${what}, ${(-20 * Math.log10(error)).toFixed(1)} dB`;
  };
  canvas.addEventListener("pointermove", (event) => {
    if (!now) return;
    const box = canvas.getBoundingClientRect();
    cursor = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
    mark();
  });
  canvas.addEventListener("keydown", (event) => {
    const [x, y] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key] || [0, 0];
    if ((!x && !y) || !now) return;
    event.preventDefault();
    const inside = (place) => Math.min(Math.max(place, 0), 0.999);
    cursor = cursor || [0.5, 0.5];
    cursor = [inside(cursor[0] + x / 32), inside(cursor[1] + y / 32)];
    bench.drawError().then(() => {
      context.strokeStyle = "#fff";
      context.strokeRect(cursor[0] * canvas.width - 8, cursor[1] * canvas.height - 8, 16, 16);
    });
  });
})();
