"use strict";
// Files beside the page: pictures, and scripts that hand over numbers, since a page from disk may read neither JSON nor pixels.
(() => {
  const waiting = new Map(), images = new Map();
  const place = (name) => `parts/${name.split("/").map(encodeURIComponent).join("/")}`;

  bench.receive = (name, content) => waiting.get(name)?.resolve(content);
  const script = (source) => new Promise((resolve, reject) => {
    document.head.append(bench.make("script", { src: source, on: { load: resolve, error: () => reject(new Error(`${source}: not there`)) } }));
  });
  bench.script = script;

  // What parts/NAME.js hands over; it is loaded once.
  bench.part = (name) => {
    if (!waiting.has(name)) {
      const entry = Promise.withResolvers();
      waiting.set(name, entry);
      script(`${place(name)}.js`).catch(entry.reject);
    }
    return waiting.get(name).promise;
  };

  // A picture that can be drawn, by its place below parts/ or by a data address.
  bench.image = (name) => {
    if (!images.has(name)) {
      const image = new Image();
      image.src = name.startsWith("data:") ? name : place(name);
      images.set(name, image.decode().then(() => image));
    }
    return images.get(name);
  };

  // Act once when an element comes near the window.
  bench.whenNear = (element, act) => {
    const near = new IntersectionObserver((seen) => { if (seen.some((one) => one.isIntersecting)) { near.disconnect(); act(); } }, { rootMargin: "300px" });
    near.observe(element);
  };

  // Scenes that have pictures, as buttons of which one is pressed.
  bench.sceneTabs = (holder, choose, scenes = Object.keys(bench.data.pictures)) => {
    const tabs = scenes.map((scene) => bench.make("button", { type: "button", "aria-pressed": false, text: scene }));
    const press = (at) => { tabs.forEach((tab, place_) => tab.setAttribute("aria-pressed", place_ === at)); choose(scenes[at]); };
    tabs.forEach((tab, at) => tab.addEventListener("click", () => press(at)));
    holder.replaceChildren(...tabs);
    return (scene) => press(Math.max(0, scenes.indexOf(scene)));
  };
  bench.fill = (select, names, chosen) => {
    select.replaceChildren(...names.map((name) => bench.make("option", { value: name, text: name })));
    select.value = names.includes(chosen) ? chosen : names[0];
  };
})();
