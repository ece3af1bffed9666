"use strict";
(() => {
  const said = document.getElementById("said");
  const text = (cell) => cell.textContent.trim();

  // Numbers by their value, others by their words; what is empty comes last either way.
  const compare = (a, b, place, sign) => {
    const [left, right] = [a.cells[place], b.cells[place]];
    const [x, y] = [text(left), text(right)];
    if (x === "" || y === "") return (x === "") - (y === "");
    if (left.dataset.value !== undefined && right.dataset.value !== undefined) {
      return sign * (Number(left.dataset.value) - Number(right.dataset.value));
    }
    return sign * x.localeCompare(y, "en", { numeric: true });
  };

  const sort = (head) => {
    const table = head.closest("table");
    const falls = head.getAttribute("aria-sort") === "ascending";
    for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", falls ? "descending" : "ascending");
    const rows = [...table.tBodies[0].rows];
    rows.sort((a, b) => compare(a, b, head.cellIndex, falls ? -1 : 1));
    table.tBodies[0].append(...rows);
  };

  const quoted = (words) => (/[",\n]/.test(words) ? `"${words.replaceAll('"', '""')}"` : words);
  const csv = (table) =>
    [...table.rows].map((row) => [...row.cells].map((cell) => quoted(text(cell))).join(",")).join("\n") + "\n";

  // Without a clipboard, as on a page from a file in some browsers, the old way.
  const copyOldWay = (words) => {
    const area = document.createElement("textarea");
    area.value = words;
    area.className = "visually-hidden";
    document.body.append(area);
    area.select();
    const done = document.execCommand("copy");
    area.remove();
    return done;
  };

  const copy = async (button) => {
    const words = csv(button.closest(".table").querySelector("table"));
    let done = false;
    try {
      await navigator.clipboard.writeText(words);
      done = true;
    } catch {
      done = copyOldWay(words);
    }
    const label = button.textContent;
    button.textContent = said.textContent = done ? "Copied" : "Could not copy";
    setTimeout(() => { button.textContent = label; }, 1500);
  };

  // What a mark is, in words: for who points at it, and for who comes by keyboard.
  const name = (event) => {
    const mark = event.target.closest(".planes .mark");
    if (mark) mark.closest(".planes").querySelector(".named").textContent = mark.textContent;
  };
  document.addEventListener("pointerover", name);
  document.addEventListener("focusin", name);

  // A table that is wider than its frame says so.
  const frames = new ResizeObserver((entries) => {
    for (const { target } of entries) {
      target.closest(".table").classList.toggle("wide", target.scrollWidth > target.clientWidth + 1);
    }
  });
  for (const frame of document.querySelectorAll(".table .scroll")) frames.observe(frame);

  document.addEventListener("click", (event) => {
    if (event.target.closest("th .sort")) sort(event.target.closest("th"));
    const button = event.target.closest(".copy");
    if (button) copy(button);
  });
})();
