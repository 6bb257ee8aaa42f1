// Shows only chosen methods in all tables, lists and legends, and keeps the choice in the link: only=a,b&find=c
const chosen = { only: new Set(), find: "" };
const finder = document.getElementById("find");
const chips = [...document.querySelectorAll("button.pick")];

function isShown(of) {
  const label = of.replace(/, corrected$/, "");
  const words = chosen.find.toLowerCase().split(/[\s,]+/).filter(Boolean);
  return (!chosen.only.size || chosen.only.has(label)) && (!words.length || words.some((word) => label.toLowerCase().includes(word)));
}

const allShown = () => chips.every((chip) => isShown(chip.value));

// The element hidden with a method: its table row (or its own table body), list item or card.
function around(named) {
  if (named.matches(".series, .tile")) return named;
  const row = named.closest("tr");
  if (!row) return named.closest("li, article, figure") ?? named;
  const body = row.parentElement;
  return body.tagName === "TBODY" && body.rows[0] === row && body.querySelectorAll("[data-of]").length === 1 ? body : row;
}

function applyFilter() {
  for (const named of document.querySelectorAll("[data-of]:not(.player [data-of], th.column)")) {
    around(named).toggleAttribute("hidden", !isShown(named.dataset.of)); // drawings have no property hidden
  }
  for (const heading of document.querySelectorAll("th.column[data-of]")) {
    const place = heading.cellIndex;
    for (const row of heading.closest("table").rows) {
      if (row.cells.length > place) row.cells[place].hidden = !isShown(heading.dataset.of);
    }
  }
  for (const row of document.querySelectorAll(".player tr[data-of]")) row.hidden = !isShown(row.dataset.of);
  const count = chips.filter((chip) => isShown(chip.value)).length;
  for (const chip of chips) {
    chip.setAttribute("aria-pressed", String(chosen.only.has(chip.value)));
    chip.classList.toggle("out", !isShown(chip.value));
  }
  const some = count < chips.length;
  for (const label of document.querySelectorAll(".filtered")) label.textContent = some ? `${count} of ${chips.length} methods` : label.dataset.all;
  document.getElementById("show-all").hidden = !some && !chosen.find;
  document.dispatchEvent(new Event("methods"));
}

function readLink() {
  const known = new Set(chips.map((chip) => chip.value));
  chosen.only = new Set((link.words.get("only") ?? []).filter((label) => known.has(label)));
  chosen.find = link.words.get("find")?.[0] ?? "";
  finder.value = chosen.find;
}

function changed() {
  link.write({ only: chosen.only.size ? [...chosen.only] : undefined, find: chosen.find ? [chosen.find] : undefined });
  applyFilter();
}

for (const chip of chips) {
  chip.addEventListener("click", () => {
    if (!chosen.only.delete(chip.value)) chosen.only.add(chip.value);
    changed();
  });
}
finder.addEventListener("input", () => {
  chosen.find = finder.value.trim();
  changed();
});
document.getElementById("show-all").addEventListener("click", () => {
  chosen.only.clear();
  chosen.find = finder.value = "";
  changed();
  finder.focus();
});
document.addEventListener("linked", () => {
  readLink();
  changed();
});
document.addEventListener("built", applyFilter);
