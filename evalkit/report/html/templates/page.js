"use strict";
// Sorting: a heading's button orders the bodies of its table, the better value first; rows without a value stay last.
function sortable(table) {
  const headings = [...table.tHead.rows[0].cells];
  headings.forEach((heading, column) => {
    heading.querySelector("button")?.addEventListener("click", () => {
      const sorted = heading.getAttribute("aria-sort");
      const up = sorted ? sorted !== "ascending" : heading.dataset.first !== "descending";
      headings.forEach((other) => other.removeAttribute("aria-sort"));
      heading.setAttribute("aria-sort", up ? "ascending" : "descending");
      const key = (body) => {
        const cell = body.rows[0].cells[column];
        return cell.dataset.sort ?? cell.textContent.trim(); // its text where that is all it shows
      };
      const order = (a, b) => {
        const [x, y] = [key(a), key(b)];
        if (x === "" || y === "") return (x === "") - (y === "");
        const by = Number.isNaN(Number(x)) ? x.localeCompare(y) : Number(x) - Number(y);
        return up ? by : -by;
      };
      table.append(...[...table.tBodies].sort(order));
    });
  });
}
// Pictures: a click or Enter enlarges, Escape or a second click closes.
const viewer = document.getElementById("viewer");
viewer.addEventListener("click", () => viewer.close());
function enlargeable(button) {
  button.addEventListener("click", () => {
    const image = button.querySelector("img");
    viewer.querySelector("img").src = image.src;
    viewer.querySelector("img").alt = image.alt;
    viewer.querySelector("p").textContent = image.alt;
    viewer.showModal();
  });
}
// Gives a part of the page its behaviour: at the start, and when it is built.
function enhance(root) {
  for (const table of root.querySelectorAll("table.sortable")) sortable(table);
  for (const button of root.querySelectorAll("button.enlarge")) enlargeable(button);
  for (const row of root.querySelectorAll("table.wrapping tbody tr")) { // labels of the cards of a narrow screen
    const { cells } = row.closest("table").tHead.rows[0];
    const name = (heading) => [(heading.querySelector("button") ?? heading).firstChild, heading.querySelector(".unit")]
      .map((part) => part?.textContent.trim()).filter(Boolean).join(" ");
    for (const cell of row.cells) if (cell.cellIndex) cell.dataset.label = name(cells[cell.cellIndex]);
  }
  for (const command of root.querySelectorAll(".command")) {
    command.addEventListener("click", () => getSelection().selectAllChildren(command));
  }
}
// Parts in a template are built when they are opened or linked to.
const LATER = "template:not(.data)";
function build(template) {
  const parent = template.parentElement;
  template.replaceWith(template.content);
  enhance(parent);
  for (const inner of parent.querySelectorAll(`details[open] > ${LATER}`)) build(inner);
  document.dispatchEvent(new CustomEvent("built", { detail: parent }));
}
function buildWithin(element) {
  for (const template of element.querySelectorAll(`:scope > ${LATER}`)) build(template);
}
const holds = (part, id) => part.getElementById(id) || [...part.querySelectorAll(LATER)].some((inner) => holds(inner.content, id));
function located(id) {
  const found = document.getElementById(id);
  if (found || !id) return found;
  const outer = [...document.querySelectorAll(LATER)].find((template) => holds(template.content, id));
  if (!outer) return null;
  build(outer);
  return located(id);
}
document.addEventListener("toggle", (event) => {
  if (event.target.open) buildWithin(event.target);
}, true);
enhance(document);
// A truncated link may end within an escape sequence.
function decoded(word) {
  try { return decodeURIComponent(word); } catch { return ""; }
}
// A link to a folded element opens its folds.
const unfold = () => {
  const target = located(decoded(location.hash.slice(1).split("?")[0]));
  document.querySelector(".aimed")?.classList.remove("aimed");
  if (!target) return;
  document.dispatchEvent(new CustomEvent("reveal", { detail: target }));
  if (target.tagName === "DETAILS") target.open = true;
  for (let fold = target.closest("details"); fold; fold = fold.parentElement.closest("details")) fold.open = true;
  for (const fold of [target, ...target.querySelectorAll("details")]) if (fold.open) buildWithin(fold);
  if (!target.matches(".tab, .part, section")) target.classList.add("aimed");
  target.scrollIntoView();
};
addEventListener("hashchange", unfold);
addEventListener("DOMContentLoaded", () => location.hash && unfold()); // when every script listens
// Print shows every fold of a page without tabs; afterwards their state is restored.
let printing = false;
let folded = [];
addEventListener("beforeprint", () => {
  printing = true;
  folded = [...document.querySelectorAll("details:not([open])")].filter((fold) => !fold.closest(".tab"));
  for (const details of folded) details.open = true;
});
addEventListener("afterprint", () => {
  for (const details of folded) details.open = false;
  setTimeout(() => { printing = false; }); // toggle events arrive later
});
