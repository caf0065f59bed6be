"use strict";
// Colours as the system has them, light, or dark: a click goes on to the next.
(() => {
  const names = { "": "as the system has them", light: "light", dark: "dark" };
  const button = bench.find("#theme");
  const apply = (theme) => {
    document.documentElement.dataset.theme = theme;
    button.setAttribute("aria-label", `Colours: ${names[theme]}`);
    document.dispatchEvent(new Event("bench-theme"));
  };
  button.addEventListener("click", () => {
    const order = Object.keys(names), now = document.documentElement.dataset.theme || "";
    apply(order[(order.indexOf(now) + 1) % order.length]);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => document.dispatchEvent(new Event("bench-theme")));
})();
