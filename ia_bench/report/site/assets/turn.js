"use strict";
// What was recovered in a 3-D viewer: the mesh once a scene, textures by row, lit or one channel alone, under any of the lights.
(() => {
  const section = bench.find("#turn");
  if (!section || !Object.keys(bench.data.pictures).length) return;
  const stage = bench.find("#turn-stage"), [row, channel, light] = ["row", "channel", "light"].map((name) => bench.find(`#turn-${name}`));
  let scene = null, viewer = null, shown = null, seen = null;

  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const inflated = (content) => new Response(new Blob([content]).stream().pipeThrough(new DecompressionStream("gzip"))).blob();
  const place = () => `${bench.data.pictures[scene].folder}`;

  const solidOf = (name) => bench.part(`${place()}/${name === "truth" ? "truth" : bench.data.pictures[scene].rows[name].folder}/solid`);
  // A run whose mesh was made from the photographs has its own.
  const meshOf = async () => (await solidOf(row.value)).mesh || (await solidOf("truth")).mesh;

  const paint = async () => {
    const mine = shown;
    const textures = await solidOf(row.value);
    if (mine !== shown || !viewer.model) return;
    const [material] = viewer.model.materials, pbr = material.pbrMetallicRoughness, lit = channel.value === "lit";
    const of = (name) => viewer.createTexture(textures[name]);
    pbr.setBaseColorFactor(lit ? [1, 1, 1, 1] : [0, 0, 0, 1]);
    pbr.setRoughnessFactor(1);
    pbr.setMetallicFactor(0);
    material.setEmissiveFactor(lit ? [0, 0, 0] : [1, 1, 1]);
    if (lit) {
      pbr.baseColorTexture.setTexture(await of("albedo"));
      pbr.metallicRoughnessTexture.setTexture(await of("roughness"));
    } else {
      material.emissiveTexture.setTexture(await of(channel.value));
    }
    stage.dataset.shown = `${scene}, ${row.value}, ${channel.value}, ${light.value}`;
  };
  // The true lights, and of photographs whose light nobody knows the one that the row has recovered.
  const illuminate = async () => {
    const [{ lights: known }, { light: recovered }] = [await solidOf("truth"), await solidOf(row.value)];
    const lights = { ...(recovered && { recovered }), ...known };
    bench.fill(light, Object.keys(lights), light.value);
    const chosen = lights[light.value]; // without any the viewer has a neutral one
    viewer.environmentImage = chosen ? `${URL.createObjectURL(new Blob([bytes(chosen)]))}#.hdr` : null;
  };
  const show = async () => {
    if (!viewer) return;
    const mine = (shown = {});
    const mesh = await meshOf();
    await illuminate();
    const model = await inflated(bytes(mesh));
    if (mine !== shown) return;
    seen = mesh;
    viewer.addEventListener("load", paint, { once: true });
    viewer.src = URL.createObjectURL(model);
  };
  const choose = bench.sceneTabs(bench.find("#turn-scenes"), (name) => {
    scene = name;
    const rows = Object.keys(bench.data.pictures[name].rows);
    bench.fill(row, [...(bench.data.pictures[name].textured ? ["truth"] : []), ...rows], row.value || rows.find((one) => !bench.data.rows.find((other) => other.name === one).bound));
    show();
  });
  row.addEventListener("change", async () => ((await meshOf()) === seen ? illuminate().then(paint) : show()));
  channel.addEventListener("change", paint);
  light.addEventListener("change", async () => { await illuminate(); await paint(); });
  bench.whenNear(section, async () => {
    await bench.script("parts/model-viewer-umd.min.js");
    viewer = bench.make("model-viewer", { "camera-controls": true, "touch-action": "pan-y", "interaction-prompt": "none", "tone-mapping": "neutral",
      alt: "The object, to be turned", "camera-orbit": "30deg 70deg 105%" });
    stage.replaceChildren(viewer);
    choose();
  });
})();
