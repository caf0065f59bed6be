"use strict";
// The table as it is shown (scene, columns, order), as text for a spreadsheet, a document or a paper.
(() => {
  const escapes = { "&": "\\&", "%": "\\%", $: "\\$", "#": "\\#", _: "\\_", "†": "$^\\dagger$", "±": "$\\pm$", "↑": "$\\uparrow$", "↓": "$\\downarrow$", "–": "--" };
  const tex = (text) => text.replace(/[&%$#_†±↑↓–]/g, (letter) => escapes[letter]);

  // Header and lines of what is seen: {text, value, best}.
  const shown = (panel) => {
    const seen = (cell) => cell.offsetParent !== null;
    const words = (cell) => {
      const copy = cell.cloneNode(true);
      bench.all(".paper, .unfold", copy).forEach((part) => part.remove());
      return copy.textContent.replace(/\s+/g, " ").trim();
    };
    const table = bench.find("table.results", panel);
    const entry = (cell) => ({ text: words(cell), value: cell.dataset.v || "", best: cell.classList.contains("best") });
    return {
      header: [...table.tHead.rows[0].cells].filter(seen).map((cell) => ({ text: words(cell), key: cell.dataset.key })),
      lines: [...table.tBodies[0].rows].map((row) => [...row.cells].filter(seen).map(entry)),
    };
  };

  bench.formats = {
    CSV: ({ header, lines }) => {
      const quote = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
      const names = header.map((one) => one.key);
      return [names, ...lines.map((line) => line.map((cell, place) => (place && names[place] !== "failed" ? cell.value : cell.text)))]
        .map((cells) => cells.map(quote).join(",")).join("\n") + "\n";
    },
    Markdown: ({ header, lines }) => {
      const plain = (text) => text.replace(/[\\`*_|[\]<>]/g, "\\$&");
      const entry = (cell) => (cell.best ? `**${plain(cell.text)}**` : plain(cell.text));
      const body = [header.map((one) => plain(one.text)), header.map((_, place) => (place ? "---:" : ":---")), ...lines.map((line) => line.map(entry))];
      return body.map((cells) => `| ${cells.join(" | ")} |`).join("\n") + "\n";
    },
    LaTeX: ({ header, lines }) => {
      const entry = (cell) => (cell.best ? `\\textbf{${tex(cell.text)}}` : tex(cell.text));
      const rows = lines.map((line) => `${line.map(entry).join(" & ")} \\\\`);
      return [`\\begin{tabular}{l${"r".repeat(header.length - 1)}}`, "\\toprule", `${header.map((one) => tex(one.text)).join(" & ")} \\\\`,
        "\\midrule", ...rows, "\\bottomrule", "\\end{tabular}", ""].join("\n");
    },
  };

  bench.copy = async (text) => {
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
  const told = (button) => {
    bench.say(`${button.dataset.copy || "Command"} copied`);
    button.classList.add("done");
    setTimeout(() => button.classList.remove("done"), 1200);
  };
  bench.copyButton = (text) => {
    const button = bench.make("button", { type: "button", class: "quiet", text: "copy" });
    button.addEventListener("click", async () => { await bench.copy(text); told(button); });
    return button;
  };
  bench.all("[data-copy]").forEach((button) => button.addEventListener("click", async () => {
    bench.copied = bench.formats[button.dataset.copy](shown(bench.scope()));
    await bench.copy(bench.copied);
    told(button);
  }));
})();
