"use strict";
// Sorting: a heading's button orders the bodies of its table; rows without a value stay last.
for (const table of document.querySelectorAll("table.sortable")) {
  const headings = [...table.tHead.rows[0].cells];
  headings.forEach((heading, column) => {
    const button = heading.querySelector("button");
    if (!button) return;
    button.addEventListener("click", () => {
      const up = heading.getAttribute("aria-sort") !== "ascending";
      headings.forEach((other) => other.removeAttribute("aria-sort"));
      heading.setAttribute("aria-sort", up ? "ascending" : "descending");
      const key = (body) => body.rows[0].cells[column].dataset.sort ?? "";
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
for (const button of document.querySelectorAll("button.enlarge")) {
  button.addEventListener("click", () => {
    const image = button.querySelector("img");
    viewer.querySelector("img").src = image.src;
    viewer.querySelector("img").alt = image.alt;
    viewer.querySelector("p").textContent = image.alt;
    viewer.showModal();
  });
}
viewer.addEventListener("click", () => viewer.close());
// A truncated link may end within an escape sequence.
function decoded(word) {
  try { return decodeURIComponent(word); } catch { return ""; }
}
// A link to a folded element opens its folds.
const unfold = () => {
  const target = document.getElementById(decoded(location.hash.slice(1).split("?")[0]));
  document.querySelector(".aimed")?.classList.remove("aimed");
  target?.classList.add("aimed");
  for (let fold = target?.closest("details"); fold; fold = fold.parentElement.closest("details")) fold.open = true;
  target?.scrollIntoView();
};
addEventListener("hashchange", unfold);
if (location.hash) unfold();
// Print shows every fold; afterwards their state is restored.
let printing = false;
let folded = [];
addEventListener("beforeprint", () => {
  printing = true;
  folded = [...document.querySelectorAll("details:not([open])")];
  for (const details of folded) details.open = true;
});
addEventListener("afterprint", () => {
  for (const details of folded) details.open = false;
  setTimeout(() => { printing = false; }); // toggle events arrive later
});
// A click on a command selects all of it.
for (const command of document.querySelectorAll("code.command")) {
  command.addEventListener("click", () => getSelection().selectAllChildren(command));
}
