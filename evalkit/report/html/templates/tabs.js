// The three parts of a report: tabs by click and arrow keys; a part is built when it is first shown.
const tabs = [...document.querySelectorAll("[role=tab]")];

function showTab(tab) {
  for (const one of tabs) {
    const chosen = one === tab;
    one.setAttribute("aria-selected", String(chosen));
    one.tabIndex = chosen ? 0 : -1;
    document.getElementById(one.getAttribute("aria-controls")).hidden = !chosen;
  }
  buildWithin(document.getElementById(tab.getAttribute("aria-controls")));
}

tabs.forEach((tab, place) => {
  tab.addEventListener("click", () => {
    showTab(tab);
    link.write({}, tab.getAttribute("aria-controls"));
    scrollTo(0, 0);
  });
  tab.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step) return;
    const next = tabs[(place + step + tabs.length) % tabs.length];
    next.focus();
    next.click();
  });
});
document.addEventListener("reveal", ({ detail }) => {
  const part = detail.closest(".tab");
  if (part) showTab(tabs.find((tab) => tab.getAttribute("aria-controls") === part.id));
});
// Pointing at a method, or focusing its name, colours it in every chart; a click on a name keeps it coloured.
let pointed = "";
let pinned = "";
function point(label) {
  if (label === pointed) return;
  pointed = label;
  for (const part of document.querySelectorAll(".series, .tile")) {
    const own = part.dataset.of === label;
    part.classList.toggle("pointed", own);
    if (own && part instanceof SVGElement && part.parentNode.lastChild !== part) part.parentNode.append(part);
  }
}
for (const kind of ["pointerover", "focusin"]) {
  document.addEventListener(kind, ({ target }) => point(target.closest?.(".series, .tile")?.dataset.of ?? pinned));
}
document.addEventListener("click", ({ target }) => {
  const name = target.closest(".keys button");
  if (!name) return;
  pinned = pinned === name.dataset.of ? "" : name.dataset.of;
  for (const other of document.querySelectorAll(".keys button")) other.setAttribute("aria-pressed", String(other.dataset.of === pinned));
});
link.read();
