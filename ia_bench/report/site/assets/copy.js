"use strict";
// A button that copies a text: the command of a run.
(() => {
  const copy = async (text) => {
    try {
      await navigator.clipboard.writeText(text);
    } catch { // a browser that keeps its clipboard from files
      const field = bench.make("textarea", { class: "unseen" });
      field.value = text;
      document.body.append(field);
      field.select();
      document.execCommand("copy");
      field.remove();
    }
  };
  bench.copyButton = (text) => {
    const button = bench.make("button", { type: "button", class: "quiet", text: "copy" });
    button.addEventListener("click", async () => {
      await copy(text);
      bench.say("Command copied");
      button.classList.add("done");
      setTimeout(() => button.classList.remove("done"), 1200);
    });
    return button;
  };
})();
