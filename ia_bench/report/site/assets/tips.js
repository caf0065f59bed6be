"use strict";
// What a number means, beside it: on hover, on focus, and on a touch; Escape puts it away.
(() => {
  const tip = bench.find("#tip");
  let holder = null;
  const hide = () => {
    if (holder) holder.removeAttribute("aria-describedby");
    holder = null;
    tip.hidden = true;
  };
  const show = (target) => {
    if (target === holder) return;
    hide();
    holder = target;
    tip.textContent = target.dataset.tip;
    tip.hidden = false;
    target.setAttribute("aria-describedby", "tip");
    const box = target.getBoundingClientRect(), own = tip.getBoundingClientRect();
    const left = Math.min(Math.max(8, box.left + box.width / 2 - own.width / 2), document.documentElement.clientWidth - own.width - 8);
    const below = box.bottom + 8 + own.height < innerHeight;
    tip.style.left = `${left + scrollX}px`;
    tip.style.top = `${(below ? box.bottom + 8 : box.top - own.height - 8) + scrollY}px`;
  };
  const of = (event) => (event.target instanceof Element ? event.target.closest("[data-tip]") : null);
  for (const name of ["pointerover", "focusin"]) document.addEventListener(name, (event) => { const target = of(event); if (target) show(target); else hide(); });
  document.addEventListener("keydown", (event) => { if (event.key === "Escape") hide(); });
  document.addEventListener("scroll", hide, true);
})();
